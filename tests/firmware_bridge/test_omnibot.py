"""Host and device of the native protocol joined in memory, over good lines and bad ones."""

from __future__ import annotations

import math

import pytest

from firmware_bridge import messages
from firmware_bridge.bases.omnibot import OmnibotHost
from firmware_bridge.device import ALL, OmnibotDevice
from firmware_bridge.events import BridgeError, Connected, Disconnected, Event, Telemetry
from firmware_bridge.faults import HostileLine
from firmware_bridge.framing import Decoder
from firmware_bridge.messages import Capability, Hello, SetPoint, Stop

STEP = 0.01
TURN = 2.0 * math.pi  # rad/s at which a wheel makes one turn, 1000 ticks, a second


class Pair:
    """Both ends, a line each way, a clock, and wheels that do as they are told at once."""

    def __init__(self, seed: int = 1, **faults: float) -> None:
        self.host = OmnibotHost()
        self.device = OmnibotDevice(1000.0, boot_nonce=0xA0000001)
        self.down, self.up = HostileLine(seed), HostileLine(seed + 100)
        for line in (self.down, self.up):
            for name, value in faults.items():
                setattr(line, name, value)
        self.now = 5.0
        self.wheels = [0.0, 0.0]
        self.events: list[Event] = []
        self.targets: set[tuple[int, int]] = set()

    def run(self, seconds: float, drive: tuple[float, float] | None = None) -> None:
        """Let time pass; with `drive`, the host asks for these speeds at 20 Hz."""
        for tick in range(round(seconds / STEP)):
            if drive is not None and tick % 5 == 0:
                self.host.drive(*drive, self.now)
            self.step()

    def step(self) -> None:
        self.down.push(self.host.data_to_send(), self.now)
        for data in self.down.pull(self.now):
            self.device.receive(data, self.now)
            self.targets.add(self.device.target)
        self.wheels = [w + STEP * t for w, t in zip(self.wheels, self.device.target, strict=True)]
        self.device.set_state(*map(round, self.wheels))
        self.device.poll(self.now)
        self.up.push(self.device.data_to_send(), self.now)
        for data in self.up.pull(self.now):
            self.events += self.host.receive(data, self.now)
        self.events += self.host.poll(self.now)
        self.now += STEP

    def happened(self) -> list[Event]:
        """Connections and disconnections so far, and forget them and all telemetry."""
        links = [event for event in self.events if not isinstance(event, Telemetry)]
        self.events = []
        return links

    def latest(self) -> Telemetry:
        return [event for event in self.events if isinstance(event, Telemetry)][-1]


def connected_pair(seed: int = 1, **faults: float) -> Pair:
    pair = Pair(seed, **faults)
    pair.run(0.1)
    assert isinstance(pair.happened()[0], Connected)
    return pair


def kinds_sent(data: bytes) -> list[type[messages.Message]]:
    return [type(messages.parse(frame)) for frame in Decoder().feed(data)]


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
    assert messages.parse(frame) == SetPoint(0xA0000001, round(3000 / TURN), round(3000 / TURN))
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
    pair.down.delay = pair.up.delay = 0.2
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


def test_emergency_stop_latches_until_release() -> None:
    pair = connected_pair()
    pair.run(0.5, drive=(TURN, TURN))
    pair.host.emergency_stop(pair.now)
    pair.step()
    assert pair.device.target == (0, 0)
    pair.run(1.0, drive=(TURN, TURN))
    assert pair.device.target == (0, 0) and pair.device.emergency_stopped
    assert pair.latest().emergency_stop
    pair.host.release(pair.now)
    pair.run(0.1)
    assert not pair.device.emergency_stopped
    assert pair.device.target == (0, 0)
    pair.run(0.1, drive=(TURN, TURN))
    assert pair.device.target == (1000, 1000)
    assert not pair.latest().emergency_stop


def test_latched_base_refuses_the_set_points_of_any_host() -> None:
    device = OmnibotDevice(1000.0, 9)
    for message in (Hello(), Stop(), Hello(), SetPoint(9, 5, 5)):
        device.receive(messages.to_bytes(message, 1), 0.0)
    assert device.target == (0, 0)


@pytest.mark.parametrize("seed", range(5))
def test_emergency_stop_gets_through_a_bad_line(seed: int) -> None:
    pair = connected_pair(seed=seed)
    pair.down.loss = pair.up.loss = 0.5
    pair.host.emergency_stop(pair.now)
    pair.run(0.6)
    assert pair.device.emergency_stopped
    pair.host.release(pair.now)
    pair.run(0.6)
    assert not pair.device.emergency_stopped


def test_emergency_stop_before_hands_are_shaken() -> None:
    host = OmnibotHost()
    host.emergency_stop(0.0)
    assert kinds_sent(host.data_to_send()) == [Stop]


def test_no_set_point_is_sent_while_a_stop_is_wanted() -> None:
    pair = connected_pair()
    pair.host.emergency_stop(pair.now)
    pair.host.drive(TURN, TURN, pair.now)
    assert kinds_sent(pair.host.data_to_send()) == [Stop]


def test_emergency_stop_outlives_a_restart() -> None:
    pair = connected_pair()
    pair.host.emergency_stop(pair.now)
    pair.run(0.1)
    pair.device.reset(0xA0000002)
    assert not pair.device.emergency_stopped
    pair.run(1.0, drive=(TURN, TURN))
    assert pair.device.emergency_stopped
    assert pair.targets <= {(0, 0)}


def test_retries_are_bounded_and_acknowledgement_ends_them() -> None:
    pair = connected_pair()
    pair.host.emergency_stop(pair.now)
    pair.run(2.0)
    assert pair.happened() == []
    pair.down.loss = 1.0
    pair.host.release(pair.now)
    pair.run(0.9)
    assert pair.happened() == []
    pair.run(0.4)  # the clock of this test stretches 50 ms to up to 60
    assert pair.happened()[0] == Disconnected("no acknowledgement of RELEASE")


def test_stop_cancels_a_release_under_way() -> None:
    pair = connected_pair()
    pair.host.emergency_stop(pair.now)
    pair.run(0.1)
    pair.down.loss = 1.0
    pair.host.release(pair.now)
    pair.run(0.1)
    pair.host.emergency_stop(pair.now)
    pair.down.loss = 0.0
    pair.run(0.3)
    assert pair.device.emergency_stopped


def test_speeds_that_are_no_speeds_are_our_bug() -> None:
    pair = connected_pair()
    with pytest.raises(BridgeError, match="not finite"):
        pair.host.drive(math.nan, 0.0, pair.now)
    with pytest.raises(BridgeError, match="beyond"):
        pair.host.drive(0.0, 1e9, pair.now)
