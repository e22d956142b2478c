"""The robot whose clock is the daemon's set-points, driven by the real driver."""

import math
import random

import cv2
import numpy as np
import pytest

from firmware_bridge.bases.omnibot import OmnibotHost
from firmware_bridge.events import Connected, Telemetry
from tools.sim import ceilings
from tools.sim.lockstep import GREETING_STEPS, LONGEST, STEP, LockstepRobot

TICK = 0.1  # s, the daemon's
GREETING = GREETING_STEPS * STEP
SPEED = 4.0  # rad/s of both wheels
METRES = SPEED * 0.035  # a second, for the nominal wheel


class Daemon:
    """As much of it as talks to a base: one set-point a tick, at moments of its own."""

    def __init__(self) -> None:
        self.pictures: list[bytes] = []
        self.robot = LockstepRobot(ceilings.plain(1), (0.0, 0.0, 0.0), 1, self.pictures.append)
        self.host = OmnibotHost()
        self.now = 0.0
        self.telemetry: list[Telemetry] = []
        self.host.poll(self.now)
        assert any(isinstance(event, Connected) for event in self.hear(self.robot.receive(self.host.data_to_send())))

    def hear(self, data: bytes) -> list[object]:
        events = self.host.receive(data, self.now)
        self.telemetry += [event for event in events if isinstance(event, Telemetry)]
        return list(events)

    def tick(self, left: float, right: float, seconds: float = TICK) -> None:
        self.now += seconds
        self.host.drive(left, right, self.now)
        self.hear(self.robot.receive(self.host.data_to_send()))


@pytest.fixture
def daemon() -> Daemon:
    return Daemon()


def test_shaking_hands_takes_hardly_any_time_of_the_world_and_brings_telemetry(daemon):
    assert daemon.robot.seconds == pytest.approx(GREETING)
    assert daemon.telemetry


def test_the_world_lives_as_long_as_the_daemon_whatever_its_ticks(daemon):
    rng = random.Random(1)
    for _ in range(100):
        daemon.tick(0.0, 0.0, rng.uniform(0.08, 0.14))
    # Each tick is rounded to steps of 20 ms: six milliseconds of standard deviation, sixty in a hundred ticks.
    assert daemon.robot.seconds == pytest.approx(daemon.now, abs=0.2)
    assert len(daemon.telemetry) == pytest.approx(daemon.robot.seconds / STEP, abs=2)


def test_it_drives_as_far_as_it_was_told(daemon):
    for _ in range(20):
        daemon.tick(SPEED, SPEED)
    # The first set-point holds from its own moment on, and the motors take 80 ms to follow.
    assert daemon.robot.pose[0] == pytest.approx(METRES * (19 * TICK - 0.08), rel=0.03)


def test_a_daemon_that_stood_still_does_not_let_hours_pass(daemon):
    daemon.tick(0.0, 0.0, 600.0)
    assert daemon.robot.seconds == pytest.approx(GREETING + LONGEST)


def test_left_alone_the_base_stops_by_itself(daemon):
    for _ in range(5):
        daemon.tick(SPEED, SPEED)
    assert daemon.robot.driven
    daemon.robot.idle(0.2)
    assert daemon.robot.driven
    daemon.robot.idle(0.1)
    assert not daemon.robot.driven


def test_words_cut_anywhere_are_understood(daemon):
    daemon.now += TICK
    daemon.host.drive(0.0, 0.0, daemon.now)
    for byte in daemon.host.data_to_send():
        daemon.robot.receive(bytes([byte]))
    assert daemon.robot.seconds == pytest.approx(GREETING + TICK, abs=STEP)


def test_pictures_show_where_it_is_five_times_a_second(daemon):
    for _ in range(20):
        daemon.tick(SPEED, -SPEED)
    assert len(daemon.pictures) == 10
    first, last = (cv2.imdecode(np.frombuffer(daemon.pictures[i], np.uint8), cv2.IMREAD_GRAYSCALE) for i in (0, -1))
    assert first.shape == (480, 640)
    assert np.abs(first.astype(int) - last).mean() > 2.0  # it has turned
    assert abs(daemon.robot.pose[2]) > math.radians(30.0)


def test_who_waits_for_set_points_is_told_of_each(daemon):
    told = []
    daemon.robot.on_tick = lambda: told.append(daemon.robot.seconds)
    for _ in range(3):
        daemon.tick(0.0, 0.0)
    assert told == pytest.approx([GREETING + TICK, GREETING + 2 * TICK, GREETING + 3 * TICK], abs=STEP)
