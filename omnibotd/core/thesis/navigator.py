"""Goes to a node of the map by the thesis' loop (§6.5.5): offset from the map, filter, dynamic window, stop rule.

LOCALISING ──a route is known──► NAVIGATING ──stop rule──► (done)
"""

from __future__ import annotations

import math
from dataclasses import replace
from enum import StrEnum

import numpy as np

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Pose2D, Twist2D, wrap
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation.goal_filter import GoalFilter
from omnibotd.core.navigation.navigator import Tolerance
from omnibotd.core.percept import PlaceEstimate
from omnibotd.core.safety import Limits, danger
from omnibotd.core.thesis.dynamic_window import choose
from omnibotd.core.thesis.links import Links
from omnibotd.core.thesis.offset_filter import OffsetFilter
from omnibotd.core.thesis.route import Route

# m from the nearest node: in the thesis a goal is a node; farther off nothing tells a way.
BESIDE = 0.6
# s to a first node with a route to the goal: some twenty frames.
FIRST_FIX = 3.0
# s that a trip may begin in touch with something: time to turn away on the spot.
TURN_AWAY = 5.0
# s, and as much again for each metre at a sixth of the speed: the wide loops take their time.
PATIENCE, SLOWEST = 60.0, 0.05


class ThesisState(StrEnum):
    LOCALISING = "LOCALISING"
    NAVIGATING = "NAVIGATING"


class ThesisNavigator:
    """One trip; `step` is called at a fixed rate and never blocks.

    It stops by the thesis' own rule and does not turn to the goal's heading, so `tolerance` plays no part; neither do
    `goal_filter`, for it filters the offset itself, and `robot_radius`, for it knows of no obstacles: a bump ends it.
    """

    def __init__(
        self,
        topo_map: TopoMap,
        goal: Pose2D,
        goal_filter: GoalFilter,
        limits: Limits,
        tolerance: Tolerance,
        robot_radius: float,
        period: float,
    ) -> None:
        """MapError where the map is of another method."""
        self._name, self._limits, self._period = topo_map.name, limits, period
        away = np.hypot(*(topo_map.poses[:, :2] - np.array([goal.x, goal.y])).T)
        target = int(away.argmin())
        self._far = float(away[target])
        self._route = Route(Links.of(topo_map), len(topo_map), target)
        node = topo_map.pose(target)
        self._beyond = goal.x - node.x, goal.y - node.y
        self._filter: OffsetFilter | None = None
        self._place: PlaceEstimate | None = None
        self._last_odom: Pose2D | None = None
        self._last_twist = STOP
        self._touching = True  # until the first cycle without: a trip may begin where the last one bumped
        self._started: float | None = None
        self._deadline = math.inf
        self.state = ThesisState.LOCALISING

    def step(self, seen: Observation) -> Decision:
        """One cycle: predict with odometry, update with the map, stop or steer."""
        if self._started is None:
            self._started, self._deadline = seen.stamp, seen.stamp + PATIENCE
        if seen.place is not None and seen.place.node >= 0:
            self._place = seen.place
        self._predict(seen.odom_from_base)
        if seen.place is not None:
            self._update(seen.place, seen.stamp)
        outcome = self._abort(seen)
        if outcome is not None:
            return self._decide(STOP, outcome)
        if self._filter is None:
            return self._decide(STOP, self._unplaced(self._running(seen)))
        if self._filter.arrived():
            message = f"arrived, {self._filter.distance * 100:.0f} cm by its own estimate"
            return self._decide(STOP, Outcome(None, message))
        return self._decide(self._steer(self._filter, seen.odom_from_base))

    def _predict(self, odom_from_base: Pose2D) -> None:
        before, self._last_odom = self._last_odom, odom_from_base
        if before is None or self._filter is None:
            return
        step = before.inverse() @ odom_from_base
        self._filter.predict(*Pose2D(yaw=self._heading(before)).transform(step.x, step.y))

    def _update(self, place: PlaceEstimate, stamp: float) -> None:
        """Take in what the map says from this node; without a route from it there is nothing to take."""
        measurement = self._route.measurement(place.node) if place.node >= 0 else None
        if measurement is None:
            return
        (zx, zy), r = measurement
        z = float(zx) + self._beyond[0], float(zy) + self._beyond[1]
        if self._filter is not None:
            self._filter.update(z, r)
            return
        self._filter = OffsetFilter(z, r)
        self.state = ThesisState.NAVIGATING
        self._deadline = stamp + PATIENCE + self._filter.distance / SLOWEST

    def _heading(self, odom_from_base: Pose2D) -> float:
        """In compass axes: the compass's at the last frame, and what odometry turned since."""
        assert self._place is not None
        turned = wrap(odom_from_base.yaw - self._place.odom_from_base.yaw)
        return wrap(self._place.map_from_base.yaw + turned)

    def _steer(self, offset: OffsetFilter, odom_from_base: Pose2D) -> Twist2D:
        goal = Pose2D(yaw=-self._heading(odom_from_base)).transform(*offset.offset)
        return choose(self._last_twist, goal, self._limits, self._period)

    def _abort(self, seen: Observation) -> Outcome | None:
        """Conditions that end the job in any state, worst first."""
        if (outcome := danger(seen)) is not None:
            return outcome
        touching = seen.bumper_left or seen.bumper_right or seen.cliff
        self._touching = self._touching and touching and self._running(seen) < TURN_AWAY
        if touching and not self._touching:
            return Outcome(ErrorName.BLOCKED, "something is in the way, and this method knows no way round it")
        if self._far > BESIDE:
            return Outcome(ErrorName.NO_ROUTE, f"the goal is {self._far:.1f} m from the nearest node of the map")
        if seen.stamp > self._deadline:
            return Outcome(ErrorName.TIMEOUT, f"not there after {self._running(seen):.0f} s")
        return None

    def _running(self, seen: Observation) -> float:
        """Seconds since the trip's first cycle."""
        return seen.stamp - (seen.stamp if self._started is None else self._started)

    def _unplaced(self, waited: float) -> Outcome | None:
        """Why there was nothing to steer by, once that has lasted."""
        if waited < FIRST_FIX:
            return None
        if self._place is None:
            message = f"no heading in map {self._name!r}: the red and the blue tile were not seen together"
            return Outcome(ErrorName.LOST, message)
        return Outcome(ErrorName.NO_ROUTE, "no links lead from here to the goal")

    def _decide(self, twist: Twist2D, outcome: Outcome | None = None) -> Decision:
        self._last_twist = twist
        left = None if self._filter is None else self._filter.distance
        if outcome is not None:
            outcome = replace(outcome, report=self._report())
        return Decision(self.state, twist, outcome, distance_remaining=left)

    def _report(self) -> dict[str, float | str]:
        """What was seen and believed at the end, under the default navigator's names."""
        told: dict[str, float | str] = {"state": str(self.state)}
        if self._filter is not None:
            told |= {"distance_left": self._filter.distance, "deviation": math.sqrt(self._filter.variance)}
        if self._place is not None:
            place = self._place
            told |= {"node": place.node, "score": place.score, "margin": place.margin, "sigma": place.sigma}
        return {name: value if isinstance(value, str) else round(value, 3) for name, value in told.items()}
