"""Which homing estimates count: answers to the question asked now, each once, and those taken at rest."""

from __future__ import annotations

import math
from dataclasses import dataclass

from omnibotd.core.decision import HomingRequest, Observation
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.percept import HomingEstimate

# Odometry that moved less than this is standing still: encoder flicker, not motion (m, rad).
_STILL, _STILL_YAW = 0.001, math.radians(0.1)
# A frame taken at rest shows the robot where it is now.
_SAME_PLACE, _SAME_YAW = 0.005, math.radians(0.3)
# After the wheels stop the body sways and the exposure of a frame may have begun earlier (s).
_SETTLE = 0.3


@dataclass(frozen=True, slots=True)
class _Rest:
    since: float
    odom_from_base: Pose2D


class Sightings:
    """Asks for registrations of one dock and sorts the answers."""

    def __init__(self, dock: str) -> None:
        self._dock = dock
        self._rest: _Rest | None = None
        self._last_stamp = -math.inf
        self._tracking: bool | None = None
        self._asked = -math.inf
        self._now = -math.inf

    def update(self, observation: Observation) -> None:
        """Call once a tick, first."""
        self._now = observation.stamp
        odom = observation.odom_from_base
        if self._rest is None or not agree(odom, self._rest.odom_from_base, _STILL, _STILL_YAW):
            self._rest = _Rest(observation.stamp, odom)

    def ask(self, dock_from_odom: Pose2D | None) -> HomingRequest:
        """The request for this tick. Answers to frames before the kind of question changed are not taken."""
        tracking = dock_from_odom is not None
        if tracking is not self._tracking:
            self._tracking, self._asked = tracking, self._now
        return HomingRequest(self._dock, dock_from_odom)

    def take(self, observation: Observation) -> HomingEstimate | None:
        """The newest estimate, if it was not taken before and answers the question asked."""
        estimate = observation.homing
        if estimate is None or estimate.stamp <= max(self._last_stamp, self._asked):
            return None
        self._last_stamp = estimate.stamp
        return estimate

    def take_at_rest(self, observation: Observation) -> HomingEstimate | None:
        """As `take`, but only of a frame taken here, after the robot came to rest."""
        estimate = self.take(observation)
        return estimate if estimate is not None and self.at_rest(observation, estimate) else None

    def at_rest(self, observation: Observation, estimate: HomingEstimate) -> bool:
        """Whether the robot stood here when the estimate's frame was taken, and does still."""
        settled = self._rest is not None and estimate.stamp >= self._rest.since + _SETTLE
        return settled and agree(estimate.odom_from_base, observation.odom_from_base, _SAME_PLACE, _SAME_YAW)

    def forget(self) -> None:
        """The next question is a new one, even of the same kind."""
        self._tracking = None


def dock_from_odom(estimate: HomingEstimate) -> Pose2D:
    return estimate.dock_from_base @ estimate.odom_from_base.inverse()


def agree(first: Pose2D, second: Pose2D, distance: float, yaw: float) -> bool:
    """Whether two poses are the same within `distance` m and `yaw` rad."""
    return first.distance(second) <= distance and abs(wrap(first.yaw - second.yaw)) <= yaw
