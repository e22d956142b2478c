"""Host role of the ros_arduino_bridge text protocol: the driver `arduino_bridge`.

Requests are a letter, arguments and CR; replies end with CRLF and tell by their form what they answer. Wheel speeds
are whole ticks per frame of 33 ms; what rounding leaves over goes into the next set-point, so that the average is
right. With 1440 ticks on a 70 mm wheel a tick a frame is 4.6 mm/s. The board stops by itself only 2 s after the last
set-point.
"""

from __future__ import annotations

import math
import re

from firmware_bridge.bases.arduino_odometer import Odometer
from firmware_bridge.events import BaseInfo, BridgeError, Connected, Disconnected, Event, LastWords, Telemetry

BAUDRATE = 57600
STOP = b"\rm 0 0\r"  # the empty line ends whatever half request the board holds; it costs an `Invalid Command`
GREETING = STOP + b"b\r"  # nothing moves while hands are shaken
FRAME = 0.033  # seconds, the board's control period
AUTO_STOP = 2.0  # seconds
GREETING_PERIOD = 0.25  # seconds; a board that boots for 1-2 s is found soon after, and its boot loader is not flooded
ASK_PERIOD = 0.04  # seconds; two readings a control tick, for 8 % of what the line carries
REPLY_LIMIT = 0.06  # seconds; a round trip takes 5 ms, 21 behind an FTDI adapter that gathers for 16 ms
SILENCE = 0.5  # seconds: eight requests unanswered
MAX_LINE = 32  # bytes; the longest reply, two counts of 32 bits, has 23
MAX_TICKS_A_FRAME = 2**15 - 1  # what the board's atoi holds
_READING = re.compile(rb"(-?\d{1,10}) (-?\d{1,10})")
_BAUD = re.compile(rb" ?[1-9]\d{3,6}")  # some versions print a space before it
_WORDS = re.compile(rb"(?!.*(Invalid|Command)).*[A-Za-z]{4}")  # of a board that says hello when it boots


class LineReader:
    """Finds replies in whatever comes from the line; what does not end with CRLF or is too long is no reply."""

    def __init__(self) -> None:
        self._partial = bytearray()  # never above MAX_LINE + 1: more can't become a reply
        self._overrun = False

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes in pieces of any size; returns the replies they complete, without their CRLF."""
        *ended, rest = bytes(data).split(b"\n")
        replies = []
        for piece in ended:
            self._extend(piece)
            if not self._overrun and self._partial.endswith(b"\r"):
                replies.append(bytes(self._partial[:-1]))
            self._partial.clear()
            self._overrun = False
        self._extend(rest)
        return replies

    def _extend(self, piece: bytes) -> None:
        if self._overrun or len(self._partial) + len(piece) > MAX_LINE + 1:
            self._overrun = True
            self._partial.clear()
        else:
            self._partial += piece


class Dither:
    """Whole ticks per frame whose average is the speed asked for (error diffusion); zero is zero at once."""

    def __init__(self) -> None:
        self._left_over = 0.0

    def round(self, wanted: float) -> int:
        if wanted == 0.0:
            self._left_over = 0.0
            return 0
        whole = round(wanted + self._left_over)
        self._left_over += wanted - whole
        return whole


class ArduinoBridgeHost:
    """Shakes hands, polls the encoders, turns set-points into ticks per frame; implements `events.Driver`.

    One greeting, one encoder request and one set-point at most wait for `data_to_send`. Set-points wait for no reply.
    The board cannot latch an emergency stop, so the latch is here.
    """

    last_words: LastWords | None = LastWords(stand=STOP, leave=STOP)

    def __init__(self, ticks_per_rev: float, max_wheel_speed: float) -> None:
        """Counts in a turn of a wheel; rad/s, the fastest a wheel may be asked for, which bounds what is believed."""
        for name, value in (("ticks_per_rev", ticks_per_rev), ("max_wheel_speed", max_wheel_speed)):
            if not 0.0 < value < math.inf:
                raise BridgeError(f"{name} must be a positive number, not {value}")
        self._ticks_per_rev = ticks_per_rev
        self._fastest = max_wheel_speed * ticks_per_rev / (2.0 * math.pi)  # ticks/s
        self._lines = LineReader()
        self._latched = False
        self._stop_due = False
        self._greeting_due = False
        self._forget(-math.inf)

    def _forget(self, now: float) -> None:
        """Whatever was meant for the board as it was."""
        self._greeted = False  # it has told its baud rate: what comes now are answers to us
        self._odometer: Odometer | None = None  # None: not connected
        self._greet_at = self._heard_at = self._ask_at = self._last_asked_at = now
        self._asked_at: float | None = None  # since when an answer is missing
        self._ask_due = self._doubtful = self._moving = False
        self._setpoint: tuple[float, float] | None = None  # ticks per frame
        self._dithers = (Dither(), Dither())

    def receive(self, data: bytes, now: float) -> list[Event]:
        """Take bytes from the board; lines that make no sense are dropped."""
        happened: list[Event] = []
        for line in self._lines.feed(data):
            if reading := _READING.fullmatch(line):
                happened += self._on_counts((int(reading[1]), int(reading[2])), now)
            elif not self._greeted and _BAUD.fullmatch(line):
                self._greeted, self._heard_at, self._ask_at = True, now, now
            elif self._odometer is not None and _WORDS.match(line):
                self._odometer.doubt()
        return happened

    def poll(self, now: float) -> list[Event]:
        """Greet or ask when it is time; notice silence."""
        happened: list[Event] = []
        if self._greeted and now - self._heard_at > SILENCE:
            jumping = self._odometer is not None and self._odometer.disturbed
            happened += self._disconnect("its encoder counts jump" if jumping else "silent", now)
        if not self._greeted and now >= self._greet_at:
            self._greeting_due = True
            self._greet_at = now + GREETING_PERIOD
        if self._greeted and now >= self._ask_at:
            self._ask(now)
        return happened

    def drive(self, left: float, right: float, now: float) -> None:
        """New set-points, rad/s; ignored while not connected, or stopped in an emergency."""
        if not (math.isfinite(left) and math.isfinite(right)):
            raise BridgeError(f"wheel speeds {left}, {right} rad/s are not finite")
        scale = self._ticks_per_rev / (2.0 * math.pi) * FRAME
        if max(abs(left), abs(right)) * scale > MAX_TICKS_A_FRAME - 1:
            raise BridgeError(f"wheel speeds {left}, {right} rad/s are beyond {MAX_TICKS_A_FRAME} ticks a frame")
        if self._odometer is not None and not self._latched:
            self._setpoint = (left * scale, right * scale)

    def emergency_stop(self, now: float) -> None:
        """Stop, connected or not, and take no set-point until `release`; told again with every request till then."""
        self._latched = self._stop_due = True
        self._setpoint = None

    def release(self, now: float) -> None:
        """Take set-points again."""
        self._latched = False

    def data_to_send(self) -> bytes:
        """What waits: greeting, stop, set-point, request."""
        data = GREETING if self._greeting_due else b""
        if self._stop_due:
            data += STOP
        if self._setpoint is not None:
            data += self._motion(self._setpoint)
        if self._ask_due:
            data += b"\re\r" if self._doubtful else b"e\r"
        self._greeting_due = self._stop_due = self._ask_due = False
        self._setpoint = None
        return data

    def _motion(self, setpoint: tuple[float, float]) -> bytes:
        left, right = (dither.round(wanted) for dither, wanted in zip(self._dithers, setpoint, strict=True))
        was_moving, self._moving = self._moving, any(setpoint)
        if was_moving and not self._moving:
            return STOP
        # While replies are missing the board may hold half a request, and would read this one as its end.
        return b"%sm %d %d\r" % (b"\r" if self._doubtful else b"", left, right)

    def _ask(self, now: float) -> None:
        self._doubtful = self._asked_at is not None
        if self._asked_at is None:
            self._asked_at = now
        self._ask_due = True
        self._ask_at = now + REPLY_LIMIT
        self._stop_due = self._stop_due or self._latched

    def _on_counts(self, counts: tuple[int, int], now: float) -> list[Event]:
        unasked = self._odometer is None and self._asked_at is None
        if unasked or not all(-(2**31) <= count < 2**31 for count in counts):
            return []
        # A reply that nobody waits for answers a request given up; the board read it after that.
        asked_at = self._asked_at if self._asked_at is not None else self._last_asked_at
        if self._asked_at is not None:
            self._ask_at = max(now, self._asked_at + ASK_PERIOD)
        self._last_asked_at, self._asked_at = asked_at, None
        if self._odometer is None:
            return self._connect(Odometer(counts, asked_at, self._fastest), now)
        if self._odometer.take(counts, asked_at, now):
            self._heard_at = now
            return [self._telemetry(self._odometer, now)]
        return self._disconnect("base restarted", now) if self._odometer.displaced else []

    def _connect(self, odometer: Odometer, now: float) -> list[Event]:
        self._odometer, self._heard_at = odometer, now
        info = BaseInfo(
            driver="arduino_bridge",
            board="ros_arduino_bridge",
            firmware="unknown",
            boot_nonce=0,  # it has none
            watchdog=AUTO_STOP,
            ticks_per_rev=self._ticks_per_rev,
        )
        return [Connected(info), self._telemetry(odometer, now)]

    def _telemetry(self, odometer: Odometer, now: float) -> Telemetry:
        left, right = odometer.total
        return Telemetry(stamp=now, left_ticks=left, right_ticks=right, emergency_stop=self._latched)

    def _disconnect(self, reason: str, now: float) -> list[Event]:
        connected = self._odometer is not None
        self._forget(now)
        return [Disconnected(reason)] if connected else []
