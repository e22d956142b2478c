"""The ros_arduino_bridge driver alone, fed by hand."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_bridge.bases.arduino_bridge import MAX_LINE, ArduinoBridgeHost, Dither, LineReader
from firmware_bridge.bases.arduino_odometer import Odometer
from firmware_bridge.events import BridgeError, Connected, Disconnected, Event, Telemetry

TICKS = 1440.0
FASTEST = 10.0  # rad/s
TICK_A_FRAME = 2.0 * math.pi / TICKS / 0.033  # rad/s


def host() -> ArduinoBridgeHost:
    return ArduinoBridgeHost(TICKS, FASTEST)


def connected(counts: bytes = b"0 0") -> ArduinoBridgeHost:
    """Hands shaken at 0 s; asks again from 0.04 s on."""
    made = host()
    made.poll(0.0)
    made.receive(b"Invalid Command\r\nOK\r\n57600\r\n", 0.0)
    made.poll(0.0)
    made.receive(counts + b"\r\n", 0.0)
    made.data_to_send()
    return made


def ask(made: ArduinoBridgeHost, counts: bytes, now: float) -> list[Event]:
    """What happens when it asks at `now`, and is answered 5 ms later."""
    events = made.poll(now)
    return events + made.receive(counts + b"\r\n", now + 0.005)


def links(events: list[Event]) -> list[Event]:
    return [event for event in events if not isinstance(event, Telemetry)]


def test_handshake() -> None:
    made = host()
    assert made.poll(5.0) == []
    assert made.data_to_send() == b"\rm 0 0\rb\r"
    assert made.receive(b"Invalid Command\r\nOK\r\n57600\r\n", 5.01) == []
    made.poll(5.02)
    assert made.data_to_send() == b"e\r"
    event, telemetry = made.receive(b"-70 2000000000\r\n", 5.03)
    assert isinstance(event, Connected)
    assert (event.info.driver, event.info.watchdog, event.info.ticks_per_rev) == ("arduino_bridge", 2.0, TICKS)
    assert telemetry == Telemetry(stamp=5.03, left_ticks=0, right_ticks=0)


def test_greets_four_times_a_second_while_the_board_boots_and_says_nothing_else() -> None:
    made = host()
    sent = b""
    for tick in range(100):  # 2 s
        made.poll(tick * 0.02)
        made.drive(1.0, 1.0, tick * 0.02)
        sent += made.data_to_send()
    assert 7 <= sent.count(b"b\r") <= 9
    assert sent == b"\rm 0 0\rb\r" * sent.count(b"b\r")


@pytest.mark.parametrize("stale", [b"4 5", b"OK", b"12 57600", b"576", b"Invalid Command", b"\xff\xfe", b"57600 "])
def test_only_a_baud_rate_answers_the_greeting(stale: bytes) -> None:
    made = host()
    made.poll(0.0)
    made.receive(stale + b"\r\n", 0.01)
    made.data_to_send()
    made.poll(0.1)
    assert made.data_to_send() == b""


def test_a_version_that_prints_a_space_before_its_baud_rate() -> None:
    made = host()
    made.poll(0.0)
    made.receive(b" 57600\r\n", 0.01)
    made.data_to_send()
    made.poll(0.02)
    assert made.data_to_send() == b"e\r"


def test_counts_that_nobody_asked_for_do_not_connect() -> None:
    made = host()
    made.poll(0.0)
    assert made.receive(b"57600\r\n12 12\r\n", 0.01) == []


def test_asks_at_25_hz_one_request_at_a_time() -> None:
    made = connected()
    sent, now = b"", 0.0
    for _ in range(100):  # 1 s of a poll every 10 ms, answered at once
        now += 0.01
        made.poll(now)
        data = made.data_to_send()
        if data:
            made.receive(b"0 0\r\n", now)
        sent += data
    assert sent in (b"e\r" * 24, b"e\r" * 25)


def test_a_missing_reply_is_asked_for_again_behind_an_empty_line() -> None:
    made = connected()
    made.poll(0.04)
    assert made.data_to_send() == b"e\r"
    made.poll(0.09)
    assert made.data_to_send() == b""
    made.drive(TICK_A_FRAME, 0.0, 0.09)
    assert made.data_to_send() == b"m 1 0\r"
    made.poll(0.11)
    assert made.data_to_send() == b"\re\r"
    made.drive(TICK_A_FRAME, 0.0, 0.12)
    assert made.data_to_send() == b"\rm 1 0\r"
    made.receive(b"0 0\r\n", 0.13)
    made.poll(0.2)
    assert made.data_to_send() == b"e\r"


def test_silence() -> None:
    made = connected()
    assert [made.poll(0.02 * k) for k in range(26)] == [[]] * 26
    assert made.poll(0.51) == [Disconnected("silent")]
    assert made.data_to_send().startswith(b"\rm 0 0\rb\r")
    made.drive(1.0, 1.0, 0.52)
    assert made.data_to_send() == b""


def test_a_set_point_that_waits_is_dropped_with_the_connection() -> None:
    made = connected()
    made.drive(TICK_A_FRAME, TICK_A_FRAME, 0.5)
    assert made.poll(0.51) == [Disconnected("silent")]
    assert made.data_to_send() == b"\rm 0 0\rb\r"


def test_baud_rates_do_not_stand_for_counts() -> None:
    made = connected()
    events: list[Event] = []
    for k in range(1, 27):
        events += made.poll(0.02 * k) + made.receive(b"57600\r\n", 0.02 * k)
    assert events == [Disconnected("silent")]


def test_silence_between_greeting_and_counts_begins_anew() -> None:
    made = host()
    made.poll(0.0)
    made.receive(b"57600\r\n", 0.01)
    made.poll(0.02)
    made.data_to_send()
    assert made.poll(0.52) == []
    assert b"b\r" in made.data_to_send()


# Set-points


def test_speeds_are_whole_ticks_a_frame() -> None:
    made = connected()
    made.drive(12.0 * TICK_A_FRAME, -3.0 * TICK_A_FRAME, 0.01)
    assert made.data_to_send() == b"m 12 -3\r"


def test_the_newest_set_point_wins_and_none_is_repeated() -> None:
    made = connected()
    for ticks in (1.0, 2.0, 3.0):
        made.drive(ticks * TICK_A_FRAME, ticks * TICK_A_FRAME, 0.01)
    assert made.data_to_send() == b"m 3 3\r"
    made.poll(0.02)
    assert made.data_to_send() == b""


def test_a_stop_ends_whatever_half_line_the_board_holds_and_waits_for_nothing() -> None:
    made = connected()
    made.drive(TICK_A_FRAME, TICK_A_FRAME, 0.01)
    made.data_to_send()
    made.poll(0.04)
    made.data_to_send()  # a request is under way
    made.drive(0.0, 0.0, 0.041)
    assert made.data_to_send() == b"\rm 0 0\r"
    made.drive(0.0, 0.0, 0.05)
    assert made.data_to_send() == b"m 0 0\r"


@settings(derandomize=True, max_examples=50)
@given(st.floats(-40.0, 40.0), st.integers(20, 400))
def test_rounding_errors_never_add_up(wanted: float, frames: int) -> None:
    dither = Dither()
    sent = [dither.round(wanted) for _ in range(frames)]
    assert abs(sum(sent) - frames * wanted) <= 0.5 + 1e-6
    assert max(sent) - min(sent) <= 1
    assert dither.round(0.0) == 0
    assert dither.round(0.4) == 0  # nothing is left over from before the stop


def test_speeds_that_are_no_speeds_and_wheels_that_are_no_wheels_are_our_bug() -> None:
    made = connected()
    with pytest.raises(BridgeError, match="not finite"):
        made.drive(math.nan, 0.0, 0.0)
    with pytest.raises(BridgeError, match="beyond 32767"):
        made.drive(0.0, -33000.0 * TICK_A_FRAME, 0.0)
    for ticks, speed in ((0.0, 1.0), (math.inf, 1.0), (100.0, -1.0), (100.0, math.nan)):
        with pytest.raises(BridgeError, match="must be a positive number"):
            ArduinoBridgeHost(ticks, speed)


def test_emergency_stop_overtakes_a_set_point_that_waits() -> None:
    made = connected()
    made.drive(TICK_A_FRAME, TICK_A_FRAME, 0.01)
    made.emergency_stop(0.01)
    assert made.data_to_send() == b"\rm 0 0\r"


def test_emergency_stop_works_before_hands_are_shaken_and_latches_until_release() -> None:
    made = host()
    made.emergency_stop(0.0)
    assert made.data_to_send() == b"\rm 0 0\r"
    made.poll(0.0)
    made.receive(b"57600\r\n", 0.0)
    made.poll(0.0)
    assert b"m 0 0\r" in made.data_to_send()
    *_, telemetry = made.receive(b"0 0\r\n", 0.0)
    assert isinstance(telemetry, Telemetry) and telemetry.emergency_stop
    made.drive(1.0, 1.0, 0.01)
    made.poll(0.04)
    assert made.data_to_send() == b"\rm 0 0\re\r"  # told again: the board has no latch
    made.release(0.05)
    (telemetry,) = made.receive(b"0 0\r\n", 0.05)
    assert isinstance(telemetry, Telemetry) and not telemetry.emergency_stop
    assert made.data_to_send() == b""  # no set-point from before the release
    made.drive(TICK_A_FRAME, TICK_A_FRAME, 0.06)
    assert made.data_to_send() == b"m 1 1\r"


# Encoders. At 10 rad/s a wheel makes 2292 ticks a second; twice that is believed, 4584.


def test_counts_wrap_at_32_bits() -> None:
    made = connected(b"2147483640 -2147483640")
    (telemetry,) = ask(made, b"-2147483646 2147483646", 0.04)
    assert isinstance(telemetry, Telemetry)
    assert (telemetry.left_ticks, telemetry.right_ticks) == (10, -10)


def test_counts_beyond_32_bits_are_noise() -> None:
    made = connected(b"2147483640 0")
    assert ask(made, b"2147483648 0", 0.04) == []


def test_a_jump_no_wheel_can_make_is_rejected_and_the_next_reading_is_right() -> None:
    made = connected()
    assert ask(made, b"100 1000", 0.04) == []  # 0.045 s: 206 ticks at the most
    (telemetry,) = ask(made, b"150 160", 0.08)
    assert isinstance(telemetry, Telemetry)
    assert (telemetry.left_ticks, telemetry.right_ticks) == (150, 160)


def test_the_bound_is_the_speed_times_the_time_since() -> None:
    for jump, events in ((207, 1), (208, 0), (-207, 1), (-208, 0)):  # 4584 x 0.045 is 206.3, and one tick
        made = connected()
        assert len(ask(made, b"%d 0" % jump, 0.04)) == events


def test_the_board_may_have_read_as_early_as_it_was_asked_the_first_time() -> None:
    made = connected()
    ask(made, b"0 0", 0.04)
    made.poll(0.1)  # asked; the reply is late
    made.poll(0.17)  # asked again
    made.receive(b"100 100\r\n", 0.171)
    (telemetry,) = made.receive(b"400 400\r\n", 0.172)  # both replies at once, 0.07 s apart on the board
    assert isinstance(telemetry, Telemetry) and telemetry.left_ticks == 400


def test_restart_is_known_from_three_readings_that_agree() -> None:
    made = connected(b"50000 60000")
    assert ask(made, b"0 0", 0.04) == []
    assert ask(made, b"3 3", 0.08) == []
    assert ask(made, b"5 5", 0.12) == [Disconnected("base restarted")]
    made.data_to_send()
    made.poll(0.13)
    assert made.data_to_send() == b"\rm 0 0\rb\r"


def test_noise_is_no_restart_but_silence() -> None:
    made = connected()
    events: list[Event] = []
    for k in range(1, 14):
        events += ask(made, b"%d 70000" % (k * 100_000), 0.04 * k)
    assert events == [Disconnected("its encoder counts jump")]


def test_words_of_a_booting_board_need_but_one_jump_to_prove_a_restart() -> None:
    made = connected(b"50000 60000")
    made.receive(b"ROS Arduino Bridge ready\r\n", 0.03)
    assert ask(made, b"0 0", 0.04) == [Disconnected("base restarted")]


@pytest.mark.parametrize("words", [b"ready for use", b"Invalid Commanf", b"Inralid Command", b"OJ"])
def test_words_alone_prove_nothing(words: bytes) -> None:
    made = connected(b"500 600")
    made.receive(words + b"\r\n", 0.03)
    assert len(ask(made, b"505 606", 0.04)) == 1
    assert ask(made, b"90000 606", 0.08) == []
    assert len(ask(made, b"515 616", 0.12)) == 1


@pytest.mark.parametrize("words", [b"Invalid Commanf", b"Inralid Command", b"OJ"])
def test_a_broken_refusal_is_no_boot_message(words: bytes) -> None:
    made = connected(b"500 600")
    made.receive(words + b"\r\n", 0.03)
    assert ask(made, b"90000 606", 0.04) == []


def test_odometer_keeps_the_sum_of_what_it_believed() -> None:
    odometer = Odometer((0, 0), 0.0, fastest=100.0)
    assert odometer.take((10, -10), 0.1, 0.1)
    assert not odometer.take((300, 0), 0.2, 0.2)
    assert odometer.disturbed
    assert odometer.take((20, -20), 0.3, 0.3)
    assert odometer.total == (20, -20)


# Lines


COUNTS = st.integers(-(2**31), 2**31 - 1)
REPLIES = st.lists(st.tuples(COUNTS, COUNTS).map(lambda pair: b"%d %d" % pair), max_size=6)


@settings(derandomize=True, max_examples=50)
@given(REPLIES, st.lists(st.integers(1, 40), min_size=1, max_size=20))
def test_lines_however_cut(sent: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(line + b"\r\n" for line in sent)
    reader, received, at = LineReader(), [], 0
    while at < len(stream):
        size = cuts[at % len(cuts)]
        received += reader.feed(stream[at : at + size])
        at += size
    assert received == sent


@settings(derandomize=True, max_examples=50)
@given(st.lists(st.binary(max_size=100), max_size=8))
def test_any_bytes_then_the_next_line_is_found_in_bounded_memory(noise: list[bytes]) -> None:
    reader = LineReader()
    for piece in noise:
        reader.feed(piece)
        assert len(reader._partial) <= MAX_LINE + 1
    reader.feed(b"\r\n")
    assert reader.feed(b"1 2\r\n") == [b"1 2"]


@pytest.mark.parametrize("stream", [b"12 34\n", b"12 3\n4\r", b"1" * 33 + b"\r\n", b"12 34\r"])
def test_half_lines_are_no_replies(stream: bytes) -> None:
    assert LineReader().feed(stream) == []


@pytest.mark.parametrize("line", [b"12", b"12 34 56", b"12  34", b"1 2-", b"+1 2", b"1.5 2", b"12 34 ", b"--1 2"])
def test_what_is_not_two_whole_numbers_is_no_reading(line: bytes) -> None:
    assert ask(connected(), line, 0.04) == []
