"""The daemon with `odometry.heading` of another kind than wheels, with a simulated robot in virtual time."""

from __future__ import annotations

import math

import pytest

from omnibotd.core.geometry import Pose2D, wrap
from tools.sim import ceilings, virtual_time
from tools.sim.teacher import Area, Teacher
from tools.sim.virtual_robot import virtual_robot

START = Pose2D(0.0, 0.0, 0.5)
SECONDS = 60.0


def _drift(heading: str) -> tuple[Pose2D, Pose2D, Pose2D]:
    """True motion of the base over a minute of wandering, and the same by the wheels and by the daemon's odometry."""

    async def live() -> tuple[Pose2D, Pose2D, Pose2D]:
        world = ceilings.tiles(2)
        async with virtual_robot(world, 3, START, heading=heading) as robot:
            area = Area.to_teach(world, (0.0, 0.0), side=3.0, margin=0.6)
            control = robot.daemon.control
            begin = robot.pose, control.wheels.odom_from_base, control.odometry.odom_from_base
            await Teacher(robot, area, 3).wander(SECONDS)
            end = robot.pose, control.wheels.odom_from_base, control.odometry.odom_from_base
            true, wheels, odometry = (a.inverse() @ b for a, b in zip(begin, end, strict=True))
            return true, wheels, odometry

    return virtual_time.run(live())


@pytest.mark.parametrize("heading", ["fused", "compass"])
def test_sight_keeps_the_heading_that_wheels_lose(heading: str) -> None:
    true, wheels, odometry = _drift(heading)
    assert abs(wrap(wheels.yaw - true.yaw)) > math.radians(2.0)
    assert abs(wrap(odometry.yaw - true.yaw)) < math.radians(0.5)
    assert odometry.distance(true) < wheels.distance(true)


def test_by_the_wheels_there_is_one_odometry() -> None:
    _, wheels, odometry = _drift("wheels")
    assert odometry == wheels
