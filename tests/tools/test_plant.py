"""The simulated body: kinematics from first principles, errors of the stated size, walls that never trap."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tools.sim.plant import MOTOR_LAG, RANGE_REACH, ROBOT_RADIUS, Body, SimulatedRobot

IDEAL = Body(scale_error=0.0, wheel_difference=0.0, slip=0.0)
TICKS_PER_METRE = 1440 / (2 * math.pi * 0.035)


class Box:
    """A 6 m square of floor with a dock."""

    dock = (2.78, 0.5, 0.0)

    def free(self, x: float, y: float, radius: float) -> bool:
        return max(abs(x), abs(y)) <= 3.0 - radius


def drive(robot: SimulatedRobot, seconds: float, left: float, right: float) -> tuple[int, int]:
    """Metres a second of each wheel; returns the ticks counted meanwhile."""
    target = (left * TICKS_PER_METRE, right * TICKS_PER_METRE)
    steps = [robot.step(0.02, *target) for _ in range(round(seconds / 0.02))]
    return sum(step[0] for step in steps), sum(step[1] for step in steps)


def test_straight_drive_covers_speed_times_time_less_the_lag():
    robot = SimulatedRobot(Box(), (-1.0, 0.5, 0.0), 0, IDEAL)
    ticks = drive(robot, 4.0, 0.25, 0.25)
    way = 0.25 * (4.0 - MOTOR_LAG)
    assert robot.pose == pytest.approx((-1.0 + way, 0.5, 0.0), abs=0.002)
    assert ticks == pytest.approx((way * TICKS_PER_METRE,) * 2, abs=12)


def test_opposite_wheels_turn_counter_clockwise_on_the_spot():
    robot = SimulatedRobot(Box(), (0.0, 0.0, 0.0), 0, IDEAL)
    left, right = drive(robot, 2.0, -0.1, 0.1)
    assert robot.pose[:2] == pytest.approx((0.0, 0.0), abs=1e-9)
    assert robot.pose[2] == pytest.approx((right - left) / TICKS_PER_METRE / 0.23, abs=0.002)
    assert robot.pose[2] > 1.5


def test_arc_follows_the_circle_of_its_wheel_speeds():
    robot = SimulatedRobot(Box(), (0.0, -0.5, 0.0), 0, IDEAL)
    radius = 0.23 / 2 * (0.3 + 0.2) / (0.3 - 0.2)
    for _ in range(100):
        robot.step(0.05, 0.2 * TICKS_PER_METRE, 0.3 * TICKS_PER_METRE)
        assert math.hypot(robot.pose[0], robot.pose[1] - (radius - 0.5)) == pytest.approx(radius, abs=0.003)


def test_motor_reaches_63_percent_of_a_step_after_its_lag():
    robot = SimulatedRobot(Box(), (0.0, 0.0, 0.0), 0, IDEAL)
    drive(robot, MOTOR_LAG, 0.5, 0.5)
    before = robot.pose[0]
    robot.step(0.001, 0.5 * TICKS_PER_METRE, 0.5 * TICKS_PER_METRE)
    assert (robot.pose[0] - before) / 0.001 == pytest.approx(0.5 * (1 - math.exp(-1.0)), rel=0.03)


def test_ticks_are_whole_and_none_gets_lost():
    robot = SimulatedRobot(Box(), (0.0, 0.0, 0.0), 0, IDEAL)
    counts = [robot.step(0.003, 40.0, -40.0) for _ in range(2000)]
    assert all(isinstance(n, int) for pair in counts for n in pair)
    total = 40.0 * (6.0 - MOTOR_LAG)
    assert sum(c[0] for c in counts) == pytest.approx(total, abs=2)
    assert sum(c[1] for c in counts) == pytest.approx(-total, abs=2)


def test_runs_differ_by_seed_and_errors_have_the_stated_size():
    def end(seed: int) -> tuple[float, float, float, int]:
        robot = SimulatedRobot(Box(), (-2.0, 0.0, 0.0), seed)
        ticks = drive(robot, 8.0, 0.25, 0.25)
        return (*robot.pose, ticks[0])

    ends = np.array([end(seed) for seed in range(60)])
    assert np.all(ends[:, 3] == ends[0, 3])
    assert end(7) == end(7)
    # Way 1.98 m, both wheels 1 % off: 20 mm, and slip adds 0.004 * sqrt(1.98 / 2) = 4 mm; the wheels differ by 0.2 %
    # and slip apart: heading off by both over the 0.23 m between them.
    way, slip = 1.98, 0.004 * math.sqrt(1.98)
    assert np.std(ends[:, 0]) == pytest.approx(math.hypot(0.01 * way, slip / math.sqrt(2)), rel=0.35)
    assert np.std(ends[:, 2]) == pytest.approx(math.hypot(0.002 * way, slip * math.sqrt(2)) / 0.23, rel=0.3)


@pytest.mark.parametrize(
    ("yaw", "pressed"),
    [(0.0, (True, True)), (0.7, (False, True)), (-0.7, (True, False))],
)
def test_wall_stops_the_robot_presses_its_side_and_lets_it_back_off(yaw, pressed):
    robot = SimulatedRobot(Box(), (2.6, 0.0, yaw), 3, IDEAL)
    ticks = drive(robot, 2.0, 0.2, 0.2)
    assert 3.0 - ROBOT_RADIUS - 0.001 < robot.pose[0] <= 3.0 - ROBOT_RADIUS
    assert robot.bumpers == pressed
    assert min(ticks) > 0.3 * TICKS_PER_METRE
    drive(robot, 1.0, -0.2, -0.2)
    assert robot.pose[0] < 3.0 - ROBOT_RADIUS - 0.08
    assert robot.bumpers == (False, False)


def test_reversing_into_a_wall_presses_no_bumper():
    robot = SimulatedRobot(Box(), (-2.6, 0.0, 0.0), 3, IDEAL)
    drive(robot, 2.0, -0.2, -0.2)
    assert robot.pose[0] < -2.8
    assert robot.bumpers == (False, False)


def test_no_sequence_of_commands_leaves_the_floor_or_traps_the_robot():
    rng = np.random.default_rng(11)
    box = Box()
    robot = SimulatedRobot(box, (2.5, 2.5, 0.8), 1)
    for _ in range(300):
        left, right = rng.uniform(-0.5, 0.5, 2)
        drive(robot, 0.4, left, right)
        assert box.free(*robot.pose[:2], ROBOT_RADIUS)
    robot.teleport((2.5, 2.5, math.pi / 4))
    drive(robot, 3.0, 0.4, 0.4)
    assert robot.bumpers == (True, True)
    corner = robot.pose
    drive(robot, 2.0, -0.4, -0.4)
    assert math.hypot(robot.pose[0] - corner[0], robot.pose[1] - corner[1]) > 0.5


def test_charging_contact_needs_place_and_heading():
    robot = SimulatedRobot(Box(), (2.78, 0.5, 0.0), 0)
    assert robot.at_dock()
    for pose, docked in [
        ((2.76, 0.52, 0.0), True),
        ((2.74, 0.5, 0.0), False),
        ((2.78, 0.5, math.radians(4.5)), True),
        ((2.78, 0.5, math.radians(-5.5)), False),
        ((2.78, 0.5, 2 * math.pi), True),
    ]:
        robot.teleport(pose)
        assert robot.at_dock() is docked
    robot.teleport((2.70, 0.5, 0.0))
    assert robot.at_dock(tolerance=0.1)


def test_teleport_moves_the_body_but_not_the_encoders():
    robot = SimulatedRobot(Box(), (0.0, 0.0, 0.0), 0)
    robot.teleport((1.0, -1.0, 7.0))
    assert robot.pose == pytest.approx((1.0, -1.0, 7.0 - 2 * math.pi))
    assert robot.step(0.02, 0.0, 0.0) == (0, 0)


def test_place_without_room_is_refused():
    with pytest.raises(ValueError, match=r"no room for a robot of radius 0\.17 m at x=2\.900"):
        SimulatedRobot(Box(), (2.9, 0.0, 0.0), 0)


@pytest.mark.parametrize(
    ("pose", "metres"),
    [
        ((2.0, 0.0, 0.0), 0.83),
        ((2.0, 0.0, math.pi), math.inf),
        ((2.0, 0.0, math.pi / 4), math.sqrt(2.0) - ROBOT_RADIUS),
        ((3.0 - ROBOT_RADIUS - 0.001, 0.0, 0.0), 0.001),
        ((3.0 - ROBOT_RADIUS - RANGE_REACH - 0.1, 0.0, 0.0), math.inf),
    ],
)
def test_range_is_measured_from_the_front_edge_straight_ahead(pose, metres):
    robot = SimulatedRobot(Box(), pose, 0, IDEAL, range_sensor=True)
    assert robot.range_ahead == pytest.approx(metres, abs=0.02)


def test_a_robot_without_a_range_sensor_measures_none():
    assert SimulatedRobot(Box(), (2.0, 0.0, 0.0), 0, IDEAL).range_ahead is None


def test_wheels_that_others_turn_move_it_as_its_own_do():
    own, others = (SimulatedRobot(Box(), (-1.0, 0.5, 0.3), 0, IDEAL) for _ in range(2))
    for _ in range(100):
        others.roll(*own.step(0.01, 0.2 * TICKS_PER_METRE, 0.3 * TICKS_PER_METRE))
    # What the encoders have not yet counted is less than a tick of each wheel.
    assert others.pose == pytest.approx(own.pose, abs=0.001)
    assert math.hypot(others.pose[0] + 1.0, others.pose[1] - 0.5) > 0.2


def test_a_body_may_have_a_fraction_of_a_tick_to_the_turn():
    roomba = Body(wheel_radius=0.036, wheel_separation=0.235, ticks_per_rev=508.8)
    assert roomba.metres_per_tick == pytest.approx(0.00044456, rel=1e-4)
