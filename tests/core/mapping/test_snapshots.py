from __future__ import annotations

import numpy as np
import pytest

from omnibotd.core.errors import MapError
from omnibotd.core.mapping import snapshots
from omnibotd.core.vision.view import RINGS, SECTORS


def test_a_snapshot_is_512_bytes_and_half_a_level_true() -> None:
    views = np.random.default_rng(0).uniform(-1.5, 3.75, (5, RINGS, SECTORS)).astype(np.float32)
    packed = snapshots.pack(views)
    assert packed.shape == (5, 512)
    assert packed.dtype == np.uint8
    # 16 levels over 5.25 standard deviations: 0.35 apart.
    np.testing.assert_allclose(snapshots.unpack(packed), views, atol=0.175 + 1e-5)


def test_what_is_out_of_range_saturates() -> None:
    views = np.zeros((1, RINGS, SECTORS), np.float32)
    views[0, 0, 0], views[0, 0, 1] = 50.0, -50.0
    back = snapshots.unpack(snapshots.pack(views))[0, 0]
    assert back[0] == pytest.approx(3.75)
    assert back[1] == pytest.approx(-1.5)


def test_the_even_cell_is_in_the_low_bits() -> None:
    views = np.full((1, RINGS, SECTORS), -1.5, np.float32)
    views[0, 0, 0] = 3.75
    packed = snapshots.pack(views)
    assert packed[0, 0] == 0x0F
    assert not packed[0, 1:].any()


def test_packing_again_changes_nothing() -> None:
    packed = np.random.default_rng(1).integers(0, 256, (3, 512)).astype(np.uint8)
    np.testing.assert_array_equal(snapshots.pack(snapshots.unpack(packed)), packed)


def test_other_shapes_are_refused() -> None:
    with pytest.raises(MapError, match="expected"):
        snapshots.pack(np.zeros((2, 8, 32), np.float32))
    with pytest.raises(MapError, match="another version"):
        snapshots.unpack(np.zeros((2, 128), np.uint8))
