"""What likeness means is learnt from the map."""

from __future__ import annotations

import numpy as np
import pytest

from omnibotd.core.mapping import snapshots
from omnibotd.core.mapping.topo_map import Edges, TopoMap
from omnibotd.core.navigation.likeness import Likeness, measure
from omnibotd.core.navigation.node_index import NodeIndex
from omnibotd.core.vision.descriptor import Descriptor
from omnibotd.core.vision.view import RINGS, SECTORS, View


def a_map(views: View, x: np.ndarray) -> TopoMap:
    count = len(views)
    poses = np.column_stack([x, np.zeros(count), np.zeros(count)]).astype(np.float32)
    none = np.zeros(0, np.int32)
    units = np.arange(count, dtype=np.uint16) // 20
    spectra = Descriptor.spectrum(views)
    codebook = np.array([spectra[units == unit].mean(0) for unit in np.unique(units)])
    edges = Edges(none, none, none.astype(np.uint8))
    return TopoMap("m", codebook, units, snapshots.pack(views), poses, np.zeros(count, np.uint16), edges)


def moving_views(count: int, step: float, length: float, rng: np.random.Generator) -> View:
    """Views of unit variance whose correlation falls as exp(-distance / length), `step` metres apart."""
    keep = np.exp(-step / length)
    views = [rng.standard_normal((RINGS, SECTORS))]
    for _ in range(count - 1):
        views.append(keep * views[-1] + np.sqrt(1.0 - keep**2) * rng.standard_normal((RINGS, SECTORS)))
    return np.array(views, np.float32)


@pytest.mark.parametrize("length", [0.4, 0.8])
def test_reach_grows_with_the_length_over_which_views_stay_alike(length: float) -> None:
    rng = np.random.default_rng(1)
    likeness = measure(NodeIndex(a_map(moving_views(120, 0.05, length, rng), np.arange(120) * 0.05)))
    # exp(-d / l) = 1 - c gives d / c = l * -ln(1 - c) / c: between l and 1.28 l for c up to 0.4; the coding adds noise.
    assert 0.8 * length < likeness.reach < 1.4 * length


def test_repeating_views_raise_what_chance_reaches() -> None:
    rng = np.random.default_rng(2)
    views, x = moving_views(80, 0.05, 0.5, rng), np.arange(80) * 0.05
    alone = measure(NodeIndex(a_map(views, x)))
    twice = measure(NodeIndex(a_map(np.concatenate([views, views]), np.r_[x, x + 5.0])))
    assert alone.chance < 0.6
    assert twice.chance > 0.9


def test_a_map_too_small_to_tell_is_taken_as_usual() -> None:
    views = np.random.default_rng(3).standard_normal((3, RINGS, SECTORS)).astype(np.float32)
    assert measure(NodeIndex(a_map(views, np.array([0.0, 0.1, 0.2])))) == Likeness()
