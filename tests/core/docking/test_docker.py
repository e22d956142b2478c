"""The docking state machine: aborts in every state, the ways through the table, and what it never does."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import pytest

from omnibotd.core.decision import Decision, Observation
from omnibotd.core.docking.docker import Docker, DockingParameters, staging_pose
from omnibotd.core.docking.states import TRANSITIONS, Event, State
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Pose2D
from omnibotd.core.percept import HomingEstimate, Verdict
from omnibotd.core.safety import Limits, SafetyGate

TICK = 0.1


@dataclass
class Stage:
    """A docker, an exact base and an exact eye whose answers lag two ticks; tests bend what it observes."""

    dock_from_base: Pose2D
    docker: Docker = field(default_factory=lambda: Docker("home"))
    stamp: float = 50.0
    odom_from_base: Pose2D = field(default_factory=lambda: Pose2D(3.0, -2.0, 1.0))
    charging: bool | None = None
    bend_estimate: Callable[[HomingEstimate, bool], HomingEstimate | None] = lambda estimate, full: estimate
    bend_observation: Callable[[Observation], Observation] = lambda observation: observation
    decisions: list[Decision] = field(default_factory=list)
    _answers: list[HomingEstimate | None] = field(default_factory=lambda: [None, None])
    _newest: HomingEstimate | None = None

    def tick(self) -> Decision:
        self._newest = self._answers.pop(0) or self._newest
        observation = Observation(self.stamp, self.odom_from_base, homing=self._newest, charging=self.charging)
        decision = self.docker.step(self.bend_observation(observation))
        self.decisions.append(decision)
        self._move(decision, TICK / 2)
        self._answers.append(self._seen(decision))
        self._move(decision, TICK / 2)
        self.stamp += TICK
        return decision

    def until(self, *states: State, seconds: float = 130.0) -> Decision:
        end = self.stamp + seconds
        while self.stamp < end:
            decision = self.tick()
            if decision.state in states or (decision.outcome is not None and not states):
                return decision
        raise AssertionError(f"still {self.docker.state} after {seconds} s, wanted {states or 'an outcome'}")

    def _move(self, decision: Decision, dt: float) -> None:
        twist = decision.twist
        yaw = twist.wz * dt
        step = Pose2D(twist.vx * dt * math.cos(yaw / 2), twist.vx * dt * math.sin(yaw / 2), yaw)
        self.dock_from_base, self.odom_from_base = self.dock_from_base @ step, self.odom_from_base @ step

    def _seen(self, decision: Decision) -> HomingEstimate | None:
        if decision.homing is None:
            return None
        stamp = self.stamp + TICK / 2
        exact = HomingEstimate(stamp, self.odom_from_base, self.dock_from_base, 0.9, 0.3, Verdict.ACCEPTED)
        return self.bend_estimate(exact, decision.homing.dock_from_odom is None)


START = Pose2D(-0.5, 0.1, 0.3)


def stage_in(state: State) -> Stage:
    """A stage whose docker has just come to `state`."""
    stage = Stage(START)
    if state is State.INITIAL_PERCEPTION:
        stage.tick()
    elif state is State.RETRY:
        stage.charging = False
        stage.until(State.RETRY)
    else:
        stage.charging = False if state is State.WAIT_FOR_CHARGE else None
        stage.until(state)
    assert stage.docker.state == state
    return stage


RUNNING = [State.INITIAL_PERCEPTION, State.CONTROLLING, State.WAIT_FOR_CHARGE, State.RETRY]
ABORTS = [
    ({"base_ok": False}, ErrorName.BASE_LINK_DOWN),
    ({"camera_ok": False}, ErrorName.CAMERA_DOWN),
    ({"emergency_stop": True}, ErrorName.EMERGENCY_STOP),
    ({"stamp": 50.0 + 4 * 60.0 + 0.5}, ErrorName.TIMEOUT),
]


@pytest.mark.parametrize("state", RUNNING)
@pytest.mark.parametrize(("change", "error"), ABORTS)
def test_every_state_aborts_at_once_standing_still(state: State, change: dict[str, float], error: ErrorName) -> None:
    stage = stage_in(state)
    stage.bend_observation = lambda observation: replace(observation, **change)
    decision = stage.tick()
    assert decision.outcome is not None
    assert decision.outcome.error is error
    assert (decision.state, decision.twist, decision.homing) == (State.FAILED, STOP, None)


@pytest.mark.parametrize("state", RUNNING)
def test_an_outcome_is_final(state: State) -> None:
    stage = stage_in(state)
    stage.bend_observation = lambda observation: replace(observation, base_ok=False)
    first = stage.tick()
    stage.bend_observation = lambda observation: observation
    assert stage.tick() == first


def test_the_table_leads_from_every_state_to_an_end() -> None:
    reached, ahead = set(), [State.INITIAL_PERCEPTION]
    while ahead:
        state = ahead.pop()
        if state not in reached:
            reached.add(state)
            ahead += TRANSITIONS[state].values()
    assert reached == set(State)
    assert all(TRANSITIONS[state][Event.ABORTED] is State.FAILED for state in RUNNING)
    assert not TRANSITIONS[State.DOCKED]
    assert not TRANSITIONS[State.FAILED]


@pytest.mark.parametrize("x", [-0.9, -0.4, 0.3, 0.0])
@pytest.mark.parametrize("y", [-0.4, 0.005, 0.5])
@pytest.mark.parametrize("yaw", [-2.8, -1.5, 0.0, 0.4, 3.1])
def test_docks_from_anywhere_near(x: float, y: float, yaw: float) -> None:
    stage = Stage(Pose2D(x, y, yaw))
    decision = stage.until()
    assert decision.outcome is not None
    assert decision.outcome.error is None
    assert decision.state == State.DOCKED
    assert decision.recoveries == 0
    assert math.hypot(stage.dock_from_base.x, stage.dock_from_base.y) <= 0.004
    assert abs(stage.dock_from_base.yaw) <= math.radians(0.25)
    assert stage.stamp - 50.0 < 60.0


def test_speeds_stay_within_the_limits_and_never_below_what_wheels_can_do() -> None:
    stage = Stage(Pose2D(-0.9, 0.4, -2.0))
    stage.until()
    assert max(abs(d.twist.vx) for d in stage.decisions) <= 0.2
    assert max(abs(d.twist.wz) for d in stage.decisions) <= 0.8
    straight = [abs(d.twist.vx) for d in stage.decisions if d.twist.wz == 0.0 and d.twist.vx != 0.0]
    turning = [abs(d.twist.wz) for d in stage.decisions if d.twist.vx == 0.0 and d.twist.wz != 0.0]
    assert min(straight) >= 0.01
    assert min(turning) >= 0.05


def test_stands_still_and_asks_for_full_fixes_until_two_agree() -> None:
    stage = Stage(START)
    stage.until(State.CONTROLLING)
    looking = [d for d in stage.decisions if d.state == State.INITIAL_PERCEPTION]
    assert all(d.twist == STOP for d in looking)
    assert all(d.homing is not None and d.homing.dock_from_odom is None and d.homing.dock == "home" for d in looking)


def test_fixes_that_contradict_each_other_never_set_it_off() -> None:
    turn = iter(range(10_000))

    def scatter(estimate: HomingEstimate, full: bool) -> HomingEstimate:
        offset = Pose2D(0.3 * next(turn), 0.0, 0.0)
        return replace(estimate, dock_from_base=offset @ estimate.dock_from_base)

    stage = Stage(START, bend_estimate=scatter)
    decision = stage.until()
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.FAILED_TO_DETECT_DOCK
    assert all(d.twist == STOP for d in stage.decisions if d.state != State.RETRY)
    assert all(d.twist.vx == 0.0 for d in stage.decisions)


def test_rejected_fixes_end_in_failed_to_detect_after_looking_other_ways() -> None:
    stage = Stage(START, bend_estimate=lambda estimate, full: replace(estimate, verdict=Verdict.REJECTED))
    decision = stage.until()
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.FAILED_TO_DETECT_DOCK
    assert decision.recoveries == 3
    assert stage.dock_from_base.distance(START) < 1e-9
    assert stage.dock_from_base.yaw - START.yaw == pytest.approx(3 * math.radians(40.0), abs=0.1)


def test_on_a_contact_it_never_turns_about_to_look() -> None:
    stage = Stage(Pose2D(), charging=True)
    stage.bend_estimate = lambda estimate, full: replace(estimate, verdict=Verdict.REJECTED)
    stage.until()
    assert all(d.twist == STOP for d in stage.decisions)


def rejected(estimate: HomingEstimate) -> HomingEstimate:
    return replace(estimate, verdict=Verdict.REJECTED)


def test_what_is_seen_only_from_near_by_is_approached_by_the_word_of_a_map_that_is_sure() -> None:
    stage = Stage(START)
    stage.docker.expect(Pose2D(0.05, -0.03, 0.03) @ START @ stage.odom_from_base.inverse())
    stage.bend_estimate = lambda estimate, full: (
        estimate if math.hypot(estimate.dock_from_base.x, estimate.dock_from_base.y) < 0.4 else rejected(estimate)
    )
    decision = stage.until()
    assert decision.state == State.DOCKED
    assert decision.recoveries == 1


def test_a_sure_map_s_word_alone_brings_it_no_nearer_than_a_quarter_metre() -> None:
    stage = Stage(Pose2D(-0.6, 0.0, 0.0), bend_estimate=lambda estimate, full: rejected(estimate))
    stage.docker.expect(stage.dock_from_base @ stage.odom_from_base.inverse())
    decision = stage.until()
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.FAILED_TO_DETECT_DOCK
    assert -0.3 < stage.dock_from_base.x < -0.2


def test_where_the_map_is_sure_it_looks_there_first_and_then_everywhere() -> None:
    stage = Stage(START, bend_estimate=lambda estimate, full: estimate if full else rejected(estimate))
    stage.docker.expect(START @ stage.odom_from_base.inverse())
    stage.until(State.CONTROLLING)
    asked = [d.homing.dock_from_odom is None for d in stage.decisions if d.homing is not None]
    assert asked[:30] == [False] * 30
    assert asked[-3:] == [True] * 3


def test_ambiguous_fixes_need_more_agreement() -> None:
    sure, unsure = Stage(START), Stage(START)
    unsure.bend_estimate = lambda estimate, full: replace(estimate, verdict=Verdict.AMBIGUOUS)
    sure.until(State.CONTROLLING)
    unsure.until(State.CONTROLLING)
    assert unsure.stamp > sure.stamp


def test_a_fix_from_before_the_robot_stood_still_does_not_count() -> None:
    stage = Stage(START)
    rolling = iter([0.02] * 20 + [0.0] * 1000)
    stage.bend_observation = lambda observation: observation
    moved_until = 0.0
    for _ in range(60):
        roll = next(rolling)
        if roll:
            moved_until = stage.stamp
            step = Pose2D(roll * TICK * 5, 0.0, 0.0)
            stage.dock_from_base, stage.odom_from_base = stage.dock_from_base @ step, stage.odom_from_base @ step
        if stage.tick().state == State.CONTROLLING:
            break
    assert stage.docker.state == State.CONTROLLING
    assert stage.stamp > moved_until + 0.3


def test_a_confirmation_that_disagrees_looks_again_and_at_last_gives_up() -> None:
    def elsewhere_at_the_end(estimate: HomingEstimate, full: bool) -> HomingEstimate:
        at_dock = math.hypot(estimate.dock_from_base.x, estimate.dock_from_base.y) < 0.02
        wrong = Pose2D(0.6, 0.0, 0.0) @ estimate.dock_from_base
        return replace(estimate, dock_from_base=wrong) if full and at_dock else estimate

    stage = Stage(START, bend_estimate=elsewhere_at_the_end)
    decision = stage.until()
    assert decision.state != State.DOCKED
    assert decision.outcome is not None
    assert decision.outcome.error in (ErrorName.FAILED_TO_CONTROL, ErrorName.TIMEOUT)


def test_a_confirmation_that_sees_it_a_little_off_corrects_it() -> None:
    """Tracking errs; a fix from nothing tells the truth."""

    def tracked_askew(estimate: HomingEstimate, full: bool) -> HomingEstimate:
        wrong = Pose2D(0.004, 0.006, math.radians(0.6))
        return estimate if full else replace(estimate, dock_from_base=wrong @ estimate.dock_from_base)

    stage = Stage(START, bend_estimate=tracked_askew)
    assert stage.until().state == State.DOCKED
    assert math.hypot(stage.dock_from_base.x, stage.dock_from_base.y) <= 0.004
    assert abs(stage.dock_from_base.yaw) <= math.radians(0.25)


def test_a_contact_that_charges_ends_it_and_is_waited_for() -> None:
    stage = stage_in(State.WAIT_FOR_CHARGE)
    assert stage.tick().outcome is None
    stage.charging = True
    decision = stage.tick()
    assert decision.outcome is not None
    assert decision.outcome.error is None


def test_no_contact_backs_out_half_a_metre_three_times_then_fails() -> None:
    stage = stage_in(State.RETRY)
    stage.until(State.INITIAL_PERCEPTION)
    assert stage.dock_from_base.x == pytest.approx(-0.5, abs=0.03)
    decision = stage.until()
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.FAILED_TO_CHARGE
    assert decision.recoveries == 3


def test_losing_sight_while_driving_stops_and_looks_again() -> None:
    stage = stage_in(State.CONTROLLING)
    stage.bend_estimate = lambda estimate, full: None
    stage.until(State.INITIAL_PERCEPTION, seconds=3.0)
    assert stage.decisions[-1].twist == STOP


def test_a_lifted_robot_looks_again() -> None:
    stage = stage_in(State.CONTROLLING)
    stage.bend_observation = lambda observation: replace(observation, wheel_drop=True)
    assert stage.tick().state == State.INITIAL_PERCEPTION


@pytest.mark.parametrize(
    ("short_of_it", "charging", "state"),
    [
        (0.05, None, State.RETRY),
        (0.05, False, State.RETRY),
        (0.05, True, State.DOCKED),
        (0.3, True, State.RETRY),  # on a cable, or at another charger
    ],
)
def test_held_by_its_bumper_it_retries_unless_it_charges_at_the_dock(
    short_of_it: float, charging: bool | None, state: State
) -> None:
    stage = stage_in(State.CONTROLLING)
    while stage.dock_from_base.x < -short_of_it:
        stage.tick()
    stage.charging = charging
    stage.bend_observation = lambda observation: replace(observation, bumper_left=True)
    stage.until(state, seconds=2.0)


@pytest.mark.parametrize(("short_of_it", "docked"), [(0.03, True), (0.3, False)])
def test_a_base_that_stops_by_itself_once_it_charges_is_docked(short_of_it: float, docked: bool) -> None:
    stage = stage_in(State.CONTROLLING)
    while stage.dock_from_base.x < -short_of_it:
        stage.tick()
    stage.charging = True
    stage._move = lambda decision, dt: None  # type: ignore[method-assign]
    if docked:
        stage.until(State.DOCKED, seconds=3.0)
    else:
        with pytest.raises(AssertionError, match="CONTROLLING"):
            stage.until(State.DOCKED, seconds=10.0)


def test_held_at_an_edge_it_retries() -> None:
    stage = stage_in(State.CONTROLLING)
    stage.bend_observation = lambda observation: replace(observation, cliff=True)
    stage.until(State.RETRY, seconds=2.0)


@pytest.mark.parametrize("state", RUNNING)
@pytest.mark.parametrize("sensor", ["bumper_left", "bumper_right", "cliff", "wheel_drop"])
def test_whatever_it_touches_it_does_not_push_in_any_state(state: State, sensor: str) -> None:
    stage, gate = stage_in(state), SafetyGate(Limits(0.2, 0.8, 0.5, 2.0))
    stage.bend_observation = lambda observation: replace(observation, **{sensor: True})
    for _ in range(30):
        decision = stage.tick()
        seen = replace(Observation(stage.stamp, stage.odom_from_base), **{sensor: True})
        assert gate.limit(decision.twist, seen, TICK).vx <= 0.0


def test_a_touch_in_passing_does_not_stop_it() -> None:
    stage = stage_in(State.CONTROLLING)
    stage.bend_observation = lambda observation: replace(observation, bumper_right=True)
    for _ in range(5):
        stage.tick()
    stage.bend_observation = lambda observation: observation
    assert stage.until().recoveries == 0


def test_odometry_of_the_frame_not_of_now_places_an_estimate() -> None:
    stage = Stage(Pose2D(-0.8, 0.0, 0.0))
    stage.until(State.CONTROLLING)
    for _ in range(15):
        stage.tick()
    asked = stage.decisions[-1].homing
    assert asked is not None
    assert asked.dock_from_odom is not None
    odom_before = stage.odom_from_base
    assert (asked.dock_from_odom @ odom_before).distance(stage.dock_from_base) < 1e-6


def test_remaining_distance_falls_to_zero() -> None:
    stage = Stage(START)
    stage.until()
    remaining = [d.distance_remaining for d in stage.decisions if d.distance_remaining is not None]
    assert remaining[0] == pytest.approx(math.hypot(START.x, START.y), abs=0.05)
    assert remaining[-1] == 0.0


def test_attempts_together_have_their_time() -> None:
    stage = Stage(START, docker=Docker("home", DockingParameters(attempt_time=0.5)))
    decision = stage.until()
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.TIMEOUT
    assert stage.stamp - 50.0 < 2.4


def test_from_beside_the_staging_pose_a_retry_gets_back_to_it() -> None:
    """Stuck half-way and off to the side: straight back would end beside the staging pose."""
    stage = stage_in(State.CONTROLLING)
    stage.dock_from_base = Pose2D(-0.35, 0.25, -0.6)
    for _ in range(5):
        stage.tick()
    stage.bend_observation = lambda observation: replace(observation, bumper_left=True)
    stage.until(State.RETRY, seconds=3.0)
    stage.bend_observation = lambda observation: observation
    stage.until(State.INITIAL_PERCEPTION, seconds=25.0)
    assert stage.dock_from_base.distance(Pose2D(-0.5, 0.0)) < 0.1
    assert abs(stage.dock_from_base.yaw) < math.radians(12.0)


def test_out_of_the_dock_it_backs_straight_before_it_turns() -> None:
    stage = stage_in(State.RETRY)
    stage.dock_from_base = stage.dock_from_base @ Pose2D(0.0, 0.1, 0.0)  # nudged: odometry knows nothing of it
    while stage.dock_from_base.x > -0.45:
        decision = stage.tick()
        assert decision.state == State.RETRY
        assert abs(decision.twist.wz) < 0.1
        assert decision.twist.vx < 0.0


@pytest.mark.parametrize("charging", [None, True])
def test_standing_in_the_dock_it_is_docked_without_a_move(charging: bool | None) -> None:
    stage = Stage(Pose2D(0.002, -0.001, 0.002), charging=charging)
    decision = stage.until()
    assert decision.state == State.DOCKED
    assert all(d.twist == STOP for d in stage.decisions)
    assert decision.outcome is not None
    assert decision.outcome.report["dock_x"] == pytest.approx(0.002)
    assert stage.stamp - 50.0 < 4.0


def test_pushed_well_into_its_dock_it_charges_and_stays() -> None:
    stage = Stage(Pose2D(0.03, 0.02, 0.1), charging=True)
    assert stage.until().state == State.DOCKED
    assert all(d.twist == STOP for d in stage.decisions)


def test_losing_sight_askew_on_its_contact_it_is_aligned_and_not_left_so() -> None:
    stage = stage_in(State.CONTROLLING)
    while stage.dock_from_base.x < -0.02:
        stage.tick()
    stage.charging, stage.dock_from_base = True, Pose2D(-0.01, 0.0, 0.08)
    stage.bend_estimate = lambda estimate, full: None
    stage.until(State.INITIAL_PERCEPTION, seconds=5.0)
    stage.bend_estimate = lambda estimate, full: estimate
    assert stage.until().state == State.DOCKED
    assert abs(stage.dock_from_base.yaw) < math.radians(0.3)


@pytest.mark.parametrize(("attempt_time", "retries"), [(60.0, 1), (4.0, 0)])
def test_askew_on_its_contact_it_tries_again_and_at_last_takes_what_it_has(attempt_time: float, retries: int) -> None:
    """It stands 2 degrees askew, and its wheels slip when they turn it."""

    class Slipping(Stage):
        def _move(self, decision: Decision, dt: float) -> None:
            super()._move(decision, dt)
            self.dock_from_base = replace(self.dock_from_base, yaw=0.035)

    docker = Docker("home", DockingParameters(max_retries=1, attempt_time=attempt_time))
    stage = Slipping(Pose2D(-0.1, 0.0, 0.035), docker)
    stage.bend_observation = lambda seen: replace(seen, charging=abs(stage.dock_from_base.x) < 0.02)
    decision = stage.until(seconds=200.0)
    assert (decision.state, decision.recoveries) == (State.DOCKED, retries)
    assert decision.outcome is not None and decision.outcome.error is None


def test_on_its_contact_beside_its_place_it_comes_again_rather_than_stay() -> None:
    """What is tracked is 3 cm from what a fix from nothing says, until it has backed out."""

    def tracked_beside(estimate: HomingEstimate, full: bool) -> HomingEstimate:
        there = estimate.dock_from_base
        beside = replace(there, x=there.x + 0.02, y=there.y - 0.02)
        return estimate if full or came_again(stage) else replace(estimate, dock_from_base=beside)

    stage = Stage(START, bend_estimate=tracked_beside)
    stage.bend_observation = lambda seen: replace(seen, charging=abs(stage.dock_from_base.x) < 0.05)
    assert stage.until(seconds=200.0).state == State.DOCKED
    assert came_again(stage)
    assert math.hypot(stage.dock_from_base.x, stage.dock_from_base.y) <= 0.004


def came_again(stage: Stage) -> bool:
    return any(decision.recoveries > 0 for decision in stage.decisions)


def test_charging_on_a_cable_is_not_docked() -> None:
    """It charges from the start, half a metre away: only at the dock that counts."""
    stage = Stage(START, charging=True)
    decision = stage.until()
    assert decision.state == State.DOCKED
    assert math.hypot(stage.dock_from_base.x, stage.dock_from_base.y) <= 0.004


def ambiguous(estimate: HomingEstimate, full: bool) -> HomingEstimate:
    return replace(estimate, verdict=Verdict.AMBIGUOUS) if full else estimate


def test_a_view_that_stays_ambiguous_proves_no_dock_by_itself() -> None:
    stage = Stage(START, bend_estimate=ambiguous)
    decision = stage.until(seconds=300.0)
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.FAILED_TO_CONTROL
    assert State.DOCKED not in {d.state for d in stage.decisions}


@pytest.mark.parametrize("proof", ["contact", "map"])
def test_an_ambiguous_view_is_enough_where_contact_or_map_tell(proof: str) -> None:
    stage = Stage(START, bend_estimate=ambiguous)
    if proof == "map":
        stage.docker.expect(START @ Pose2D(0.05, -0.05, 0.1) @ stage.odom_from_base.inverse())
        assert stage.until().state == State.DOCKED
    else:
        stage.charging = False
        stage.until(State.WAIT_FOR_CHARGE)
        stage.charging = True
        assert stage.until().state == State.DOCKED


def test_what_contradicts_a_sure_map_is_not_believed_however_sure_it_looks() -> None:
    next_tile = Pose2D(0.6, 0.0, 0.0)
    stage = Stage(START, bend_estimate=lambda e, full: replace(e, dock_from_base=next_tile @ e.dock_from_base))
    stage.docker.expect(START @ stage.odom_from_base.inverse())
    decision = stage.until()
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.FAILED_TO_DETECT_DOCK
    assert decision.outcome.report["contradict_map"] > 0
    assert all(d.twist == STOP for d in stage.decisions)


def test_a_confirmation_that_is_a_few_centimetres_off_is_none() -> None:
    def shifted(estimate: HomingEstimate, full: bool) -> HomingEstimate:
        at_dock = math.hypot(estimate.dock_from_base.x, estimate.dock_from_base.y) < 0.02
        moved = Pose2D(0.02, 0.0, 0.0) @ estimate.dock_from_base
        return replace(estimate, dock_from_base=moved) if full and at_dock else estimate

    stage = Stage(START, bend_estimate=shifted)
    stage.until(seconds=300.0)
    assert State.DOCKED not in {d.state for d in stage.decisions}


@pytest.mark.parametrize("retries", [0, 1, 5])
def test_retries_are_the_configured_number(retries: int) -> None:
    stage = Stage(START, docker=Docker("home", DockingParameters(max_retries=retries)), charging=False)
    decision = stage.until(seconds=60.0 * (retries + 1))
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.FAILED_TO_CHARGE
    assert decision.recoveries == retries


def test_staging_pose_is_half_a_metre_behind_the_dock_facing_it() -> None:
    pose = staging_pose(Pose2D(1.0, 2.0, math.pi / 2))
    assert (pose.x, pose.y, pose.yaw) == pytest.approx((1.0, 1.5, math.pi / 2))
