"""Differential drive with wheels of one size and of two."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from omnibotd.core.geometry import Twist2D
from omnibotd.core.kinematics import DifferentialDrive


def test_radii_have_the_mean_and_the_ratio_they_should() -> None:
    left, right = DifferentialDrive(0.04, 0.2, 1.5).radii
    assert (left + right) / 2.0 == pytest.approx(0.04)
    assert left / right == pytest.approx(1.5)


def test_a_larger_left_wheel_turns_the_robot_right_when_both_turn_alike() -> None:
    # Radii 44 and 36 mm: a radian of both rolls 44 and 36 mm, 8 mm over 0.2 m to the right.
    step = DifferentialDrive(0.04, 0.2, 44.0 / 36.0).displacement(1.0, 1.0)
    assert step.yaw == pytest.approx(-0.04)
    assert math.hypot(step.x, step.y) == pytest.approx(0.04, rel=1e-3)


@given(st.floats(-0.5, 0.5), st.floats(-2.0, 2.0), st.floats(0.8, 1.25))
def test_wheel_speeds_and_displacement_are_each_others_inverse(vx: float, wz: float, ratio: float) -> None:
    drive, dt = DifferentialDrive(0.035, 0.23, ratio), 0.01
    left, right = drive.wheel_speeds(Twist2D(vx, wz))
    step = drive.displacement(left * dt, right * dt)
    assert step.yaw == pytest.approx(wz * dt, abs=1e-12)
    assert step.x == pytest.approx(vx * dt, abs=1e-6)
