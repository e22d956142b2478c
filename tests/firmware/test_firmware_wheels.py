"""Encoders to the edge, closed-loop speed, and what happens where wheel and encoder don't belong together."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest

from firmware_bridge.messages import Fault, Hello, Status, Telemetry
from tools.avr.bench import Bench
from tools.avr.robot import FULL_SPEED, LEFT, RIGHT

FAST = 20_000.0  # edges/s a wheel
ACCELERATION = 16_000.0  # ticks/s^2, the default
INTERRUPT_LIMIT = 12e-6  # s without interrupts; an edge comes every 25 us on two wheels at 20,000 a second


def counted(bench: Bench) -> tuple[int, int]:
    report = bench.report()
    return report.left_ticks, report.right_ticks


@pytest.mark.parametrize("speeds", [(FAST, FAST), (-FAST, -FAST), (FAST, -FAST), (FAST, -FAST / 3.0)])
def test_counts_every_edge(any_bench: Bench, speeds: tuple[float, float]) -> None:
    """While telemetry goes out, and set-points come at 50 a second."""
    bench = any_bench
    bench.greet()
    assert bench.configure(full_speed=25_000, max_speed=25_000, acceleration=1_000_000)
    for side, speed in enumerate(speeds):
        bench.robot.spin(side, speed)
    for _ in range(20):
        bench.drive(round(speeds[LEFT]), round(speeds[RIGHT]))
        bench.robot.run(0.02)
    for side in (LEFT, RIGHT):
        bench.robot.spin(side, 0.0)
    assert counted(bench) == bench.robot.ticks
    assert abs(bench.robot.ticks[LEFT]) > 8000 and abs(bench.robot.ticks[RIGHT]) > 2500
    report = bench.report()
    assert (report.crc_errors, report.faults, bench.robot.lost_bytes) == (0, 0, 0)
    assert bench.robot.longest_deaf < INTERRUPT_LIMIT


def test_counts_every_edge_of_a_wheel_that_shakes(bench: Bench) -> None:
    bench.greet()
    rng = random.Random(4)
    for _ in range(300):
        for side in (LEFT, RIGHT):
            bench.robot.spin(side, rng.uniform(-FAST, FAST))
        bench.robot.run(rng.uniform(0.0, 0.002))
    for side in (LEFT, RIGHT):
        bench.robot.spin(side, 0.0)
    assert counted(bench) == bench.robot.ticks


def test_says_so_when_an_edge_was_missed(bench: Bench) -> None:
    """Both channels of a pulled encoder go high at once, which no wheel can do between two readings."""
    bench.greet()
    bench.robot.unplug(RIGHT)
    assert any(message.faults == Fault.ENCODER_RIGHT for message in reports_during(bench, 0.05))
    assert bench.report().faults == 0


def reports_during(bench: Bench, seconds: float) -> list[Telemetry]:
    bench.robot.run(seconds)
    return [message for message in bench.heard() if isinstance(message, Telemetry)]


def test_odometry_is_exact_to_the_tick(any_bench: Bench) -> None:
    """Whatever is driven: the count is the wheel's."""
    bench = any_bench
    bench.greet()
    rng = random.Random(8)
    for _ in range(6):
        bench.hold(rng.randrange(-3500, 3500), rng.randrange(-3500, 3500), 0.4)
    bench.rest()
    assert counted(bench) == bench.robot.ticks
    assert all(abs(ticks) > 100 for ticks in bench.robot.ticks)


def record(bench: Bench, left: int, right: int, seconds: float) -> list[tuple[float, float]]:
    """True speeds, left and right, each millisecond while set-points are held."""
    speeds = []
    for step in range(round(seconds * 1000.0)):
        if step % 50 == 0:
            bench.drive(left, right)  # takes some milliseconds, in which nothing is recorded
        bench.robot.run(0.001)
        speeds.append(bench.robot.speeds)
    return speeds


def test_step_response(any_bench: Bench) -> None:
    bench = any_bench
    bench.greet()
    target = 2000
    left = [speed for speed, _ in record(bench, target, -target, 1.5)]
    reached = next(i for i, speed in enumerate(left) if speed >= 0.9 * target)
    # The acceleration limit alone takes 125 ms; the motor's lag is 80 ms.
    assert 0.10 <= reached / 1000.0 <= 0.35
    assert max(left) <= 1.15 * target
    assert all(abs(speed - target) <= 0.05 * target for speed in left[800:])


@pytest.mark.parametrize("target", [300, -1000, 3000])
@pytest.mark.parametrize(("strength", "friction"), [(1.0, 0.0), (0.8, 0.1), (1.3, 0.2)])
def test_no_steady_error(bench: Bench, target: int, strength: float, friction: float) -> None:
    """Also with motors stronger, weaker or stiffer than the configuration says; 3000 is then almost all they have."""
    bench.robot.motor(LEFT, strength * FULL_SPEED / (1.0 - friction), friction=friction)
    bench.greet()
    bench.hold(target, 500, 1.5)
    begin, start = bench.robot.ticks[LEFT], bench.robot.now
    bench.hold(target, 500, 2.0)
    speed = (bench.robot.ticks[LEFT] - begin) / (bench.robot.now - start)
    assert speed == pytest.approx(target, rel=0.005)


def test_acceleration_is_limited_both_ways(bench: Bench) -> None:
    bench.greet()
    there = [speed for speed, _ in record(bench, 3000, 0, 0.8)]
    back = [speed for speed, _ in record(bench, -3000, 0, 1.0)]
    for speeds in (there, back):
        steepest = max(abs(b - a) for a, b in zip(speeds, speeds[20:], strict=False)) / 0.020
        assert steepest <= 1.5 * ACCELERATION  # the loop may catch up a little faster than it is led
    assert there[-1] == pytest.approx(3000, rel=0.05) and back[-1] == pytest.approx(-3000, rel=0.05)


def test_setpoints_beyond_the_limit_are_held_to_it(bench: Bench) -> None:
    bench.greet()
    bench.robot.motor(LEFT, 6000.0)
    bench.hold(2**31 - 1, -(2**31), 1.5)
    left, right = bench.robot.speeds
    assert left == pytest.approx(3600, rel=0.05)  # max_speed by default
    assert right == pytest.approx(-3600, rel=0.05)


def test_takes_over_a_rolling_wheel_without_a_jerk(bench: Bench) -> None:
    """The watchdog let go at 3000 ticks/s; the next set-point asks for what the wheel still has."""
    bench.greet()
    bench.hold(3000, 3000, 1.0)
    bench.robot.run(0.26)
    rolling = bench.robot.speeds[LEFT]
    bench.drive(round(rolling), round(rolling))
    speeds = record(bench, round(rolling), round(rolling), 0.3)
    assert 500 < rolling < 3000
    assert all(abs(after - rolling) < 0.3 * rolling for after, _ in speeds[5:])


def test_at_rest_it_is_silent(bench: Bench) -> None:
    bench.greet()
    bench.hold(1000, 1000, 0.5)
    bench.hold(0, 0, 1.5)
    assert bench.robot.duty == (0.0, 0.0)
    assert bench.report().status & Status.MOVING_ALLOWED


def stopped_after(bench: Bench, seconds: float) -> float:
    """Drives for so long; how long after the start the motors went off."""
    start = bench.robot.now
    bench.hold(1500, 1500, seconds)
    return bench.robot.driven_at - start


@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_an_encoder_without_its_plug_stops_the_wheels(bench: Bench, side: int) -> None:
    bench.robot.unplug(side)
    bench.greet()
    assert stopped_after(bench, 2.0) < 0.8
    assert bench.report().faults == (Fault.MOTOR_LEFT, Fault.MOTOR_RIGHT)[side]


@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_swapped_motor_wires_stop_the_wheels(bench: Bench, side: int) -> None:
    bench.robot.motor(side, -FULL_SPEED)
    bench.greet()
    assert stopped_after(bench, 2.0) < 0.8
    assert bench.report().faults == (Fault.ENCODER_LEFT, Fault.ENCODER_RIGHT)[side]


def test_a_blocked_wheel_is_let_go_until_the_host_asks_for_rest(bench: Bench) -> None:
    bench.greet()
    bench.hold(1500, 1500, 0.5)
    bench.robot.spin(LEFT, 0.0)
    assert stopped_after(bench, 2.0) < 0.8
    assert bench.report().faults == Fault.MOTOR_LEFT
    bench.hold(0, 0, 0.1)
    bench.robot.motor(LEFT)
    bench.hold(1500, 1500, 1.0)
    assert bench.report().faults == 0
    assert bench.robot.speeds[LEFT] == pytest.approx(1500, rel=0.1)


def test_a_hello_forgives_a_blocked_wheel(bench: Bench) -> None:
    bench.greet()
    bench.robot.spin(LEFT, 0.0)
    stopped_after(bench, 2.0)
    bench.robot.motor(LEFT)
    bench.say(Hello())
    bench.hold(1500, 1500, 1.0)
    assert bench.robot.speeds[LEFT] == pytest.approx(1500, rel=0.1)


def test_hard_turns_and_stops_are_no_faults(bench: Bench) -> None:
    bench.greet()
    rng = random.Random(3)
    for _ in range(12):
        bench.hold(rng.choice((-3500, 0, 3500)), rng.choice((-3500, 0, 3500)), rng.uniform(0.1, 0.6))
        assert bench.report().faults == 0


def test_the_clock_counts_microseconds(bench: Bench) -> None:
    bench.greet()
    bench.report()
    stamps = [message.mcu_us for message in reports_during(bench, 1.0)]
    assert all(abs(after - before - 20_000) < 1000 for before, after in pairwise(stamps))
    assert stamps[-1] - stamps[0] == pytest.approx(20_000 * (len(stamps) - 1), abs=1000)
