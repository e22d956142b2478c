"""Jobs made of jobs: staging and docking, rounds, and a search by itself."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Pose2D, Twist2D
from omnibotd.core.jobs import DockingTrip, Relocalisation, Rounds
from omnibotd.core.mapping.topo_map import Edges, TopoMap
from omnibotd.core.navigation.goal_filter import GoalFilter
from omnibotd.core.percept import PlaceEstimate
from omnibotd.core.safety import Limits

SEEN = Observation(0.0, Pose2D())
DONE = Outcome(None, "done")


def failed(error: ErrorName) -> Outcome:
    return Outcome(error, "why")


@dataclass
class Scripted:
    """Ends with this outcome at its second step."""

    outcome: Outcome
    decision: Decision = field(default_factory=lambda: Decision("SCRIPTED"))
    steps: list[Observation] = field(default_factory=list)

    def step(self, seen: Observation) -> Decision:
        self.steps.append(seen)
        return replace(self.decision, outcome=self.outcome if len(self.steps) == 2 else None)


def end_of(staging: Outcome, docking: Outcome) -> tuple[Outcome, Scripted]:
    navigator, docker = Scripted(staging), Scripted(docking)
    trip = DockingTrip(lambda: navigator, lambda staged: docker)
    for _ in range(5):
        decision = trip.step(SEEN)
        if decision.outcome is not None:
            return decision.outcome, docker
    raise AssertionError("no outcome")


def test_a_trip_that_staged_ends_as_its_docking_does() -> None:
    assert end_of(DONE, DONE)[0] == DONE
    assert end_of(DONE, failed(ErrorName.FAILED_TO_CHARGE))[0] == failed(ErrorName.FAILED_TO_CHARGE)
    assert end_of(DONE, failed(ErrorName.FAILED_TO_DETECT_DOCK))[0].error is ErrorName.FAILED_TO_DETECT_DOCK


@pytest.mark.parametrize("why", [ErrorName.LOST, ErrorName.TIMEOUT])
def test_a_robot_lost_or_stuck_on_the_way_looks_for_the_dock_from_where_it_is(why: ErrorName) -> None:
    assert end_of(failed(why), DONE)[0] == DONE
    outcome, _ = end_of(failed(why), failed(ErrorName.FAILED_TO_DETECT_DOCK))
    assert outcome.error is ErrorName.FAILED_TO_STAGE
    assert why in outcome.message


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (ErrorName.BLOCKED, ErrorName.FAILED_TO_STAGE),
        (ErrorName.NO_ROUTE, ErrorName.FAILED_TO_STAGE),
        (ErrorName.BASE_LINK_DOWN, ErrorName.BASE_LINK_DOWN),
        (ErrorName.EMERGENCY_STOP, ErrorName.EMERGENCY_STOP),
    ],
)
def test_other_failures_of_staging_end_the_trip(error: ErrorName, told: ErrorName) -> None:
    outcome, docker = end_of(failed(error), DONE)
    assert outcome.error is told
    assert docker.steps == []


def ends(trip: DockingTrip) -> list[Decision]:
    """All decisions up to the one with the outcome."""
    decisions = [trip.step(SEEN)]
    while decisions[-1].outcome is None:
        assert len(decisions) < 30
        decisions.append(trip.step(SEEN))
    return decisions


def test_before_it_drives_about_in_search_it_looks_for_the_dock() -> None:
    navigator = Scripted(DONE, Decision("SEARCHING", Twist2D(0.1, 0.0)))
    decisions = ends(DockingTrip(lambda: navigator, lambda staged: Scripted(DONE)))
    assert decisions[0].twist == STOP
    assert len(navigator.steps) == 1
    assert decisions[-1].outcome == DONE


def test_a_dock_that_is_not_seen_from_there_is_searched_for_by_the_map() -> None:
    navigator = Scripted(DONE, Decision("SEARCHING", Twist2D(0.1, 0.0)))
    dockers = [Scripted(failed(ErrorName.FAILED_TO_DETECT_DOCK)), Scripted(DONE)]
    staged: list[Observation | None] = []

    def dock(seen: Observation | None) -> Scripted:
        staged.append(seen)
        return dockers[len(staged) - 1]

    assert ends(DockingTrip(lambda: navigator, dock))[-1].outcome == DONE
    assert len(navigator.steps) == 2
    assert staged == [None, SEEN]


def test_a_search_in_vain_ends_in_failed_to_stage_and_says_why() -> None:
    navigator = Scripted(failed(ErrorName.LOST), Decision("SEARCHING", Twist2D(0.1, 0.0)))
    trip = DockingTrip(lambda: navigator, lambda staged: Scripted(failed(ErrorName.FAILED_TO_DETECT_DOCK)))
    outcome = ends(trip)[-1].outcome
    assert outcome is not None
    assert (outcome.error, outcome.message) == (
        ErrorName.FAILED_TO_STAGE,
        "did not reach the staging pose: LOST, why",
    )


@pytest.mark.parametrize(("way", "by_the_map"), [(0.5, True), (3.0, False)])
def test_it_looks_where_the_map_was_sure_a_moment_ago(way: float, by_the_map: bool) -> None:
    sure = PlaceEstimate(0.0, Pose2D(), Pose2D(), 0.95, 0.02, 0.5, 0.2, 3)
    here = replace(SEEN, odom_from_base=Pose2D(way, 0.0))
    staged: list[Observation | None] = []
    trip = DockingTrip(lambda: Scripted(failed(ErrorName.LOST)), lambda seen: staged.append(seen) or Scripted(DONE))
    for seen in (replace(SEEN, place=sure), here, here):
        trip.step(seen)
    assert staged == [here if by_the_map else None]


def test_a_second_look_does_without_the_maps_word() -> None:
    """It is wrong for a robot that was carried."""
    sure = PlaceEstimate(0.0, Pose2D(), Pose2D(), 0.95, 0.02, 0.5, 0.2, 3)
    seen, staged = replace(SEEN, place=sure), list[Observation | None]()
    navigator = Scripted(failed(ErrorName.LOST), Decision("SEARCHING", Twist2D(0.1, 0.0)))

    def dock(known: Observation | None) -> Scripted:
        staged.append(known)
        return Scripted(failed(ErrorName.FAILED_TO_DETECT_DOCK))

    trip = DockingTrip(lambda: navigator, dock)
    while trip.step(seen).outcome is None:
        assert len(staged) < 3
    assert staged == [seen, None]


def test_a_trip_that_ended_lost_is_made_once_more() -> None:
    ends_of = iter([failed(ErrorName.LOST), DONE])
    dockers = iter([Scripted(failed(ErrorName.FAILED_TO_DETECT_DOCK)), Scripted(DONE)])
    trip = DockingTrip(lambda: Scripted(next(ends_of)), lambda staged: next(dockers), trips=2)
    assert ends(trip)[-1].outcome == DONE


@pytest.mark.parametrize(
    ("error", "trips"),
    [
        (ErrorName.FAILED_TO_DETECT_DOCK, 2),
        (ErrorName.FAILED_TO_CONTROL, 2),
        (ErrorName.TIMEOUT, 2),
        (ErrorName.FAILED_TO_CHARGE, 1),
        (ErrorName.EMERGENCY_STOP, 1),
    ],
)
def test_a_dock_that_was_not_recognised_is_approached_once_more(error: ErrorName, trips: int) -> None:
    navigators: list[Scripted] = []

    def trip() -> Scripted:
        navigators.append(Scripted(DONE))
        return navigators[-1]

    assert ends(DockingTrip(trip, lambda staged: Scripted(failed(error)), trips=2))[-1].outcome == failed(error)
    assert len(navigators) == trips


def test_a_robot_that_took_another_place_for_the_dock_drives_to_the_staging_pose_after_all() -> None:
    navigator = Scripted(DONE)
    dockers = iter([Scripted(failed(ErrorName.FAILED_TO_CONTROL)), Scripted(DONE)])
    trip = DockingTrip(lambda: navigator, lambda staged: next(dockers), Scripted(DONE))
    assert ends(trip)[-1].outcome == DONE
    assert len(navigator.steps) == 2


@pytest.mark.parametrize("error", [ErrorName.NOT_DOCKED, ErrorName.FAILED_TO_DETECT_DOCK])
def test_a_robot_that_is_not_in_the_dock_goes_to_the_staging_pose_first(error: ErrorName) -> None:
    navigator, docker, staged = Scripted(DONE), Scripted(DONE), list[Observation | None]()
    trip = DockingTrip(lambda: navigator, lambda seen: staged.append(seen) or docker, Scripted(failed(error)))
    decisions = [trip.step(SEEN) for _ in range(6)]
    assert [len(job.steps) for job in (navigator, docker)] == [2, 2]
    assert staged == [SEEN]
    assert [d.outcome for d in decisions] == [None] * 5 + [DONE]


def test_a_robot_in_the_dock_goes_nowhere_first() -> None:
    navigator, docker, staged = Scripted(DONE), Scripted(DONE), list[Observation | None]()
    trip = DockingTrip(lambda: navigator, lambda seen: staged.append(seen) or docker, Scripted(DONE))
    decisions = [trip.step(SEEN) for _ in range(4)]
    assert (len(navigator.steps), len(docker.steps), staged) == (0, 2, [None])
    assert decisions[-1].outcome == DONE


def test_a_robot_that_charges_in_the_dock_is_done() -> None:
    navigator, docker = Scripted(DONE), Scripted(DONE)
    trip = DockingTrip(lambda: navigator, lambda staged: docker, Scripted(DONE, Decision("DOCKED")))
    assert [trip.step(SEEN).outcome for _ in range(2)] == [None, DONE]
    assert (len(navigator.steps), len(docker.steps)) == (0, 0)


def test_danger_while_it_looks_ends_the_trip() -> None:
    glance = Scripted(failed(ErrorName.EMERGENCY_STOP))
    trip = DockingTrip(lambda: Scripted(DONE), lambda staged: Scripted(DONE), glance)
    assert [trip.step(SEEN).outcome for _ in range(2)] == [None, failed(ErrorName.EMERGENCY_STOP)]


def test_a_trip_that_lost_its_way_is_not_staged() -> None:
    staged: list[Observation | None] = []
    trip = DockingTrip(lambda: Scripted(failed(ErrorName.LOST)), lambda seen: staged.append(seen) or Scripted(DONE))
    ends(trip)
    assert staged == [None]


@pytest.mark.parametrize(("left", "expected"), [(None, False), (0.5, False), (0.2, True), (0.0, True)])
def test_only_near_the_dock_contact_is_expected(left: float | None, expected: bool) -> None:
    docker = Scripted(DONE, Decision("CONTROLLING", distance_remaining=left))
    navigator = Scripted(DONE, Decision("FOLLOWING", distance_remaining=0.1))
    trip = DockingTrip(lambda: navigator, lambda staged: docker)
    assert [trip.step(SEEN).contact_expected for _ in range(3)] == [False, False, expected]


class Course:
    """Makes scripted navigators; the trip numbered `fails` (from 1) fails."""

    def __init__(self, fails: int = 0) -> None:
        self.goals: list[Pose2D] = []
        self._fails = fails

    def make(self, goal: Pose2D) -> Scripted:
        self.goals.append(goal)
        fails = len(self.goals) == self._fails
        outcome = Outcome(ErrorName.BLOCKED, "a box", {"bumps": 9.0}) if fails else DONE
        return Scripted(outcome, Decision("FOLLOWING", recoveries=1))


GOALS = [Pose2D(1.0), Pose2D(2.0), Pose2D(3.0)]


def test_rounds_visit_the_goals_in_order_and_say_where_they_are() -> None:
    course = Course()
    rounds = Rounds(GOALS, 2, course.make)
    decisions = []
    while not decisions or decisions[-1].outcome is None:
        decisions.append(rounds.step(SEEN))
    assert course.goals == GOALS * 2
    assert [(d.loop, d.waypoint) for d in decisions[::2]] == [(1, 1), (1, 2), (1, 3), (2, 1), (2, 2), (2, 3)]
    assert decisions[-1].outcome.error is None
    assert decisions[-1].recoveries == 6


def test_a_waypoint_not_reached_ends_the_rounds_and_is_named() -> None:
    course = Course(fails=5)
    rounds = Rounds(GOALS, 2, course.make)
    decision = rounds.step(SEEN)
    while decision.outcome is None:
        decision = rounds.step(SEEN)
    assert decision.outcome.error is ErrorName.BLOCKED
    assert decision.outcome.message == "waypoint 2 of 3, loop 2 of 2: a box"
    assert decision.outcome.report == {"bumps": 9.0, "waypoint": 2.0, "loop": 2.0}
    assert len(course.goals) == 5


def two_nodes() -> TopoMap:
    edges = Edges(np.array([0], np.int32), np.array([1], np.int32), np.zeros(1, np.uint8))
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], np.float32)
    codebook, units = np.zeros((1, 192), np.float32), np.zeros(2, np.uint16)
    return TopoMap("pair", codebook, units, np.zeros((2, 512), np.uint8), poses, units, edges)


def relocalise(confidence: float, start: Pose2D) -> tuple[list[Decision], Pose2D]:
    """On an ideal base whose odometry is its map's frame; returns what was decided, and where it ended."""
    goal_filter, pose, stamp = GoalFilter(), start, 5.0
    job = Relocalisation(two_nodes(), goal_filter, Limits(0.3, 1.0, 0.5, 2.0))
    decisions: list[Decision] = []
    while not decisions or decisions[-1].outcome is None:
        place = PlaceEstimate(stamp, pose, pose, confidence, 0.02, 0.8, 0.2, 1)
        goal_filter.predict(pose)
        goal_filter.update(place, 0.6)
        decisions.append(job.step(Observation(stamp, pose, place)))
        twist = decisions[-1].twist
        pose, stamp = pose @ Pose2D(twist.vx * 0.1, 0.0, twist.wz * 0.1), stamp + 0.1
        assert stamp < 400.0
    return decisions, pose


def test_relocalising_turns_a_little_even_where_it_is_sure() -> None:
    decisions, pose = relocalise(0.95, Pose2D(0.5, 0.2, 1.0))
    outcome = decisions[-1].outcome
    assert outcome.error is None
    assert pose.distance(Pose2D(0.5, 0.2)) < 0.01
    assert 0.3 < pose.yaw - 1.0 < 1.0
    assert outcome.report["x"] == pytest.approx(0.5, abs=0.02)


def test_relocalising_where_nothing_fits_ends_lost_and_says_what_was_seen() -> None:
    decisions, _ = relocalise(0.2, Pose2D(0.5, 0.2, 1.0))
    outcome = decisions[-1].outcome
    assert outcome.error is ErrorName.LOST
    assert outcome.report["confidence"] == 0.2
    assert outcome.report["metres_searched"] > 2.0
    assert {decision.state for decision in decisions} == {"LOCALISING", "SEARCHING"}
