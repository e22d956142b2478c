"""The docking state machine: look until sure, approach, confirm, wait for the contact, or back out and try again."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.docking.approach import Limits
from omnibotd.core.docking.controlling import Controlling
from omnibotd.core.docking.glance import pose_report
from omnibotd.core.docking.looking import Looking, at_contact, seated
from omnibotd.core.docking.retreat import STAGING_DISTANCE, Retreat, staging_pose
from omnibotd.core.docking.sightings import Sightings, dock_from_odom
from omnibotd.core.docking.states import TRANSITIONS, Action, Event, State
from omnibotd.core.docking.vantage import Nearer, Turned
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D

__all__ = ["STAGING_DISTANCE", "Docker", "DockingParameters", "staging_pose"]

# Seconds. A full fix takes 0.2 s on an Atom: some forty looks. A contact answers within two seconds (Create 2).
_PERCEPTION_TIME, _CHARGE_TIME = 8.0, 5.0
# Twice what backing out takes.
_BACK_OUT_TIME = 20.0
# Times an attempt may lose track of the dock and look again before it counts as a failed one.
_MAX_DOUBTS = 3

# Which failure each reason to retry ends in when no retry is left.
_FAILURES: Mapping[Event, Outcome] = {
    Event.UNSEEN: Outcome(ErrorName.FAILED_TO_DETECT_DOCK, "the ceiling over the dock was not recognised from here"),
    Event.STUCK: Outcome(ErrorName.FAILED_TO_CONTROL, "the dock's pose was not reached, or not confirmed"),
    Event.NOT_CHARGING: Outcome(ErrorName.FAILED_TO_CHARGE, "at the dock, but the base reports no charging contact"),
}
_BASE_DOWN = Outcome(ErrorName.BASE_LINK_DOWN, "the base went silent while docking")
_CAMERA_DOWN = Outcome(ErrorName.CAMERA_DOWN, "the camera stopped delivering while docking")
_EMERGENCY = Outcome(ErrorName.EMERGENCY_STOP, "the emergency stop was pressed while docking")


@dataclass(frozen=True, slots=True)
class DockingParameters:
    """What a base or a site may want otherwise: speeds (m/s, rad/s), tolerances (m, rad), time for an attempt (s)."""

    max_linear_velocity: float = 0.2
    max_angular_velocity: float = 0.8
    xy_tolerance: float = 0.004
    yaw_tolerance: float = math.radians(0.25)
    max_retries: int = 3
    attempt_time: float = 60.0

    @property
    def timeout(self) -> float:
        """For everything; some attempts may take longer than theirs if others don't (s)."""
        return self.attempt_time * (1 + self.max_retries)


class Docker:
    """Docks the base; `step` once a tick until its decision has an outcome. Start it at rest within 1 m of the dock.

    The outcome's report tells where the base stands by the fix that confirmed it, or as it was tracked last.
    """

    def __init__(self, dock: str, parameters: DockingParameters | None = None) -> None:
        self._parameters = p = parameters or DockingParameters()
        self._limits = Limits(p.max_linear_velocity, p.max_angular_velocity, p.xy_tolerance, p.yaw_tolerance)
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
        self._dt = 0.1
        self._map_says: Pose2D | None = None
        self._looking: Looking | None = None
        self._run: Controlling | None = None
        self._retreat: Retreat | Nearer | Turned | None = None
        self._retreats_in = Pose2D()
        self._dock_from_odom: Pose2D | None = None
        self._found: Pose2D | None = None
        self._reason = Event.UNSEEN
        self._driven = False
        self._retries = self._doubts = 0

    def expect(self, dock_from_odom: Pose2D) -> None:
        """Tell where a map that is sure of its pose has the dock. Fixes far from there are not believed."""
        self._map_says = dock_from_odom

    def step(self, observation: Observation) -> Decision:
        """One tick. After the outcome it goes on returning it, standing still."""
        if self._outcome is not None:
            return self._decision(Action())
        self._tick(observation)
        abort = self._abort(observation)
        result: Event | Action
        if abort is not None and abort.error is ErrorName.TIMEOUT and self._charges(observation):
            result = Event.CHARGING
        elif abort is not None:
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
        limit = self._parameters.timeout
        if self._started is not None and observation.stamp - self._started > limit:
            return Outcome(ErrorName.TIMEOUT, f"not docked within {limit:.0f} s", self._report())
        return None

    def _advance(self, event: Event, observation: Observation) -> None:
        self._learn(observation)
        if event is Event.DOUBTED:
            self._doubts += 1
            if self._doubts > _MAX_DOUBTS:
                event = Event.STUCK
        following = TRANSITIONS[self.state][event]
        if following is State.RETRY:
            self._reason, (self._retreat, self._retreats_in) = event, self._new_retreat(observation)
        elif following is State.CONTROLLING:
            assert self._dock_from_odom is not None, "located"
            sure = self._map_says is not None
            self._run = Controlling(self._limits, self._sightings, self._dock_from_odom, observation, map_sure=sure)
            self._driven = True
        elif following is State.DOCKED:
            self._outcome = Outcome(None, "docked", self._report())
        elif event is Event.EXHAUSTED:
            self._outcome = self._failure()
        self.state, self._entered = following, observation.stamp
        if following is State.INITIAL_PERCEPTION:
            self._looking = None
        self._sightings.forget()

    def _learn(self, observation: Observation) -> None:
        """Where the dock is, by what the state that ends has seen."""
        if self.state is State.INITIAL_PERCEPTION and self._looking is not None and self._looking.located is not None:
            self._dock_from_odom = dock_from_odom(self._looking.located)
        elif self.state is State.CONTROLLING and self._run is not None:
            self._dock_from_odom = self._run.dock_from_odom
        if self._dock_from_odom is not None:
            self._found = self._dock_from_odom @ observation.odom_from_base

    def _look(self, observation: Observation) -> Event | Action:
        if self._looking is None:
            self._looking = Looking(self._sightings, observation.stamp, _PERCEPTION_TIME, self._map_says)
        result = self._looking.step(observation)
        located = self._looking.located
        if result is not Event.CHARGING or located is None or not self._driven or seated(located.dock_from_base):
            return result
        return Event.LOCATED if self._doubts < _MAX_DOUBTS else Event.STUCK

    def _control(self, observation: Observation) -> Event | Action:
        assert self._run is not None, "CONTROLLING is entered with a run"
        return self._run.step(observation, self._dt)

    def _wait_for_charge(self, observation: Observation) -> Event | Action:
        if observation.charging:
            return Event.CHARGING
        late = observation.stamp - self._entered > _CHARGE_TIME
        return Event.NOT_CHARGING if late else Action(distance_remaining=0.0)

    def _charges(self, observation: Observation) -> bool:
        """Whether it stands on the dock's contact, however well."""
        self._learn(observation)
        return self._found is not None and at_contact(observation, self._found)

    def _new_retreat(self, observation: Observation) -> tuple[Retreat | Nearer | Turned | None, Pose2D]:
        """The way to where to look from next, and the frame from odom that it is driven in.

        Back to the staging pose only where this attempt has driven, and so knows the dock's pose: never blindly.
        """
        odom = observation.odom_from_base
        if self._driven and self._dock_from_odom is not None:
            return Retreat(self._limits, self._dock_from_odom @ odom, bumped=_bumped(observation)), self._dock_from_odom
        contradicted = self._looking is not None and self._looking.contradicted
        if self._map_says is not None and not contradicted and Nearer.worth(self._map_says @ odom):
            return Nearer(self._limits, self._map_says @ odom), self._map_says
        if observation.charging or self._map_says is not None:
            return None, Pose2D()  # in the dock, or too near to it to turn
        return Turned(self._limits, odom), Pose2D()

    def _back_out(self, observation: Observation) -> Event | Action:
        if self._retries >= self._parameters.max_retries:
            return Event.CHARGING if self._charges(observation) else Event.EXHAUSTED
        twist = None
        if self._retreat is not None:
            pose = self._retreats_in @ observation.odom_from_base
            twist = self._retreat.twist(pose, self._dt, bumped=_bumped(observation))
        if twist is None or observation.wheel_drop or observation.stamp - self._entered > _BACK_OUT_TIME:
            self._retries += 1
            self._doubts, self._driven = 0, False
            return Event.BACKED_OUT
        return Action(twist)

    def _failure(self) -> Outcome:
        outcome, report = _FAILURES[self._reason], self._report()
        message = outcome.message
        if self._reason is Event.UNSEEN and report.get("ambiguous", 0.0) > 0.0:
            message = "the ceiling looks alike in several places here, and which of them this is was not to be seen"
        return Outcome(outcome.error, message, report)

    def _report(self) -> dict[str, float]:
        """What the last look at the dock saw, and where the base is thought to stand."""
        report = dict(self._looking.seen) if self._looking is not None else {}
        return report if self._found is None else report | pose_report(self._found)

    def _decision(self, action: Action) -> Decision:
        remaining = 0.0 if self.state is State.DOCKED else action.distance_remaining
        return Decision(self.state, action.twist, self._outcome, action.homing, remaining, self._retries)


def _bumped(observation: Observation) -> bool:
    return observation.bumper_left or observation.bumper_right or observation.cliff
