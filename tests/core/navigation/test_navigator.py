"""The navigator on an ideal robot whose pose is known: what it does, not how well it sees."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from omnibotd.core.decision import Decision, Observation
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D, Twist2D, wrap
from omnibotd.core.mapping.topo_map import EdgeKind, Edges, TopoMap
from omnibotd.core.navigation.arrival import ARRIVED_SURE
from omnibotd.core.navigation.certainty import SURE
from omnibotd.core.navigation.floor import DrivenFloor
from omnibotd.core.navigation.goal_filter import GoalFilter
from omnibotd.core.navigation.navigator import MAX_BUMPS, Navigator, NavigatorState, Tolerance
from omnibotd.core.percept import PlaceEstimate
from omnibotd.core.safety import Limits, SafetyGate

LIMITS = Limits(0.3, 1.0, 0.5, 2.0)
PERIOD = 0.1


def grid_map(cells: list[tuple[int, int]], spacing: float = 0.2) -> TopoMap:
    """Nodes on a grid, linked to their neighbours above and to the right."""
    index = {cell: k for k, cell in enumerate(cells)}
    links = [(k, index[n]) for (i, j), k in index.items() for n in ((i + 1, j), (i, j + 1)) if n in index]
    first, second = np.array(links, np.int32).T
    poses = np.array([(i * spacing, j * spacing, 0.0) for i, j in cells], np.float32)
    edges = Edges(first, second, np.full(len(first), EdgeKind.PROXIMITY, np.uint8))
    count = len(cells)
    return TopoMap(
        "grid",
        np.zeros((1, 192), np.float32),
        np.zeros(count, np.uint16),
        np.zeros((count, 512), np.uint8),
        poses,
        np.zeros(count, np.uint16),
        edges,
    )


OPEN = grid_map([(i, j) for i in range(16) for j in range(16)])
# A U round a block in the middle: from the lower left to the lower right the only way is over the top.
HORSESHOE = grid_map([(i, j) for i in range(16) for j in range(16) if not (4 <= i <= 11 and j <= 11)])


class IdealTrip:
    """Steps a navigator with exact odometry and place estimates as sure as told."""

    def __init__(self, topo_map: TopoMap, start: Pose2D, goal: Pose2D) -> None:
        self.goal_filter = GoalFilter()
        self.navigator = self.new_navigator(topo_map, goal)
        self.gate = SafetyGate(LIMITS)
        self.pose, self.start, self.time = start, start, 0.0
        self.path = [start]
        self.states: list[str] = []
        self.confidence: Callable[[], float] = lambda: 0.99
        self.noise: Callable[[], Pose2D] = Pose2D
        self.change: Callable[[Observation], Observation] = lambda seen: seen

    def new_navigator(self, topo_map: TopoMap, goal: Pose2D) -> Navigator:
        return Navigator(topo_map, goal, self.goal_filter, LIMITS, Tolerance(0.05, 0.05), 0.17, PERIOD)

    def tick(self) -> Decision:
        odom = self.start.inverse() @ self.pose
        noise = self.noise()
        measured = Pose2D(self.pose.x + noise.x, self.pose.y + noise.y, self.pose.yaw + noise.yaw)
        place = PlaceEstimate(self.time, odom, measured, self.confidence(), 0.02, 0.9, 0.3, 0)
        self.goal_filter.predict(odom)
        self.goal_filter.update(place, SURE)
        seen = self.change(Observation(self.time, odom, place))
        decision = self.navigator.step(seen)
        twist = self.gate.limit(decision.twist, seen, PERIOD)
        half = twist.wz * PERIOD / 2
        step = Pose2D(twist.vx * PERIOD * math.cos(half), twist.vx * PERIOD * math.sin(half), 2 * half)
        self.pose = self.pose @ step
        self.time += PERIOD
        self.path.append(self.pose)
        self.states.append(decision.state)
        return decision

    def run(self, limit: float = 120.0) -> Decision:
        while self.time < limit:
            decision = self.tick()
            if decision.outcome is not None:
                return decision
        raise AssertionError(f"no outcome after {limit} s, state {self.states[-1]}")


@pytest.mark.parametrize("yaw", [-3.0, -1.5, 0.0, 1.5, 3.0])
def test_it_arrives_within_its_tolerance_and_at_the_goals_heading(yaw: float) -> None:
    goal = Pose2D(2.4, 2.2, yaw)
    trip = IdealTrip(OPEN, Pose2D(0.4, 0.6, 2.0), goal)
    assert trip.run().outcome is not None
    assert trip.pose.distance(goal) < 0.05
    assert abs(wrap(trip.pose.yaw - yaw)) < 0.05


def test_facing_away_it_turns_first_and_goes_straight() -> None:
    start, goal = Pose2D(2.4, 1.4, 0.0), Pose2D(0.6, 1.4, math.pi)
    trip = IdealTrip(OPEN, start, goal)
    trip.run()
    driven = sum(a.distance(b) for a, b in pairwise(trip.path))
    assert driven < 1.1 * start.distance(goal)


def test_it_goes_round_floor_where_nobody_drove() -> None:
    trip = IdealTrip(HORSESHOE, Pose2D(0.3, 0.2, 0.0), Pose2D(2.7, 0.2, 0.0))
    assert trip.run().outcome is not None
    assert trip.pose.distance(Pose2D(2.7, 0.2)) < 0.05
    floor = DrivenFloor(HORSESHOE.poses[:, :2])
    assert all(floor.contains(np.array([pose.x, pose.y])) for pose in trip.path)


def test_no_way_to_a_goal_on_an_island() -> None:
    island = grid_map([(i, j) for i in range(16) for j in range(16) if i < 5 or i > 10])
    decision = IdealTrip(island, Pose2D(0.2, 0.2, 0.0), Pose2D(2.8, 0.2, 0.0)).run()
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.NO_ROUTE


def test_a_goal_far_from_driven_floor_is_refused_and_one_just_beside_it_reached() -> None:
    decision = IdealTrip(OPEN, Pose2D(1.0, 1.0, 0.0), Pose2D(5.0, 5.0, 0.0)).run()
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.NO_ROUTE
    beside = Pose2D(3.45, 1.5, 0.0)
    trip = IdealTrip(OPEN, Pose2D(1.0, 1.0, 0.0), beside)
    trip.run()
    assert trip.pose.distance(beside) < 0.05


def turned(path: list[Pose2D]) -> float:
    return sum(abs(wrap(b.yaw - a.yaw)) for a, b in pairwise(path))


def test_lost_from_the_start_it_looks_round_searches_nearby_and_then_says_so() -> None:
    trip = IdealTrip(OPEN, Pose2D(1.0, 1.0, 0.0), Pose2D(2.0, 2.0, 0.0))
    trip.confidence = lambda: 0.1
    decision = trip.run(300.0)
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.LOST
    assert max(pose.distance(trip.start) for pose in trip.path) < 1.2
    assert turned(trip.path[:150]) > math.tau
    assert {"confidence", "score", "margin", "searches", "bumps", "state"} <= decision.outcome.report.keys()
    assert decision.outcome.report["confidence"] == 0.1


def test_it_never_says_arrived_on_dead_reckoning() -> None:
    trip = IdealTrip(OPEN, Pose2D(1.0, 1.0, 0.0), Pose2D(1.6, 1.0, 0.0))
    trip.confidence = lambda: 0.99 if trip.pose.x < 1.3 else 0.1
    decision = trip.run(900.0)
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.LOST


def test_sure_enough_to_drive_is_not_sure_enough_to_arrive() -> None:
    goal = Pose2D(1.6, 1.0, 0.0)
    trip = IdealTrip(OPEN, Pose2D(1.0, 1.0, 0.0), goal)
    trip.confidence = lambda: (SURE + ARRIVED_SURE) / 2.0
    decision = trip.run(300.0)
    assert trip.pose.distance(goal) < 0.1
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.LOST


def test_lost_on_the_way_it_goes_back_to_where_it_was_sure() -> None:
    trip = IdealTrip(OPEN, Pose2D(0.2, 1.0, 0.0), Pose2D(2.8, 1.0, 0.0))
    lost_from: list[float] = []

    def confidence() -> float:
        if trip.pose.x > 1.2:
            lost_from.append(trip.time)
        return 0.1 if lost_from and (trip.pose.x > 1.2 or trip.time < lost_from[0] + 20.0) else 0.99

    trip.confidence = confidence
    while "RETURNING" not in trip.states:
        trip.tick()
    out = trip.pose.x
    while trip.states[-1] == "RETURNING":
        trip.tick()
    assert out > 1.2 + 1.0
    assert trip.pose.x == pytest.approx(1.2, abs=0.25)
    assert trip.pose.y == pytest.approx(1.0, abs=0.05)


def test_driven_out_by_hand_it_returns_to_the_map_before_it_searches() -> None:
    trip = IdealTrip(OPEN, Pose2D(3.0, 1.0, 0.0), Pose2D(1.0, 1.0, 0.0))
    trip.goal_filter.predict(Pose2D())
    trip.goal_filter.update(PlaceEstimate(0.0, Pose2D(), trip.start, 0.99, 0.02, 0.9, 0.3, 0), SURE)
    trip.pose = Pose2D(5.0, 1.3, 0.5)  # with odometry, but unseen
    trip.navigator = trip.new_navigator(OPEN, Pose2D(1.0, 1.0, 0.0))
    trip.confidence = lambda: 0.99 if trip.pose.x < 3.2 else 0.05
    decision = trip.run(200.0)
    assert decision.outcome is not None
    assert decision.outcome.error is None
    assert trip.pose.distance(Pose2D(1.0, 1.0)) < 0.05
    assert "RETURNING" in trip.states
    assert "SEARCHING" not in trip.states


def test_carried_elsewhere_on_the_way_it_finds_itself_proves_it_and_arrives() -> None:
    goal = Pose2D(2.8, 1.0, 0.0)
    trip = IdealTrip(OPEN, Pose2D(0.2, 1.0, 0.0), goal)
    while trip.pose.x < 1.0:
        trip.tick()
    since = len(trip.path)
    odom_from_base, trip.pose = trip.start.inverse() @ trip.pose, Pose2D(2.6, 1.1, 2.0)
    trip.start = trip.pose @ odom_from_base.inverse()  # the odometry does not notice
    decision = trip.run()
    assert decision.outcome is not None
    assert decision.outcome.error is None
    assert trip.pose.distance(goal) < 0.05
    driven = sum(a.distance(b) for a, b in pairwise(trip.path[since:]))
    assert driven / 0.5 + turned(trip.path[since:]) / math.tau > 1.0


@pytest.mark.parametrize("seed", range(6))
def test_estimates_that_jump_by_centimetres_do_not_make_it_dither(seed: int) -> None:
    rng = np.random.default_rng(seed)
    goal = Pose2D(*rng.uniform(0.4, 2.6, 2), rng.uniform(-3.0, 3.0))
    trip = IdealTrip(OPEN, Pose2D(*rng.uniform(0.4, 2.6, 2), 0.0), goal)
    trip.noise = lambda: Pose2D(*rng.normal(0.0, 0.04, 2), rng.normal(0.0, 0.01))
    decision = trip.run()
    assert decision.outcome is not None
    assert decision.outcome.error is None
    assert trip.pose.distance(goal) < 0.05
    near = next(k for k, pose in enumerate(trip.path) if pose.distance(goal) < 0.15)
    assert (len(trip.path) - near) * PERIOD < 20.0
    assert sum(a != b for a, b in pairwise(trip.states[near:])) <= 5


def test_unsure_on_the_way_it_stops_within_its_allowance_and_goes_on_once_sure() -> None:
    trip = IdealTrip(OPEN, Pose2D(0.2, 1.0, 0.0), Pose2D(2.8, 1.0, 0.0))
    trip.confidence = lambda: 0.1 if 6.0 < trip.time < 14.0 else 0.99
    assert trip.run().outcome is not None
    assert trip.pose.distance(Pose2D(2.8, 1.0)) < 0.05
    assert NavigatorState.LOCALISING in trip.states[60:140]


def something(trip: IdealTrip, at: Pose2D, until: float = math.inf) -> Callable[[Observation], Observation]:
    """A disc of 13 cm that the robot's bumpers feel, as long as it stands there."""

    def feel(seen: Observation) -> Observation:
        ahead = abs(trip.pose.bearing(at)) < 1.0 and trip.pose.distance(at) < 0.3
        return replace(seen, bumper_left=ahead and trip.time < until)

    return feel


def test_a_bump_makes_it_back_off_try_again_and_then_go_round() -> None:
    trip = IdealTrip(OPEN, Pose2D(0.4, 1.4, 0.0), Pose2D(2.6, 1.4, 0.0))
    obstacle = Pose2D(1.5, 1.4)
    trip.change = something(trip, obstacle)
    decision = trip.run()
    assert decision.outcome is not None
    assert decision.outcome.error is None
    assert 2 <= decision.outcome.report["bumps"] <= MAX_BUMPS
    assert min(pose.distance(obstacle) for pose in trip.path) > 0.25


def test_who_steps_aside_after_the_first_bump_is_not_driven_round() -> None:
    trip = IdealTrip(OPEN, Pose2D(0.4, 1.4, 0.0), Pose2D(2.6, 1.4, 0.0))
    trip.change = something(trip, Pose2D(1.5, 1.4), until=6.0)
    decision = trip.run()
    assert decision.outcome is not None
    assert decision.outcome.error is None
    assert decision.outcome.report["bumps"] == 1
    assert max(abs(pose.y - 1.4) for pose in trip.path) < 0.1


def test_what_the_range_sensor_sees_for_a_second_counts_as_a_bump_without_contact() -> None:
    trip = IdealTrip(OPEN, Pose2D(0.4, 1.4, 0.0), Pose2D(2.6, 1.4, 0.0))
    wall = 1.5
    trip.change = lambda seen: replace(
        seen, range_ahead=max(0.0, wall - 0.17 - trip.pose.x) if abs(trip.pose.yaw) < 0.8 else math.inf
    )
    while trip.navigator.state != NavigatorState.BACKING_OFF:
        trip.tick()
    assert trip.pose.x < wall - 0.17 - 0.04
    assert trip.states[-11:] == ["FOLLOWING"] * 10 + ["BACKING_OFF"]


def test_a_wall_right_behind_the_goal_keeps_nobody_from_it() -> None:
    goal = Pose2D(2.6, 1.4, 0.0)
    trip = IdealTrip(OPEN, Pose2D(0.4, 1.4, 0.0), goal)
    trip.change = lambda seen: replace(seen, range_ahead=max(0.0, goal.x + 0.07 - trip.pose.x))
    decision = trip.run()
    assert decision.outcome is not None
    assert (decision.outcome.error, decision.outcome.report["bumps"]) == (None, 0)


def test_with_no_way_round_it_is_blocked() -> None:
    corridor = grid_map([(i, j) for i in range(16) for j in range(2)])
    trip = IdealTrip(corridor, Pose2D(0.2, 0.1, 0.0), Pose2D(2.8, 0.1, 0.0))
    trip.change = lambda seen: replace(seen, bumper_left=trip.pose.x > 1.5, bumper_right=trip.pose.x > 1.5)
    decision = trip.run(300.0)
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.BLOCKED


def test_a_bumper_that_never_lets_go_ends_in_blocked() -> None:
    trip = IdealTrip(OPEN, Pose2D(0.4, 1.4, 0.0), Pose2D(2.6, 1.4, 0.0))
    trip.change = lambda seen: replace(seen, bumper_left=trip.time > 3.0)
    decision = trip.run()
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.BLOCKED


def trip_in(state: NavigatorState) -> IdealTrip:
    """A trip that has just come to this state, by itself."""
    trip = IdealTrip(OPEN, Pose2D(0.4, 1.4, 0.0), Pose2D(2.6, 1.4, 1.0))
    if state in (NavigatorState.RETURNING, NavigatorState.SEARCHING):
        trip.confidence = lambda: 0.99 if trip.time < 5.0 else 0.1
    if state is NavigatorState.BACKING_OFF:
        trip.change = lambda seen: replace(seen, bumper_left=trip.time > 3.0)
    while trip.tick().state != state:
        assert trip.time < 60.0
    return trip


ABORTS = [
    ({"emergency_stop": True}, ErrorName.EMERGENCY_STOP),
    ({"base_ok": False}, ErrorName.BASE_LINK_DOWN),
    ({"camera_ok": False}, ErrorName.CAMERA_DOWN),
    ({"wheel_drop": True}, ErrorName.BLOCKED),
]


@pytest.mark.parametrize(("danger", "error"), ABORTS)
@pytest.mark.parametrize("state", list(NavigatorState))
def test_every_danger_ends_the_job_in_every_state(
    danger: dict[str, bool], error: ErrorName, state: NavigatorState
) -> None:
    trip = trip_in(state)
    trip.change = lambda seen: replace(seen, **danger)
    decision = trip.tick()
    assert decision.outcome is not None
    assert decision.outcome.error is error
    assert decision.twist == Twist2D()


@pytest.mark.parametrize("touch", [{"bumper_left": True}, {"bumper_right": True}, {"cliff": True}])
@pytest.mark.parametrize("state", list(NavigatorState))
def test_touched_it_never_goes_on_ahead_in_any_state(touch: dict[str, bool], state: NavigatorState) -> None:
    trip = trip_in(state)
    trip.change = lambda seen: replace(seen, **touch)
    for _ in range(30):
        decision = trip.tick()
        assert decision.twist.vx <= 0.0 or decision.outcome is not None
