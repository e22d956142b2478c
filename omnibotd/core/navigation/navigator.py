"""Goes to one pose of the map: be sure, follow the route, arrive, face the goal's heading.

LOCALISING ──sure, way known──► FOLLOWING ──near──► ARRIVING ──held, confirmed──► (done)
 RETURNING                        │  ▲  ▲             │
 SEARCHING ◄──unsure, or moved────┤  │  └───drifted───┤
     │           by somebody      │  └─ BACKING_OFF    │
     └─► (LOST)       ▲           └─in the way──┘      │
                      └────────not confirmed───────────┘
"""

from __future__ import annotations

import math
from dataclasses import replace
from enum import StrEnum

import numpy as np

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Pose2D, Twist2D
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation.arrival import HOMING, Arrival, Ending, Tolerance, homing
from omnibotd.core.navigation.certainty import SURE, Certainty
from omnibotd.core.navigation.contact import BACKWARDS, BackingOff, Contact
from omnibotd.core.navigation.dynamic_window import DynamicWindow, pursuit
from omnibotd.core.navigation.goal_filter import GoalFilter
from omnibotd.core.navigation.planning import Route, roads_of
from omnibotd.core.navigation.report import report
from omnibotd.core.navigation.search import Search, way_back
from omnibotd.core.safety import Limits, danger

__all__ = ["SURE", "Navigator", "NavigatorState", "Tolerance"]

MAX_SEARCHES = 4  # a robot that gets lost more often on one trip had better say so
PLANNED_A_TICK = 1024  # nodes; 2 ms on a PC of today, a fifth of a tick on an Atom
MOVED = 0.3  # m between a tick's pose and where odometry leads from the last one's: somebody moved it, or it was wrong
MAX_BUMPS = 8
SAME_OBSTACLE = 0.4  # m between two bumps against one thing
PATIENT = 2.0  # s to wait for somebody to step aside, before the same way is tried once more
BUMP_SIDE = math.radians(35)  # to the side from straight ahead, where one bumper alone was pressed
PATIENCE = 60.0  # s, and as much again for each metre of the route at a twentieth of a metre a second
SLOWEST = 0.05  # m/s


class NavigatorState(StrEnum):
    LOCALISING = "LOCALISING"
    RETURNING = "RETURNING"
    SEARCHING = "SEARCHING"
    FOLLOWING = "FOLLOWING"
    ARRIVING = "ARRIVING"
    BACKING_OFF = "BACKING_OFF"


class Navigator:
    """One trip; `step` is called at a fixed rate and never blocks. `goal_filter` outlives it and keeps the pose."""

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
        """Slow for a map not used before, else a matter of microseconds."""
        self._goal = goal
        self._filter = goal_filter
        self._limits = limits
        self._tolerance = tolerance
        self._radius = robot_radius
        self._window = DynamicWindow(limits, period)
        self._roads = roads_of(topo_map)
        self._floor = self._roads.floor.copy()
        self._route = Route(self._roads, goal, self._floor)
        self._certainty = Certainty()
        self._known = goal_filter.map_from_base is not None  # then it need not move to be found
        self._search: Search | None = None
        self.state = NavigatorState.LOCALISING
        self._searches = self._bumps = self._blocked = 0
        self._contact = Contact()
        self._bumped_at: Pose2D | None = None
        self._backing: BackingOff | None = None
        self._patient_until = -math.inf
        self._last: tuple[Pose2D, Pose2D] | None = None  # odom_from_base, map_from_base
        self._last_twist = STOP
        self._started: float | None = None
        self._deadline = math.inf
        self._arrival: Arrival | None = None

    # ---- every tick

    def step(self, seen: Observation) -> Decision:
        """What to do now. The filter has already taken in this observation's odometry and place estimate."""
        self._route.advance(PLANNED_A_TICK)
        here = self._filter.map_from_base
        self._certainty.take(seen, here)
        if self._started is None:
            self._started = seen.stamp
            self._search = self._new_search(seen, here, known=self._known)
        moved = self._was_moved(seen, here)
        outcome = danger(seen) or self._late(seen)
        decision = Decision(self.state, STOP, outcome) if outcome is not None else self._act(seen, here, moved)
        return self._told(decision, seen, here)

    def _act(self, seen: Observation, here: Pose2D | None, moved: bool) -> Decision:
        if moved and self._search is not None:
            self._search.doubt()
        if self._search is None and (here is None or moved or not self._certainty.recent(seen)):
            self._get_lost(seen, here)
        if self._search is not None or here is None:
            return self._find_yourself(seen, here)
        if self.state is NavigatorState.BACKING_OFF:
            return self._back_off(seen)
        if self.state is NavigatorState.ARRIVING:
            return self._arrive(seen, here)
        return self._follow(seen, here)

    def _late(self, seen: Observation) -> Outcome | None:
        if self._search is not None or seen.stamp <= self._deadline:  # a search has bounds of its own
            return None
        return Outcome(ErrorName.TIMEOUT, f"not there after {seen.stamp - (self._started or 0.0):.0f} s")

    def _was_moved(self, seen: Observation, here: Pose2D | None) -> bool:
        """Whether the pose is not where odometry leads from the last one."""
        last, self._last = self._last, None if here is None else (seen.odom_from_base, here)
        if last is None or here is None:
            return False
        return (last[1] @ (last[0].inverse() @ seen.odom_from_base)).distance(here) > MOVED

    def _told(self, decision: Decision, seen: Observation, here: Pose2D | None) -> Decision:
        """The decision with all that a user wants to know."""
        self._last_twist = decision.twist
        remaining = None if here is None else here.distance(self._goal)
        searches = self._searches + int(self._search is not None and self._search.looked)
        outcome = decision.outcome
        if outcome is not None:
            told = report(self._certainty, seen, here, distance_left=remaining, searches=searches, bumps=self._bumps)
            outcome = replace(outcome, report={**told, "state": str(decision.state)})
        return replace(decision, outcome=outcome, distance_remaining=remaining, recoveries=searches + self._bumps)

    def _go(self, twist: Twist2D) -> Decision:
        return Decision(self.state, twist)

    def _end(self, error: ErrorName | None, message: str) -> Decision:
        return Decision(self.state, STOP, Outcome(error, message))

    # ---- lost

    def _new_search(self, seen: Observation, here: Pose2D | None, known: bool) -> Search:
        nearest = None if here is None else self._roads.nearest(here)
        return Search(self._certainty, self._limits, way_back(self._certainty, seen, here, nearest), known=known)

    def _get_lost(self, seen: Observation, here: Pose2D | None) -> None:
        self._search = self._new_search(seen, here, known=False)
        self._certainty.restart()

    def _find_yourself(self, seen: Observation, here: Pose2D | None) -> Decision:
        assert self._search is not None, "a trip without a pose begins with a search"
        if self._searches >= MAX_SEARCHES:
            return self._end(ErrorName.LOST, f"lost {MAX_SEARCHES} times on the way; this map is no guide here")
        decision = self._search.step(seen)
        self.state = NavigatorState(decision.state)
        if here is None or decision.outcome is None or decision.outcome.error is not None:
            return decision
        return self._set_out(seen, here)

    def _set_out(self, seen: Observation, here: Pose2D) -> Decision:
        """Found: drive on as soon as the way from here is known."""
        self.state = NavigatorState.LOCALISING
        if not self._route.known(here):
            return self._go(STOP)
        distance = self._route.distance(here)
        if not math.isfinite(distance):
            return self._no_way()
        self._deadline = seen.stamp + PATIENCE + distance / SLOWEST
        self._searches += int(self._search is not None and self._search.looked)
        self.state, self._search = NavigatorState.FOLLOWING, None
        return self._follow(seen, here)

    # ---- on the way

    def _follow(self, seen: Observation, here: Pose2D) -> Decision:
        distance = here.distance(self._goal)
        if self._contact.blocks(seen, distance if self._last_twist.vx > 0.0 else 0.0):
            return self._bumped(seen, here)
        if distance < HOMING:
            return self._home(seen, here)
        if not self._route.known(here):
            return self._go(STOP)
        carrot = self._route.carrot(here)
        if carrot is None:
            return self._no_way()
        wanted = pursuit(here.bearing(carrot), here.distance(carrot), self._limits)
        return self._go(self._steer(wanted, here))

    def _home(self, seen: Observation, here: Pose2D) -> Decision:
        twist = homing(here, self._goal, self._tolerance.xy, self._limits)
        if twist is not None:
            return self._go(twist)
        self.state, self._arrival = NavigatorState.ARRIVING, Arrival(self._goal, self._tolerance, self._limits)
        return self._arrive(seen, here)

    def _steer(self, wanted: Twist2D, here: Pose2D) -> Twist2D:
        """Keep to free floor, unless the robot stands beside it already: then the straight way back is best."""
        if not self._floor.contains(np.array([here.x, here.y])):
            return wanted
        return self._window.choose(wanted, self._last_twist, here, self._floor)

    def _no_way(self) -> Decision:
        if self._blocked:
            return self._end(ErrorName.BLOCKED, "something is in the way, and no driven way leads round it")
        return self._end(ErrorName.NO_ROUTE, "no driven way leads from here to the goal")

    def _bumped(self, seen: Observation, here: Pose2D) -> Decision:
        """Back off; the first time to try the same way again, then to look for another one."""
        self._bumps += 1
        if self._bumps > MAX_BUMPS:
            return self._end(ErrorName.BLOCKED, f"something is in the way; gave up after {MAX_BUMPS} tries round it")
        again = self._bumped_at is not None and self._bumped_at.distance(here) < SAME_OBSTACLE
        self._bumped_at = here
        self._patient_until = -math.inf if again else seen.stamp + PATIENT
        if again:
            self._block(seen, here)
        self.state, self._backing = NavigatorState.BACKING_OFF, BackingOff(seen)
        return self._go(BACKWARDS)

    def _block(self, seen: Observation, here: Pose2D) -> None:
        """Of what stands there only the edge is known: a disc as large as the robot, beyond the point of touch."""
        touched = here @ Pose2D(yaw=BUMP_SIDE * (int(seen.bumper_left) - int(seen.bumper_right)))
        self._floor.block(*touched.transform(1.75 * self._radius, 0.0), 1.2 * self._radius)
        self._route.restart()
        self._blocked += 1

    def _back_off(self, seen: Observation) -> Decision:
        if self._backing is not None and not self._backing.over(seen):
            return self._go(BACKWARDS)
        self._backing = None
        if seen.stamp >= self._patient_until:
            self.state = NavigatorState.FOLLOWING
        return self._go(STOP)

    def _arrive(self, seen: Observation, here: Pose2D) -> Decision:
        assert self._arrival is not None, "ARRIVING is entered with a stay at the goal"
        result = self._arrival.step(seen, here, self._certainty)
        if isinstance(result, Twist2D):
            return self._go(result)
        if result is Ending.ARRIVED:
            return self._end(None, f"arrived, {here.distance(self._goal) * 100:.0f} cm by its own estimate")
        if result is Ending.DOUBTED:
            self._get_lost(seen, here)
            return self._go(STOP)
        self.state = NavigatorState.FOLLOWING
        return self._follow(seen, here)
