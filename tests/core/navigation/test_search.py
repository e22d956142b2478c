"""The search of a lost robot: what it tries, what ends it, and what it never does."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise

import pytest

from omnibotd.core.decision import Decision, Observation
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D, Twist2D, wrap
from omnibotd.core.navigation.certainty import Certainty
from omnibotd.core.navigation.search import RETURN_LIMIT, SEARCH_DISTANCE, SEARCH_TIME, Search, SearchState
from omnibotd.core.percept import PlaceEstimate
from omnibotd.core.safety import Limits

LIMITS = Limits(0.3, 1.0, 0.5, 2.0)
TICK = 0.1


@dataclass
class Wanderer:
    """A search on an ideal base; tests say what it sees."""

    back: Pose2D | None = None
    known: bool = False
    estimate: Callable[[float, Pose2D], tuple[float, Pose2D]] = lambda time, pose: (0.1, pose)
    bend: Callable[[Observation], Observation] = lambda seen: seen
    time: float = 100.0
    pose: Pose2D = field(default_factory=lambda: Pose2D(1.0, -2.0, 0.7))
    certainty: Certainty = field(default_factory=Certainty)
    decisions: list[Decision] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.search = Search(self.certainty, LIMITS, self.back, known=self.known)
        self.path = [self.pose]

    def tick(self) -> Decision:
        confidence, pose = self.estimate(self.time, self.pose)
        place = PlaceEstimate(self.time, self.pose, pose, confidence, 0.03, 0.7, 0.1, 5)
        seen = self.bend(Observation(self.time, self.pose, place))
        self.certainty.take(seen, pose)
        decision = self.search.step(seen)
        yaw = decision.twist.wz * TICK
        way = decision.twist.vx * TICK
        self.pose = self.pose @ Pose2D(way * math.cos(yaw / 2), way * math.sin(yaw / 2), yaw)
        self.time += TICK
        self.path.append(self.pose)
        self.decisions.append(decision)
        return decision

    def until(self, done: Callable[[Decision], bool], seconds: float = 300.0) -> Decision:
        end = self.time + seconds
        while self.time < end:
            decision = self.tick()
            if done(decision):
                return decision
        raise AssertionError(f"still {decision.state} after {seconds} s")

    def end(self) -> Decision:
        return self.until(lambda decision: decision.outcome is not None)

    @property
    def metres(self) -> float:
        return sum(a.distance(b) for a, b in pairwise(self.path))


def test_it_stands_then_looks_all_round_before_it_goes_anywhere() -> None:
    robot = Wanderer()
    robot.until(lambda decision: decision.state != SearchState.LOCALISING)
    assert all(decision.twist == Twist2D() for decision in robot.decisions[:10])
    turned = sum(abs(wrap(b.yaw - a.yaw)) for a, b in pairwise(robot.path))
    assert turned > math.tau
    assert robot.path[-2].distance(robot.path[0]) < 1e-6


def test_seeing_nothing_it_is_lost_within_its_bounds() -> None:
    robot = Wanderer()
    decision = robot.end()
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.LOST
    assert decision.twist == Twist2D()
    assert robot.metres < SEARCH_DISTANCE + 0.02  # a tick more
    assert robot.time - 100.0 < SEARCH_TIME + 1.0 + 1.1 * math.tau / 0.6 + 2.0
    assert max(pose.distance(robot.path[0]) for pose in robot.path) < 1.2


def test_its_legs_are_short_slow_and_spread_round_the_compass() -> None:
    robot = Wanderer()
    robot.end()
    ahead = [(a, d) for a, d in zip(robot.path, robot.decisions, strict=False) if d.twist.vx > 0.0]
    assert max(decision.twist.vx for _, decision in ahead) <= 0.15
    bearings = {round(pose.yaw / (math.tau / 6)) % 6 for pose, _ in ahead}
    assert len(bearings) == 6


def test_it_goes_back_first_and_looks_round_there() -> None:
    back = Pose2D(1.0, 0.5, 0.0)
    robot = Wanderer(back=back)
    robot.until(lambda decision: decision.state == SearchState.RETURNING)
    robot.until(lambda decision: decision.state == SearchState.LOCALISING)
    assert robot.pose.distance(back) < 0.1
    assert max(decision.twist.vx for decision in robot.decisions) <= 0.2
    robot.until(lambda decision: decision.state == SearchState.SEARCHING)
    assert robot.pose.distance(back) < 0.1


def test_it_returns_no_farther_than_odometry_can_be_trusted() -> None:
    robot = Wanderer(back=Pose2D(50.0, 0.0, 0.0))
    robot.until(lambda decision: decision.state == SearchState.RETURNING)
    robot.until(lambda decision: decision.state == SearchState.LOCALISING)
    assert robot.metres == pytest.approx(RETURN_LIMIT, abs=0.2)


@pytest.mark.parametrize("touch", [{"bumper_left": True}, {"cliff": True}, {"range_ahead": 0.08}])
def test_a_direction_in_which_something_stands_is_given_up(touch: dict[str, float]) -> None:
    """A wall half a leg ahead of where it stands: to one side of the compass it can't go."""
    robot = Wanderer()
    wall = robot.pose.x + 0.25
    robot.bend = lambda seen: (
        replace(seen, **touch) if seen.odom_from_base.x > wall and abs(seen.odom_from_base.yaw) < 1.2 else seen
    )
    robot.end()
    assert max(pose.x for pose in robot.path) < wall + 0.16  # a second's way, for there is no safety gate here
    legs = [k for k, (a, b) in enumerate(pairwise(robot.decisions)) if a.twist.vx <= 0.0 < b.twist.vx]
    assert len(legs) >= 4
    assert any(decision.twist.vx < 0.0 for decision in robot.decisions)


def test_one_lucky_frame_does_not_end_it() -> None:
    robot = Wanderer(estimate=lambda time, pose: (0.95 if round(time * 10) % 4 == 0 else 0.2, pose))
    assert robot.end().outcome.error is ErrorName.LOST


def test_sure_estimates_that_contradict_each_other_do_not_end_it() -> None:
    robot = Wanderer(estimate=lambda time, pose: (0.95, Pose2D(0.9 * (round(time * 10) % 2)) @ pose))
    assert robot.end().outcome.error is ErrorName.LOST


def test_a_place_that_does_not_turn_with_the_robot_does_not_end_it() -> None:
    robot = Wanderer(estimate=lambda time, pose: (0.95, Pose2D(3.0, 1.0, 0.0)))
    assert robot.end().outcome.error is ErrorName.LOST


@pytest.mark.parametrize(("known", "seconds", "turned"), [(True, 0.4, 0.0), (False, 3.0, 0.35)])
def test_estimates_that_agree_end_it_at_once_where_the_pose_was_known_else_after_some_motion(
    known: bool, seconds: float, turned: float
) -> None:
    robot = Wanderer(known=known, estimate=lambda time, pose: (0.9, Pose2D(4.0, 1.0, 2.0) @ pose))
    decision = robot.end()
    assert decision.outcome is not None
    assert decision.outcome.error is None
    assert robot.time - 100.0 <= seconds
    assert abs(wrap(robot.pose.yaw - robot.path[0].yaw)) == pytest.approx(turned, abs=0.1)


DANGERS = [
    ({"emergency_stop": True}, ErrorName.EMERGENCY_STOP),
    ({"base_ok": False}, ErrorName.BASE_LINK_DOWN),
    ({"camera_ok": False}, ErrorName.CAMERA_DOWN),
    ({"wheel_drop": True}, ErrorName.BLOCKED),
]


@pytest.mark.parametrize(("danger", "error"), DANGERS)
@pytest.mark.parametrize("state", list(SearchState))
def test_every_danger_ends_it_in_every_state(danger: dict[str, bool], error: ErrorName, state: SearchState) -> None:
    robot = Wanderer(back=Pose2D(3.0, -2.0, 0.0))
    robot.until(lambda decision: decision.state == state)
    robot.bend = lambda seen: replace(seen, **danger)
    decision = robot.tick()
    assert decision.outcome is not None
    assert decision.outcome.error is error
    assert decision.twist == Twist2D()


@pytest.mark.parametrize("touch", [{"bumper_left": True}, {"bumper_right": True}, {"cliff": True}])
@pytest.mark.parametrize("state", list(SearchState))
def test_touched_it_never_goes_on_ahead(touch: dict[str, bool], state: SearchState) -> None:
    robot = Wanderer(back=Pose2D(3.0, -2.0, 0.0))
    robot.until(lambda decision: decision.state == state)
    robot.bend = lambda seen: replace(seen, **touch)
    assert all(robot.tick().twist.vx <= 0.0 for _ in range(100))


def test_wheels_that_turn_without_moving_the_robot_do_not_hold_it_for_ever() -> None:
    robot = Wanderer()
    here = robot.pose
    robot.bend = lambda seen: replace(seen, odom_from_base=here)
    assert robot.end().outcome.error is ErrorName.LOST
