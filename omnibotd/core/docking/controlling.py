"""One run at the dock from a known pose: smooth approach, trim at rest, confirmation by an independent fix."""

from __future__ import annotations

import math
from enum import Enum, auto

from omnibotd.core.decision import Observation
from omnibotd.core.docking.approach import Limits, SmoothApproach, Trim
from omnibotd.core.docking.dock_filter import DockFilter
from omnibotd.core.docking.looking import at_contact, seated
from omnibotd.core.docking.sightings import Sightings, agree, dock_from_odom
from omnibotd.core.docking.states import Action, Event
from omnibotd.core.geometry import STOP, Pose2D, Twist2D
from omnibotd.core.percept import HomingEstimate, Verdict

# The fix that confirms the end knows nothing of the way here: within this of it (m, rad). Both look at the same
# picture, so that in the light of the snapshot they differ by less than a millimetre.
_CONFIRMATION, _CONFIRMATION_YAW = 0.015, math.radians(1.0)
# Odometry alone is good for this long (s) of driving; standing, five rejected looks in a row take about as long.
_BLIND_TIME = 1.5
# A bumper held this long is no touch in passing (s), a cliff sensor no mark on the floor.
_BUMPED_TIME = 1.0
# Some bases stop by themselves at the first touch of the contacts (Create 2) and heed nothing but backing out: wheels
# that stand (m, rad) for so long (s) while they are told to turn.
_STANDING, _STANDING_YAW, _DEAF_TIME = 0.001, math.radians(0.2), 1.0
# From 1 m at any heading a run takes about 20 s; three times that is stuck.
_TIME = 60.0
# Moves a trim may take (three are usual), fixes that may fail to confirm the end, and that may correct it: in the dark
# they differ by up to a centimetre from what is tracked, which leans on odometry.
_MAX_ROUNDS, _MAX_DISAGREEMENTS, _MAX_CORRECTIONS = 25, 3, 3


class _Phase(Enum):
    APPROACH = auto()
    MEASURE = auto()
    MOVE = auto()
    CONFIRM = auto()


class _Deafness:
    """Seconds for which the base was told to move, and did not."""

    def __init__(self) -> None:
        self._moved_to = Pose2D()
        self._told = False
        self.seconds = 0.0

    def update(self, odom_from_base: Pose2D, dt: float) -> None:
        """Call once a tick, first."""
        if not agree(odom_from_base, self._moved_to, _STANDING, _STANDING_YAW):
            self._moved_to, self.seconds = odom_from_base, 0.0
        elif self._told:
            self.seconds += dt

    def told(self, twist: Twist2D) -> None:
        """What the base is told now."""
        self._told = twist != STOP


class Controlling:
    """Drives to the dock; `step` returns an Event when the run is over. `dock_from_odom` is the newest known."""

    def __init__(
        self,
        limits: Limits,
        sightings: Sightings,
        dock_from_odom: Pose2D,
        observation: Observation,
        *,
        map_sure: bool = False,
    ) -> None:
        """`map_sure`: a map that knows its pose has this dock here, so that no alias of it is to be feared."""
        self._limits = limits
        self._sightings = sightings
        self._map_sure = map_sure
        self.dock_from_odom = dock_from_odom
        self._filter = DockFilter(dock_from_odom, observation.odom_from_base)
        self._approach = SmoothApproach(limits, dock_from_odom @ observation.odom_from_base)
        self._trim = Trim(limits)
        self._phase = _Phase.APPROACH
        self._started = self._seen = observation.stamp
        self._bumped: float | None = None
        self._deafness = _Deafness()
        self._disagreements = self._corrections = 0
        self._correction = Pose2D()  # from tracked poses to what a fix made of the same view

    def step(self, observation: Observation, dt: float) -> Action | Event:
        """`dt` is how long a command holds."""
        self._deafness.update(observation.odom_from_base, dt)
        result = self._over(observation) or self._go_on(observation, dt)
        self._deafness.told(result.twist if isinstance(result, Action) else STOP)
        return result

    def _go_on(self, observation: Observation, dt: float) -> Action | Event:
        if self._phase is _Phase.CONFIRM:
            return self._confirm(observation)
        estimate = self._track(observation)
        pose = self.dock_from_odom @ observation.odom_from_base
        if self._phase is _Phase.MEASURE:
            return self._measured(observation, pose, estimate)
        return self._action(pose, self._driven(pose, dt))

    def _over(self, observation: Observation) -> Event | None:
        now = observation.stamp
        bumped = observation.bumper_left or observation.bumper_right or observation.cliff
        self._bumped = (self._bumped if self._bumped is not None else now) if bumped else None
        held = self._bumped is not None and now - self._bumped > _BUMPED_TIME
        pose = self.dock_from_odom @ observation.odom_from_base
        if self._deafness.seconds > _DEAF_TIME and at_contact(observation, pose):
            return Event.CHARGING
        if held or now - self._started > _TIME or self._trim.rounds > _MAX_ROUNDS:
            # A base on its contact can be held short of the snapshot's pose by the dock itself.
            docked = at_contact(observation, pose) and (held or seated(pose))
            return Event.CHARGING if docked else Event.STUCK
        # Lifted wheels make odometry meaningless.
        return Event.DOUBTED if observation.wheel_drop or now - self._seen > _BLIND_TIME else None

    def _track(self, observation: Observation) -> HomingEstimate | None:
        """Takes the newest estimate; returns it only when it was made here at rest."""
        fresh = self._sightings.take(observation)
        if fresh is None or fresh.verdict is Verdict.REJECTED:
            return None
        self._seen = observation.stamp
        self._filter.update(fresh)
        self.dock_from_odom = self._correction @ self._filter.dock_from_odom
        return fresh if self._sightings.at_rest(observation, fresh) else None

    def _driven(self, pose: Pose2D, dt: float) -> Twist2D:
        twist = self._approach.twist(pose) if self._phase is _Phase.APPROACH else self._trim.twist(pose, dt)
        if twist is None:
            self._phase = _Phase.MEASURE
            return STOP
        return twist

    def _measured(self, observation: Observation, pose: Pose2D, estimate: HomingEstimate | None) -> Action:
        if estimate is None:
            return self._action(pose)
        if self._limits.reached(pose):
            self._phase, self._seen = _Phase.CONFIRM, observation.stamp
            return Action(STOP, self._sightings.ask(None), math.hypot(pose.x, pose.y))
        return self._trimmed(pose)

    def _trimmed(self, pose: Pose2D) -> Action:
        self._trim.plan(pose)
        self._phase = _Phase.MOVE
        return self._action(pose)

    def _confirm(self, observation: Observation) -> Action | Event:
        pose = self.dock_from_odom @ observation.odom_from_base
        fix = self._sightings.take_at_rest(observation)
        if fix is not None:
            if self._confirms(fix, pose, observation):
                self.dock_from_odom = dock_from_odom(fix)
                if self._corrections < _MAX_CORRECTIONS and not self._limits.reached(fix.dock_from_base):
                    self._corrections, self._seen = self._corrections + 1, observation.stamp
                    self._correction = fix.dock_from_base @ pose.inverse() @ self._correction
                    return self._trimmed(fix.dock_from_base)
                return Event.CONFIRMED if observation.charging is None else Event.CONTACT_DUE
            self._seen = observation.stamp
            self._disagreements += 1
            if self._disagreements >= _MAX_DISAGREEMENTS:
                return Event.DOUBTED
        return Action(STOP, self._sightings.ask(None), math.hypot(pose.x, pose.y))

    def _confirms(self, fix: HomingEstimate, pose: Pose2D, observation: Observation) -> bool:
        """An ambiguous fix is enough where the map tells which dock it is, or the contact will."""
        enough = fix.verdict is Verdict.ACCEPTED or self._map_sure or observation.charging is not None
        near = agree(fix.dock_from_base, pose, _CONFIRMATION, _CONFIRMATION_YAW)
        return near and enough and fix.verdict is not Verdict.REJECTED

    def _action(self, pose: Pose2D, twist: Twist2D = STOP) -> Action:
        return Action(twist, self._sightings.ask(self.dock_from_odom), math.hypot(pose.x, pose.y))
