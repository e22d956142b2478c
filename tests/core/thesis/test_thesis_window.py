"""The thesis' dynamic window: never slow, within what can be reached, and turning towards the goal."""

import math

import pytest

from omnibotd.core.geometry import STOP, Twist2D
from omnibotd.core.safety import Limits
from omnibotd.core.thesis.dynamic_window import choose

LIMITS = Limits(0.3, 1.0, 0.5, 2.0)


@pytest.mark.parametrize("current", [STOP, Twist2D(0.2, 1.0), Twist2D(0.3, -0.4)])
@pytest.mark.parametrize("bearing", [-3.0, -1.0, 0.0, 0.2, 2.0])
def test_velocities_are_within_the_published_bounds_and_reach(current: Twist2D, bearing: float) -> None:
    goal = 2.0 * math.cos(bearing), 2.0 * math.sin(bearing)
    twist = choose(current, goal, LIMITS, 0.1)
    assert 0.2 <= twist.vx <= 0.3
    assert abs(twist.wz) <= 1.0
    assert abs(twist.wz - current.wz) <= 2.0 * 0.1 + 1e-9
    assert twist.vx <= max(0.2, current.vx + 0.05) + 1e-9


def test_straight_ahead_it_goes_straight_and_fast() -> None:
    twist = choose(Twist2D(0.3, 0.0), (3.0, 0.0), LIMITS, 0.1)
    assert twist.wz == pytest.approx(0.0, abs=1e-9)
    assert twist.vx == pytest.approx(0.3)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_it_turns_towards_the_goal(side: float) -> None:
    twist = choose(Twist2D(0.25, 0.0), (0.2, side * 1.5), LIMITS, 0.1)
    assert twist.wz * side == pytest.approx(0.2)  # as hard as one cycle allows


def test_a_slow_base_is_driven_at_its_own_top_speed() -> None:
    assert choose(STOP, (1.0, 0.0), Limits(0.1, 0.5, 0.5, 2.0), 0.1).vx == pytest.approx(0.1)
