"""Alignment of two views of a synthetic plane whose displacement is known from how they were made."""

from __future__ import annotations

import math

import numpy as np
import pytest

from omnibotd.core.docking.alignment import AlignmentTarget, Effort, Layer
from omnibotd.core.docking.displacement import Displacement
from omnibotd.core.vision.frame import FloatImage

SIZE = 121
EFFORT = Effort(iterations=25, huber=1.0, with_scale=True, tolerance=1e-4)
FULL = np.full((SIZE, SIZE), 255, np.uint8)


def pattern(u: np.ndarray, v: np.ndarray) -> FloatImage:
    """A smooth function of the plane, without symmetry, that can be sampled anywhere."""
    value = np.sin(0.13 * u + 0.4) * np.cos(0.09 * v) + 0.7 * np.sin(0.05 * u - 0.11 * v) + 0.01 * u
    return np.asarray(value + 0.8 * np.exp(-((u - 12) ** 2 + (v + 9) ** 2) / 90), np.float32)


def grid() -> tuple[np.ndarray, np.ndarray]:
    axis = np.arange(SIZE) - (SIZE - 1) / 2
    return tuple(np.meshgrid(axis, axis))  # type: ignore[return-value]


def seen_from(yaw: float, u: float, v: float, scale: float = 1.0) -> Layer:
    """The view of a camera at (u, v) of the target view, turned by yaw: p_target = R(yaw) p / scale + (u, v)."""
    x, y = grid()
    c, s = math.cos(yaw), math.sin(yaw)
    return Layer(pattern((c * x - s * y) / scale + u, (s * x + c * y) / scale + v), FULL)


@pytest.mark.parametrize(("yaw", "u", "v"), [(0.1, 3.0, -2.0), (-0.12, -4.0, 1.5), (0.0, 0.0, 0.0), (3.1, 2.0, 4.0)])
def test_finds_a_known_displacement_to_a_fiftieth_of_a_pixel(yaw: float, u: float, v: float) -> None:
    target = AlignmentTarget(seen_from(0.0, 0.0, 0.0))
    start = Displacement.of_pose(yaw + 0.05, u + 1.5, v - 1.0)
    result = target.align(seen_from(yaw, u, v), start, EFFORT)
    found = result.displacement.pose()
    assert math.cos(found[0] - yaw) == pytest.approx(1.0, abs=1e-7)
    assert found[1:] == pytest.approx((u, v), abs=0.02)
    assert result.score > 0.99


def test_finds_the_scale() -> None:
    target = AlignmentTarget(seen_from(0.0, 0.0, 0.0))
    result = target.align(seen_from(0.05, 2.0, 1.0, scale=1.05), Displacement.of_pose(0.0, 0.0, 0.0), EFFORT)
    assert math.exp(result.displacement.log_scale) == pytest.approx(1.05, abs=1e-3)
    assert result.displacement.pose() == pytest.approx((0.05, 2.0, 1.0), abs=0.03)


def test_gain_and_offset_change_nothing() -> None:
    target = AlignmentTarget(seen_from(0.0, 0.0, 0.0))
    dark = Layer(np.asarray(0.3 * seen_from(0.1, 2.0, 1.0).feature - 5.0, np.float32), FULL)
    found = target.align(dark, Displacement.of_pose(0.05, 1.0, 0.0), EFFORT).displacement.pose()
    assert found == pytest.approx((0.1, 2.0, 1.0), abs=0.02)


def test_a_flat_view_takes_no_step_and_scores_nothing() -> None:
    flat = Layer(np.zeros((SIZE, SIZE), np.float32), FULL)
    result = AlignmentTarget(flat).align(flat, Displacement.of_pose(0.2, 3.0, 1.0), EFFORT)
    assert result.displacement.pose() == pytest.approx((0.2, 3.0, 1.0), abs=1e-6)
    assert result.score == pytest.approx(0.0, abs=1e-6)


def test_views_that_do_not_overlap_score_minus_one() -> None:
    target = AlignmentTarget(seen_from(0.0, 0.0, 0.0))
    assert target.align(seen_from(0.0, 0.0, 0.0), Displacement.of_pose(0.0, 0.0, 118.0), EFFORT).score == -1.0


@pytest.mark.parametrize("displacement", [Displacement(0.4, 3.0, -2.0), Displacement(-2.0, 1.0, 5.0, 0.1)])
def test_pose_undoes_the_displacement(displacement: Displacement) -> None:
    """The current axis (0, 0) is the image of the pose's point."""
    _, u, v = displacement.pose()
    assert displacement.linear() @ (u, v) + (displacement.u, displacement.v) == pytest.approx(np.zeros(2), abs=1e-9)
    yaw, _, _ = displacement.pose()
    assert math.cos(yaw + displacement.angle) == pytest.approx(1.0)
