"""Who may move the wheels: the rules of PROTOCOL.md, "The base", on the compiled firmware."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest

from firmware_bridge import messages
from firmware_bridge.device import OmnibotDevice
from firmware_bridge.framing import Decoder
from firmware_bridge.messages import (
    Ack,
    Hello,
    HelloReply,
    Message,
    Release,
    SetPoint,
    Status,
    Stop,
    Telemetry,
)
from tools.avr.bench import BOOT, Bench

WATCHDOG = 0.25


def driven(bench: Bench) -> bool:
    """Whether a motor is driven within the next 20 ms."""
    begin = bench.robot.now
    bench.robot.run(0.02)
    return bench.robot.driven_at > begin


def test_silent_and_still_before_hello(any_bench: Bench) -> None:
    bench = any_bench
    bench.say(bench.setpoint(1000, 1000, 1))
    bench.robot.run(0.3)
    assert bench.heard() == [] and not driven(bench)


def test_introduces_itself(any_bench: Bench) -> None:
    reply = any_bench.greet()
    assert (reply.version, reply.watchdog_ms, reply.ticks_per_1000_rev) == (2, 250, 1_440_000)
    assert reply.board.rstrip(b"\0").decode() == any_bench.robot.board.mcu
    assert messages.names(messages.Capability(reply.capabilities)) == {
        "bumpers", "charging", "battery", "configuration"
    }  # fmt: skip
    assert reply.firmware != 0


def test_serves_no_other_version_but_answers(bench: Bench) -> None:
    reply = bench.ask(Hello(version=3), HelloReply)
    bench.say(bench.setpoint(1000, 1000, reply.boot_nonce))
    assert not driven(bench)
    bench.robot.run(0.2)
    assert bench.heard() == []


def test_telemetry_comes_fifty_times_a_second(any_bench: Bench) -> None:
    bench = any_bench
    bench.greet()
    bench.report()
    bench.robot.run(2.0)
    reports = [message for message in bench.heard() if isinstance(message, Telemetry)]
    gaps = [after.mcu_us - before.mcu_us for before, after in pairwise(reports)]
    assert len(reports) in {99, 100, 101}
    assert max(gaps) <= 21_000 and min(gaps) >= 19_000


def test_a_hello_stops_the_wheels(bench: Bench) -> None:
    bench.greet()
    bench.hold(2000, 2000, 0.3)
    assert driven(bench)
    bench.say(Hello())
    assert not driven(bench)


@pytest.mark.parametrize("ahead", [0, -1, -100, 128])
def test_only_a_newer_setpoint_counts(bench: Bench, ahead: int) -> None:
    bench.greet()
    last = bench.drive(2000, 2000)
    bench.say(bench.setpoint(-2000, -2000), (last + ahead) % 256)
    report = bench.report()
    assert report.setpoint_seq == last and report.pwm_left > 0


def test_a_repeated_setpoint_never_moves_the_wheels_again(bench: Bench) -> None:
    bench.greet()
    last = bench.drive(2000, 2000)
    bench.rest()
    bench.say(bench.setpoint(2000, 2000), last)
    assert not driven(bench)
    bench.say(bench.setpoint(2000, 2000), (last - 5) % 256)  # the host went on counting all round
    assert driven(bench)


def test_a_setpoint_for_another_boot_is_dropped(bench: Bench) -> None:
    bench.greet()
    for nonce in (bench.nonce - 1, bench.nonce + 1, 0, 0xFFFFFFFF, bench.nonce | 1 << 31):
        bench.say(bench.setpoint(2000, 2000, nonce))
        assert not driven(bench)


@pytest.mark.parametrize(("age", "moves"), [(0.24, True), (0.26, False), (3.0, False), (-0.01, True), (-0.03, False)])
def test_a_setpoint_that_comes_late_does_not_move_the_wheels(any_bench: Bench, age: float, moves: bool) -> None:
    bench = any_bench
    bench.greet()
    bench.robot.run(0.3)
    bench.say(bench.setpoint(2000, 2000, age=age))
    assert driven(bench) == moves


def test_rest_is_never_late(bench: Bench) -> None:
    bench.greet()
    bench.hold(2000, 2000, 0.3)
    bench.say(bench.setpoint(0, 0, age=3.0))
    bench.robot.run(0.2)  # it brakes
    assert not driven(bench) and bench.report().status & Status.MOVING_ALLOWED


def test_the_emergency_stop_latches(any_bench: Bench) -> None:
    bench = any_bench
    bench.greet()
    bench.hold(2000, -2000, 0.5)
    began = bench.robot.now
    assert bench.ask(Stop(), Ack) == Ack(Stop.CODE, bench.seq)
    assert bench.robot.driven_at - began < 0.003  # 6 bytes of line, and the main loop
    for attempt in (bench.setpoint(2000, 2000), Hello(), Release(bench.nonce + 1)):
        bench.say(attempt)
        bench.drive(2000, 2000)
        assert not driven(bench), attempt
    assert bench.report().status & Status.EMERGENCY_STOP


def test_a_release_alone_moves_nothing(bench: Bench) -> None:
    bench.greet()
    bench.hold(2000, 2000, 0.3)
    bench.say(Stop())
    bench.drive(2000, 2000)
    assert bench.ask(Release(bench.nonce), Ack) == Ack(Release.CODE, bench.seq)
    assert not driven(bench)
    bench.drive(2000, 2000)
    assert driven(bench)


def test_stops_before_any_hello(bench: Bench) -> None:
    assert bench.ask(Stop(), Ack).kind == Stop.CODE
    bench.greet()
    bench.drive(2000, 2000)
    assert not driven(bench)


def test_after_a_reset_hands_must_be_shaken_again(any_bench: Bench) -> None:
    bench = any_bench
    bench.greet()
    before = bench.nonce
    bench.hold(2000, 2000, 0.3)
    bench.robot.reset()
    bench.heard()
    bench.robot.run(BOOT)
    bench.drive(2000, 2000)
    assert not driven(bench)
    bench.robot.run(0.1)
    assert bench.heard() == []
    assert bench.greet().boot_nonce != before
    bench.say(bench.setpoint(2000, 2000, before))
    bench.say(Release(before))
    assert not driven(bench) and not any(isinstance(message, Ack) for message in bench.heard())
    bench.drive(2000, 2000)
    assert driven(bench)


def test_no_setpoint_from_before_a_reset_is_ever_applied(bench: Bench) -> None:
    """Set-points of the old life and HELLOs go on arriving, whatever the moment of the reset."""
    rng = random.Random(5)
    for _ in range(10):
        bench.greet()
        bench.hold(2000, 2000, 0.15)
        under_way = [messages.to_bytes(Hello(), 1)] * 3
        # As they were sent, and as if they had been sent to the new life.
        times = [bench.setpoint(0, 0).mcu_us] * 20 + [rng.randrange(200_000) for _ in range(20)]
        late = [SetPoint(bench.nonce, 2000, 2000, time) for time in times]
        under_way += [messages.to_bytes(message, rng.randrange(256)) for message in late]
        rng.shuffle(under_way)
        bench.robot.send(b"".join(under_way))
        bench.robot.run(rng.uniform(0.0, 0.03))
        bench.robot.reset()
        reset_at = bench.robot.now
        bench.robot.run(0.2)
        assert bench.robot.driven_at <= reset_at + 0.0002


def test_bumpers_charger_and_battery_are_reported(any_bench: Bench) -> None:
    bench = any_bench
    bench.greet()
    assert bench.report().status == 0
    bench.robot.bump(True, False)
    assert bench.report().status == Status.BUMPER_LEFT
    bench.robot.bump(False, True)
    bench.report()
    assert bench.report().status == Status.BUMPER_RIGHT
    bench.robot.bump(False, False)
    bench.robot.dock(True)
    bench.report()
    assert bench.report().status == Status.CHARGING
    bench.robot.battery(9.5)
    bench.robot.run(1.0)
    report = bench.report()
    assert report.battery_mv == pytest.approx(9500, abs=30)
    assert report.faults == messages.Fault.BATTERY_LOW


def test_a_knock_between_two_reports_is_reported(bench: Bench) -> None:
    bench.greet()
    for _ in range(20):
        bench.robot.run(0.0037)  # another moment of the period each time
        bench.heard()
        bench.robot.bump(True, False)
        bench.robot.run(0.006)
        bench.robot.bump(False, False)
        bench.robot.run(0.03)
        assert any(message.status & Status.BUMPER_LEFT for message in bench.heard() if isinstance(message, Telemetry))


def test_floods_of_hellos_cost_only_answers(bench: Bench) -> None:
    bench.robot.deliver(messages.to_bytes(Hello(), 1) * 500)
    bench.robot.run(0.1)
    replies = [message for message in bench.heard() if isinstance(message, HelloReply)]
    assert 50 < len(replies) < 500  # the line back is full: whole frames are left out, none is cut
    assert bench.robot.resets == bench.robot.lost_bytes == 0
    assert bench.report().crc_errors == 0


class Twin:
    """The device role in Python, which hears the same bytes as the firmware at the same time."""

    def __init__(self, nonce: int) -> None:
        self.device = OmnibotDevice(1440.0, nonce)

    def hear(self, data: bytes, now: float) -> list[Message]:
        self.device.receive(data, now)
        return [messages.parse(frame) for frame in Decoder().feed(self.device.data_to_send())]

    def settle(self, bench: Bench) -> None:
        """Lets the moment pass at which one's watchdog has just run out and the other's is about to."""
        fed_at = self.device._fed_at
        if fed_at is not None and abs(bench.robot.now - fed_at - WATCHDOG) < 0.04:
            bench.robot.run(0.1)
        self.device.poll(bench.robot.now)


def answers_in(said: list[Message]) -> list[tuple[type, int]]:
    """Replies and acknowledgements, as both number them alike."""
    return [(type(m), m.kind if isinstance(m, Ack) else 0) for m in said if isinstance(m, HelloReply | Ack)]


def invent(rng: random.Random, bench: Bench, last_seq: int) -> tuple[Message, int]:
    """A message that a host, or what a line makes of one, might send."""
    nonce = bench.nonce if rng.random() < 0.8 else rng.randrange(2**32)
    speeds = rng.choice(((1500, 1500), (-800, 900), (1000, 0), (0, 0)))
    age = rng.choice((0.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3, 10.0, -0.01, -0.05))
    drive = bench.setpoint(*speeds, nonce, age=age)
    message = rng.choice((drive,) * 12 + (Hello(), Hello(3), Stop(), Release(nonce), Release(nonce)))
    seq = (last_seq + rng.choice((1, 1, 1, 1, 2, 0, -1, 100, 127, 128, 200))) % 256
    return message, seq


def test_behaves_as_the_device_role_in_python(bench: Bench) -> None:
    converse(bench, 100, 11)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_behaves_as_the_device_role_in_python_for_long(any_bench: Bench) -> None:
    converse(any_bench, 2000, 12)


def converse(bench: Bench, count: int, seed: int) -> None:
    """Messages, some for another boot, repeated, reordered or changed on the way, in random gaps."""
    bench.greet()
    twin = Twin(bench.nonce)
    twin.hear(messages.to_bytes(Hello(), 1), 0.0)
    rng = random.Random(seed)
    seq = bench.seq
    for _ in range(count):
        message, number = invent(rng, bench, seq)
        data = messages.to_bytes(message, number)
        if rng.random() < 0.1:
            at = rng.randrange(len(data) - 1)
            data = b"\0" + data[:at] + bytes((data[at] ^ 1 << rng.randrange(8),)) + data[at + 1 :] + b"\0"
        bench.robot.run(rng.choice((0.002, 0.01, 0.1, 0.5)))
        twin.settle(bench)
        bench.heard()
        bench.robot.deliver(data)
        expected = answers_in(twin.hear(data, bench.robot.now))
        bench.robot.run(0.012)  # an answer of 39 bytes, and whatever telemetry is before it
        assert answers_in(bench.heard()) == expected
        assert_same_state(bench, twin)
        seq = twin.device._setpoint_seq or number


def assert_same_state(bench: Bench, twin: Twin) -> None:
    twin.settle(bench)
    report = bench.report()
    assert bool(report.status & Status.MOVING_ALLOWED) == (twin.device._fed_at is not None)
    assert bool(report.status & Status.EMERGENCY_STOP) == twin.device.emergency_stopped
    assert report.setpoint_seq == (twin.device._setpoint_seq or 0)
