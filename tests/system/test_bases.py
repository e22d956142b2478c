"""The whole daemon on bases of other makers, in virtual time."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D, Twist2D
from omnibotd.core.safety import danger
from tests.empty_hall import EmptyHall
from tools.sim import virtual_time
from tools.sim.virtual_robot import VirtualRobot, virtual_robot

BASES = ("omnibot", "create2", "arduino_bridge")


class Ahead:
    """A job that drives on until a danger ends it."""

    def step(self, seen: Observation) -> Decision:
        return Decision("AHEAD", Twist2D(0.2, 0.0), danger(seen))


async def by_odometry(robot: VirtualRobot) -> Pose2D:
    robot.daemon.control.absorb()
    return robot.daemon.control.odometry.odom_from_base


@pytest.mark.parametrize("base", BASES)
def test_drives_turns_and_tells_where_it_went(base: str) -> None:
    async def live() -> tuple[Pose2D, Pose2D, dict[str, Any]]:
        async with virtual_robot(EmptyHall(), 1, Pose2D(), base=base) as robot:
            for vx, wz, seconds in ((0.2, 0.3, 3.0), (-0.1, 0.0, 2.0), (0.0, -0.8, 2.0)):
                await robot.call("drive", vx=vx, wz=wz, **{"for": seconds})
                await asyncio.sleep(1.0)
            return robot.pose, await by_odometry(robot), await robot.call("status")

    truth, told, status = virtual_time.run(live())
    assert math.hypot(truth.x, truth.y) > 0.2
    # Each robot's wheels differ from what it knows of them by a percent or two, and slip.
    assert told.distance(truth) < 0.03
    assert abs(told.yaw - truth.yaw) < 0.06
    assert (status["base"]["driver"], status["base"]["connected"]) == (base, True)


def test_a_roomba_taken_over_by_its_button_ends_the_job_and_stands() -> None:
    async def live() -> tuple[Outcome, bool, float]:
        async with virtual_robot(EmptyHall(), 1, Pose2D(-2.0, 0.0, 0.0), base="create2") as robot:
            ended = robot.daemon.control.start("ahead", Ahead(), None)
            await asyncio.sleep(1.0)
            was_moving = robot.device.target != (0.0, 0.0)
            robot.device.press_clean()
            outcome = await asyncio.wait_for(ended, 0.5)
            before = robot.pose.x
            await asyncio.sleep(2.0)
            assert robot.device.target == (0.0, 0.0)
            return outcome, was_moving, robot.pose.x - before

    outcome, was_moving, moved = virtual_time.run(live())
    assert outcome.error is ErrorName.BASE_LINK_DOWN and was_moving
    assert moved < 0.05


def test_a_roomba_charges_when_it_has_come_to_rest_on_its_dock_and_leaves_it_when_driven_back() -> None:
    hall = EmptyHall()

    async def live() -> list[tuple[bool, float]]:
        found = []
        start = Pose2D(*hall.dock) @ Pose2D(-0.3, 0.0)
        async with virtual_robot(hall, 1, start, base="create2") as robot:
            for vx, seconds in ((0.1, 4.0), (0.0, 2.0), (-0.1, 3.0)):
                await robot.call("drive", vx=vx, wz=0.0, **{"for": seconds})
                await asyncio.sleep(0.3)
                latest = robot.daemon.control._base.latest
                assert latest is not None
                found.append((bool(latest.charging), robot.pose.distance(Pose2D(*hall.dock))))
        return found

    (touched, at_touch), (charging, _), (left, away) = virtual_time.run(live())
    assert touched and charging and not left
    assert at_touch < 0.03 and away > 0.1
