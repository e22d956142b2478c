"""The native protocol, host and device joined: hands shaken, driving, and what lines and restarts do to both."""

from __future__ import annotations

import math

import pytest
from omnibot_pair import OTHER_VERSION, STEP, TURN, Pair, connected_pair, kinds_sent

from firmware_bridge import messages
from firmware_bridge.bases.omnibot import OmnibotHost
from firmware_bridge.device import ALL, OmnibotDevice
from firmware_bridge.events import BridgeError, Connected, Disconnected, Telemetry
from firmware_bridge.framing import Decoder
from firmware_bridge.messages import Capability, Hello, SetPoint


def test_connects_and_knows_the_base() -> None:
    pair = Pair()
    pair.run(0.1)
    (event,) = pair.happened()
    assert isinstance(event, Connected)
    info = event.info
    assert (info.driver, info.board, info.boot_nonce) == ("omnibot", "emulator", 0xA0000001)
    assert (info.watchdog, info.ticks_per_rev) == (0.25, 1000.0)
    assert info.capabilities == {"bumpers", "cliff", "wheel_drop", "charging", "battery", "range"}


def test_hello_every_200_ms_and_nothing_else_before_the_answer() -> None:
    host = OmnibotHost()
    sent = b""
    for tick in range(100):  # 1 s
        host.poll(tick * STEP)
        host.drive(1.0, 1.0, tick * STEP)
        sent += host.data_to_send()
    assert kinds_sent(sent) == [Hello] * 5


def test_drives_at_the_speed_asked_for() -> None:
    pair = connected_pair()
    pair.run(1.0, drive=(TURN, -0.5 * TURN))
    assert pair.device.target == (1000, -500)
    assert pair.latest().left_ticks == pytest.approx(1000, abs=20)
    assert pair.latest().right_ticks == pytest.approx(-500, abs=10)


def test_only_the_newest_set_point_is_sent_and_only_once() -> None:
    pair = connected_pair()
    for speed in (1.0, 2.0, 3.0):
        pair.host.drive(speed, speed, pair.now)
    (frame,) = Decoder().feed(pair.host.data_to_send())
    sent = messages.parse(frame)
    assert isinstance(sent, SetPoint)
    assert (sent.boot_nonce, sent.left, sent.right) == (0xA0000001, round(3000 / TURN), round(3000 / TURN))
    assert pair.host.data_to_send() == b""


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "faults",
    [
        {"split": True},
        {"loss": 0.2},
        {"delay": 0.1},
        {"flips": 0.004},
        {"garbage": 0.2},
        {"split": True, "loss": 0.1, "delay": 0.05, "flips": 0.001, "garbage": 0.1},
    ],
    ids="+".join,
)
def test_bad_lines(seed: int, faults: dict[str, float]) -> None:
    """It connects, drives most of the way, says where it is, and never moves as nobody said."""
    pair = Pair(seed=10 * seed, **faults)
    pair.run(1.5)
    pair.events.clear()
    pair.wheels = [0.0, 0.0]
    pair.device.set_state(0, 0)
    pair.run(2.0, drive=(TURN, TURN))
    assert pair.wheels[0] > 1300
    assert pair.targets <= {(0, 0), (1000, 1000)}
    assert pair.latest().left_ticks == pytest.approx(pair.wheels[0], abs=150)
    assert [event for event in pair.happened() if isinstance(event, Disconnected)] == []


def test_set_points_that_a_line_kept_do_not_move_the_wheels() -> None:
    """As an adapter does that hangs for a while and then delivers what it had been given."""
    pair = connected_pair()
    pair.run(0.5, drive=(TURN, TURN))
    kept = []
    for _ in range(10):
        pair.host.drive(TURN, TURN, pair.now)
        kept.append(pair.host.data_to_send())
        pair.run(0.02)
    pair.run(0.6)  # the host has died
    before = pair.wheels.copy()
    for late in kept:
        pair.device.receive(late, pair.now)
        pair.step()
    pair.run(0.3)
    assert pair.wheels == before
    pair.run(0.2, drive=(TURN, TURN))
    assert pair.wheels != before


def test_a_host_drives_in_the_time_that_the_base_has_told() -> None:
    """The reckoned clock goes on between two reports, and across the wrap of the base's 32 bits."""
    host, device = OmnibotHost(), OmnibotDevice(1000.0, 7)
    device.poll(0.0)
    now = 2**32 / 1e6 - 0.01
    device.receive(messages.to_bytes(Hello(), 1), now)
    host.receive(device.data_to_send(), 9.0)
    host.drive(TURN, TURN, 9.0)
    assert host.data_to_send() == b""  # it knows the base, not its time
    device.poll(now)
    host.receive(device.data_to_send(), 9.0)
    for later in (0.0, 0.02, 0.24):
        host.drive(TURN, TURN, 9.0 + later)
        (frame,) = Decoder().feed(host.data_to_send())
        sent = messages.parse(frame)
        assert isinstance(sent, SetPoint)
        assert (sent.mcu_us - round((now + later) * 1e6) + 10) % 2**32 <= 20
        device.receive(messages.to_bytes(sent, frame.seq), now + later)
        assert device.target == (1000, 1000)


def test_silence() -> None:
    pair = connected_pair()
    pair.up.loss = 1.0
    pair.run(0.29)
    assert pair.happened() == []
    pair.run(0.03)
    assert pair.happened() == [Disconnected("silent")]
    pair.host.drive(1.0, 1.0, pair.now)
    assert SetPoint not in kinds_sent(pair.host.data_to_send())
    pair.up.loss = 0.0
    pair.run(0.3)
    assert [type(event) for event in pair.happened()] == [Connected]


def test_what_waits_for_a_base_that_is_gone_is_void() -> None:
    for gone in (lambda host, now: host.poll(now + 0.31), lambda host, now: host.receive(OTHER_VERSION, now)):
        pair = connected_pair()
        pair.host.drive(TURN, TURN, pair.now)
        (event,) = gone(pair.host, pair.now)
        assert isinstance(event, Disconnected)
        assert SetPoint not in kinds_sent(pair.host.data_to_send())


def test_restart_in_mid_message() -> None:
    pair = connected_pair(split=True)
    pair.run(1.0, drive=(TURN, TURN))
    pair.host.drive(TURN, TURN, pair.now)
    frame = pair.host.data_to_send()
    pair.device.receive(frame[: len(frame) // 2], pair.now)
    pair.device.reset(0xA0000002)
    pair.device.receive(frame[len(frame) // 2 :], pair.now)
    pair.targets.clear()
    pair.events.clear()
    pair.run(0.3, drive=(TURN, TURN))
    assert pair.targets <= {(0, 0)}
    pair.run(1.0, drive=(TURN, TURN))
    restarted, connected = pair.happened()[-2:]
    assert restarted == Disconnected("base restarted")
    assert isinstance(connected, Connected) and connected.info.boot_nonce == 0xA0000002
    assert pair.device.target == (1000, 1000)


def test_encoders_start_anew_after_a_restart() -> None:
    pair = connected_pair()
    pair.run(2.0, drive=(TURN, TURN))
    pair.device.reset(0xA0000002)
    pair.events.clear()
    pair.run(0.6)
    first = next(event for event in pair.events if isinstance(event, Telemetry))
    assert (first.left_ticks, first.right_ticks) == (0, 0)


def test_no_set_point_of_an_earlier_life_is_applied_though_a_late_hello_greets_the_new_one() -> None:
    pair = connected_pair()
    pair.down.delay = pair.up.delay = 0.1
    pair.run(1.0, drive=(TURN, TURN))
    assert pair.device.target == (1000, 1000)
    pair.down.push(messages.to_bytes(Hello(), 200), pair.now)
    pair.targets.clear()
    pair.device.reset(0xA0000002)
    while not any(isinstance(event, Disconnected) for event in pair.happened()):
        pair.run(STEP, drive=(TURN, TURN))
    assert pair.targets == {(0, 0)}


def test_restart_is_known_from_one_frame_of_telemetry() -> None:
    pair = connected_pair()
    other = OmnibotDevice(1000.0, boot_nonce=7)
    other.receive(messages.to_bytes(Hello(), 1), pair.now)
    other.poll(pair.now)
    (telemetry,) = [f for f in Decoder().feed(other.data_to_send()) if f.kind == messages.Telemetry.CODE]
    report = messages.to_bytes(messages.parse(telemetry), telemetry.seq)
    assert pair.host.receive(report, pair.now) == [Disconnected("base restarted")]
    pair.host.poll(pair.now)
    assert kinds_sent(pair.host.data_to_send()) == [Hello]


def test_senses_come_through() -> None:
    pair = connected_pair()
    pair.device.set_state(0, 0, bumper_left=True, cliff=True, charging=True, battery_mv=11234)
    pair.device.poll(pair.now + 0.02)
    *_, event = pair.host.receive(pair.device.data_to_send(), pair.now + 0.02)
    assert isinstance(event, Telemetry)
    assert (event.bumper_left, event.bumper_right, event.cliff, event.wheel_drop) == (True, False, True, False)
    assert (event.charging, event.battery) == (True, 11.234)


def test_a_base_without_contact_or_gauge_says_nothing_of_them() -> None:
    pair = Pair()
    pair.device = OmnibotDevice(1000.0, 3, capabilities=ALL & ~(Capability.CHARGING | Capability.BATTERY))
    pair.run(0.2)
    assert (pair.latest().charging, pair.latest().battery) == (None, None)


def test_speeds_that_are_no_speeds_are_our_bug() -> None:
    pair = connected_pair()
    with pytest.raises(BridgeError, match="not finite"):
        pair.host.drive(math.nan, 0.0, pair.now)
    with pytest.raises(BridgeError, match="beyond"):
        pair.host.drive(0.0, 1e9, pair.now)
