"""The navigator on an ideal robot whose pose is known: what it does, not how well it sees."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from omnibotd.core.decision import Decision, Observation
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D, Twist2D, wrap
from omnibotd.core.mapping.topo_map import EdgeKind, Edges, TopoMap
from omnibotd.core.navigation.floor import DrivenFloor
from omnibotd.core.navigation.goal_filter import GoalFilter
from omnibotd.core.navigation.navigator import MAX_RECOVERIES, Navigator, NavigatorState, Tolerance
from omnibotd.core.navigation.planning import Route
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
        self.navigator = Navigator(topo_map, goal, self.goal_filter, LIMITS, Tolerance(0.05, 0.05), 0.17, PERIOD)
        self.gate = SafetyGate(LIMITS)
        self.pose, self.start, self.time = start, start, 0.0
        self.path = [start]
        self.states: list[str] = []
        self.confidence: Callable[[], float] = lambda: 0.99
        self.change: Callable[[Observation], Observation] = lambda seen: seen

    def tick(self) -> Decision:
        odom = self.start.inverse() @ self.pose
        place = PlaceEstimate(self.time, odom, self.pose, self.confidence(), 0.02, 0.9, 0.3, 0)
        self.goal_filter.predict(odom)
        self.goal_filter.update(place, 0.6)
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
    driven = sum(a.distance(b) for a, b in zip(trip.path, trip.path[1:], strict=False))
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


def test_lost_it_looks_around_on_the_spot_and_then_says_so() -> None:
    trip = IdealTrip(OPEN, Pose2D(1.0, 1.0, 0.0), Pose2D(2.0, 2.0, 0.0))
    trip.confidence = lambda: 0.1
    decision = trip.run()
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.LOST
    assert trip.pose.distance(trip.start) < 0.01
    turned = sum(abs(wrap(b.yaw - a.yaw)) for a, b in zip(trip.path, trip.path[1:], strict=False))
    assert turned > 2 * math.pi


def test_it_never_says_arrived_on_dead_reckoning() -> None:
    trip = IdealTrip(OPEN, Pose2D(1.0, 1.0, 0.0), Pose2D(1.6, 1.0, 0.0))
    trip.confidence = lambda: 0.99 if trip.pose.x < 1.3 else 0.1
    decision = trip.run()
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.LOST


def test_unsure_on_the_way_it_stops_within_its_allowance_and_goes_on_once_sure() -> None:
    trip = IdealTrip(OPEN, Pose2D(0.2, 1.0, 0.0), Pose2D(2.8, 1.0, 0.0))
    trip.confidence = lambda: 0.1 if 6.0 < trip.time < 14.0 else 0.99
    assert trip.run().outcome is not None
    assert trip.pose.distance(Pose2D(2.8, 1.0)) < 0.05
    assert NavigatorState.LOCALISING in trip.states[60:140]


def test_a_bump_makes_it_back_off_and_go_round() -> None:
    trip = IdealTrip(OPEN, Pose2D(0.4, 1.4, 0.0), Pose2D(2.6, 1.4, 0.0))
    obstacle = Pose2D(1.5, 1.4)

    def touched(seen: Observation) -> Observation:
        ahead = abs(trip.pose.bearing(obstacle)) < 1.0
        return replace(seen, bumper_left=ahead and trip.pose.distance(obstacle) < 0.3)

    trip.change = touched
    decision = trip.run()
    assert decision.outcome is not None
    assert decision.outcome.error is None
    assert 1 <= decision.recoveries <= MAX_RECOVERIES
    assert min(pose.distance(obstacle) for pose in trip.path) > 0.25


def test_a_bumper_that_never_lets_go_ends_in_blocked() -> None:
    trip = IdealTrip(OPEN, Pose2D(0.4, 1.4, 0.0), Pose2D(2.6, 1.4, 0.0))
    trip.change = lambda seen: replace(seen, bumper_left=trip.time > 3.0)
    decision = trip.run()
    assert decision.outcome is not None
    assert decision.outcome.error in (ErrorName.BLOCKED, ErrorName.NO_ROUTE)


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
    trip = IdealTrip(OPEN, Pose2D(0.4, 1.4, 0.0), Pose2D(2.6, 1.4, 0.0))
    trip.tick()
    trip.navigator.state = state
    trip.change = lambda seen: replace(seen, **danger)
    decision = trip.tick()
    assert decision.outcome is not None
    assert decision.outcome.error is error
    assert decision.twist == Twist2D()


def test_the_route_is_the_shortest_over_links() -> None:
    goal = Pose2D(2.8, 0.2, 0.0)
    route = Route(HORSESHOE, goal, DrivenFloor(HORSESHOE.poses[:, :2]))
    up_over_and_down = 2 * (2.4 - 0.2) + (2.8 - 0.2)
    assert route.distance(Pose2D(0.2, 0.2, 0.0)) == pytest.approx(up_over_and_down, rel=0.15)
    assert route.distance(Pose2D(2.6, 2.0, 0.0)) == pytest.approx(math.hypot(0.2, 1.8))
