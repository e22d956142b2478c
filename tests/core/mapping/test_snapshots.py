"""Snapshots: as true as their bytes allow, stable, and as documented."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from omnibotd.core.errors import MapError
from omnibotd.core.mapping import snapshots
from omnibotd.core.vision.view import RINGS, SECTORS, View
from omnibotd.io import map_format

FORMAT = Path(map_format.__file__).with_name("MAP_FORMAT.md")
BEARINGS = 2.0 * np.pi * np.arange(SECTORS) / SECTORS


def documented_ring() -> Callable[[bytes], list[float]]:
    """The decoder printed in MAP_FORMAT.md."""
    found = re.search(r"```python\n(.*?)```", FORMAT.read_text("utf-8"), re.DOTALL)
    assert found
    scope: dict[str, Any] = {}
    exec(found[1], scope)
    ring: Callable[[bytes], list[float]] = scope["ring"]
    return ring


def random_bytes(count: int, seed: int = 0) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return np.random.default_rng(seed).integers(0, 256, (count, snapshots.BYTES)).astype(np.uint8)


def ceiling_like(count: int, seed: int) -> View:
    """Views whose power falls with the order as those of ceilings do, mean 0, variance 1."""
    rng = np.random.default_rng(seed)
    orders = np.arange(SECTORS // 2 + 1)
    spectra = rng.normal(size=(count, RINGS, len(orders), 2)) @ np.array([1.0, 1j]) / (1.0 + orders) ** 0.7
    views = np.fft.irfft(spectra, n=SECTORS, axis=-1)
    views -= views.mean((1, 2), keepdims=True)
    return (views / views.std((1, 2), keepdims=True)).astype(np.float32)


def test_ten_bytes_a_ring() -> None:
    packed = snapshots.pack(np.zeros((5, RINGS, SECTORS), np.float32))
    assert (packed.shape, packed.dtype) == ((5, 160), np.uint8)
    back = snapshots.unpack(packed)
    assert (back.shape, back.dtype) == ((5, RINGS, SECTORS), np.float32)
    assert snapshots.unpack(packed[:0]).shape == (0, RINGS, SECTORS)


def test_it_is_decoded_as_documented() -> None:
    packed = random_bytes(3)
    packed[1, 30:40] = 0
    ring = documented_ring()
    for snapshot, view in zip(packed, snapshots.unpack(packed), strict=True):
        for number, cells in enumerate(view):
            np.testing.assert_allclose(cells, ring(bytes(snapshot[10 * number : 10 * number + 10])), atol=1e-4)


def test_the_documented_example() -> None:
    packed = random_bytes(1)
    packed[0, 0] = 0xB4
    first = snapshots.unpack(packed)[0, 0].astype(float)
    assert first.mean() == pytest.approx(0.35, abs=1e-5)
    assert first @ np.cos(BEARINGS) / 8.0 == pytest.approx(-1.2, abs=1e-4)


@pytest.mark.parametrize(("order", "lowest"), [(1, -3.2), (5, -3.2), (6, -1.6), (13, -1.6), (14, -0.8), (20, -0.8)])
def test_within_its_range_a_coefficient_is_true_to_half_a_step(order: int, lowest: float) -> None:
    for value in np.linspace(lowest + 0.01, -lowest - 0.01, 9):
        # c cos(k b) has Re F(k) = c * 32 / 8.
        views = np.full((1, RINGS, SECTORS), value / 4.0, np.float32) * np.cos(order * BEARINGS).astype(np.float32)
        found = snapshots.unpack(snapshots.pack(views))[0] @ np.exp(-1j * order * BEARINGS) / 8.0
        np.testing.assert_allclose(found.real, value, atol=0.4 + 1e-4)


def test_what_is_out_of_range_saturates() -> None:
    views = np.full((1, RINGS, SECTORS), 50.0, np.float32)
    assert snapshots.unpack(snapshots.pack(views)).mean() == pytest.approx(7.5 * 0.8 / 8.0, abs=1e-4)
    assert snapshots.unpack(snapshots.pack(-views)).mean() == pytest.approx(-7.5 * 0.8 / 8.0, abs=1e-4)


def test_views_like_those_of_ceilings_come_back_alike() -> None:
    views = ceiling_like(20, seed=3)
    back = snapshots.unpack(snapshots.pack(views))
    likeness = [np.corrcoef(a.ravel(), b.ravel())[0, 1] for a, b in zip(views, back, strict=True)]
    # Independent errors of step^2 / 12 in 39 parts of 64 leave 0.97; the orders left out hold a tenth of the power.
    assert min(likeness) > 0.85


def test_a_turned_view_is_not_taken_for_another() -> None:
    views = ceiling_like(1, seed=4)
    back = snapshots.unpack(snapshots.pack(np.stack([np.roll(views[0], shift, -1) for shift in range(0, SECTORS, 5)])))
    for shift, view in zip(range(0, SECTORS, 5), back, strict=True):
        likeness = [np.corrcoef(np.roll(views[0], turn, -1).ravel(), view.ravel())[0, 1] for turn in range(SECTORS)]
        assert int(np.argmax(likeness)) == shift


def test_packing_again_changes_nothing() -> None:
    packed = random_bytes(50, seed=1)
    np.testing.assert_array_equal(snapshots.pack(snapshots.unpack(packed)), packed)


def test_a_ring_that_is_not_seen_stays_empty() -> None:
    views = ceiling_like(2, seed=5)
    views[:, 12:] = 0.0
    back = snapshots.unpack(snapshots.pack(views))
    assert not back[:, 12:].any()
    assert (back[:, :12].std(-1) > 0.1).all()


def test_other_shapes_are_refused() -> None:
    with pytest.raises(MapError, match="expected"):
        snapshots.pack(np.zeros((2, 8, 32), np.float32))
    for shape in [(2, 128), (2, 512), (160,)]:
        with pytest.raises(MapError, match="another version"):
            snapshots.unpack(np.zeros(shape, np.uint8))
