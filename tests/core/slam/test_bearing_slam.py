"""The filter as a whole, on made drives: maps, gaps, misread bearings, and what it says of itself."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from omnibotd.core.geometry import Pose2D
from omnibotd.core.slam.association import NearestNeighbour
from omnibotd.core.slam.bearing_slam import BearingSlam
from omnibotd.core.slam.consistency import State, chi_square_band
from omnibotd.core.slam.delayed import TwoBearings
from omnibotd.core.slam.motion import VelocityNoise, WheelNoise, WheelStep
from omnibotd.core.slam.several import SeveralBearings
from omnibotd.core.slam.sighting import Bearing, Frozen, Initialiser
from omnibotd.core.slam.undelayed import InverseDepth
from tools.reproduction.slam_simulation import RING, drive, rolling, views

WHEELS = WheelNoise()
EXACT = WheelNoise(1e-6, 1e-6, 1e-6, 1e-6)
INITIALISERS = (TwoBearings, SeveralBearings, InverseDepth)


def step(a: np.ndarray, b: np.ndarray) -> WheelStep:
    move = Pose2D(*a).inverse() @ Pose2D(*b)
    return WheelStep(move, math.hypot(move.x, move.y), abs(move.yaw))


def driven(initialiser: Initialiser, noise: float, seconds: int = 40, wheels: WheelNoise = WHEELS) -> BearingSlam:
    """Wheels without error, landmarks on a ring."""
    poses, slam = drive(30 * seconds)[::15], BearingSlam(initialiser, noise)
    for i, view in enumerate(views(poses, RING, math.tau, noise, np.random.default_rng(3))):
        if i:
            slam.roll(step(poses[i - 1], poses[i]), wheels)
        slam.look(view, i / 2.0)
    return slam


@pytest.mark.parametrize("initialiser", INITIALISERS)
def test_landmarks_are_where_they_are(initialiser: Callable[[], Initialiser]) -> None:
    slam = driven(initialiser(), math.radians(0.3))
    assert len(slam.names) == len(RING)
    off = [np.hypot(*(slam.landmark(i).point - point)) for i, point in enumerate(RING)]
    assert np.median(off) < 0.1
    assert slam.health.state is State.CONSISTENT
    assert np.linalg.eigvalsh(slam.belief.covariance)[0] > -1e-12


def test_two_exact_bearings_from_exact_poses_find_the_landmark() -> None:
    slam, point = BearingSlam(TwoBearings(), 0.0), np.array([2.0, 1.0])
    slam.look([Bearing("lamp", math.atan2(1.0, 2.0))], 0.0)
    slam.roll(WheelStep(Pose2D(1.0, 0.0, 0.0), 1.0, 0.0), EXACT)
    slam.look([Bearing("lamp", math.atan2(1.0, 1.0))], 1.0)
    assert slam.landmark("lamp").point == pytest.approx(point, abs=1e-6)
    assert not any(isinstance(name, Frozen) for name in slam.belief.names)


def test_thesis_forgets_a_landmark_that_was_lost_before_it_was_mapped() -> None:
    slam = BearingSlam(TwoBearings(), 0.01)
    slam.look([Bearing("lamp", 0.5)], 0.0)
    assert slam.belief.names == (Frozen(0.0),)
    slam.look([], 1.0)
    assert slam.belief.names == ()


def test_several_bearings_wait_over_a_gap_of_the_view() -> None:
    slam = BearingSlam(SeveralBearings(), 0.01)
    for i, x in enumerate((0.0, 0.5, 1.0, 1.5)):
        if i:
            slam.roll(WheelStep(Pose2D(0.5, 0.0, 0.0), 0.5, 0.0), WHEELS)
        slam.look([Bearing("lamp", math.atan2(2.0, 1.5 - x))], 10.0 * i)
        slam.look([], 10.0 * i + 5.0)
    assert slam.landmark("lamp").point == pytest.approx([1.5, 2.0], abs=0.02)


def test_constant_velocity_finds_its_speed_from_known_landmarks() -> None:
    """And comes back after two seconds without any, and over the jump of the heading at half a turn."""
    poses, slam = drive(600), BearingSlam(TwoBearings(), math.radians(0.9), moving=True)
    for i, point in enumerate(RING):
        slam.know(i, point, 1e-4)
    for i, view in enumerate(views(poses, RING, math.tau, math.radians(0.9), np.random.default_rng(0))):
        if i:
            slam.coast(1 / 30, VelocityNoise())
        slam.look([] if 300 <= i < 360 else view, i / 30)
    assert np.hypot(*(slam.belief.pose - poses[-1])[:2]) < 0.1
    speed = 30 * np.hypot(*(poses[-1] - poses[-2])[:2])
    assert slam.belief.mean[3] == pytest.approx(speed, abs=0.15)
    assert slam.health.state is State.CONSISTENT


def test_misread_bearings_are_refused() -> None:
    slam = driven(InverseDepth(), math.radians(0.5))
    before = slam.pose
    slam.look([Bearing(0, 2.0)], 99.0)
    assert slam.pose == before


def test_wheels_that_lie_are_noticed() -> None:
    """Turning is reported a third too small, and the filter is told that wheels are exact."""
    poses, slam = drive(1800)[::15], BearingSlam(InverseDepth(), math.radians(0.5))
    for i, view in enumerate(views(poses, RING, math.tau, math.radians(0.5), np.random.default_rng(3))):
        if i:
            true = step(poses[i - 1], poses[i])
            less = Pose2D(true.move.x, true.move.y, true.move.yaw / 1.5)
            slam.roll(WheelStep(less, true.rolled, true.turned), WheelNoise(0.01, 0.005, 0.01, 0.01))
        slam.look(view, i / 2.0)
    assert slam.health.state is State.DIVERGED
    assert slam.health.reason


def test_without_bearings_it_says_that_it_is_blind() -> None:
    slam = BearingSlam(InverseDepth(), 0.01)
    slam.roll(WheelStep(Pose2D(1.0, 0.0, 0.0), 1.0, 0.0), WHEELS)
    slam.look([], 1.0)
    assert slam.pose.x == pytest.approx(1.0)
    assert slam.health.state is State.BLIND


def test_bearings_without_names_find_theirs() -> None:
    poses, slam, names = drive(900)[::5], BearingSlam(InverseDepth(), math.radians(0.5)), NearestNeighbour()
    for i, view in enumerate(views(poses, RING, math.tau, math.radians(0.5), np.random.default_rng(3))):
        if i:
            slam.roll(step(poses[i - 1], poses[i]), WHEELS)
        slam.look(names.named(slam, [bearing.angle for bearing in view]), i / 6.0)
    assert np.hypot(*(slam.belief.pose - poses[-1])[:2]) < 0.1
    points = np.array([slam.landmark(name).point for name in slam.names])
    near = np.hypot(*(points[:, None] - RING).transpose(2, 0, 1)).min(axis=0)
    assert (near < 0.3).all()


@pytest.mark.slow
@pytest.mark.parametrize("initialiser", [SeveralBearings, InverseDepth])
def test_errors_are_as_large_as_the_filter_says(initialiser: Callable[[], Initialiser]) -> None:
    """NEES over 50 seeds, within its 95 % band."""
    poses = drive(900)[::15]
    nees = [rolling(poses, RING, initialiser(), math.radians(1.0), WHEELS, seed).last_nees for seed in range(50)]
    low, high = chi_square_band(3, 50)
    assert low < np.mean(nees) / 3.0 < high


def test_who_may_be_far_off_says_so() -> None:
    """A minute of careless wheels between two looks at the map; innovations cannot tell, the covariance can."""
    slam = driven(InverseDepth(), math.radians(0.5))
    careless = WheelNoise(along=0.5, across=0.5)
    slam.roll(WheelStep(Pose2D(0.1, 0.0, 0.0), 4.0, 0.0), careless)
    assert slam.health.state is State.VAGUE
    assert "m off" in slam.health.reason


@pytest.mark.parametrize("initialiser", INITIALISERS)
def test_of_two_bearings_of_one_name_none_is_believed(initialiser: Callable[[], Initialiser]) -> None:
    slam = driven(initialiser(), math.radians(0.3))
    before = slam.belief.mean.copy()
    slam.look([Bearing(0, 0.3), Bearing(0, 1.0), Bearing("new", 0.3), Bearing("new", 1.0)], 100.0)
    assert "new" not in slam.names
    assert slam.belief.mean == pytest.approx(before, abs=0.0)


def test_names_given_at_random_are_no_trouble_but_noticed() -> None:
    """A third of the bearings under any name, now and then twice in a view, while landmarks come and go."""
    rng, poses, slam = np.random.default_rng(8), drive(30 * 60)[::15], BearingSlam(InverseDepth(), math.radians(0.5))
    for i, view in enumerate(views(poses, RING, math.tau, math.radians(0.5), rng)):
        if i:
            slam.roll(step(poses[i - 1], poses[i]), WHEELS)
        names = [one.name if rng.random() > 0.4 else int(rng.integers(len(RING))) for one in view]
        slam.look([Bearing(name, one.angle) for name, one in zip(names, view, strict=True)], i / 2.0)
    assert slam.health.state is State.DIVERGED
