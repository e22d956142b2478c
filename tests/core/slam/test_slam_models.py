"""Motion and bearing models: derivatives beside central differences, and the cases without a bearing or a turn."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D
from omnibotd.core.slam.bearing import crossing, of_points, of_rays, ray_point
from omnibotd.core.slam.motion import VelocityNoise, WheelNoise, WheelStep, constant_velocity, wheel_motion

Floats = NDArray[np.float64]
NOISE = VelocityNoise()


def slopes(function: Callable[[Floats], Floats], at: Floats) -> Floats:
    """Central differences."""
    step = 1e-6
    columns = [(function(at + step * e) - function(at - step * e)) / (2.0 * step) for e in np.eye(len(at))]
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("turn", [0.0, 1e-9, -1e-9, 0.05, 0.06, -1.5, 40.0])
def test_constant_velocity_derivative(turn: float) -> None:
    vehicle = np.array([0.3, -0.2, 3.1, 0.6, turn])
    found = constant_velocity(vehicle, 1 / 30, NOISE)
    expected = slopes(lambda v: constant_velocity(v, 1 / 30, NOISE).mean, vehicle)
    assert found.jacobian == pytest.approx(expected, abs=1e-8)


def test_constant_velocity_moves_on_the_circle_of_the_thesis() -> None:
    """Eq 5.3 as printed, where the turn rate is not zero."""
    th, v, w, dt = 0.4, 0.7, 1.3, 0.5
    found = constant_velocity(np.array([1.0, 2.0, th, v, w]), dt, NOISE).mean
    x = 1.0 - v / w * math.sin(th) + v / w * math.sin(th + w * dt)
    y = 2.0 + v / w * math.cos(th) - v / w * math.cos(th + w * dt)
    assert found == pytest.approx([x, y, th + w * dt, v, w], abs=1e-12)


def test_turn_rate_goes_to_nothing_without_a_jump() -> None:
    straight = constant_velocity(np.array([0, 0, 0.7, 0.5, 0.0]), 1 / 30, NOISE)
    for turn in (1e-9, -1e-9):
        bent = constant_velocity(np.array([0, 0, 0.7, 0.5, turn]), 1 / 30, NOISE)
        assert bent.mean[:4] == pytest.approx(straight.mean[:4], abs=1e-10)
        assert bent.jacobian == pytest.approx(straight.jacobian, abs=1e-10)


def test_wheel_motion_derivative_and_noise_along_the_heading() -> None:
    step = WheelStep(Pose2D(0.2, 0.01, 0.3), 0.2, 0.3)
    vehicle = np.array([1.0, 2.0, math.pi / 2])
    found = wheel_motion(vehicle, step, WheelNoise(along=0.1, across=0.0))
    expected = slopes(lambda v: wheel_motion(v, step, WheelNoise()).mean, vehicle)
    assert found.jacobian == pytest.approx(expected, abs=1e-8)
    assert found.noise[1, 1] == pytest.approx(0.1**2 * 0.2, rel=1e-3)
    assert found.noise[0, 0] < 1e-9


@pytest.mark.parametrize("point", [(2.0, 1.0), (-3.0, 0.0), (-3.0, -1e-7), (0.5, -4.0)])
def test_bearing_of_a_point_derivative(point: tuple[float, float]) -> None:
    both = np.array([0.1, -0.1, 0.2, *point])
    seen = of_points(both[:3], both[None, 3:])

    def turned(v: Floats) -> Floats:
        """Without a jump at half a turn."""
        return np.angle(np.exp(1j * (of_points(v[:3], v[None, 3:]).bearings - seen.bearings)))

    found = np.hstack([seen.by_pose, seen.by_landmark])
    assert found == pytest.approx(slopes(turned, both), abs=1e-7)


def test_bearing_of_a_ray_derivative() -> None:
    both = np.array([0.5, -0.3, 0.4, 0.1, 0.2, -0.6, 0.35])
    seen = of_rays(both[:3], both[None, 3:])
    expected = slopes(lambda v: of_rays(v[:3], v[None, 3:]).bearings, both)
    assert np.hstack([seen.by_pose, seen.by_landmark]) == pytest.approx(expected, abs=1e-7)


def test_a_ray_and_its_point_are_seen_in_one_direction() -> None:
    ray, pose = np.array([0.1, 0.2, -0.6, 0.35]), np.array([0.5, -0.3, 0.4])
    point, jacobian = ray_point(ray)
    assert of_rays(pose, ray[None]).bearings == pytest.approx(of_points(pose, point[None]).bearings, abs=1e-12)
    assert jacobian == pytest.approx(slopes(lambda r: ray_point(r)[0], ray), abs=1e-6)


def test_a_landmark_in_the_robot_has_no_bearing() -> None:
    pose = np.array([1.0, 1.0, 0.0])
    seen = of_points(pose, np.array([[1.0, 1.0], [2.0, 1.0]]))
    assert seen.valid.tolist() == [False, True]
    assert np.isfinite(seen.by_pose).all()


def test_crossing_is_exact_and_its_derivatives_are() -> None:
    point = np.array([2.0, 1.5])
    poses = np.array([0.0, 0.0, 0.1, 0.5, -0.4, 0.6])
    a1, a2 = (float(of_points(pose, point[None]).bearings[0]) for pose in poses.reshape(2, 3))
    met = crossing(poses[:3], a1, poses[3:], a2)
    assert met is not None
    assert met.point == pytest.approx(point, abs=1e-12)
    assert met.ranges == pytest.approx([np.hypot(2.0, 1.5), np.hypot(1.5, 1.9)])

    def point_of(v: Floats) -> Floats:
        again = crossing(v[:3], v[6], v[3:6], v[7])
        assert again is not None
        return again.point

    expected = slopes(point_of, np.array([*poses, a1, a2]))
    found = np.column_stack([met.by_first, met.by_second, *met.by_bearings])
    assert found == pytest.approx(expected, abs=1e-6)


def test_parallel_bearings_do_not_cross_and_diverging_ones_meet_behind() -> None:
    first, second = np.zeros(3), np.array([0.0, 1.0, 0.0])
    assert crossing(first, 0.3, second, 0.3) is None
    met = crossing(first, -0.3, second, 0.3)
    assert met is not None
    assert max(met.ranges) < 0.0
