"""What a robot can be busy with: each job is stepped by the control tick until its decision carries an outcome."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.docking.states import State
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Pose2D
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation.certainty import Certainty
from omnibotd.core.navigation.goal_filter import GoalFilter
from omnibotd.core.navigation.planning import roads_of
from omnibotd.core.navigation.report import report
from omnibotd.core.navigation.search import Search, SearchState, way_back
from omnibotd.core.safety import Limits

# Failures of the trip to the staging pose that are its own; a dead base is no staging trouble and keeps its name.
_STAGING_FAILURES = {ErrorName.LOST, ErrorName.BLOCKED, ErrorName.NO_ROUTE, ErrorName.TIMEOUT}
# How a look at the dock from where the robot stands may end without ending the trip.
_NOT_THERE = {None, ErrorName.NOT_DOCKED, ErrorName.FAILED_TO_DETECT_DOCK}
# So near (m) the dock itself is what the range sensor sees ahead.
_CONTACT_WITHIN = 0.3


class Job(Protocol):
    """A state machine with one goal."""

    def step(self, seen: Observation) -> Decision:
        """What to do at this tick."""


class DockingTrip:
    """`goto` the staging pose, then dock (thesis §7.5: the two tiers as one whole).

    A robot that may stand in the dock already looks before it goes anywhere: turning round in a dock, or leaving it to
    come back, helps nobody. One that the map can't place may still stand within sight of the dock, beside the floor
    that was driven: it looks for the dock from where it is before it would drive about in search, and before the trip
    counts as failed.
    """

    def __init__(
        self,
        navigator: Job,
        docker: Job,
        glance: Job | None = None,
        staged: Callable[[Observation], None] = lambda seen: None,
    ) -> None:
        """`glance` ends without an error where the robot is in the dock, as DOCKED where it charges there; `staged`
        hears when the staging pose is reached."""
        self._glance = glance
        self._navigator: Job | None = navigator
        self._docker = docker
        self._hear_staged = staged
        self._unstaged: Outcome | None = None

    def step(self, seen: Observation) -> Decision:
        if self._glance is not None:
            return self._glanced(self._glance, seen)
        if self._navigator is None:
            return self._dock(seen)
        decision = self._navigator.step(seen)
        if decision.state == SearchState.SEARCHING and decision.outcome is None:
            lost = Outcome(ErrorName.LOST, "not recognised from here")
            decision = replace(decision, twist=STOP, outcome=lost)
        return self._staged(replace(decision, state="NAV_TO_STAGING_POSE"), seen)

    def _glanced(self, glance: Job, seen: Observation) -> Decision:
        decision = glance.step(seen)
        if decision.outcome is None or decision.outcome.error not in _NOT_THERE or decision.state == State.DOCKED:
            return decision
        self._glance = None
        if decision.outcome.error is None:
            self._navigator = None
        return replace(decision, outcome=None)

    def _staged(self, decision: Decision, seen: Observation) -> Decision:
        outcome = decision.outcome
        if outcome is None:
            return decision
        if outcome.error in _STAGING_FAILURES:
            message = f"did not reach the staging pose: {outcome.error}, {outcome.message}"
            self._unstaged = Outcome(ErrorName.FAILED_TO_STAGE, message, outcome.report)
        if outcome.error is None:
            self._hear_staged(seen)
        if outcome.error in (None, ErrorName.LOST):
            self._navigator = None
            return replace(decision, outcome=None)
        return replace(decision, outcome=self._unstaged or outcome)

    def _dock(self, seen: Observation) -> Decision:
        decision = self._docker.step(seen)
        left = decision.distance_remaining
        decision = replace(decision, contact_expected=left is not None and left < _CONTACT_WITHIN)
        unseen = decision.outcome is not None and decision.outcome.error is ErrorName.FAILED_TO_DETECT_DOCK
        return replace(decision, outcome=self._unstaged) if unseen and self._unstaged else decision


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
