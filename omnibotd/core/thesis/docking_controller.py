"""Drives to the dock by the thesis' procedure (§7.2.3): estimate, turn to it, drive k centimetres a pixel, again.

LOOK ──more than a pixel away──► TURN ──► DRIVE ──► LOOK ──a pixel or less──► FACE ──► (done)

It believes every estimate, knows no retry, and asks no charging contact.
"""

from __future__ import annotations

import math
from dataclasses import replace
from enum import Enum, auto

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.docking.approach import Limits, Move
from omnibotd.core.docking.docker import DockingParameters
from omnibotd.core.docking.sightings import Sightings
from omnibotd.core.docking.states import State
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Twist2D, wrap
from omnibotd.core.jobs import Job
from omnibotd.core.percept import Verdict
from omnibotd.core.safety import danger
from omnibotd.core.thesis.docking import STEP

TOLERANCE = 1.0 * STEP  # tau: one pixel or less, as §7.3.1 has it
MAX_STEPS = 60  # [assumed]; the thesis needed 16 on average
NEAR = 1.0  # m of the dock within which the map's part ends (§7.1)
# s [assumed]: to see an edge at all; and for one turn or drive, twice what the farthest takes.
LOOK_TIME, MOVE_TIME = 8.0, 25.0
# s a command holds: a tick.
_TICK = 0.1


class _Phase(Enum):
    LOOK = auto()
    TURN = auto()
    DRIVE = auto()
    FACE = auto()


class ThesisDocker:
    """Docks the base; `step` once a tick until its decision has an outcome. Start it at rest within 1 m of the dock."""

    def __init__(self, dock: str, parameters: DockingParameters) -> None:
        """Of the parameters only the top speeds count."""
        self._sightings = Sightings(dock)
        self._limits = Limits(parameters.max_linear_velocity, parameters.max_angular_velocity, TOLERANCE, 0.0)
        self._phase = _Phase.LOOK
        self._entered: float | None = None  # the phase, s
        self._move: Move | None = None
        self._away: float | None = None  # m by the last estimate
        self._outcome: Outcome | None = None
        self.steps = 0

    def step(self, seen: Observation) -> Decision:
        """One tick. After the outcome it goes on returning it, standing still."""
        self._sightings.update(seen)
        self._entered = seen.stamp if self._entered is None else self._entered
        self._outcome = self._outcome or danger(seen)
        twist = STOP
        if self._outcome is None:
            twist = self._look(seen) if self._phase is _Phase.LOOK else self._drive(seen)
        if self._outcome is not None:
            told = replace(self._outcome, report={**self._outcome.report, "steps": float(self.steps)})
            state = State.DOCKED if told.error is None else State.FAILED
            return Decision(state, outcome=told, distance_remaining=self._away)
        state = State.INITIAL_PERCEPTION if self._away is None else State.CONTROLLING
        # Asked all the time, so that an estimate is there as soon as the robot stands.
        return Decision(state, twist, homing=self._sightings.ask(None), distance_remaining=self._away)

    def _look(self, seen: Observation) -> Twist2D:
        """At rest, until there is an estimate; then the first turn of what it asks for."""
        estimate = self._sightings.take_at_rest(seen)
        if estimate is None or estimate.verdict is Verdict.REJECTED:
            if self._waited(seen) > LOOK_TIME:
                message = "no edge of the ceiling is strong enough to go by, here or over the dock"
                self._outcome = Outcome(ErrorName.FAILED_TO_DETECT_DOCK, message)
            return STOP
        dock = estimate.dock_from_base.inverse()
        self._away = math.hypot(dock.x, dock.y)
        # Whole pixels, turned: a millionth of one is rounding.
        if self._away <= TOLERANCE * (1.0 + 1e-6):
            return self._begin(_Phase.FACE, seen, wrap(seen.odom_from_base.yaw + dock.yaw))
        if self.steps == MAX_STEPS:
            message = f"still {self._away / STEP:.0f} px away after {MAX_STEPS} steps"
            self._outcome = Outcome(ErrorName.FAILED_TO_CONTROL, message)
            return STOP
        self.steps += 1
        return self._begin(_Phase.TURN, seen, wrap(seen.odom_from_base.yaw + math.atan2(dock.y, dock.x)))

    def _drive(self, seen: Observation) -> Twist2D:
        """Go on with the turn or drive, by odometry."""
        assert self._move is not None
        twist = None if self._hindered(seen) else self._move.twist(seen.odom_from_base, _TICK)
        return self._moved(seen) if twist is None else twist

    def _hindered(self, seen: Observation) -> bool:
        """Something is in the way of a drive, or the wheels do not get there."""
        touching = seen.bumper_left or seen.bumper_right or seen.cliff
        return (touching and self._phase is _Phase.DRIVE) or self._waited(seen) > MOVE_TIME

    def _moved(self, seen: Observation) -> Twist2D:
        """What follows a turn or drive."""
        if self._phase is _Phase.TURN:
            return self._begin(_Phase.DRIVE, seen, seen.odom_from_base.transform(self._away or 0.0, 0.0))
        if self._phase is _Phase.FACE:
            self._outcome = Outcome(None, f"docked in {self.steps} steps")
        self._enter(_Phase.LOOK, seen)
        return STOP

    def _begin(self, phase: _Phase, seen: Observation, goal: float | tuple[float, float]) -> Twist2D:
        self._enter(phase, seen)
        self._move = Move(self._limits, seen.odom_from_base, goal, boost=1.0)
        return STOP

    def _enter(self, phase: _Phase, seen: Observation) -> None:
        self._phase, self._entered = phase, seen.stamp

    def _waited(self, seen: Observation) -> float:
        """Seconds in this phase."""
        return seen.stamp - (seen.stamp if self._entered is None else self._entered)


class Vicinity:
    """A trip that ends within a metre of its goal, by its own account: the map's part of two (§7.1)."""

    def __init__(self, navigator: Job) -> None:
        self._navigator = navigator

    def step(self, seen: Observation) -> Decision:
        decision = self._navigator.step(seen)
        left = decision.distance_remaining
        if decision.outcome is not None or left is None or left > NEAR:
            return decision
        return replace(decision, twist=STOP, outcome=Outcome(None, f"{left:.2f} m from the goal"))
