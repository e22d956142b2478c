"""The device role by itself: what PROTOCOL.md demands of firmware."""

from __future__ import annotations

import pytest

from firmware_bridge import messages
from firmware_bridge.device import OmnibotDevice
from firmware_bridge.events import BridgeError
from firmware_bridge.framing import Decoder
from firmware_bridge.messages import Ack, Hello, HelloReply, Message, Range, Release, SetPoint, Status, Stop, Telemetry

NONCE = 0x1234


def greeted(now: float = 0.0) -> OmnibotDevice:
    device = OmnibotDevice(508.8, NONCE)
    tell(device, Hello(), 1, now)
    device.data_to_send()
    return device


def tell(device: OmnibotDevice, message: Message, seq: int, now: float) -> None:
    device.receive(messages.to_bytes(message, seq), now)


def us(seconds: float) -> int:
    return round(seconds * 1e6)


def said(device: OmnibotDevice) -> list[Message]:
    return [messages.parse(frame) for frame in Decoder().feed(device.data_to_send())]


def report(device: OmnibotDevice, now: float) -> Telemetry:
    device.poll(now)
    (telemetry,) = (message for message in said(device) if isinstance(message, Telemetry))
    return telemetry


def test_silent_and_still_before_hello() -> None:
    device = OmnibotDevice(1000.0, NONCE)
    tell(device, SetPoint(NONCE, 100, 100, us(0.0)), 1, 0.0)
    device.poll(1.0)
    assert device.target == (0, 0)
    assert device.data_to_send() == b""


def test_introduces_itself() -> None:
    device = OmnibotDevice(508.8, NONCE, board="uno-r3", firmware=0xC0FFEE01)
    tell(device, Hello(), 1, 0.0)
    (reply,) = said(device)
    assert reply == HelloReply(2, 250, 508800, NONCE, 0xC0FFEE01, b"uno-r3".ljust(16, b"\0"), 0x3F)


def test_does_not_serve_another_version_but_answers() -> None:
    device = OmnibotDevice(1000.0, NONCE)
    tell(device, Hello(version=3), 1, 0.0)
    device.poll(1.0)
    assert [type(message) for message in said(device)] == [HelloReply]
    tell(device, SetPoint(NONCE, 100, 100, us(1.0)), 2, 1.0)
    assert device.target == (0, 0)


def test_watchdog_stops_the_wheels_a_quarter_second_after_the_last_set_point() -> None:
    device = greeted()
    tell(device, SetPoint(NONCE, 100, -100, us(10.0)), 2, 10.0)
    device.poll(10.249)
    assert device.target == (100, -100)
    device.poll(10.251)
    assert device.target == (0, 0)
    tell(device, SetPoint(NONCE, 7, 7, us(20.0)), 3, 20.0)
    assert device.target == (7, 7)


def test_watchdog_is_minded_before_new_bytes() -> None:
    device = greeted()
    tell(device, SetPoint(NONCE, 100, 100, us(10.0)), 2, 10.0)
    device.receive(b"anything", 11.0)
    assert device.target == (0, 0)


@pytest.mark.parametrize("seq", [2, 1, 250, 130])
def test_repeated_or_older_set_points_neither_drive_nor_feed(seq: int) -> None:
    device = greeted()
    tell(device, SetPoint(NONCE, 100, 100, us(10.0)), 2, 10.0)
    tell(device, SetPoint(NONCE, 5, 5, us(10.2)), seq, 10.2)
    assert device.target == (100, 100)
    device.poll(10.26)
    assert device.target == (0, 0)


def test_sequence_numbers_wrap() -> None:
    device = greeted()
    tell(device, SetPoint(NONCE, 1, 1, us(10.0)), 255, 10.0)
    tell(device, SetPoint(NONCE, 2, 2, us(10.1)), 0, 10.1)
    assert device.target == (2, 2)


def test_after_the_watchdog_any_number_but_the_last() -> None:
    device = greeted()
    tell(device, SetPoint(NONCE, 1, 1, us(10.0)), 5, 10.0)
    tell(device, SetPoint(NONCE, 2, 2, us(11.0)), 5, 11.0)
    assert device.target == (0, 0)
    tell(device, SetPoint(NONCE, 3, 3, us(11.1)), 200, 11.1)
    assert device.target == (3, 3)


@pytest.mark.parametrize(
    ("age", "applied"), [(0.0, True), (0.249, True), (0.251, False), (60.0, False), (-0.019, True), (-0.021, False)]
)
@pytest.mark.parametrize("wraps", [0.0, 2**32 / 1e6])
def test_a_set_point_that_comes_late_does_not_move_the_wheels(age: float, applied: bool, wraps: float) -> None:
    device = greeted()
    now = wraps + 100.0
    tell(device, SetPoint(NONCE, 100, 100, us(100.0 - age) % 2**32), 2, now)
    assert device.target == ((100, 100) if applied else (0, 0))


def test_rest_is_never_late() -> None:
    device = greeted()
    tell(device, SetPoint(NONCE, 100, 100, us(10.0)), 2, 10.0)
    tell(device, SetPoint(NONCE, 0, 0, us(9.0)), 3, 10.1)
    assert device.target == (0, 0)


def test_set_point_and_release_of_another_life_change_nothing() -> None:
    device = greeted()
    tell(device, SetPoint(NONCE - 1, 100, 100, us(0.0)), 2, 0.0)
    assert device.target == (0, 0)
    tell(device, Stop(), 3, 0.0)
    tell(device, Release(NONCE - 1), 4, 0.0)
    assert device.emergency_stopped
    assert said(device) == [Ack(Stop.CODE, 3)]


def test_stop_works_ungreeted_and_each_repetition_is_acknowledged() -> None:
    device = OmnibotDevice(1000.0, NONCE)
    tell(device, Stop(), 3, 0.0)
    tell(device, Stop(), 3, 0.1)
    assert device.emergency_stopped
    assert said(device) == [Ack(Stop.CODE, 3)] * 2


def test_telemetry_at_50_hz_and_no_burst_after_a_pause() -> None:
    device, count = greeted(), 0
    for millisecond in range(0, 1000, 5):
        device.poll(millisecond / 1000.0 + 1e-6)
        count += len(said(device))
    assert count in (49, 50, 51)
    device.poll(5.0)
    device.poll(5.001)
    device.poll(5.002)
    assert len(said(device)) == 1


def test_telemetry_tells_the_state() -> None:
    device = greeted(now=100.0)
    device.set_state(2**31 + 5, -3, wheel_drop=True, battery_mv=9999)
    tell(device, SetPoint(NONCE, 1, 1, us(0.5)), 77, 100.5)
    device.receive(b"\x02\x03\x03\x48\x5c\x00" + b"\x01" * 90 + b"\0", 100.5)
    telemetry = report(device, 100.6)
    assert (telemetry.left_ticks, telemetry.right_ticks) == (-(2**31) + 5, -3)
    assert telemetry.status == Status.WHEEL_DROP | Status.MOVING_ALLOWED
    assert (telemetry.boot_nonce, telemetry.setpoint_seq, telemetry.battery_mv) == (NONCE, 77, 9999)
    assert (telemetry.crc_errors, telemetry.overruns) == (1, 1)
    assert telemetry.mcu_us == pytest.approx(600_000, abs=1)


def test_reset_forgets_all_but_the_wheels() -> None:
    device = greeted()
    device.set_state(500, 600)
    tell(device, SetPoint(NONCE, 9, 9, us(0.1)), 2, 0.1)
    tell(device, Stop(), 3, 0.1)
    device.reset(NONCE + 1)
    assert device.target == (0, 0) and not device.emergency_stopped
    assert device.data_to_send() == b""
    tell(device, Hello(), 1, 1.0)
    device.set_state(510, 590)
    telemetry = report(device, 1.1)
    assert (telemetry.left_ticks, telemetry.right_ticks) == (10, -10)
    assert telemetry.boot_nonce == NONCE + 1


def test_answers_waiting_are_bounded() -> None:
    device = OmnibotDevice(1000.0, NONCE)
    for seq in range(100):
        tell(device, Stop(), seq, 0.0)
    assert len(said(device)) == 8


def test_board_name_too_long_is_our_bug() -> None:
    with pytest.raises(BridgeError, match="16 bytes"):
        OmnibotDevice(1000.0, NONCE, board="a-very-long-board-name")


@pytest.mark.parametrize(("metres", "millimetres"), [(0.355, 355), (float("inf"), 65535), (80.0, 65535), (0.0, 0)])
def test_range_goes_out_before_the_telemetry_it_belongs_to(metres: float, millimetres: int) -> None:
    device = greeted()
    device.set_state(1, 2, range_ahead=metres)
    device.poll(0.02)
    first, second = said(device)
    assert first == Range(NONCE, millimetres)
    assert isinstance(second, Telemetry)


def test_without_a_range_sensor_no_range_is_sent() -> None:
    device = greeted()
    device.set_state(1, 2)
    device.poll(0.02)
    assert [type(message) for message in said(device)] == [Telemetry]
