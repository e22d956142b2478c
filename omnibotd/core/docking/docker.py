"""The docking state machine: look until sure, approach, confirm, wait for the contact, or back out and try again."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.docking.approach import Limits
from omnibotd.core.docking.controlling import Controlling
from omnibotd.core.docking.sightings import Sightings, agree, dock_from_odom
from omnibotd.core.docking.states import TRANSITIONS, Action, Event, State
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D, Twist2D
from omnibotd.core.percept import HomingEstimate, Verdict

# Half a metre: far enough to straighten out in; missed by 0.25 m it is still well within a fix's reach.
STAGING_DISTANCE = 0.5

# Independent fixes at rest agree within this before the robot moves (m, rad).
_AGREEMENT, _AGREEMENT_YAW = 0.05, math.radians(5.0)
# Two sure fixes that agree are enough, or four of which none is.
_VOTES: Mapping[Verdict, int] = {Verdict.ACCEPTED: 2, Verdict.AMBIGUOUS: 1, Verdict.REJECTED: 0}
_VOTES_NEEDED = 4
# Twice the votes needed: older fixes say nothing new.
_REMEMBERED_FIXES = 8
# Seconds. A full fix takes 0.2 s on an Atom: some forty looks. A contact answers within two seconds (Create 2).
_PERCEPTION_TIME, _CHARGE_TIME = 8.0, 5.0
# Twice what backing out takes.
_BACK_OUT_SPEED, _BACK_OUT_TIME = 0.1, 10.0
# Times an attempt may lose track of the dock and look again before it counts as a failed one.
_MAX_DOUBTS = 3

# Which failure each reason to retry ends in when no retry is left.
_FAILURES: Mapping[Event, Outcome] = {
    Event.UNSEEN: Outcome(ErrorName.FAILED_TO_DETECT_DOCK, "the ceiling over the dock was not recognised from here"),
    Event.STUCK: Outcome(ErrorName.FAILED_TO_CONTROL, "the dock's pose was not reached, or not confirmed"),
    Event.NOT_CHARGING: Outcome(ErrorName.FAILED_TO_CHARGE, "at the dock, but the base reports no charging contact"),
}
_DOCKED = Outcome(None, "docked")
_BASE_DOWN = Outcome(ErrorName.BASE_LINK_DOWN, "the base went silent while docking")
_CAMERA_DOWN = Outcome(ErrorName.CAMERA_DOWN, "the camera stopped delivering while docking")
_EMERGENCY = Outcome(ErrorName.EMERGENCY_STOP, "the emergency stop was pressed while docking")


def staging_pose(map_from_dock: Pose2D) -> Pose2D:
    """Where to start docking: half a metre behind the dock along its own x, facing as it does.

    Contacts and bumpers are in front and a dock stands against a wall: from here the approach is straight ahead, over
    floor that was driven when the dock was saved, under nearly the same piece of ceiling.
    """
    return map_from_dock @ Pose2D(-STAGING_DISTANCE, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class DockingParameters:
    """What a base or a site may want otherwise: speeds (m/s, rad/s), tolerances (m, rad), time for everything (s)."""

    max_linear_velocity: float = 0.2
    max_angular_velocity: float = 0.8
    xy_tolerance: float = 0.004
    yaw_tolerance: float = math.radians(0.25)
    max_retries: int = 3
    timeout: float = 120.0


class Docker:
    """Docks the base; `step` once a tick until its decision has an outcome. Start it at rest within 1 m of the dock."""

    def __init__(self, dock: str, parameters: DockingParameters | None = None) -> None:
        self._parameters = p = parameters or DockingParameters()
        self._limits = Limits(p.max_linear_velocity, p.max_angular_velocity, p.xy_tolerance, p.yaw_tolerance)
        self._dock = dock
        self._sightings = Sightings(dock)
        self._handlers: Mapping[State, Callable[[Observation], Event | Action]] = {
            State.INITIAL_PERCEPTION: self._look,
            State.CONTROLLING: self._control,
            State.WAIT_FOR_CHARGE: self._wait_for_charge,
            State.RETRY: self._back_out,
        }
        self.state = State.INITIAL_PERCEPTION
        self._outcome: Outcome | None = None
        self._started: float | None = None
        self._last_tick = self._entered = 0.0
        self._entered_at = Pose2D()
        self._dt = 0.1
        self._fixes: deque[HomingEstimate] = deque(maxlen=_REMEMBERED_FIXES)
        self._run: Controlling | None = None
        self._reason = Event.UNSEEN
        self._driven = False
        self._retries = self._doubts = 0

    def step(self, observation: Observation) -> Decision:
        """One tick. After the outcome it goes on returning it, standing still."""
        if self._outcome is not None:
            return self._decision(Action())
        self._tick(observation)
        abort = self._abort(observation)
        result: Event | Action
        if abort is not None:
            self._outcome, result = abort, Event.ABORTED
        else:
            result = self._handlers[self.state](observation)
        if isinstance(result, Event):
            self._advance(result, observation)
            result = Action()
        return self._decision(result)

    def _tick(self, observation: Observation) -> None:
        if self._started is None:
            self._started = self._last_tick = self._entered = observation.stamp
            self._entered_at = observation.odom_from_base
        if observation.stamp > self._last_tick:
            # A late tick must not make the next pulse tiny, nor a doubled one make it huge.
            self._dt = min(max(observation.stamp - self._last_tick, 0.05), 0.2)
            self._last_tick = observation.stamp
        self._sightings.update(observation)

    def _abort(self, observation: Observation) -> Outcome | None:
        if observation.emergency_stop:
            return _EMERGENCY
        if not observation.base_ok:
            return _BASE_DOWN
        if not observation.camera_ok:
            return _CAMERA_DOWN
        if self._started is not None and observation.stamp - self._started > self._parameters.timeout:
            return Outcome(ErrorName.TIMEOUT, f"not docked within {self._parameters.timeout:.0f} s")
        return None

    def _advance(self, event: Event, observation: Observation) -> None:
        if event is Event.DOUBTED:
            self._doubts += 1
            if self._doubts > _MAX_DOUBTS:
                event = Event.STUCK
        following = TRANSITIONS[self.state][event]
        if following is State.RETRY:
            self._reason = event
        elif following is State.CONTROLLING:
            self._run = Controlling(self._limits, self._sightings, dock_from_odom(self._fixes[-1]), observation)
            self._driven = True
        elif following is State.DOCKED:
            self._outcome = _DOCKED
        elif event is Event.EXHAUSTED:
            self._outcome = _FAILURES[self._reason]
        self.state = following
        self._entered, self._entered_at = observation.stamp, observation.odom_from_base
        self._fixes.clear()
        self._sightings.forget()

    def _look(self, observation: Observation) -> Event | Action:
        """At rest, until enough independent fixes agree."""
        fix = self._sightings.take_at_rest(observation)
        if fix is not None and fix.verdict is not Verdict.REJECTED:
            self._fixes.append(fix)
            if self._votes(fix) >= _VOTES_NEEDED:
                return Event.LOCATED
        if observation.stamp - self._entered > _PERCEPTION_TIME:
            return Event.UNSEEN
        return Action(homing=self._sightings.ask(None))

    def _votes(self, fix: HomingEstimate) -> int:
        pose = fix.dock_from_base
        alike = (f for f in self._fixes if agree(f.dock_from_base, pose, _AGREEMENT, _AGREEMENT_YAW))
        return sum(_VOTES[f.verdict] for f in alike)

    def _control(self, observation: Observation) -> Event | Action:
        assert self._run is not None, "CONTROLLING is entered with a run"
        return self._run.step(observation, self._dt)

    def _wait_for_charge(self, observation: Observation) -> Event | Action:
        if observation.charging:
            return Event.CHARGING
        late = observation.stamp - self._entered > _CHARGE_TIME
        return Event.NOT_CHARGING if late else Action(distance_remaining=0.0)

    def _back_out(self, observation: Observation) -> Event | Action:
        """Back to about the staging pose, but only where this attempt has driven in: never blindly."""
        if self._retries >= self._parameters.max_retries:
            return Event.EXHAUSTED
        far = observation.odom_from_base.distance(self._entered_at) >= STAGING_DISTANCE
        if not self._driven or far or observation.stamp - self._entered > _BACK_OUT_TIME:
            self._retries += 1
            self._doubts, self._driven = 0, False
            return Event.BACKED_OUT
        return Action(Twist2D(-min(_BACK_OUT_SPEED, self._limits.linear), 0.0))

    def _decision(self, action: Action) -> Decision:
        remaining = 0.0 if self.state is State.DOCKED else action.distance_remaining
        return Decision(self.state, action.twist, self._outcome, action.homing, remaining, self._retries)
