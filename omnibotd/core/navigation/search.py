"""What a robot does that does not know where it is: look round, go back, feel its way about, and at last say so.

LOCALISING (stand, then one turn) ──► RETURNING (by odometry to where it was sure) ──► LOCALISING
                                  ──► SEARCHING (a short leg one way, the next ...) ──► LOST
Several sure estimates that agree while it moves end it at any time.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import replace
from enum import StrEnum

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Pose2D, Twist2D, wrap
from omnibotd.core.navigation.certainty import Certainty
from omnibotd.core.navigation.contact import BACKWARDS, BackingOff, Contact
from omnibotd.core.navigation.dynamic_window import pursuit
from omnibotd.core.safety import Limits, danger

STAND = 1.0  # s; ten frames without blur, the first of which may still be on their way
SEARCH_TURN = 0.6  # rad/s while looking round; slow enough for a sharp picture
RETURN_SPEED, SEARCH_SPEED = 0.18, 0.13  # m/s; back where one came from, and over floor nobody knows
RETURN_LIMIT = 6.0  # m; beyond it odometry is no guide, and after being carried it never was one
LEG = 0.5  # m; from one view to a clearly other one
SEARCH_DISTANCE, SEARCH_TIME = 7.0, 120.0  # m, s; the first ring of legs, and the nearer half of the second
REACHED = 0.05  # m from the end of a leg
SLACK = 2.0  # times what a motion takes; after that the wheels turn but the robot does not
GIVEN_UP = math.radians(35.0)  # to both sides of a direction in which something stands
# Where the legs end: bearing and distance in legs from where they begin, on a hexagon and on a ring of twelve round it,
# each about one leg from the one before.
STATIONS = [(math.tau * k / 6, 1) for k in range(6)] + [(math.tau * (k - 1) / 12, 2) for k in range(12)]

Motion = Generator[Twist2D, None, None]


class SearchState(StrEnum):
    LOCALISING = "LOCALISING"
    RETURNING = "RETURNING"
    SEARCHING = "SEARCHING"


class Search:
    """One search; `step` until its decision has an outcome: without an error (found), LOST, or what endangers it."""

    def __init__(
        self, certainty: Certainty, limits: Limits, back: Pose2D | None = None, *, known: bool = False
    ) -> None:
        """`certainty` is kept up by the owner; `back` is where to return to, in the odom frame.

        A robot whose pose is `known` may be found while it stands; another one must have moved under sure estimates.
        """
        self._certainty = certainty
        self._limits = replace(limits, max_angular_velocity=min(limits.max_angular_velocity, SEARCH_TURN))
        self._back = back
        self._known = known
        self._contact = Contact()
        self._seen: Observation | None = None
        self._motion = self._behave()
        self._deadline = self._farthest = math.inf
        self.metres = 0.0
        self.looked = False  # whether it has begun to move
        self.state = SearchState.LOCALISING

    def step(self, seen: Observation) -> Decision:
        """One tick; stands still at any danger."""
        outcome = danger(seen)
        if outcome is not None:
            return Decision(self.state, STOP, outcome)
        if self._seen is not None:
            self.metres += self._seen.odom_from_base.distance(seen.odom_from_base)
        self._seen = seen
        if self._certainty.steady if self._known else self._certainty.found:
            return Decision(self.state, STOP, Outcome(None, "found"))
        twist = next(self._motion, None)
        if twist is None or seen.stamp > self._deadline or self.metres > self._farthest:
            return Decision(self.state, STOP, self._lost())
        return Decision(self.state, twist)

    def doubt(self) -> None:
        """The pose that was known before was not where the robot is."""
        self._known = False

    def _lost(self) -> Outcome:
        latest = self._certainty.latest
        confidence = "no estimate" if latest is None else f"confidence {latest.confidence:.2f}"
        message = f"no view fits the map surely ({confidence}), after looking round and {self.metres:.1f} m of search"
        return Outcome(ErrorName.LOST, message)

    # ---- the behaviour: each generator yields what to do now, and goes on at the next tick

    def _behave(self) -> Motion:
        yield from self._stand()
        yield from self._look_round()
        if self._back is not None:
            yield from self._leg(SearchState.RETURNING, self._back, RETURN_SPEED, RETURN_LIMIT)
            yield from self._look_round()
        self._deadline, self._farthest = self._now.stamp + SEARCH_TIME, self.metres + SEARCH_DISTANCE
        yield from self._feel_about()

    def _feel_about(self) -> Motion:
        """Short legs round the compass; a direction in which something stands is not tried again.

        The camera sees all round while it drives: to turn at each end would only cost the time for more legs.
        """
        centre, given_up = self._now.odom_from_base, list[float]()
        for bearing, legs in STATIONS:
            if any(abs(wrap(bearing - other)) < GIVEN_UP for other in given_up):
                continue
            station = centre @ Pose2D(yaw=bearing) @ Pose2D(legs * LEG)
            if (yield from self._leg(SearchState.SEARCHING, station, SEARCH_SPEED, 1.2 * LEG)):
                given_up.append(bearing)

    def _stand(self) -> Motion:
        since = self._now.stamp
        while self._now.stamp - since < STAND:
            yield STOP
        self._known, self.looked = False, True  # standing did not settle it

    def _look_round(self) -> Motion:
        self.state = SearchState.LOCALISING
        turned, before = 0.0, self._now.odom_from_base.yaw
        latest = self._now.stamp + SLACK * math.tau / SEARCH_TURN
        while turned < math.tau and self._now.stamp < latest:
            yield Twist2D(0.0, SEARCH_TURN)
            yaw = self._now.odom_from_base.yaw
            turned, before = turned + abs(wrap(yaw - before)), yaw

    def _leg(self, state: SearchState, end: Pose2D, speed: float, limit: float) -> Generator[Twist2D, None, bool]:
        """Straight towards `end`, at most `limit` metres; returns whether something stood in the way."""
        self.state = state
        start = self._now
        limits = replace(self._limits, max_linear_velocity=min(speed, self._limits.max_linear_velocity))
        way = min(start.odom_from_base.distance(end), limit)
        latest = start.stamp + SLACK * (way / limits.max_linear_velocity + math.pi / limits.max_angular_velocity)
        while self._now.stamp < latest:
            here = self._now.odom_from_base
            left = min(here.distance(end), way - start.odom_from_base.distance(here))
            if left < REACHED:
                return False
            wanted = pursuit(here.bearing(end), max(left, 2 * REACHED), limits)
            if self._contact.blocks(self._now, left if wanted.vx > 0.0 else 0.0):
                yield from self._back_off()
                return True
            yield wanted
        return True

    def _back_off(self) -> Motion:
        backing = BackingOff(self._now)
        while not backing.over(self._now):
            yield BACKWARDS

    @property
    def _now(self) -> Observation:
        assert self._seen is not None, "behaviour is stepped with an observation"
        return self._seen


def way_back(certainty: Certainty, seen: Observation, here: Pose2D | None, nearest: Pose2D | None) -> Pose2D | None:
    """Where a lost robot should return to, in the odom frame, by odometry alone: None where it would lead nowhere.

    Where it was sure in this job; else, from where it believes to be, the `nearest` node of the map.
    """
    if certainty.sure is not None:
        target = certainty.sure.odom_from_base
    elif here is not None and nearest is not None:
        target = seen.odom_from_base @ here.inverse() @ nearest
    else:
        return None
    return target if seen.odom_from_base.distance(target) > LEG / 2.0 else None
