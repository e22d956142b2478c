"""The emulated ros_arduino_bridge board, checked against what is known of the firmware; no driver takes part."""

from __future__ import annotations

import pytest

from tools.sim.emulators.arduino_bridge import ArduinoBridgeBoard

FRAME = 0.033


def booted(**options: object) -> ArduinoBridgeBoard:
    """Ready at 0 s."""
    board = ArduinoBridgeBoard(boot_time=0.0, **options)  # type: ignore[arg-type]
    board.poll(0.0)
    return board


def answer(board: ArduinoBridgeBoard, request: bytes, now: float = 0.0) -> bytes:
    board.receive(request, now)
    return board.data_to_send()


def test_deaf_while_it_boots() -> None:
    board = ArduinoBridgeBoard(boot_time=1.5, greeting=b"hello")
    assert answer(board, b"b\r", 10.0) == b""
    assert answer(board, b"b\r", 11.4) == b""
    board.poll(11.5)
    assert board.data_to_send() == b"hello\r\n"
    assert answer(board, b"b\r", 11.6) == b"57600\r\n"


@pytest.mark.parametrize(
    ("request_line", "reply"),
    [
        (b"b\r", b"57600\r\n"),
        (b"e\r", b"17 -4\r\n"),
        (b"m 3 4\r", b"OK\r\n"),
        (b"u 20:12:0:50\r", b"OK\r\n"),
        (b"r\r", b"OK\r\n"),
        (b"\r", b"Invalid Command\r\n"),
        (b"z\r", b"Invalid Command\r\n"),
        (b"\ne\r", b"17 -4\r\n"),  # the last letter before the first space is the command
        (b"ze\r", b"17 -4\r\n"),
        (b"e", b""),
    ],
)
def test_replies(request_line: bytes, reply: bytes) -> None:
    board = booted()
    board.set_state(17, -4)
    assert answer(board, request_line) == reply


def test_bytes_one_by_one() -> None:
    board = booted()
    said = b"".join(answer(board, bytes((byte,))) for byte in b"m 5 -6\r")
    assert said == b"OK\r\n"
    board.poll(FRAME)
    assert board.target == pytest.approx((5 / FRAME, -6 / FRAME))


def test_speeds_are_taken_over_at_a_frame_and_a_stop_at_once() -> None:
    board = booted()
    board.poll(0.034)
    answer(board, b"m 10 10\r", 0.035)
    assert board.target == (0.0, 0.0)
    board.poll(0.065)
    assert board.target == (0.0, 0.0)
    board.poll(0.0661)
    assert board.target == pytest.approx((303.0, 303.0), abs=0.1)
    answer(board, b"m 0 0\r", 0.067)
    assert board.target == (0.0, 0.0)


def test_stops_2_s_after_the_last_speed_and_asking_does_not_count() -> None:
    board = booted()
    answer(board, b"m 10 10\r", 1.0)
    answer(board, b"m 10 10\r", 1.5)
    for step in range(1, 20):
        answer(board, b"e\r", 1.5 + 0.1 * step)
        assert board.target != (0.0, 0.0)
    board.poll(3.499)
    assert board.target != (0.0, 0.0)
    board.poll(3.501)
    assert board.target == (0.0, 0.0)
    board.poll(4.0)
    assert board.target == (0.0, 0.0)


def test_a_lost_end_of_line_joins_two_requests() -> None:
    board = booted()
    assert answer(board, b"m 10 10m 0 0\r") == b"OK\r\n"
    board.poll(FRAME)
    assert board.target == pytest.approx((10 / FRAME, 10 / FRAME))  # the stop was read as `10m00`


@pytest.mark.parametrize(
    ("text", "ticks"), [(b"12x4", 12), (b"x", 0), (b"", 0), (b"-7", -7), (b"+7", 7), (b"40000", -25536), (b"-", 0)]
)
def test_numbers_are_read_as_c_does(text: bytes, ticks: int) -> None:
    board = booted()
    answer(board, b"m " + text + b" 1\r")
    board.poll(FRAME)
    assert board.target[0] == pytest.approx(ticks / FRAME)


def test_counts_wrap_and_begin_anew_when_asked_or_reset() -> None:
    board = booted()
    board.set_state(2**31 + 5, -(2**31) - 1)
    assert answer(board, b"e\r") == b"%d %d\r\n" % (5 - 2**31, 2**31 - 1)
    answer(board, b"r\r")
    assert answer(board, b"e\r") == b"0 0\r\n"
    board.set_state(2**31 + 6, -(2**31))
    assert answer(board, b"e\r") == b"1 1\r\n"
    board.reset()
    board.poll(1.0)
    assert answer(board, b"e\r", 1.0) == b"0 0\r\n"


def test_a_reset_stops_the_wheels_and_forgets_half_a_request() -> None:
    board = booted()
    answer(board, b"m 10 10\r")
    board.poll(FRAME)
    board.receive(b"m 9 ", 0.05)
    board.reset()
    assert board.target == (0.0, 0.0)
    board.poll(0.1)
    assert answer(board, b"e\r", 0.1) == b"0 0\r\n"
    board.poll(0.2)
    assert board.target == (0.0, 0.0)


def test_too_long_an_argument_is_counted() -> None:
    board = booted()
    board.receive(b"m " + b"1" * 31 + b" 1\r", 0.0)
    assert board.overflows == 0
    board.receive(b"m " + b"1" * 32 + b" 1\r", 0.0)
    assert board.overflows == 1


def test_replies_that_nobody_fetches_are_bounded() -> None:
    board = booted()
    board.receive(b"\r" * 10_000, 0.0)
    said = board.data_to_send()
    assert 400 < len(said) <= 512
    assert said == b"Invalid Command\r\n" * (len(said) // 17)
