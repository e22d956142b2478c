"""What a robot can be busy with: each job is stepped by the control tick until its decision carries an outcome."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.docking.docker import Docker
from omnibotd.core.error_name import ErrorName
from omnibotd.core.navigation.navigator import Navigator

# Failures of the trip to the staging pose that are its own; a dead base is no staging trouble and keeps its name.
_STAGING_FAILURES = {ErrorName.LOST, ErrorName.BLOCKED, ErrorName.NO_ROUTE, ErrorName.TIMEOUT}


class Job(Protocol):
    """A state machine with one goal."""

    def step(self, seen: Observation) -> Decision:
        """What to do at this tick."""


class DockingTrip:
    """`goto` the staging pose, then dock (thesis §7.5: the two tiers as one whole).

    A robot that the map can't place may still stand within sight of the dock, beside the floor that was driven: it
    looks for the dock from where it is before the trip counts as failed.
    """

    def __init__(self, navigator: Navigator, docker: Docker) -> None:
        self._navigator: Navigator | None = navigator
        self._docker = docker
        self._unstaged: Outcome | None = None

    def step(self, seen: Observation) -> Decision:
        if self._navigator is None:
            return self._dock(seen)
        decision = replace(self._navigator.step(seen), state="NAV_TO_STAGING_POSE")
        if decision.outcome is None:
            return decision
        if decision.outcome.error in _STAGING_FAILURES:
            message = f"did not reach the staging pose: {decision.outcome.error}, {decision.outcome.message}"
            self._unstaged = Outcome(ErrorName.FAILED_TO_STAGE, message)
        if decision.outcome.error in (None, ErrorName.LOST):
            self._navigator = None
            return replace(decision, outcome=None)
        return replace(decision, outcome=self._unstaged or decision.outcome)

    def _dock(self, seen: Observation) -> Decision:
        decision = self._docker.step(seen)
        unseen = decision.outcome is not None and decision.outcome.error is ErrorName.FAILED_TO_DETECT_DOCK
        return replace(decision, outcome=self._unstaged) if unseen and self._unstaged else decision
