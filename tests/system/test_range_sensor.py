"""The whole way of a range: simulated sensor, bytes of the base, driver, observation, safety gate, wheels."""

import asyncio
import math

import cv2
import numpy as np
import pytest

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.geometry import Pose2D, Twist2D
from tools.sim import virtual_time
from tools.sim.plant import ROBOT_RADIUS
from tools.sim.virtual_robot import virtual_robot

WALL = 3.0  # m ahead of the middle


class Room:
    """An empty square room under a picture that never changes."""

    fov_deg = 190.0
    bounds = (-WALL, -WALL, WALL, WALL)
    dock = (WALL - ROBOT_RADIUS - 0.02, 0.0, 0.0)

    def __init__(self) -> None:
        noise = np.random.default_rng(1).integers(60, 200, (120, 160, 3), dtype=np.uint8)
        disc = cv2.circle(np.zeros((120, 160), np.uint8), (80, 60), 59, 255, -1)
        self._image = cv2.bitwise_and(noise, noise, mask=disc)

    def free(self, x: float, y: float, radius: float) -> bool:
        return max(abs(x), abs(y)) + radius <= WALL

    def render(self, x: float, y: float, yaw: float, t: float) -> np.ndarray:
        return self._image


@pytest.mark.parametrize(("sensor", "room_left"), [(True, 0.05), (False, 0.0)])
def test_a_hand_that_drives_into_a_wall_is_stopped_short_of_it(sensor: bool, room_left: float) -> None:
    async def live() -> float:
        async with virtual_robot(Room(), 1, Pose2D(1.8, 0.4, 0.0), range_sensor=sensor) as robot:
            await robot.call("drive", vx=0.3, wz=0.0, **{"for": 8.0})
            return WALL - ROBOT_RADIUS - robot.pose.x

    assert virtual_time.run(live()) == pytest.approx(room_left, abs=0.02)


def test_contact_that_is_expected_is_not_prevented() -> None:
    class Ahead:
        def step(self, seen: Observation) -> Decision:
            assert seen.range_ahead is not None
            outcome = Outcome(None, "touched") if seen.bumper_left and seen.bumper_right else None
            return Decision("AHEAD", Twist2D(0.1, 0.0), outcome, contact_expected=True)

    async def live() -> float:
        async with virtual_robot(Room(), 1, Pose2D(2.6, 0.0, 0.0), range_sensor=True) as robot:
            await asyncio.sleep(0.5)
            await asyncio.wait_for(robot.daemon.control.start("ahead", Ahead(), None), 10.0)
            return WALL - ROBOT_RADIUS - robot.pose.x

    assert virtual_time.run(live()) < 0.003


def test_nothing_ahead_is_infinitely_far_away() -> None:
    async def live() -> float | None:
        async with virtual_robot(Room(), 1, Pose2D(0.0, 0.0, 0.0), range_sensor=True) as robot:
            await asyncio.sleep(0.5)
            assert robot.daemon.control._base.latest is not None
            return robot.daemon.control._base.latest.range_ahead

    assert virtual_time.run(live()) == math.inf
