"""The wheels stop by themselves: when the host is silent, when the firmware hangs, when it resets."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest

from firmware_bridge import messages
from firmware_bridge.messages import GetConfig, Hello
from tools.avr.bench import BOOT, Bench

LIMIT, TOLERANCE = 0.250, 0.010
RESOLUTION = 0.0001  # s, of `driven_at`
HANG_LIMIT = 0.075  # s: the hardware watchdog's 64 ms, and 10 ms of the last control step before the hang


Chatter = Callable[[Bench, random.Random], bytes]


def nothing(bench: Bench, rng: random.Random) -> bytes:
    """The cable is cut."""
    return b""


def the_last_again(bench: Bench, rng: random.Random) -> bytes:
    return messages.to_bytes(bench.setpoint(2000, 2000), bench.seq)


def an_old_one(bench: Bench, rng: random.Random) -> bytes:
    return messages.to_bytes(bench.setpoint(2000, 2000), (bench.seq - rng.randrange(1, 129)) % 256)


def a_late_one(bench: Bench, rng: random.Random) -> bytes:
    late = bench.setpoint(2000, 2000, age=rng.uniform(LIMIT + TOLERANCE, 60.0))
    return messages.to_bytes(late, (bench.seq + 1) % 256)


def another_boots(bench: Bench, rng: random.Random) -> bytes:
    return messages.to_bytes(bench.setpoint(2000, 2000, bench.nonce ^ 1 << rng.randrange(32)), (bench.seq + 1) % 256)


def a_broken_one(bench: Bench, rng: random.Random) -> bytes:
    good = messages.to_bytes(bench.setpoint(2000, 2000), (bench.seq + 1) % 256)
    at = rng.randrange(1, len(good) - 1)
    return good[:at] + bytes((good[at] ^ 1 << rng.randrange(8),)) + good[at + 1 :]


def other_things(bench: Bench, rng: random.Random) -> bytes:
    return messages.to_bytes(rng.choice((GetConfig(), Hello(3))), (bench.seq + 1) % 256)


AFTERWARDS: tuple[Chatter, ...] = (
    nothing,
    the_last_again,
    an_old_one,
    a_late_one,
    another_boots,
    a_broken_one,
    other_things,
)


def time_cut(bench: Bench, rng: random.Random) -> float:
    """Drives for a while, then says nothing new: how long after the last valid set-point the motors went off."""
    for _ in range(rng.randrange(1, 6)):
        left, right = rng.randrange(800, 3600), rng.randrange(800, 3600)
        bench.drive(left * rng.choice((-1, 1)), right * rng.choice((-1, 1)))
        last = bench.robot.now - 0.002  # of its last byte
        bench.robot.run(rng.uniform(0.0, 0.15))
    chatter = rng.choice(AFTERWARDS)
    # Once the watchdog holds the wheels, an old number counts as new: a host may have counted all round.
    while bench.robot.now < last + LIMIT - TOLERANCE - 0.01:
        bench.robot.deliver(chatter(bench, rng))
        bench.robot.run(0.008)
    bench.robot.run_until(last + 2 * LIMIT)
    off = bench.robot.driven_at - last
    bench.robot.run(rng.uniform(0.0, 0.2))
    assert bench.robot.driven_at - last == off
    return off


def time_cuts(bench: Bench, count: int, seed: int) -> list[float]:
    bench.greet()
    rng = random.Random(seed)
    return [time_cut(bench, rng) for _ in range(count)]


def test_motors_are_off_a_quarter_of_a_second_after_the_last_setpoint(any_bench: Bench) -> None:
    times = time_cuts(any_bench, 15, 1)
    assert all(abs(time - LIMIT) <= TOLERANCE for time in times), times


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_thousand_random_cuts(bench: Bench) -> None:
    times = time_cuts(bench, 1000, 2)
    print(f"off after {min(times) * 1e3:.2f} to {max(times) * 1e3:.2f} ms")
    assert all(abs(time - LIMIT) <= TOLERANCE for time in times), (min(times), max(times))


def test_the_wheels_roll_out(bench: Bench) -> None:
    bench.greet()
    bench.hold(3000, 3000, 1.0)
    assert bench.robot.awake
    bench.rest()
    assert not bench.robot.awake
    assert bench.robot.speeds == pytest.approx((0.0, 0.0), abs=1.0)
    assert bench.report().pwm_left == 0


@pytest.mark.parametrize("in_interrupt", [False, True])
def test_a_hung_program_stops_the_wheels_and_starts_anew(any_bench: Bench, in_interrupt: bool) -> None:
    bench = any_bench
    bench.greet()
    bench.hold(2500, -2500, 0.4)
    before = bench.nonce
    repair = bench.robot.hang(in_interrupt=in_interrupt)
    hung_at = bench.robot.now
    for _ in range(10):  # the host goes on
        bench.say(bench.setpoint(2500, -2500, before))
        bench.robot.run(0.02)
    assert bench.robot.driven_at - hung_at <= HANG_LIMIT
    assert bench.robot.resets >= 1
    repair()
    bench.robot.run(0.2)
    bench.heard()
    bench.say(bench.setpoint(2500, -2500, before))
    bench.robot.run(0.1)
    assert bench.robot.driven_at - hung_at <= HANG_LIMIT and bench.heard() == []
    assert bench.greet().boot_nonce != before


def test_a_program_that_hangs_at_each_boot_never_drives(bench: Bench) -> None:
    bench.greet()
    bench.hold(2500, 2500, 0.3)
    bench.robot.hang()
    bench.robot.run(0.1)
    quiet_since = bench.robot.now
    for n in range(20):
        bench.say(Hello(), n)
        bench.say(bench.setpoint(2500, 2500, bench.nonce + n), n + 1)
        bench.robot.run(0.05)
    assert bench.robot.resets > 5
    assert bench.robot.driven_at < quiet_since


def test_reset_lets_go_of_the_motors(any_bench: Bench) -> None:
    bench = any_bench
    bench.greet()
    bench.hold(2500, 2500, 0.3)
    bench.robot.reset()
    at = bench.robot.now
    bench.robot.run(BOOT)
    assert bench.robot.driven_at <= at + RESOLUTION
