"""Out of the dock: straight back to the staging pose, by odometry alone."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.docking.approach import Limits
from omnibotd.core.docking.retreat import SPEED, STAGING_DISTANCE, Sidestep, straight_back
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Pose2D, Twist2D
from omnibotd.core.jobs import Job
from omnibotd.core.safety import danger

# Wheels that are told to turn and move the base less than this (m) in so long (s) are held, or not listening: a base
# that charges may need a second or two to leave its charging mode.
_STUCK, _STUCK_TIME = 0.01, 4.0
# A contact that is still closed so far out (m) is no dock but a cable. Some bases tell a second late, at 0.1 m/s.
_CABLE = 0.25
# Twice what it takes (s).
_TIME = 15.0


class UndockingState(StrEnum):
    UNDOCKING = "UNDOCKING"
    STEPPING_ASIDE = "STEPPING_ASIDE"


_HELD = Outcome(
    ErrorName.FAILED_TO_CONTROL,
    "the base did not move out of the dock: something holds it, or it takes no commands while it charges",
)
_ON_A_CABLE = Outcome(ErrorName.FAILED_TO_CONTROL, "still charging 25 cm out of the dock: is it on a cable?")


class Undocking:
    """Backs out along its own heading, which is the dock's, and then may step aside by `offset` (staging_from_base).

    Needs no camera: a robot must come out of its dock in the dark, too. Start it at rest in the dock.
    """

    def __init__(self, limits: Limits, offset: Pose2D | None = None) -> None:
        self._limits = limits
        self._offset = offset
        self._start: Pose2D | None = None
        self._began = self._last_tick = self._moved_at = 0.0
        self._moved_to = Pose2D()
        self._aside: Sidestep | None = None

    def step(self, seen: Observation) -> Decision:
        """One tick."""
        odom = seen.odom_from_base
        if self._start is None:
            self._start, self._moved_to = odom, odom
            self._began = self._last_tick = self._moved_at = seen.stamp
        dt = min(max(seen.stamp - self._last_tick, 0.05), 0.2)
        self._last_tick = seen.stamp
        here = self._start.inverse() @ odom
        outcome = self._failure(seen, here)
        state = UndockingState.UNDOCKING if self._aside is None else UndockingState.STEPPING_ASIDE
        twist = STOP
        if outcome is None:
            wanted = self._driven(here, dt)
            outcome = Outcome(None, f"undocked, {-here.x:.2f} m back") if wanted is None else None
            twist = wanted or STOP
        return Decision(state, twist, outcome, distance_remaining=max(0.0, STAGING_DISTANCE + here.x))

    def _failure(self, seen: Observation, here: Pose2D) -> Outcome | None:
        outcome = danger(replace(seen, camera_ok=True))
        if outcome is not None:
            return outcome
        if seen.odom_from_base.distance(self._moved_to) > _STUCK or self._aside is not None:
            self._moved_to, self._moved_at = seen.odom_from_base, seen.stamp
        if seen.charging and -here.x > _CABLE:
            return _ON_A_CABLE
        if seen.stamp - self._moved_at > _STUCK_TIME:
            return _HELD
        if seen.stamp - self._began > _TIME:
            return Outcome(ErrorName.TIMEOUT, f"not out of the dock within {_TIME:.0f} s, {-here.x:.2f} m back")
        return None

    def _driven(self, here: Pose2D, dt: float) -> Twist2D | None:
        """In the frame in which it stood in the dock; None once out."""
        if self._aside is None:
            if -here.x < STAGING_DISTANCE:
                return straight_back(Pose2D(), here, min(SPEED, self._limits.linear))
            if self._offset is None:
                return None
            self._aside = Sidestep(self._limits, here, Pose2D(-STAGING_DISTANCE) @ self._offset)
        return self._aside.twist(here, dt)


class ProvenUndocking:
    """Looks whether the robot is in the dock before it backs out: it has no eyes behind."""

    def __init__(self, glance: Job, undocking: Job, *, by_memory: bool) -> None:
        """`by_memory`: it docked here and has not moved since, so that not seeing the dock is no reason to stay."""
        self._glance: Job | None = glance
        self._undocking, self._by_memory = undocking, by_memory

    def step(self, seen: Observation) -> Decision:
        """One tick; NOT_DOCKED where it is not in the dock, or that can't be seen."""
        if self._glance is None:
            return self._undocking.step(seen)
        decision = self._glance.step(seen)
        outcome = decision.outcome
        if outcome is None:
            return decision
        unseen = outcome.error is ErrorName.FAILED_TO_DETECT_DOCK
        if outcome.error is None or (unseen and self._by_memory):
            self._glance = None
            return replace(decision, outcome=None)
        if unseen or outcome.error is ErrorName.NOT_DOCKED:
            return replace(decision, outcome=replace(outcome, error=ErrorName.NOT_DOCKED, message=_refusal(outcome)))
        return decision


def _refusal(outcome: Outcome) -> str:
    return f"not docked, so there is nothing to leave: {outcome.message}"
