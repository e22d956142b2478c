"""The fixed-rate control tick: the one owner of the robot's state (observe, decide, limit, drive)."""

from __future__ import annotations

import asyncio
import logging
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from firmware_bridge.events import Connected, Disconnected, Telemetry
from omnibotd.config import Config
from omnibotd.core.compass.sighted_odometry import SightedOdometry
from omnibotd.core.decision import Decision, HomingRequest, Observation, Outcome
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Pose2D, Twist2D
from omnibotd.core.jobs import Job
from omnibotd.core.kinematics import DifferentialDrive
from omnibotd.core.navigation.goal_filter import GoalFilter
from omnibotd.core.navigation.navigator import SURE
from omnibotd.core.odometry import WheelOdometry
from omnibotd.core.percept import HomingEstimate, PlaceEstimate
from omnibotd.core.safety import Limits, SafetyGate, hazard
from omnibotd.io.camera import Camera
from omnibotd.io.motor_base import MotorBase
from omnibotd.io.recorder import Recorder
from omnibotd.io.systemd_notify import Notifier

log = logging.getLogger(__name__)

PERIOD = 0.1  # s; the thesis' rate, and two set-points within the base's watchdog of 250 ms
LATENESS_WINDOW = 600  # ticks: the last minute
# A tick that begins later than half a period after its time counts as late: still well within every base's watchdog.
LATE = PERIOD / 2.0
# A percept older than this says nothing about now: perception hangs or the camera does.
STALE = 1.0

Feedback = Callable[[dict[str, Any]], None]


@dataclass
class Running:
    """A job in progress and whoever waits for its end."""

    name: str
    job: Job
    future: asyncio.Future[Outcome]
    feedback: Feedback | None
    started: float
    last: Decision = field(default_factory=lambda: Decision("STARTING"))


@dataclass
class Teleop:
    """A set-point from a person's hand: good until `until`."""

    twist: Twist2D
    until: float
    hand: object = None  # whose it is: the client's session


class ControlLoop:
    """Steps the job, passes its wish through the safety gate, drives the wheels, and keeps time."""

    def __init__(self, config: Config, base: MotorBase, camera: Camera, notifier: Notifier) -> None:
        limits = config.base
        self.limits = Limits(
            limits.max_linear_velocity,
            limits.max_angular_velocity,
            limits.max_linear_acceleration,
            limits.max_angular_acceleration,
        )
        self.drive = DifferentialDrive(limits.wheel_radius, limits.wheel_separation, limits.wheel_ratio)
        self._ticks_per_rev = limits.ticks_per_rev
        self._base, self._camera, self._notifier = base, camera, notifier
        self.wheels = WheelOdometry(self.drive)
        sighted = config.odometry.heading != "wheels"
        self.odometry: WheelOdometry | SightedOdometry = SightedOdometry(self.wheels) if sighted else self.wheels
        self.goal_filter = GoalFilter()
        self._gate = SafetyGate(self.limits)
        self.place: PlaceEstimate | None = None
        self._fresh_place: PlaceEstimate | None = None
        self._homing: HomingEstimate | None = None
        self.homing_request: HomingRequest | None = None
        self.running: Running | None = None
        self.teleop: Teleop | None = None
        self._base_lost = False  # since the last tick: a base that restarted is back before anybody looks
        self.recorder: Recorder | None = None
        self.twist = STOP
        self.moved_at = -math.inf
        self.lateness: deque[float] = deque(maxlen=LATENESS_WINDOW)
        self.ticks = self.late_ticks = 0
        self.events: Callable[[dict[str, Any]], None] = lambda event: None

    # ---- what others may ask of it (same event loop, so between two ticks)

    @property
    def state(self) -> str:
        if self.running is not None:
            return self.running.last.state
        if self.teleop is not None:
            return "DRIVEN"
        return "RECORDING" if self.recorder is not None else "IDLE"

    @property
    def moving(self) -> bool:
        """Whether anything asks for fresh percepts: a job, a hand on the stick, or wheels that just turned."""
        return self.running is not None or self.teleop is not None or self._now() - self.moved_at < STALE

    def start(self, name: str, job: Job, feedback: Feedback | None) -> asyncio.Future[Outcome]:
        """Begin a job; the future holds its outcome. The caller has made sure that none is running."""
        assert self.running is None
        future: asyncio.Future[Outcome] = asyncio.get_running_loop().create_future()
        self.running = Running(name, job, future, feedback, self._now())
        self.teleop = None
        self.events({"event": "job_started", "job": name})
        return future

    def halt(self, reason: str) -> None:
        """Cancel any job and any hand on the stick; the wheels stop at once, not at the next tick."""
        self.teleop = None
        if self.running is not None:
            self._finish(self.running, Outcome(ErrorName.CANCELLED, reason))
        self._apply(self._gate.stop())

    def note_place(self, place: PlaceEstimate) -> None:
        self.place = self._fresh_place = place

    def note_homing(self, homing: HomingEstimate) -> None:
        self._homing = homing

    def forget_pose(self) -> None:
        """Another map: nothing of the old pose holds."""
        self.goal_filter = GoalFilter()
        self.place = self._fresh_place = None

    def absorb(self) -> None:
        """Take in what the base has told since last time; before every tick and before odometry is read."""
        for event in self._base.drain():
            match event:
                case Telemetry():
                    ticks_per_rev = self._ticks_per_rev or (self._base.info.ticks_per_rev if self._base.info else 0.0)
                    if ticks_per_rev > 0.0:
                        self.wheels.update(event.stamp, event.left_ticks, event.right_ticks, ticks_per_rev)
                case Connected(info):
                    self.wheels.rebase()
                    log.info("base connected: %s %s, firmware %s", info.driver, info.board, info.firmware)
                    self.events({"event": "base_connected", "driver": info.driver, "board": info.board})
                case Disconnected(reason):
                    self._base_lost = True
                    log.info("base not connected: %s", reason)
                    self.events({"event": "base_disconnected", "reason": reason})

    # ---- the loop

    async def run(self) -> None:
        """Tick for ever; every tick that worked feeds the systemd watchdog."""
        due = self._now()
        while True:
            await asyncio.sleep(max(0.0, due - self._now()))
            self.lateness.append(max(0.0, self._now() - due))
            self.late_ticks += self.lateness[-1] > LATE
            if self._safe_tick():
                self._notifier.watchdog(self._now())
            # After a stall the missed ticks are not made up: old set-points are worth nothing.
            due = max(due + PERIOD, self._now() - PERIOD)

    def _safe_tick(self) -> bool:
        """One tick; our own bug stops the robot and fails the job, but leaves the daemon to answer questions."""
        try:
            self.tick(self._now())
        except Exception:
            log.exception("control tick failed; stopping")
            if self.running is not None:
                self._finish(
                    self.running,
                    Outcome(ErrorName.CANCELLED, "internal error in the control tick, see the log"),
                )
            self.teleop = None
            self._apply(self._gate.stop())
            return False
        return True

    def tick(self, now: float) -> None:
        """Observe, decide, limit, drive."""
        self.ticks += 1
        self.absorb()
        seen = self._observe(now)
        wanted = self._decide(seen)
        if self.running is not None and self.running.last.contact_expected:
            seen = replace(seen, range_ahead=None)
        self._apply(self._gate.limit(wanted, seen, PERIOD))
        self._fresh_place = self._homing = None
        self._base_lost = False
        self._record(now)

    def _observe(self, now: float) -> Observation:
        odom = self.odometry.odom_from_base
        self.goal_filter.predict(odom)
        if self._fresh_place is not None:
            self.goal_filter.update(self._fresh_place, SURE)
        latest = self._base.latest if self._base.connected else None
        return Observation(
            stamp=now,
            odom_from_base=odom,
            place=self._fresh_place,
            homing=self._homing,
            base_ok=latest is not None and not self._base_lost,
            camera_ok=self._camera.ok(now),
            bumper_left=latest is not None and latest.bumper_left,
            bumper_right=latest is not None and latest.bumper_right,
            cliff=latest is not None and latest.cliff,
            wheel_drop=latest is not None and latest.wheel_drop,
            emergency_stop=latest is not None and latest.emergency_stop,
            charging=latest.charging if latest is not None else None,
            range_ahead=latest.range_ahead if latest is not None else None,
        )

    def _decide(self, seen: Observation) -> Twist2D:
        running = self.running
        if running is not None:
            return self._step(running, seen)
        if self.teleop is not None:
            if seen.stamp <= self.teleop.until and hazard(seen) is None:
                return self.teleop.twist
            self.teleop = None
        return STOP

    def _step(self, running: Running, seen: Observation) -> Twist2D:
        before, decision = running.last.state, running.job.step(seen)
        running.last = decision
        self.homing_request = decision.homing
        if decision.state != before:
            log.info("%s: %s", running.name, decision.state)
            self.events({"event": "state", "job": running.name, "state": decision.state})
            if self.recorder is not None:
                self.recorder.decision(seen.stamp, decision.state, running.name)
        if running.feedback is not None:
            running.feedback(self.progress(running, seen.stamp))
        if decision.outcome is None:
            return decision.twist
        self._finish(running, decision.outcome)
        return STOP

    def progress(self, running: Running, now: float) -> dict[str, Any]:
        """Job feedback under nav2's names."""
        last = running.last
        tour = {} if last.waypoint is None else {"waypoint": last.waypoint, "loop": last.loop}
        return {
            "state": last.state,
            "distance_remaining": last.distance_remaining,
            "navigation_time": round(now - running.started, 1),
            "number_of_recoveries": last.recoveries,
            "confidence": self.goal_filter.confidence,
            **tour,
        }

    def _finish(self, running: Running, outcome: Outcome) -> None:
        self.running, self.homing_request = None, None
        name = outcome.error.value if outcome.error else "DONE"
        log.info("%s: %s, %s", running.name, name, outcome.message)
        self.events({"event": "job_ended", "job": running.name, "result": name, "message": outcome.message})
        if not running.future.done():
            running.future.set_result(outcome)

    def _apply(self, twist: Twist2D) -> None:
        if twist != STOP:
            self.moved_at = self._now()
        self.twist = twist
        self._base.drive(*self.drive.wheel_speeds(twist))

    def _record(self, now: float) -> None:
        if self.recorder is not None:
            self.recorder.odometry(now, self.odometry.odom_from_base)
            self.recorder.command(now, self.twist)
            if self.map_from_base is not None:
                self.recorder.pose(now, self.map_from_base)

    @property
    def map_from_base(self) -> Pose2D | None:
        return self.goal_filter.map_from_base

    @staticmethod
    def _now() -> float:
        return asyncio.get_running_loop().time()
