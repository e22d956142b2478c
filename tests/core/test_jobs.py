"""Staging and docking as one job: whose failure is whose."""

from dataclasses import dataclass, field
from typing import cast

import pytest

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.docking.docker import Docker
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D
from omnibotd.core.jobs import DockingTrip
from omnibotd.core.navigation.navigator import Navigator

SEEN = Observation(0.0, Pose2D())
DONE = Outcome(None, "done")


def failed(error: ErrorName) -> Outcome:
    return Outcome(error, "why")


@dataclass
class Scripted:
    """Ends with this outcome at its second step."""

    outcome: Outcome
    steps: list[Observation] = field(default_factory=list)

    def step(self, seen: Observation) -> Decision:
        self.steps.append(seen)
        return Decision("SCRIPTED", outcome=self.outcome if len(self.steps) == 2 else None)


def end_of(staging: Outcome, docking: Outcome) -> tuple[Outcome, Scripted]:
    navigator, docker = Scripted(staging), Scripted(docking)
    trip = DockingTrip(cast(Navigator, navigator), cast(Docker, docker))
    for _ in range(5):
        decision = trip.step(SEEN)
        if decision.outcome is not None:
            return decision.outcome, docker
    raise AssertionError("no outcome")


def test_a_trip_that_staged_ends_as_its_docking_does() -> None:
    assert end_of(DONE, DONE)[0] == DONE
    assert end_of(DONE, failed(ErrorName.FAILED_TO_CHARGE))[0] == failed(ErrorName.FAILED_TO_CHARGE)
    assert end_of(DONE, failed(ErrorName.FAILED_TO_DETECT_DOCK))[0].error is ErrorName.FAILED_TO_DETECT_DOCK


def test_a_robot_lost_on_the_way_looks_for_the_dock_from_where_it_is() -> None:
    assert end_of(failed(ErrorName.LOST), DONE)[0] == DONE
    outcome, _ = end_of(failed(ErrorName.LOST), failed(ErrorName.FAILED_TO_DETECT_DOCK))
    assert outcome.error is ErrorName.FAILED_TO_STAGE
    assert "LOST" in outcome.message


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (ErrorName.BLOCKED, ErrorName.FAILED_TO_STAGE),
        (ErrorName.NO_ROUTE, ErrorName.FAILED_TO_STAGE),
        (ErrorName.TIMEOUT, ErrorName.FAILED_TO_STAGE),
        (ErrorName.BASE_LINK_DOWN, ErrorName.BASE_LINK_DOWN),
        (ErrorName.EMERGENCY_STOP, ErrorName.EMERGENCY_STOP),
    ],
)
def test_other_failures_of_staging_end_the_trip(error: ErrorName, told: ErrorName) -> None:
    outcome, docker = end_of(failed(error), DONE)
    assert outcome.error is told
    assert docker.steps == []
