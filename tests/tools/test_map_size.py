"""The codes that maps are compared by."""

from __future__ import annotations

import math

import numpy as np
import pytest

from omnibotd.core.geometry import Pose2D
from omnibotd.core.vision.view import RINGS, SECTORS
from tools import map_size

VIEWS = np.random.default_rng(1).normal(size=(8, RINGS, SECTORS)).astype(np.float32)
SPREAD = np.full(SECTORS // 2 + 1, math.sqrt(0.5))  # of the parts of white noise, but for the first and last order


def test_finer_steps_cost_more_and_lose_less() -> None:
    codes = [map_size.harmonics(step, SPREAD) for step in (1.5, 0.7, 0.3, 0.1)]
    losses = [float(((code.restored(VIEWS) - VIEWS) ** 2).mean()) for code in codes]
    assert [code.bytes for code in codes] == sorted(code.bytes for code in codes)
    assert all(code.packed(VIEWS).shape == (8, code.bytes) for code in codes)
    assert losses == sorted(losses, reverse=True)
    assert losses[-1] < 0.02


def test_cells_lose_their_rounding() -> None:
    code = map_size.cells(4, -1.5, 0.35)
    assert code.bytes == code.packed(VIEWS).shape[1] == 512
    inside = np.clip(VIEWS, -1.5, 3.7)
    np.testing.assert_allclose(code.restored(inside), inside, atol=0.175 + 1e-5)


def test_the_products_own_code_is_among_them_and_cells_for_comparison() -> None:
    sizes = {code.name: code.bytes for code in map_size.codes(VIEWS)}
    assert sizes["omnibotd"] == 160
    assert sizes["cells, 4 bits"] == 512


def test_a_map_is_laid_onto_the_truth_by_a_turn_and_a_shift() -> None:
    truth = np.random.default_rng(2).uniform(-2.0, 2.0, (30, 3))
    map_from_world = Pose2D(1.0, -2.0, 0.4)
    found = [map_from_world @ Pose2D(*row) for row in truth]
    to_truth = map_size.onto_truth(np.array([(pose.x, pose.y, pose.yaw) for pose in found]), truth)
    assert to_truth(map_from_world @ Pose2D(0.3, 0.7)) == pytest.approx(complex(0.3, 0.7))
