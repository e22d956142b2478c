"""Out of the dock and a little aside, on an ideal base that may be held, on a cable, or in danger."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import pytest

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.docking.approach import Limits
from omnibotd.core.docking.glance import Glance
from omnibotd.core.docking.trials import Trials, offsets, summary
from omnibotd.core.docking.undocking import ProvenUndocking, Undocking
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Pose2D, Twist2D
from omnibotd.core.percept import HomingEstimate, Verdict

TICK = 0.1
LIMITS = Limits(0.2, 0.8, 0.0, 0.0)


def moved(pose: Pose2D, twist: Twist2D) -> Pose2D:
    yaw = twist.wz * TICK
    return pose @ Pose2D(twist.vx * TICK * math.cos(yaw / 2), twist.vx * TICK * math.sin(yaw / 2), yaw)


@dataclass
class Base:
    """Stands in the dock; `bend` changes what it feels, given how far back it is."""

    odom: Pose2D = field(default_factory=lambda: Pose2D(4.0, 1.0, 2.0))
    stamp: float = 30.0
    held: bool = False
    bend: Callable[[Observation, float], Observation] = lambda seen, back: seen
    decisions: list[Decision] = field(default_factory=list)

    def run(self, undocking: Undocking, seconds: float = 40.0) -> Outcome:
        start = self.odom
        for _ in range(round(seconds / TICK)):
            seen = self.bend(Observation(self.stamp, self.odom), -(start.inverse() @ self.odom).x)
            decision = undocking.step(seen)
            self.decisions.append(decision)
            if decision.outcome is not None:
                assert decision.twist == STOP
                return decision.outcome
            self.odom = self.odom if self.held else moved(self.odom, decision.twist)
            self.stamp += TICK
        raise AssertionError("no outcome")


def test_backs_out_half_a_metre_along_its_heading() -> None:
    base = Base()
    assert base.run(Undocking(LIMITS)).error is None
    out = Pose2D(4.0, 1.0, 2.0).inverse() @ base.odom
    assert (out.x, out.y, out.yaw) == pytest.approx((-0.5, 0.0, 0.0), abs=0.02)
    assert all(-0.1 <= d.twist.vx <= 0.0 for d in base.decisions)
    left = [d.distance_remaining for d in base.decisions]
    assert left == sorted(left, reverse=True)


@pytest.mark.parametrize("offset", [Pose2D(0.08, -0.07, 0.3), Pose2D(-0.05, 0.08, -0.3), Pose2D(0.0, 0.01, 0.1)])
def test_then_steps_aside(offset: Pose2D) -> None:
    base = Base()
    assert base.run(Undocking(LIMITS, offset)).error is None
    out = Pose2D(4.0, 1.0, 2.0).inverse() @ base.odom
    assert out.distance(Pose2D(-0.5) @ offset) < 0.03
    assert out.yaw == pytest.approx(offset.yaw, abs=0.1)


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"emergency_stop": True}, ErrorName.EMERGENCY_STOP),
        ({"base_ok": False}, ErrorName.BASE_LINK_DOWN),
        ({"wheel_drop": True}, ErrorName.BLOCKED),
    ],
)
@pytest.mark.parametrize("back", [0.0, 0.2, 0.5])
def test_danger_ends_it_at_once_wherever_it_is(change: dict[str, bool], error: ErrorName, back: float) -> None:
    base = Base(bend=lambda seen, now: replace(seen, **change) if now >= back else seen)
    assert base.run(Undocking(LIMITS, Pose2D(0.05, 0.05, 0.2))).error is error


def test_needs_no_camera() -> None:
    assert Base(bend=lambda seen, back: replace(seen, camera_ok=False)).run(Undocking(LIMITS)).error is None


def test_a_base_that_does_not_move_is_said_to_be_held() -> None:
    base = Base(held=True)
    outcome = base.run(Undocking(LIMITS))
    assert outcome.error is ErrorName.FAILED_TO_CONTROL
    assert "holds it" in outcome.message
    assert base.stamp - 30.0 < 6.0


def test_a_contact_opens_on_the_way_out_a_cable_does_not() -> None:
    contact = Base(bend=lambda seen, back: replace(seen, charging=back < 0.05))
    assert contact.run(Undocking(LIMITS)).error is None
    cable = Base(bend=lambda seen, back: replace(seen, charging=True))
    outcome = cable.run(Undocking(LIMITS))
    assert outcome.error is ErrorName.FAILED_TO_CONTROL
    assert "cable" in outcome.message
    assert Pose2D(4.0, 1.0).distance(cable.odom) < 0.3


def glance_at(pose: Pose2D | None, charging: bool | None = None, *, by_touch: bool = False) -> tuple[Decision, float]:
    """How a glance ends where the camera sees the base at `pose`, or nothing; and how long it took."""
    glance, odom = Glance("home", 0.1, math.radians(10.0), by_touch=by_touch), Pose2D()
    homing = None
    for tick in range(100):
        stamp = 10.0 + TICK * tick
        decision = glance.step(Observation(stamp, odom, homing=homing, charging=charging))
        assert decision.twist == STOP
        if decision.outcome is not None:
            return decision, TICK * tick
        if pose is not None:
            homing = HomingEstimate(stamp, odom, pose, 0.9, 0.3, Verdict.ACCEPTED)
    raise AssertionError("no outcome")


@pytest.mark.parametrize(
    ("pose", "charging", "by_touch", "error", "state"),
    [
        (Pose2D(0.02, 0.01, 0.05), None, False, None, "INITIAL_PERCEPTION"),
        (Pose2D(0.02, 0.01, 0.05), True, False, None, "DOCKED"),
        (Pose2D(-0.5, 0.01, 0.05), True, True, ErrorName.NOT_DOCKED, "INITIAL_PERCEPTION"),
        (Pose2D(0.0, 0.0, 0.5), None, False, ErrorName.NOT_DOCKED, "INITIAL_PERCEPTION"),
        (None, True, False, ErrorName.FAILED_TO_DETECT_DOCK, "INITIAL_PERCEPTION"),
        (None, True, True, None, "DOCKED"),
        (None, False, True, ErrorName.FAILED_TO_DETECT_DOCK, "INITIAL_PERCEPTION"),
    ],
)
def test_a_glance_tells_whether_the_robot_is_in_the_dock(
    pose: Pose2D | None, charging: bool | None, by_touch: bool, error: ErrorName | None, state: str
) -> None:
    decision, seconds = glance_at(pose, charging, by_touch=by_touch)
    assert decision.outcome is not None
    assert (decision.outcome.error, decision.state) == (error, state)
    assert seconds < (5.0 if pose is None else 2.0)


@dataclass
class Ends:
    """Ends at its second step."""

    outcome: Outcome
    steps: int = 0

    def step(self, seen: Observation) -> Decision:
        self.steps += 1
        return Decision("SCRIPTED", outcome=self.outcome if self.steps == 2 else None, recoveries=self.steps)


UNSEEN = Outcome(ErrorName.FAILED_TO_DETECT_DOCK, "dark")
NOT_THERE = Outcome(ErrorName.NOT_DOCKED, "0.43 m away")
DONE = Outcome(None, "done")


@pytest.mark.parametrize(
    ("seen", "by_memory", "error"),
    [
        (DONE, False, None),
        (UNSEEN, True, None),
        (UNSEEN, False, ErrorName.NOT_DOCKED),
        (NOT_THERE, True, ErrorName.NOT_DOCKED),
        (Outcome(ErrorName.EMERGENCY_STOP, "pressed"), True, ErrorName.EMERGENCY_STOP),
    ],
)
def test_it_leaves_only_a_dock_it_is_proven_to_be_in(seen: Outcome, by_memory: bool, error: ErrorName | None) -> None:
    undocking = Ends(DONE)
    job = ProvenUndocking(Ends(seen), undocking, by_memory=by_memory)
    outcome = None
    while outcome is None:
        outcome = job.step(Observation(0.0, Pose2D())).outcome
    assert outcome.error is error
    assert undocking.steps == (2 if error is None else 0)


class Installation:
    """Makes docking jobs that end as scripted, and drives an ideal base out of the dock."""

    def __init__(self, *endings: Outcome, trip: Outcome = DONE) -> None:
        self.endings, self.trip = list(endings), trip
        self.trips = 0
        self.decisions: list[Decision] = []

    def make_trip(self) -> Ends:
        self.trips += 1
        return Ends(self.trip)

    def make_dock(self) -> Ends:
        return Ends(self.endings.pop(0))

    def run(self, trials: Trials) -> Outcome:
        odom, stamp = Pose2D(), 0.0
        while True:
            decision = trials.step(Observation(stamp, odom))
            self.decisions.append(decision)
            if decision.outcome is not None:
                return decision.outcome
            odom, stamp = moved(odom, decision.twist), stamp + TICK
            assert stamp < 200.0


def docked_at(x: float, y: float, yaw: float) -> Outcome:
    return Outcome(None, "docked", {"dock_x": x, "dock_y": y, "dock_yaw": yaw})


def trials_of(site: Installation, count: int) -> Trials:
    return Trials(offsets(count, 7), LIMITS, site.make_trip, site.make_dock)


def test_trials_tell_each_docking_and_what_they_have_in_common() -> None:
    site = Installation(docked_at(0.003, 0.004, 0.01), docked_at(-0.001, 0.0, -0.01))
    trials = trials_of(site, 2)
    assert site.run(trials).error is None
    assert site.trips == 1  # only to get into the dock at first
    assert [trial.error for trial in trials.trials] == [None, None]
    assert {decision.loop for decision in site.decisions} == {1, 2}
    spread = summary(trials.trials)
    assert spread["x"] is not None
    assert spread["distance"] is not None
    assert (spread["x"].mean, spread["x"].sd) == pytest.approx((0.001, 0.002))
    assert spread["distance"].mean == pytest.approx(0.003)
    assert spread["retries"] is not None
    assert spread["retries"].mean == 2.0
    assert all(0.0 < trial.seconds < 0.5 for trial in trials.trials)


def test_a_docking_that_failed_is_counted_and_mended_by_a_whole_trip() -> None:
    site = Installation(Outcome(ErrorName.FAILED_TO_CHARGE, "no contact"), docked_at(0.0, 0.0, 0.0))
    trials = trials_of(site, 2)
    assert site.run(trials).error is None
    assert [trial.error for trial in trials.trials] == [ErrorName.FAILED_TO_CHARGE, None]
    assert site.trips == 2
    assert trials.trials[0].offset is None
    assert summary(trials.trials)["x"] == summary(trials.trials[1:])["x"]


def test_the_last_one_failing_ends_the_trials_all_the_same() -> None:
    site = Installation(Outcome(ErrorName.FAILED_TO_CHARGE, "no contact"))
    trials = trials_of(site, 1)
    assert site.run(trials).error is None
    assert summary(trials.trials)["seconds"] is None


@pytest.mark.parametrize("error", [ErrorName.EMERGENCY_STOP, ErrorName.BASE_LINK_DOWN, ErrorName.BLOCKED])
def test_what_is_no_docking_failure_ends_the_trials(error: ErrorName) -> None:
    site = Installation(docked_at(0.0, 0.0, 0.0), Outcome(error, "why"))
    outcome = site.run(trials_of(site, 3))
    assert outcome.error is error
    assert "trial 2 of 3" in outcome.message
    assert (outcome.report["trials"], outcome.report["docked"]) == (2, 1)


def test_a_robot_that_can_not_be_docked_at_all_makes_no_trial() -> None:
    site = Installation(trip=Outcome(ErrorName.FAILED_TO_STAGE, "blocked"))
    outcome = site.run(trials_of(site, 3))
    assert outcome.error is ErrorName.FAILED_TO_STAGE
    assert "trial 1 of 3" in outcome.message


def test_starts_are_about_the_staging_pose_and_repeatable() -> None:
    poses = offsets(200, 5)
    assert poses == offsets(200, 5)
    assert poses != offsets(200, 6)
    assert max(abs(pose.x) for pose in poses) <= 0.08
    assert max(abs(pose.y) for pose in poses) <= 0.08
    assert 0.2 < max(abs(pose.yaw) for pose in poses) <= math.radians(20.0)
