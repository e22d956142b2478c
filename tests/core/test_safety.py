import math
from collections import deque
from dataclasses import replace

import pytest

from omnibotd.core.decision import Observation
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Pose2D, Twist2D
from omnibotd.core.safety import BRAKING, RANGE_MARGIN, Limits, SafetyGate, danger, hazard

LIMITS = Limits(0.3, 1.0, 0.5, 2.0)
CLEAR = Observation(0.0, Pose2D())
FAST = Twist2D(9.0, -9.0)


def at_speed(gate: SafetyGate, wanted: Twist2D) -> Twist2D:
    """The gate after ten seconds of wanting this."""
    for _ in range(100):
        twist = gate.limit(wanted, CLEAR, 0.1)
    return twist


def test_speeds_are_clamped_to_the_limits() -> None:
    assert at_speed(SafetyGate(LIMITS), FAST) == Twist2D(0.3, -1.0)


def test_speeding_up_takes_its_time_and_braking_less() -> None:
    gate = SafetyGate(LIMITS)
    assert gate.limit(FAST, CLEAR, 0.1).vx == pytest.approx(0.05)
    at_speed(gate, FAST)
    assert gate.limit(STOP, CLEAR, 0.1).vx == pytest.approx(0.3 - 0.05 * BRAKING)


def test_after_a_stop_it_stands_and_starts_from_standing() -> None:
    gate = SafetyGate(LIMITS)
    at_speed(gate, FAST)
    assert gate.stop() == STOP
    assert gate.limit(STOP, CLEAR, 0.1) == STOP
    assert gate.limit(FAST, CLEAR, 0.1).vx == pytest.approx(0.05)


@pytest.mark.parametrize("danger", [{"emergency_stop": True}, {"base_ok": False}, {"wheel_drop": True}])
def test_danger_stops_at_once_without_a_ramp(danger: dict[str, bool]) -> None:
    gate = SafetyGate(LIMITS)
    at_speed(gate, FAST)
    seen = replace(CLEAR, **danger)
    assert hazard(seen) is not None
    assert gate.limit(FAST, seen, 0.1) == STOP


@pytest.mark.parametrize("touch", [{"bumper_left": True}, {"bumper_right": True}, {"cliff": True}])
def test_a_touched_robot_goes_no_farther_but_may_turn_and_back_off(touch: dict[str, bool]) -> None:
    gate = SafetyGate(LIMITS)
    at_speed(gate, Twist2D(0.3, 1.0))
    seen = replace(CLEAR, **touch)
    twist = gate.limit(Twist2D(0.3, 1.0), seen, 0.1)
    assert twist.vx == 0.0
    assert twist.wz == pytest.approx(1.0)
    for _ in range(20):
        twist = gate.limit(Twist2D(-0.1, 0.0), seen, 0.1)
    assert twist == Twist2D(-0.1, 0.0)


@pytest.mark.parametrize("nonsense", [Twist2D(math.nan, 0.0), Twist2D(0.0, math.inf)])
def test_what_is_no_number_stops(nonsense: Twist2D) -> None:
    gate = SafetyGate(LIMITS)
    at_speed(gate, FAST)
    assert gate.limit(nonsense, CLEAR, 0.1) == STOP


@pytest.mark.parametrize("start", [0.06, 0.2, 0.5, 1.4])
def test_it_stops_short_of_what_the_range_sensor_sees(start: float) -> None:
    """Telemetry two periods old, a motor lag of 80 ms, full speed wanted all the time."""
    gate, speed, left = SafetyGate(LIMITS), 0.0, start
    lately = deque([start] * 4, maxlen=4)  # of the last 40 ms
    for _ in range(100):
        wanted = gate.limit(Twist2D(0.3, 0.0), replace(CLEAR, range_ahead=lately[0]), 0.1).vx
        for _ in range(10):
            speed += (wanted - speed) * (1.0 - math.exp(-0.01 / 0.08))
            left -= speed * 0.01
            lately.append(left)
    assert RANGE_MARGIN - 0.005 < left < RANGE_MARGIN + 0.01


def test_nothing_within_reach_and_no_sensor_limit_nothing() -> None:
    for ahead in (math.inf, None):
        gate = SafetyGate(LIMITS)
        at_speed(gate, FAST)
        assert gate.limit(FAST, replace(CLEAR, range_ahead=ahead), 0.1).vx == pytest.approx(0.3)


def test_near_an_obstacle_it_may_still_turn_and_back_off() -> None:
    gate, near = SafetyGate(LIMITS), replace(CLEAR, range_ahead=0.0)
    for _ in range(20):
        twist = gate.limit(Twist2D(-0.2, 1.0), near, 0.1)
    assert twist == Twist2D(-0.2, 1.0)


def test_the_worst_of_several_dangers_is_named() -> None:
    everything = replace(CLEAR, emergency_stop=True, base_ok=False, camera_ok=False, wheel_drop=True)
    named = []
    for cured in ({"emergency_stop": False}, {"base_ok": True}, {"camera_ok": True}, {"wheel_drop": False}):
        outcome = danger(everything)
        assert outcome is not None
        named.append(outcome.error)
        everything = replace(everything, **cured)
    assert named == [
        ErrorName.EMERGENCY_STOP,
        ErrorName.BASE_LINK_DOWN,
        ErrorName.CAMERA_DOWN,
        ErrorName.BLOCKED,
    ]
    assert danger(everything) is None
