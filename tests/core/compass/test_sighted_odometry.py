"""Corrections of the wheels' pose, and what a heading by compass makes of their steps."""

from __future__ import annotations

import math
from functools import cache

import pytest

from omnibotd.core.compass.sighted_odometry import HeadingOnly, Sight, SightedOdometry, sight
from omnibotd.core.compass.turn import NO_TURN, Turn
from omnibotd.core.geometry import Pose2D
from omnibotd.core.kinematics import DifferentialDrive
from omnibotd.core.odometry import WheelOdometry
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from tools.sim import ceilings
from tools.sim.world import World

FRAME = Frame(0.0, b"")
CAMERA = CameraModel.equidistant(640, 480, math.radians(190.0))


class Says:
    """A compass that says what it is told to."""

    def __init__(self, *turns: Turn) -> None:
        self._turns = list(turns)

    def turn(self, frame: Frame) -> Turn:
        return self._turns.pop(0)


def wheels_after(*ticks: tuple[int, int]) -> WheelOdometry:
    wheels = WheelOdometry(DifferentialDrive(0.05, 0.2))
    for number, (left, right) in enumerate(ticks):
        wheels.update(float(number), left, right, 1000.0)
    return wheels


def test_without_a_correction_it_is_the_wheels() -> None:
    wheels = wheels_after((0, 0), (100, 120), (300, 310))
    odometry = SightedOdometry(wheels)
    assert odometry.odom_from_base == wheels.odom_from_base
    assert odometry.at(1.5) == wheels.at(1.5)
    assert odometry.distance == wheels.distance


def test_a_correction_moves_the_pose_then_and_what_was_driven_since_with_it() -> None:
    wheels = wheels_after((0, 0), (100, 100), (200, 200))
    odometry = SightedOdometry(wheels)
    step = math.pi * 0.1 / 10.0
    odometry.correct(Pose2D(1.0, 2.0, math.pi / 2.0), wheels.at(1.0))
    at, now = odometry.at(1.0), odometry.odom_from_base
    assert (at.x, at.y, at.yaw) == pytest.approx((1.0, 2.0, math.pi / 2.0))
    assert (now.x, now.y, now.yaw) == pytest.approx((1.0, 2.0 + step, math.pi / 2.0))


def follow(only: HeadingOnly, *by_wheels: Pose2D) -> Pose2D:
    pose = Pose2D()
    for each in by_wheels:
        pose = only.update(FRAME, each)
    return pose


def test_heading_is_the_compass_and_length_the_wheels() -> None:
    """On an arc of a quarter turn that the wheels took for a straight line of the chord's length."""
    pose = follow(HeadingOnly(Says(NO_TURN, Turn(math.pi / 2.0, 1))), Pose2D(), Pose2D(1.0))
    assert (pose.x, pose.y) == pytest.approx((math.sqrt(0.5), math.sqrt(0.5)))
    assert pose.yaw == pytest.approx(math.pi / 2.0)


def test_where_the_compass_cannot_tell_it_goes_by_the_wheels() -> None:
    by_wheels = Pose2D(0.1, 0.02, 0.3)
    assert follow(HeadingOnly(Says(NO_TURN, NO_TURN)), Pose2D(), by_wheels).yaw == pytest.approx(0.3)


@pytest.mark.parametrize(("seen", "low", "high"), [(0.02, 0.005, 0.02), (0.5, 0.0, 0.0)])
def test_fused_lies_between_the_two_unless_they_contradict(seen: float, low: float, high: float) -> None:
    pose = follow(HeadingOnly(Says(NO_TURN, Turn(seen, 1)), spread=0.004), Pose2D(), Pose2D(0.03))
    assert low <= pose.yaw <= high


@pytest.mark.parametrize("heading", ["compass", "fused"])
@pytest.mark.parametrize("compass", ["tracker", "registration", "two_point", "image_flow", "labrosse"])
def test_all_that_can_be_configured_follows_a_slow_turn(heading: str, compass: str) -> None:
    """Wheels that tell only of two thirds of a turn of 0.012 rad a frame, and are weighed where fused."""
    found = follow_turn(sight(heading, compass, CAMERA, 2.2, 0.1), 8)
    weighed = heading == "fused" and compass not in ("tracker", "registration")
    assert 7 * (0.0079 if weighed else 0.0100) < found < 7 * 0.0135


def follow_turn(made: Sight, frames: int) -> float:
    pose = Pose2D()
    for number in range(frames):
        image = room().render(0.3, -0.2, 0.4 + 0.012 * number, 0.0)
        pose = made.update(Frame(0.0, image), Pose2D(0.0, 0.0, 0.008 * number))
    return pose.yaw


@cache
def room() -> World:
    return ceilings.tiles(22)
