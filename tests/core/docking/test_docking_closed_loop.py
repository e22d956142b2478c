"""Docker and registration together, on a noisy simulated base under rendered ceilings; the truth is the simulator's."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
import pytest

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.docking.docker import Docker
from omnibotd.core.docking.registration import DockRegistration
from omnibotd.core.geometry import Pose2D, Twist2D, wrap
from omnibotd.core.percept import HomingEstimate
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from tools.sim import ceilings
from tools.sim.panorama import PanoramaError
from tools.sim.world import World

CAMERA = CameraModel.equidistant(640, 480, math.radians(190.0), 240.0)
CEILING_HEIGHT = 2.2
TRACK = 0.25  # m between the wheels
TICK = 0.1
STEPS = 10  # of the base within a tick
LAG = 2  # ticks from frame to estimate


class Wheel:
    """A driven wheel: slow to follow, stalls below 8 mm/s, rolls a little off, counts whole millimetres."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._scale = 1.0 + 0.02 * rng.standard_normal()
        self._speed = 0.0
        self._counted = 0.0

    def step(self, command: float, dt: float) -> tuple[float, float]:
        """True and counted metres rolled."""
        wanted = command if abs(command) >= 0.008 else 0.0
        self._speed += (wanted - self._speed) * (dt / 0.08)
        if abs(self._speed) < 0.002 and wanted == 0.0:
            self._speed = 0.0
        rolled = self._speed * dt
        true = rolled * self._scale * (1.0 + 0.05 * self._rng.standard_normal())
        before = math.floor(self._counted / 0.001)
        self._counted += rolled
        return true, 0.001 * (math.floor(self._counted / 0.001) - before)


class Base:
    """Differential drive; `room_from_base` is the truth, `odom_from_base` what its encoders say."""

    def __init__(self, room_from_base: Pose2D, seed: int) -> None:
        rng = np.random.default_rng((seed, 11))
        self._wheels = (Wheel(rng), Wheel(rng))
        self.room_from_base = room_from_base
        self.odom_from_base = Pose2D()

    def drive(self, twist: Twist2D, seconds: float) -> None:
        dt = seconds / STEPS
        commands = (twist.vx - twist.wz * TRACK / 2.0, twist.vx + twist.wz * TRACK / 2.0)
        for _ in range(STEPS):
            left, right = (wheel.step(command, dt) for wheel, command in zip(self._wheels, commands, strict=True))
            self.room_from_base = self.room_from_base @ _arc(left[0], right[0])
            self.odom_from_base = self.odom_from_base @ _arc(left[1], right[1])


def _arc(left: float, right: float) -> Pose2D:
    distance, yaw = (left + right) / 2.0, (right - left) / TRACK
    return Pose2D(distance * math.cos(yaw / 2.0), distance * math.sin(yaw / 2.0), yaw)


@dataclass(frozen=True)
class Run:
    outcome: Outcome
    seconds: float
    error_m: float
    error_deg: float
    retries: int


class Rehearsal:
    """One dock in one room; runs of docking against it, 10 ticks and frames a second."""

    def __init__(self, world: World, dock: Pose2D, now: World | None = None) -> None:
        """`now` is the room in the light of the docking, when it differs from that of the snapshot."""
        self.world, self.dock = now or world, dock
        self._snapshot = Frame(0.0, Frame(0.0, world.render(dock.x, dock.y, dock.yaw, 0.0)).jpeg())

    def start(self, seed: int, radius: float = 1.0) -> Pose2D:
        """A free pose within `radius` of the dock, any heading."""
        rng = np.random.default_rng((seed, 5))
        while True:
            r, bearing, yaw = radius * math.sqrt(rng.random()), *rng.uniform(-math.pi, math.pi, 2)
            pose = self.dock @ Pose2D(r * math.cos(bearing), r * math.sin(bearing), yaw)
            if self.world.free(pose.x, pose.y, 0.17):
                return pose

    def run(self, start: Pose2D, seed: int) -> Run:
        base, docker, stamp = Base(start, seed), Docker("home"), 100.0
        registration = DockRegistration(CAMERA, self._snapshot, CEILING_HEIGHT)
        pipeline: deque[HomingEstimate | None] = deque([None] * LAG, maxlen=LAG)
        newest: HomingEstimate | None = None
        while True:
            newest = pipeline[0] or newest
            decision = docker.step(Observation(stamp, base.odom_from_base, homing=newest))
            if decision.outcome is not None:
                return self._result(decision.outcome, stamp - 100.0, base, decision.recoveries)
            base.drive(decision.twist, TICK * 0.4)
            pipeline.append(self._see(registration, decision, base, stamp + TICK * 0.4))
            base.drive(decision.twist, TICK * 0.6)
            stamp += TICK

    def _see(
        self, registration: DockRegistration, decision: Decision, base: Base, stamp: float
    ) -> HomingEstimate | None:
        if decision.homing is None:
            return None
        pose, odom = base.room_from_base, base.odom_from_base
        frame = Frame(stamp, self.world.render(pose.x, pose.y, pose.yaw, stamp))
        if decision.homing.dock_from_odom is None:
            return registration.fix(frame, odom)
        return registration.track(frame, odom, decision.homing.dock_from_odom @ odom)

    def _result(self, outcome: Outcome, seconds: float, base: Base, retries: int) -> Run:
        error = self.dock.inverse() @ base.room_from_base
        return Run(outcome, seconds, math.hypot(error.x, error.y), abs(math.degrees(wrap(error.yaw))), retries)


MIDDLE = Pose2D(0.15, -0.1, 0.4)
STYLES = ["tiles", "plain", "beams", "photo"]


def room(style: str, seed: int) -> World:
    try:
        return getattr(ceilings, style)(seed)
    except PanoramaError as error:
        pytest.skip(str(error))


def check(run: Run) -> None:
    assert run.outcome.error is None, run.outcome.message
    assert run.error_m < 0.02
    assert run.error_deg < 1.0


@pytest.mark.parametrize("style", ["tiles", "plain", *(pytest.param(s, marks=pytest.mark.slow) for s in STYLES[2:])])
def test_docks_in_the_open_within_two_centimetres_and_one_degree(style: str) -> None:
    rehearsal = Rehearsal(room(style, 1), MIDDLE)
    check(rehearsal.run(MIDDLE @ Pose2D(-0.5, 0.12, 0.3), 1))


def test_docks_at_a_wall_that_fills_half_the_view() -> None:
    world = room("plain", 2)
    rehearsal = Rehearsal(world, Pose2D(*world.dock))
    check(rehearsal.run(rehearsal.dock @ Pose2D(-0.5, 0.1, 0.3), 1))


@pytest.mark.slow
@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
def test_never_says_docked_when_it_is_not(style: str, seed: int) -> None:
    world = room(style, seed)
    rehearsal = Rehearsal(world, Pose2D(*world.dock))
    run = rehearsal.run(rehearsal.start(seed), seed)
    if run.outcome.error is None:
        check(run)
