"""The end of a trip: at the goal's spot turn to its heading, stand, and be sure before saying so."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto

from omnibotd.core.decision import Observation
from omnibotd.core.geometry import STOP, Pose2D, Twist2D, wrap
from omnibotd.core.navigation.certainty import Certainty, carried
from omnibotd.core.navigation.dynamic_window import pursuit, turn
from omnibotd.core.navigation.search import SEARCH_TURN
from omnibotd.core.safety import Limits

HOLD = 0.5  # s of standing before it counts: the filter has then settled on a standing robot's view
# So many estimates of a standing robot must be surer than those that steer, and fit the filter (m); and how long (s) to
# wait for them: at five frames a second the last one is due after 1 s.
CONFIRMATIONS, ARRIVED_SURE, CONFIRMED_WITHIN, CONFIRM_TIME = 3, 0.95, 0.1, 5.0
# rad; what a tick of the slowest turn and the motors' lag still add to a turn that is stopped.
COASTING = 0.01
HOMING = 0.1  # m from the goal; so little may be driven backwards, over floor the robot has just come from
CREEP = 0.025  # m; what is left counts as this much, or the robot would never get there
# Ticks over which the pose of a robot that only turns is averaged: estimates jump by centimetres, the robot does not.
AVERAGED = 20


@dataclass(frozen=True, slots=True)
class Tolerance:
    """When a goal counts as reached: metres and radians."""

    xy: float
    yaw: float


class Ending(Enum):
    """How standing at the goal ended."""

    ARRIVED = auto()
    DRIFTED = auto()  # no longer within tolerance of the spot
    DOUBTED = auto()  # the estimates do not confirm it


class Arrival:
    """One stay at the goal; `step` once a tick, from the moment the robot is there."""

    def __init__(self, goal: Pose2D, tolerance: Tolerance, limits: Limits) -> None:
        self._goal, self._tolerance, self._limits = goal, tolerance, limits
        self._spot: tuple[Pose2D, Pose2D] | None = None  # odom_from_base and the averaged map_from_base
        self._ticks = 0
        self._turning = True
        self._stood_since: float | None = None
        self._confirmations = 0

    def step(self, seen: Observation, here: Pose2D, certainty: Certainty) -> Twist2D | Ending:
        """After too short a way to tell this place from one that looks alike, the robot first looks round."""
        spot = self._average(seen, here)
        if spot.distance(self._goal) > self._tolerance.xy:
            return Ending.DRIFTED
        if not certainty.proven:
            self._stood_since, self._turning = None, True
            return Twist2D(0.0, SEARCH_TURN)
        error = wrap(self._goal.yaw - here.yaw)
        self._turning = abs(error) > (COASTING if self._turning else self._tolerance.yaw / 2.0)
        if self._turning:
            self._stood_since = None
            return turn(error, self._limits)
        return self._stand(seen, here)

    def _average(self, seen: Observation, here: Pose2D) -> Pose2D:
        self._ticks += 1
        spot = here
        if self._spot is not None:
            odom, before = self._spot
            expected = before @ (odom.inverse() @ seen.odom_from_base)
            share = 1.0 / min(self._ticks, AVERAGED)
            x, y = expected.x + share * (here.x - expected.x), expected.y + share * (here.y - expected.y)
            spot = Pose2D(x, y, here.yaw)
        self._spot = seen.odom_from_base, spot
        return spot

    def _stand(self, seen: Observation, here: Pose2D) -> Twist2D | Ending:
        """Never say arrived on dead reckoning, nor on one view: what has come since it stands must fit."""
        if self._stood_since is None:
            self._stood_since, self._confirmations = seen.stamp, 0
        self._confirm(seen, here, self._stood_since)
        stood = seen.stamp - self._stood_since
        if stood >= HOLD and self._confirmations >= CONFIRMATIONS:
            return Ending.ARRIVED
        return Ending.DOUBTED if stood > CONFIRM_TIME else STOP

    def _confirm(self, seen: Observation, here: Pose2D, since: float) -> None:
        place = seen.place
        if place is None or place.stamp < since:
            return
        fits = carried(place, seen.odom_from_base).distance(here) < CONFIRMED_WITHIN
        self._confirmations = self._confirmations + 1 if fits and place.confidence >= ARRIVED_SURE else 0


def homing(here: Pose2D, goal: Pose2D, tolerance: float, limits: Limits) -> Twist2D | None:
    """The last decimetre: straight on, or straight back where the goal lies behind; None at the goal.

    Estimates jump more than the last centimetre is long: a goal that is just passed abeam is reached.
    """
    x, y = here.inverse().transform(goal.x, goal.y)
    distance = math.hypot(x, y)
    if distance < tolerance / 5.0 or (distance < tolerance / 2.0 and abs(x) < tolerance / 10.0):
        return None
    forwards = x >= 0.0
    wanted = pursuit(math.atan2(y, x) if forwards else math.atan2(-y, -x), max(distance, CREEP), limits)
    return wanted if forwards else Twist2D(-wanted.vx, wanted.wz)
