import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from omnibotd.core.geometry import Pose2D, Twist2D, wrap
from omnibotd.core.kinematics import DifferentialDrive
from omnibotd.core.odometry import HISTORY, WheelOdometry

metres = st.floats(-50, 50)
angles = st.floats(-math.pi, math.pi)
poses = st.builds(Pose2D, metres, metres, angles)


def close(a: Pose2D, b: Pose2D) -> bool:
    return a.distance(b) < 1e-9 and abs(wrap(a.yaw - b.yaw)) < 1e-9


@given(poses)
def test_a_pose_and_its_inverse_cancel(pose: Pose2D) -> None:
    assert close(pose @ pose.inverse(), Pose2D())
    assert close(pose.inverse() @ pose, Pose2D())


@given(poses, poses, poses)
def test_composition_is_associative(a: Pose2D, b: Pose2D, c: Pose2D) -> None:
    left, right = (a @ b) @ c, a @ (b @ c)
    assert left.distance(right) < 1e-8
    assert abs(wrap(left.yaw - right.yaw)) < 1e-9


def test_a_pose_turned_left_sees_forward_as_left() -> None:
    x, y = Pose2D(1.0, 2.0, math.pi / 2).transform(3.0, 0.0)
    assert (x, y) == pytest.approx((1.0, 5.0))


def test_bearing_is_counter_clockwise_from_the_own_heading() -> None:
    assert Pose2D(0, 0, 0).bearing(Pose2D(0, 1)) == pytest.approx(math.pi / 2)
    assert Pose2D(0, 0, math.pi / 2).bearing(Pose2D(0, 1)) == pytest.approx(0.0)


def test_forward_motion_turns_both_wheels_alike_and_a_left_turn_the_right_one_more() -> None:
    drive = DifferentialDrive(wheel_radius=0.05, wheel_separation=0.2)
    assert drive.wheel_speeds(Twist2D(0.1, 0.0)) == pytest.approx((2.0, 2.0))
    assert drive.wheel_speeds(Twist2D(0.0, 1.0)) == pytest.approx((-2.0, 2.0))


def test_a_quarter_circle_ends_where_geometry_says() -> None:
    drive = DifferentialDrive(wheel_radius=0.05, wheel_separation=0.2)
    radius, turned = 1.0, math.pi / 2
    left, right = ((radius + side * 0.1) * turned / 0.05 for side in (-1, 1))
    step = drive.displacement(left, right)
    assert (step.x, step.y, step.yaw) == pytest.approx((1.0, 1.0, turned))


def test_odometry_integrates_a_square_back_to_its_start() -> None:
    ticks_per_rev = 1000.0
    odometry = WheelOdometry(DifferentialDrive(0.05, 0.2))
    metre = 1.0 / (2 * math.pi * 0.05) * ticks_per_rev
    quarter = math.pi / 2 * 0.1 / (2 * math.pi * 0.05) * ticks_per_rev
    left = right = 0.0
    odometry.update(0.0, 0, 0, ticks_per_rev)
    for stamp in range(4):
        left, right = left + metre, right + metre
        odometry.update(stamp + 0.5, round(left), round(right), ticks_per_rev)
        left, right = left - quarter, right + quarter
        odometry.update(stamp + 1.0, round(left), round(right), ticks_per_rev)
    assert odometry.odom_from_base.distance(Pose2D()) < 0.005
    assert odometry.distance == pytest.approx(4.0, abs=0.01)


def test_odometry_gives_the_pose_at_a_stamp_between_two_readings() -> None:
    odometry = WheelOdometry(DifferentialDrive(0.05, 0.2))
    odometry.update(10.0, 0, 0, 1000.0)
    odometry.update(11.0, 1000, 1000, 1000.0)
    one_turn = 2 * math.pi * 0.05
    assert odometry.at(10.25).x == pytest.approx(0.25 * one_turn)
    assert odometry.at(9.0).x == pytest.approx(0.0)
    assert odometry.at(12.0).x == pytest.approx(one_turn)


def test_a_rebased_encoder_does_not_move_the_robot_and_the_history_stays_bounded() -> None:
    odometry = WheelOdometry(DifferentialDrive(0.05, 0.2))
    odometry.update(0.0, 5000, 5000, 1000.0)
    odometry.rebase()
    assert odometry.update(1.0, 0, 0, 1000.0) == Pose2D()
    for stamp in range(3 * HISTORY):
        odometry.update(2.0 + stamp, stamp, stamp, 1000.0)
    assert odometry.at(2.0) == odometry.at(2.0 + 2 * HISTORY)
