"""The thesis' loop on an ideal robot: its map says which node it is at, its compass where it looks."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from omnibotd.core.decision import Decision, Observation
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Pose2D
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation.goal_filter import GoalFilter
from omnibotd.core.navigation.navigator import Tolerance
from omnibotd.core.percept import PlaceEstimate
from omnibotd.core.safety import Limits, SafetyGate
from omnibotd.core.thesis.navigator import ThesisNavigator, ThesisState
from tests.core.thesis.maps import ODOMETRY, chain, made_map

LIMITS = Limits(0.3, 1.0, 0.5, 2.0)
PERIOD = 0.1
# Up and down the floor in rows 0.2 m apart, a node every 0.2 m.
ROWS = [(0.2 * (i if j % 2 == 0 else 14 - i), 0.2 * j) for j in range(15) for i in range(15)]
MEADOW = chain(ROWS)


class Trip:
    """Odometry in axes of its own; the localizer names the nearest node."""

    def __init__(self, topo_map: TopoMap, start: Pose2D, goal: Pose2D) -> None:
        tolerance = Tolerance(0.05, 0.05)
        self.navigator = ThesisNavigator(topo_map, goal, GoalFilter(), LIMITS, tolerance, 0.17, PERIOD)
        self.map, self.gate = topo_map, SafetyGate(LIMITS)
        self.pose = self.start = start
        self.time = 0.0
        self.change: Callable[[Observation], Observation] = lambda seen: seen

    def tick(self) -> Decision:
        odom = Pose2D(2.0, 3.0, 0.7) @ (self.start.inverse() @ self.pose)
        away = np.hypot(*(self.map.poses[:, :2] - [self.pose.x, self.pose.y]).T)
        node = self.map.pose(int(away.argmin()))
        here = Pose2D(node.x, node.y, self.pose.yaw)
        place = PlaceEstimate(self.time, odom, here, 1.0, 0.1, 0.9, 0.3, int(away.argmin()))
        seen = self.change(Observation(self.time, odom, place))
        decision = self.navigator.step(seen)
        twist = self.gate.limit(decision.twist, seen, PERIOD)
        half = twist.wz * PERIOD / 2
        self.pose = self.pose @ Pose2D(twist.vx * PERIOD * math.cos(half), twist.vx * PERIOD * math.sin(half), 2 * half)
        self.time += PERIOD
        return decision

    def run(self, limit: float = 150.0) -> Decision:
        while self.time < limit:
            decision = self.tick()
            if decision.outcome is not None:
                return decision
        raise AssertionError(f"no outcome after {limit} s")


@pytest.mark.parametrize("yaw", [-2.5, 0.0, 1.2, 3.0])
def test_it_ends_near_the_goal_whichever_way_it_faced(yaw: float) -> None:
    goal = Pose2D(*ROWS[200], 1.0)
    trip = Trip(MEADOW, Pose2D(0.5, 0.4, yaw), goal)
    decision = trip.run()
    assert decision.outcome is not None
    assert decision.outcome.error is None
    assert decision.twist == STOP
    # Half a node's spacing, the stop radius and the stop itself.
    assert trip.pose.distance(goal) < 0.1 + 0.15 + 0.1


def test_while_it_navigates_it_never_asks_for_less_than_the_least_speed() -> None:
    trip = Trip(MEADOW, Pose2D(0.5, 0.4, 2.0), Pose2D(*ROWS[120]))
    speeds = []
    while (decision := trip.tick()).outcome is None:
        speeds.append(decision.twist.vx)
    assert min(speeds) >= 0.2
    assert decision.state == ThesisState.NAVIGATING


def test_standing_at_the_goal_it_is_there_at_once() -> None:
    decision = Trip(MEADOW, Pose2D(*ROWS[40], 0.3), Pose2D(*ROWS[40])).tick()
    assert decision.outcome is not None
    assert decision.outcome.error is None


def test_it_predicts_by_odometry_while_nothing_is_seen() -> None:
    """Facing +y of the compass and driving 1 m blind: the goal, 2 m ahead, comes 1 m nearer."""
    trip = Trip(MEADOW, Pose2D(1.0, 0.4, math.pi / 2), Pose2D(1.0, 2.4))
    before = trip.tick().distance_remaining
    trip.change = lambda seen: replace(seen, place=None)
    start = trip.pose
    while trip.pose.distance(start) < 1.0:
        decision = trip.tick()
    assert before is not None
    assert decision.distance_remaining is not None
    assert before - decision.distance_remaining == pytest.approx(1.0, abs=0.05)


def test_a_goal_between_nodes_is_gone_to_by_its_offset_from_the_nearest() -> None:
    trip = Trip(MEADOW, Pose2D(*ROWS[0]), Pose2D(2.08, 1.0))
    assert trip.tick().distance_remaining == pytest.approx(math.hypot(2.08, 1.0), abs=0.01)


def test_an_island_far_from_the_rest_and_a_goal_off_the_map_have_no_route() -> None:
    poses = [(x, y, 0.0) for x, y in [(0, 0), (0.2, 0), (3, 3), (3.2, 3)]]
    split = made_map(poses, [(0, 1, ODOMETRY), (2, 3, ODOMETRY)])
    for trip in (Trip(split, Pose2D(), Pose2D(3.2, 3.0)), Trip(MEADOW, Pose2D(), Pose2D(9.0, 9.0))):
        decision = trip.run()
        assert decision.outcome is not None
        assert decision.outcome.error is ErrorName.NO_ROUTE
        assert trip.pose == trip.start


def test_without_the_tiles_it_is_lost() -> None:
    trip = Trip(MEADOW, Pose2D(), Pose2D(2.0, 2.0))
    unseen = PlaceEstimate(0.0, Pose2D(), Pose2D(), 0.0, 10.0, -1.0, 0.0, -1)
    trip.change = lambda seen: replace(seen, place=unseen)
    decision = trip.run()
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.LOST
    assert trip.time < 5.0


def test_what_holds_the_robot_ends_in_a_time_out() -> None:
    trip = Trip(MEADOW, Pose2D(0.4, 0.4, 0.0), Pose2D(2.4, 0.4))
    held = Pose2D(0.4, 0.4, 0.0)

    def hold(seen: Observation) -> Observation:
        trip.pose = held
        return seen

    trip.change = hold
    decision = trip.run(limit=200.0)
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.TIMEOUT
    assert trip.time == pytest.approx(60.0 + 2.0 / 0.05, abs=1.0)


DANGERS = [
    ({"emergency_stop": True}, ErrorName.EMERGENCY_STOP),
    ({"base_ok": False}, ErrorName.BASE_LINK_DOWN),
    ({"camera_ok": False}, ErrorName.CAMERA_DOWN),
    ({"wheel_drop": True}, ErrorName.BLOCKED),
]


@pytest.mark.parametrize(("danger", "error"), DANGERS)
@pytest.mark.parametrize("under_way", [False, True])
def test_every_danger_ends_the_trip(danger: dict[str, bool], error: ErrorName, under_way: bool) -> None:
    trip = Trip(MEADOW, Pose2D(0.4, 0.4, 0.0), Pose2D(2.4, 2.4))
    if under_way:
        trip.tick()
    trip.change = lambda seen: replace(seen, **danger)
    decision = trip.tick()
    assert decision.outcome is not None
    assert decision.outcome.error is error
    assert decision.twist == STOP


@pytest.mark.parametrize("sensor", ["bumper_left", "bumper_right", "cliff"])
def test_a_bump_ends_the_trip_unless_it_began_there(sensor: str) -> None:
    trip = Trip(MEADOW, Pose2D(0.4, 0.4, 2.0), Pose2D(2.4, 2.4))
    trip.change = lambda seen: replace(seen, **{sensor: trip.time < 1.95 or trip.time > 4.0})
    while trip.time < 1.9:
        assert trip.tick().outcome is None
    assert trip.pose.distance(trip.start) < 0.01  # the gate lets it turn only
    decision = trip.run()
    assert trip.time == pytest.approx(4.1, abs=0.15)
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.BLOCKED
    assert decision.twist == STOP


def test_what_it_cannot_turn_away_from_blocks_it() -> None:
    trip = Trip(MEADOW, Pose2D(0.4, 0.4, 2.0), Pose2D(2.4, 2.4))
    trip.change = lambda seen: replace(seen, bumper_left=True)
    decision = trip.run()
    assert decision.outcome is not None
    assert decision.outcome.error is ErrorName.BLOCKED
    assert decision.outcome.report["distance_left"] == pytest.approx(math.hypot(2.0, 2.0), abs=0.15)
    assert trip.time < 6.0
