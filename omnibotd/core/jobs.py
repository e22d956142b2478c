"""What a robot can be busy with: each job is stepped by the control tick until its decision carries an outcome."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from enum import Enum, auto
from typing import Protocol

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.docking.states import State
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Pose2D
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation.certainty import SURE, Certainty
from omnibotd.core.navigation.goal_filter import GoalFilter
from omnibotd.core.navigation.planning import roads_of
from omnibotd.core.navigation.report import report
from omnibotd.core.navigation.search import Search, SearchState, way_back
from omnibotd.core.safety import Limits

# Failures of the trip to the staging pose that are its own; a dead base is no staging trouble and keeps its name.
_STAGING_FAILURES = {ErrorName.LOST, ErrorName.BLOCKED, ErrorName.NO_ROUTE, ErrorName.TIMEOUT}
# Those of them after which the dock may be in sight: no way over the taught floor leads there, but it is near.
_STILL_IN_SIGHT = {ErrorName.LOST, ErrorName.TIMEOUT}
# How a look at the dock from where the robot stands may end without ending the trip.
_NOT_THERE = {None, ErrorName.NOT_DOCKED, ErrorName.FAILED_TO_DETECT_DOCK}
# Failures after which another way there may well succeed.
_OTHERWISE = {
    ErrorName.FAILED_TO_STAGE,
    ErrorName.FAILED_TO_DETECT_DOCK,
    ErrorName.FAILED_TO_CONTROL,
    ErrorName.TIMEOUT,
}
_ABOUT_TO_SEARCH = Outcome(ErrorName.LOST, "not recognised from here")
# No farther (m) by odometry from where the map was sure last, its word still says where to look for the dock.
_KNOWN_WITHIN = 2.0
# So near (m) the dock itself is what the range sensor sees ahead.
_CONTACT_WITHIN = 0.3


class Job(Protocol):
    """A state machine with one goal."""

    def step(self, seen: Observation) -> Decision:
        """What to do at this tick."""


class _Part(Enum):
    """Of a trip to a dock: how the decisions of its job are passed on."""

    GLANCE = auto()
    TRIP = auto()
    SEARCH = auto()
    DOCK = auto()


class DockingTrip:
    """`goto` the staging pose, then dock (thesis §7.5: the two tiers as one whole).

    A robot that may stand in the dock already looks before it goes anywhere: turning round in a dock, or leaving it to
    come back, helps nobody. One that the map can't place may still stand within sight of the dock, beside the floor
    that was driven: it looks for the dock from where it is before it drives about in search, and before the trip counts
    as failed. A dock that was not recognised, or not as expected, is approached once more by a whole trip: on the way
    the map finds out where the robot is.
    """

    def __init__(
        self,
        trip: Callable[[], Job],
        dock: Callable[[Observation | None], Job],
        glance: Job | None = None,
        trips: int = 1,
    ) -> None:
        """`trip` makes a job that drives to the staging pose, and is called in the control tick from the second of
        `trips` on; `dock` one that docks, given what is seen where that pose was reached and nothing where it was not.
        `glance` ends without an error where the robot is in the dock, as DOCKED where it charges there."""
        self._first: Job | None = trip()
        self._trip, self._dock, self._glance, self._trips = trip, dock, glance, trips
        self._seen: Observation | None = None
        self._placed: Observation | None = None  # when the map was sure last
        self._course = self._run()
        self._part, self._job = next(self._course)

    def step(self, seen: Observation) -> Decision:
        """One tick."""
        self._seen = seen
        if seen.place is not None and seen.place.confidence >= SURE:
            self._placed = seen
        decision = self._shown(self._job.step(seen))
        if decision.outcome is None:
            return decision
        if self._part is _Part.GLANCE and decision.state == State.DOCKED:
            return decision
        try:
            self._part, self._job = self._course.send(decision.outcome)
        except StopIteration as end:
            return replace(decision, outcome=end.value)
        return replace(decision, outcome=None)

    def _shown(self, decision: Decision) -> Decision:
        if self._part is _Part.DOCK:
            left = decision.distance_remaining
            return replace(decision, contact_expected=left is not None and left < _CONTACT_WITHIN)
        if self._part is _Part.GLANCE:
            return decision
        if self._part is _Part.TRIP and decision.state == SearchState.SEARCHING and decision.outcome is None:
            decision = replace(decision, twist=STOP, outcome=_ABOUT_TO_SEARCH)
        return replace(decision, state="NAV_TO_STAGING_POSE")

    def _run(self) -> Generator[tuple[_Part, Job], Outcome, Outcome]:
        """Yields one job after the other and is sent their outcomes; returns how it all ended."""
        if self._glance is not None:
            glanced = yield _Part.GLANCE, self._glance
            if glanced.error not in _NOT_THERE:
                return glanced
            if glanced.error is None:
                docked = yield _Part.DOCK, self._dock(None)
                if docked.error not in _OTHERWISE:
                    return docked
        for _ in range(self._trips - 1):
            outcome = yield from self._whole()
            if outcome.error not in _OTHERWISE:
                return outcome
        return (yield from self._whole())

    def _whole(self) -> Generator[tuple[_Part, Job], Outcome, Outcome]:
        """One trip to the staging pose, and a docking from there."""
        navigator, self._first = self._first or self._trip(), None
        staged = yield _Part.TRIP, navigator
        looked = staged is _ABOUT_TO_SEARCH
        if looked:
            docked = yield _Part.DOCK, self._dock(self._known())
            if docked.error not in _OTHERWISE:
                return docked
            staged = yield _Part.SEARCH, navigator
        if staged.error is None:
            return (yield _Part.DOCK, self._dock(self._seen))
        if staged.error not in _STAGING_FAILURES:
            return staged
        message = f"did not reach the staging pose: {staged.error}, {staged.message}"
        unstaged = Outcome(ErrorName.FAILED_TO_STAGE, message, staged.report)
        if staged.error not in _STILL_IN_SIGHT:
            return unstaged
        # The map's word is wrong for a robot that was carried: a second look does without.
        docked = yield _Part.DOCK, self._dock(None if looked else self._known())
        return unstaged if docked.error is ErrorName.FAILED_TO_DETECT_DOCK else docked

    def _known(self) -> Observation | None:
        """What is seen, where the map was sure of its pose on this trip and not long ago."""
        if self._seen is None or self._placed is None:
            return None
        way = self._placed.odom_from_base.distance(self._seen.odom_from_base)
        return self._seen if way < _KNOWN_WITHIN else None


class Relocalisation:
    """Finds out where the robot is, moving as little as that takes; LOST where it can't."""

    def __init__(self, topo_map: TopoMap, goal_filter: GoalFilter, limits: Limits) -> None:
        self._roads = roads_of(topo_map)
        self._filter = goal_filter
        self._limits = limits
        self._certainty = Certainty()
        self._search: Search | None = None

    def step(self, seen: Observation) -> Decision:
        here = self._filter.map_from_base
        self._certainty.take(seen, here)
        if self._search is None:
            nearest = None if here is None else self._roads.nearest(here)
            self._search = Search(self._certainty, self._limits, way_back(self._certainty, seen, here, nearest))
        decision = self._search.step(seen)
        if decision.outcome is None:
            return decision
        outcome = decision.outcome
        if outcome.error is None and here is not None:
            outcome = Outcome(None, f"at x {here.x:.2f} m, y {here.y:.2f} m, heading {here.yaw:.2f} rad")
        told = report(self._certainty, seen, here, metres_searched=self._search.metres)
        return replace(decision, outcome=replace(outcome, report=told))


class Rounds:
    """Visits the goals in their order, so many times; a goal that is not reached ends the job and is named."""

    def __init__(self, goals: Sequence[Pose2D], loops: int, make_navigator: Callable[[Pose2D], Job]) -> None:
        """`make_navigator` is called in the control tick for every goal but the first: it must be quick."""
        self._goals, self._loops = tuple(goals), loops
        self._make = make_navigator
        self._visited = self._recoveries = 0
        self._navigator = make_navigator(self._goals[0])

    def step(self, seen: Observation) -> Decision:
        decision = self._navigator.step(seen)
        loop, waypoint = divmod(self._visited, len(self._goals))
        recoveries = self._recoveries + decision.recoveries
        decision = replace(decision, waypoint=waypoint + 1, loop=loop + 1, recoveries=recoveries)
        if decision.outcome is None:
            return decision
        return replace(decision, outcome=self._arrived(decision, decision.outcome))

    def _arrived(self, decision: Decision, outcome: Outcome) -> Outcome | None:
        if outcome.error is not None:
            where = f"waypoint {decision.waypoint} of {len(self._goals)}, loop {decision.loop} of {self._loops}"
            told = {**outcome.report, "waypoint": float(decision.waypoint or 0), "loop": float(decision.loop or 0)}
            return Outcome(outcome.error, f"{where}: {outcome.message}", told)
        self._visited += 1
        self._recoveries = decision.recoveries
        if self._visited == len(self._goals) * self._loops:
            return Outcome(None, f"visited {len(self._goals)} waypoints, {self._loops} times")
        self._navigator = self._make(self._goals[self._visited % len(self._goals)])
        return None
