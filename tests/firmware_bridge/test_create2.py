"""The driver `create2` alone, fed by hand; frames are packed here from the specification's table."""

from __future__ import annotations

import math
import struct

import pytest

from firmware_bridge.bases import make_driver
from firmware_bridge.bases.create2 import Create2Host
from firmware_bridge.bases.create2_stream import FLUSH, FRAME, REQUEST, BootText, Report, StreamDecoder
from firmware_bridge.bases.create2_wheel import STEP, Wheel
from firmware_bridge.events import BridgeError, Connected, Disconnected, Event, Telemetry

GREETING = [128, 148]  # what must be among the first bytes: start, then the request for the stream
PASSIVE, SAFE, FULL = 1, 2, 3


def frame(mode: int = PASSIVE, left: int = 0, right: int = 0, **values: int) -> bytes:
    """A frame of the packets that the driver asks for; `values` by packet number, as p7=3."""
    order = REQUEST[2:]
    wide = {22: "H", 41: "h", 42: "h", 43: "h", 44: "h"}
    given = {35: mode, 43: left, 44: right, 22: 15608, **{int(name[1:]): value for name, value in values.items()}}
    data = b"".join(struct.pack(f">B{wide.get(n, 'B')}", n, given.get(n, 0)) for n in order)
    whole = bytes((19, len(data))) + data
    return whole + bytes(((256 - sum(whole)) % 256,))


def connected(mode: int = SAFE) -> Create2Host:
    """At 1.0 s, in that mode, told once to stand."""
    host = Create2Host()
    host.poll(0.9)
    host.data_to_send()
    host.receive(frame(), 0.95)
    host.data_to_send()
    host.receive(frame(mode), 1.0)
    host.drive(0.0, 0.0, 1.0)
    host.data_to_send()
    return host


def speeds(data: bytes) -> tuple[int, int]:
    """(left, right) mm/s of the only set-point among the bytes."""
    at = data.index(bytes((0, 0, 0, 0, 145)))
    right, left = struct.unpack(">hh", data[at + 5 : at + 9])
    return left, right


def of(kind: type[Event], events: list[Event]) -> list[Event]:
    return [event for event in events if isinstance(event, kind)]


# The stream


def test_a_frame_has_the_length_and_sum_that_the_specification_gives() -> None:
    assert len(frame()) == FRAME <= 172
    assert sum(frame(SAFE, 17, -3, p7=3)) % 256 == 0


def test_a_frame_is_understood_field_by_field() -> None:
    values = frame(FULL, -7, 32767, p7=0b0110, p11=1, p14=0b01000, p21=2, p34=1, p41=-29, p42=57)
    (report,) = StreamDecoder().feed(values)
    assert isinstance(report, Report)
    assert (report.bumper_left, report.bumper_right, report.wheel_drop, report.cliff) == (True, False, True, True)
    assert (report.overcurrent_left, report.overcurrent_right) == (False, True)
    assert (report.charging, report.plugged_in, report.millivolts, report.mode) == (True, True, 15608, FULL)
    assert report.requested == (57, -29)
    assert (report.encoders[0] % 65536, report.encoders[1] % 65536) == (65529, 32767)


@pytest.mark.parametrize("before", [b"", b"\x13", b"\x13\x24", frame()[:-1], bytes(range(256)), b"\x13" * 200])
@pytest.mark.parametrize("piece", [1, 7, 1000])
def test_the_next_whole_frame_is_found_behind_anything_in_pieces_of_any_size(before: bytes, piece: int) -> None:
    decoder, line = StreamDecoder(), before + frame(left=5)
    found = [report for k in range(0, len(line), piece) for report in decoder.feed(line[k : k + piece])]
    assert [report.encoders[0] for report in found if isinstance(report, Report)] == [5]


def test_no_byte_of_a_frame_can_be_wrong() -> None:
    good = frame(SAFE, 100, 200)
    for at in range(len(good)):
        bad = bytearray(good)
        bad[at] ^= 0x10
        assert StreamDecoder().feed(bytes(bad) + bytes(FRAME)) == []


@pytest.mark.parametrize("values", [{"p7": 16}, {"p9": 2}, {"p21": 6}, {"p34": 4}, {"p35": 4}])
def test_a_value_that_does_not_exist_is_noise_even_with_the_right_sum(values: dict[str, int]) -> None:
    assert StreamDecoder().feed(frame(**values)) == []


def test_the_stream_of_another_host_s_packets_is_none_of_ours() -> None:
    other = bytearray(frame())
    other[2], other[-1] = 8, (other[-1] - 1) % 256  # packet 8 where we ask for 7
    assert sum(other) % 256 == 0
    assert StreamDecoder().feed(bytes(other)) == []


def test_text_of_a_boot_is_noticed_once_and_hides_no_frame() -> None:
    text = b"bl-start\r\n2007-05-14-1715-L\r\nRoomba by iRobot!\r\nbattery-current-zero 257\r\n"
    found = StreamDecoder().feed(frame() + text + frame())
    assert [type(thing) for thing in found] == [Report, BootText, Report]
    assert StreamDecoder().feed(frame() * 50) == StreamDecoder().feed(frame()) * 50


# Shaking hands


def test_greets_behind_zeros_that_complete_any_command_and_again_until_answered() -> None:
    host = Create2Host()
    assert host.poll(0.0) == []
    data = host.data_to_send()
    assert data.startswith(FLUSH) and [byte for byte in data if byte in GREETING] == GREETING
    assert speeds(data) == (0, 0)
    host.poll(0.3)
    assert host.data_to_send() == b""
    host.poll(0.51)
    assert host.data_to_send() == data


def test_a_stream_that_an_earlier_host_asked_for_is_no_answer() -> None:
    host = Create2Host()
    assert host.receive(frame(), 0.0) == []
    host.poll(0.1)
    host.data_to_send()
    assert host.receive(frame(SAFE), 0.11) == []  # older than the greeting, which leads to Passive
    connection, telemetry = host.receive(frame(PASSIVE, 300, 400), 0.12)
    assert isinstance(connection, Connected) and isinstance(telemetry, Telemetry)
    assert (connection.info.driver, connection.info.watchdog, connection.info.ticks_per_rev) == ("create2", 0.0, 508.8)
    assert (telemetry.left_ticks, telemetry.right_ticks, telemetry.battery) == (0, 0, 15.608)
    assert host.data_to_send() == bytes((131,))


def test_silence_and_boot_text_end_the_connection_and_the_greeting_comes_at_once() -> None:
    for end in (lambda host: host.poll(1.31), lambda host: host.receive(b"A" * 40, 1.2)):
        host = connected()
        (event,) = end(host)
        assert isinstance(event, Disconnected)
        host.poll(1.32)
        assert 148 in host.data_to_send()
        assert end(host) == []
        host.drive(5.0, 5.0, 1.33)
        assert host.data_to_send() == b""


def test_a_base_that_says_it_is_off_is_greeted_again() -> None:
    host = connected()
    (event,) = host.receive(frame(0), 1.1)
    assert isinstance(event, Disconnected) and event.reason == "switched off"
    host.poll(1.11)
    assert 148 in host.data_to_send()


def test_encoders_that_begin_anew_are_a_restart_but_one_odd_count_is_noise() -> None:
    host = connected()
    assert host.receive(frame(SAFE, 20000, 0), 1.015) == []
    assert len(of(Telemetry, host.receive(frame(SAFE, 8, 8), 1.03))) == 1
    assert host.receive(frame(SAFE, 20000, 0), 1.045) == []
    (event,) = host.receive(frame(SAFE, 20000, 0), 1.06)
    assert isinstance(event, Disconnected) and "encoders jumped" in event.reason


# Driving


def test_speeds_are_millimetres_a_second_in_the_steps_of_the_base() -> None:
    host = connected()
    host.drive(57.0 / 36.0, -85.5 / 36.0, 1.1)
    assert speeds(host.data_to_send()) == (57, -86)
    assert host.data_to_send() == b""


def test_what_a_step_leaves_over_is_made_up_for_later() -> None:
    host, total = connected(), 0
    for k in range(200):
        host.receive(frame(SAFE), 1.0 + 0.1 * k)
        host.drive(3.0 / 36.0, 3.0 / 36.0, 1.0 + 0.1 * k)
        total += speeds(host.data_to_send())[0]
    assert total == pytest.approx(200 * 3.0, abs=STEP)


def test_beyond_the_top_speed_both_wheels_are_reduced_alike() -> None:
    host = connected()
    host.drive(1000.0 / 36.0, 500.0 / 36.0, 1.1)
    left, right = speeds(host.data_to_send())
    assert left == 500 and abs(right - 250) <= STEP / 2


def test_speeds_that_are_none_are_our_bug() -> None:
    with pytest.raises(BridgeError, match="not finite"):
        connected().drive(math.nan, 0.0, 1.1)


def test_a_set_point_in_passive_mode_asks_for_safe_mode_and_is_itself_forgotten() -> None:
    host = connected(PASSIVE)
    host.poll(1.25)
    host.drive(5.0, 5.0, 1.25)
    assert host.data_to_send() == bytes((131,))
    host.receive(frame(SAFE), 1.26)
    assert host.data_to_send() == b""


@pytest.mark.parametrize("values", [{"p7": 4}, {"p7": 8}, {"p34": 1}], ids=["left", "right", "plugged in"])
def test_a_base_that_would_fall_back_at_once_is_not_asked_for_safe_mode(values: dict[str, int]) -> None:
    host = connected(PASSIVE)
    for k in range(100):
        host.receive(frame(PASSIVE, **values), 1.2 + 0.015 * k)
        host.drive(5.0, 5.0, 1.2 + 0.015 * k)
        assert host.data_to_send() == b""
    host.receive(frame(PASSIVE), 2.8)
    assert host.data_to_send() == bytes((131,))


def test_an_emergency_stop_holds_until_released_and_is_repeated_until_the_base_stands() -> None:
    host = connected()
    host.drive(5.0, 5.0, 1.1)
    host.data_to_send()
    host.emergency_stop(1.1)
    assert speeds(host.data_to_send()) == (0, 0)
    (telemetry,) = of(Telemetry, host.receive(frame(SAFE, p41=171, p42=171), 1.12))
    assert isinstance(telemetry, Telemetry) and telemetry.emergency_stop
    assert speeds(host.data_to_send()) == (0, 0)
    host.receive(frame(SAFE, p41=171, p42=171), 1.13)
    assert host.data_to_send() == b""  # not at every frame
    host.receive(frame(SAFE, p41=171, p42=171), 1.18)
    assert speeds(host.data_to_send()) == (0, 0)
    host.receive(frame(SAFE), 1.25)
    host.drive(5.0, 5.0, 1.25)
    assert host.data_to_send() == b""
    host.release(1.3)
    host.drive(5.0, 5.0, 1.3)
    assert speeds(host.data_to_send())[0] > 0


def test_last_words_stop_in_any_state_of_the_parser() -> None:
    words = Create2Host.last_words
    assert words is not None
    assert len(FLUSH) >= 1 + 52  # a list of all packets that lacks all its bytes; a song has 34
    assert words.stand[len(FLUSH) :] == bytes((0, 0, 0, 0, 145, 0, 0, 0, 0))
    assert words.leave == words.stand + bytes((128,))


# Wheels


def test_counts_unwrap_at_16_bits() -> None:
    wheel, counted = Wheel(), []
    for k, raw in enumerate((65530, 5, 100, 65400)):
        counted.append(wheel.count(raw, 0, 10.0 * k))
    assert counted == [0, 11, 106, -130]


def test_counts_of_a_rolling_wheel_have_the_direction_it_was_asked_for() -> None:
    wheel = Wheel()
    wheel.count(0, 0, 0.0)
    assert wheel.ask(-200.0, 0.0) == -200
    assert wheel.count(65536 - 10, -200, 0.02) == -10
    assert wheel.ask(0.0, 0.03) == 0
    assert wheel.count(65536 - 5, 0, 0.045) == -15  # the base counts up again, the wheel still rolls back
    assert wheel.ask(200.0, 0.05) == 0  # not yet
    assert wheel.count(65536 - 5, 0, 0.14) == -15
    assert wheel.ask(200.0, 0.14) == 200
    assert wheel.count(0, 200, 0.2) == -10


@pytest.mark.parametrize("speed", [200, -200])
def test_a_wrong_count_is_taken_back_by_the_next(speed: int) -> None:
    wheel, forward = Wheel(), speed // 200
    wheel.ask(speed, 0.0)
    for k, raw in enumerate((0, 7, 14 + 64, 21)):
        wheel.count(forward * raw % 65536, speed, 0.015 * k)
    assert wheel.ticks == forward * 21


def test_a_wheel_pushed_by_hand_counts_as_the_base_counts() -> None:
    wheel = Wheel()
    assert [wheel.count(raw, 0, float(raw)) for raw in (0, 5, 3)] == [0, 5, 3]


def test_the_name_makes_the_driver() -> None:
    assert isinstance(make_driver("create2"), Create2Host)
