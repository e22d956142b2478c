"""What a robot can be busy with: each job is stepped by the control tick until its decision carries an outcome."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

from omnibotd.core.decision import Decision, ErrorName, Observation, Outcome
from omnibotd.core.docking.docker import Docker
from omnibotd.core.navigation.navigator import Navigator

# Failures of the trip to the staging pose that are its own; a dead base is no staging trouble and keeps its name.
_STAGING_FAILURES = {ErrorName.LOST, ErrorName.BLOCKED, ErrorName.NO_ROUTE, ErrorName.TIMEOUT}


class Job(Protocol):
    """A state machine with one goal."""

    def step(self, seen: Observation) -> Decision:
        """What to do at this tick."""


class DockingTrip:
    """`goto` the staging pose, then dock (thesis §7.5: the two tiers as one whole)."""

    def __init__(self, navigator: Navigator, docker: Docker) -> None:
        self._navigator: Navigator | None = navigator
        self._docker = docker

    def step(self, seen: Observation) -> Decision:
        if self._navigator is None:
            return self._docker.step(seen)
        decision = replace(self._navigator.step(seen), state="NAV_TO_STAGING_POSE")
        if decision.outcome is None:
            return decision
        if decision.outcome.error is None:
            self._navigator = None
            return replace(decision, outcome=None)
        if decision.outcome.error in _STAGING_FAILURES:
            message = f"did not reach the staging pose: {decision.outcome.error}, {decision.outcome.message}"
            return replace(decision, outcome=Outcome(ErrorName.FAILED_TO_STAGE, message))
        return decision
