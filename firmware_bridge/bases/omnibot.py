"""Host role of the native protocol: the driver `omnibot`."""

from __future__ import annotations

import math
from dataclasses import dataclass

from firmware_bridge import events, messages
from firmware_bridge.events import BaseInfo, BridgeError, Connected, Disconnected, Event, LastWords
from firmware_bridge.framing import DELIMITER, Decoder
from firmware_bridge.messages import (
    Ack,
    Capability,
    Fault,
    HelloReply,
    Message,
    Range,
    Release,
    SetPoint,
    Status,
    Stop,
)

HELLO_PERIOD = 0.2  # seconds; a board that boots in 2 s is found at once when it is ready
SILENCE = 0.3  # seconds: fifteen telemetry frames missing is no noise
RETRY_PERIOD = 0.05  # seconds; a round trip takes 2-10 ms
RETRY_LIMIT = 20  # a second of retries; then the base is as good as gone and hands must be shaken again
RANGE_LIFE = 0.2  # seconds: ten ranges missing; an old one says nothing about the way ahead
MAX_TICKS_PER_SECOND = 2**31 - 1  # what SETPOINT holds


@dataclass(slots=True)
class _Request:
    """A message repeated, under one sequence number, until its Ack comes."""

    message: Stop | Release
    seq: int
    due_at: float
    tries: int = 0


class _Counter:
    """Unwraps a 32-bit encoder count; starts from 0 at the first reading."""

    def __init__(self) -> None:
        self.total = 0
        self._raw: int | None = None

    def update(self, raw: int) -> int:
        if self._raw is not None:
            self.total += (raw - self._raw + 2**31) % 2**32 - 2**31
        self._raw = raw
        return self.total


class OmnibotHost:
    """Shakes hands, turns telemetry into events and set-points into frames; implements `events.Driver`.

    Nothing queues up: at most one HELLO, one request and one set-point wait for `data_to_send`.
    """

    last_words: LastWords | None = None

    def __init__(self) -> None:
        self._decoder = Decoder()
        self._seq = 0
        self._info: BaseInfo | None = None  # None: hands not shaken
        self._capabilities = Capability(0)
        self._last_nonce: int | None = None  # kept while disconnected: tells a restart from a cut cable
        self._counters = (_Counter(), _Counter())
        self._range: tuple[float, float] | None = None  # metres, and when they came
        self._heard_at = 0.0
        self._mcu_us: int | None = None  # the base's clock at `_heard_at`; None until its first telemetry
        self._hello_at = -math.inf
        self._hello_due = False
        self._setpoint: SetPoint | None = None
        self._stop_wanted = False  # outlives a restart, which the latch in the base does not
        self._request: _Request | None = None
        self._request_due = False

    def receive(self, data: bytes, now: float) -> list[Event]:
        """Take bytes from the base; broken frames and messages that make no sense are dropped."""
        happened: list[Event] = []
        for frame in self._decoder.feed(data):
            try:
                happened += self._understand(messages.parse(frame), now)
            except messages.OtherVersion as other:
                happened += self._refuse(other.version)
            except messages.MalformedMessage:
                continue
        return happened

    def poll(self, now: float) -> list[Event]:
        """Repeat what is due; notice silence."""
        happened: list[Event] = []
        if self._info is not None and now - self._heard_at > SILENCE:
            happened += self._disconnect("silent")
        happened += self._repeat_request(now)
        if self._info is None and now >= self._hello_at:
            self._hello_due = True
            self._hello_at = now + HELLO_PERIOD
        return happened

    def drive(self, left: float, right: float, now: float) -> None:
        """New set-points, rad/s; ignored before the first telemetry, and while an emergency stop is asked for."""
        if not (math.isfinite(left) and math.isfinite(right)):
            raise BridgeError(f"wheel speeds {left}, {right} rad/s are not finite")
        if self._info is None or self._mcu_us is None or self._stop_wanted:
            return
        scale = self._info.ticks_per_rev / (2.0 * math.pi)
        ticks = round(left * scale), round(right * scale)
        if max(map(abs, ticks)) > MAX_TICKS_PER_SECOND:
            raise BridgeError(f"wheel speeds {left}, {right} rad/s are beyond {MAX_TICKS_PER_SECOND} ticks/s")
        # By the clock of the base, which drops what is late: behind by the time that its telemetry was under way.
        mcu_us = (self._mcu_us + int((now - self._heard_at) * 1e6)) % 2**32
        self._setpoint = SetPoint(self._info.boot_nonce, *ticks, mcu_us)

    def emergency_stop(self, now: float) -> None:
        """Stop, and stay so across restarts of the base until `release`; works before hands are shaken."""
        self._stop_wanted = True
        self._setpoint = None
        self._ask(Stop(), now)

    def release(self, now: float) -> None:
        """Let the base move again; one not connected keeps its latch, and says so in its telemetry later."""
        self._stop_wanted = False
        self._request = None
        if self._info is not None:
            self._ask(Release(self._info.boot_nonce), now)

    def data_to_send(self) -> bytes:
        """Frames that wait, in the order HELLO, request, set-point."""
        data = b""
        if self._hello_due:
            # The leading zero ends whatever half frame the base still holds.
            data += DELIMITER + messages.to_bytes(messages.Hello(), self._next_seq())
        if self._request is not None and self._request_due:
            data += messages.to_bytes(self._request.message, self._request.seq)
        if self._setpoint is not None:
            data += messages.to_bytes(self._setpoint, self._next_seq())
        self._hello_due = self._request_due = False
        self._setpoint = None
        return data

    def _next_seq(self) -> int:
        self._seq = (self._seq + 1) % 256
        return self._seq

    def _ask(self, message: Stop | Release, now: float) -> None:
        self._request = _Request(message, self._next_seq(), now)
        self._repeat_request(now)

    def _repeat_request(self, now: float) -> list[Event]:
        request = self._request
        if request is None or now < request.due_at:
            return []
        if request.tries == RETRY_LIMIT:
            self._request = None
            return self._disconnect(f"no acknowledgement of {type(request.message).__name__.upper()}")
        request.tries += 1
        request.due_at = now + RETRY_PERIOD
        self._request_due = True
        return []

    def _understand(self, message: Message, now: float) -> list[Event]:
        match message:
            case HelloReply():
                return self._on_hello_reply(message, now)
            case messages.Telemetry():
                return self._on_telemetry(message, now)
            case Range():
                self._on_range(message, now)
            case Ack():
                self._on_ack(message)
        return []  # anything else is the host's own echo, from a line that loops back

    def _on_hello_reply(self, reply: HelloReply, now: float) -> list[Event]:
        if self._info is not None:
            return [] if reply.boot_nonce == self._info.boot_nonce else self._restarted(reply.boot_nonce)
        happened: list[Event] = []
        if self._last_nonce not in (None, reply.boot_nonce):
            happened.append(Disconnected("base restarted"))
        self._info = _info(reply)
        self._capabilities = Capability(reply.capabilities)
        self._last_nonce = reply.boot_nonce
        self._counters = (_Counter(), _Counter())
        self._range = None
        self._heard_at, self._mcu_us = now, None
        self._hello_due = False
        if self._stop_wanted:
            self._ask(Stop(), now)
        return [*happened, Connected(self._info)]

    def _on_telemetry(self, report: messages.Telemetry, now: float) -> list[Event]:
        if self._info is None:
            return []
        if report.boot_nonce != self._info.boot_nonce:
            return self._restarted(report.boot_nonce)
        self._heard_at, self._mcu_us = now, report.mcu_us
        status = Status(report.status)
        has = self._capabilities
        telemetry = events.Telemetry(
            stamp=now,
            left_ticks=self._counters[0].update(report.left_ticks),
            right_ticks=self._counters[1].update(report.right_ticks),
            bumper_left=Status.BUMPER_LEFT in status,
            bumper_right=Status.BUMPER_RIGHT in status,
            cliff=Status.CLIFF in status,
            wheel_drop=Status.WHEEL_DROP in status,
            charging=Status.CHARGING in status if Capability.CHARGING in has else None,
            battery=report.battery_mv / 1000.0 if Capability.BATTERY in has else None,
            emergency_stop=Status.EMERGENCY_STOP in status,
            range_ahead=self._ahead(now),
            faults=messages.names(Fault(report.faults)),
        )
        return [telemetry]

    def _on_range(self, message: Range, now: float) -> None:
        """Kept for the telemetry that follows it."""
        if self._info is not None and message.boot_nonce == self._info.boot_nonce:
            nothing = message.ahead_mm == messages.NOTHING_AHEAD
            self._range = (math.inf if nothing else message.ahead_mm / 1000.0, now)

    def _ahead(self, now: float) -> float | None:
        if self._range is None or now - self._range[1] > RANGE_LIFE:
            return None
        return self._range[0]

    def _on_ack(self, ack: Ack) -> None:
        request = self._request
        if request is not None and (ack.kind, ack.seq) == (request.message.CODE, request.seq):
            self._request = None

    def _refuse(self, version: int) -> list[Event]:
        """Told again at every answer: the owner sees that the base is there."""
        self._info = self._setpoint = None
        reason = f"the base speaks protocol {version}, this program {messages.VERSION}: update its firmware"
        return [Disconnected(reason)]

    def _restarted(self, nonce: int) -> list[Event]:
        self._last_nonce = nonce
        return self._disconnect("base restarted")

    def _disconnect(self, reason: str) -> list[Event]:
        """Forget what was meant for the base as it was, and shake hands at the next poll."""
        self._setpoint = None
        self._request = None
        self._hello_at = -math.inf
        if self._info is None:
            return []
        self._info = None
        return [Disconnected(reason)]


def _info(reply: HelloReply) -> BaseInfo:
    return BaseInfo(
        driver="omnibot",
        board=reply.board.rstrip(b"\0").decode("ascii", errors="replace"),
        firmware=f"{reply.firmware:08x}",
        boot_nonce=reply.boot_nonce,
        watchdog=reply.watchdog_ms / 1000.0,
        ticks_per_rev=reply.ticks_per_1000_rev / 1000.0,
        capabilities=messages.names(Capability(reply.capabilities)),
    )
