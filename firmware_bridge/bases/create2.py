"""Host role of the iRobot Create 2 / Roomba 600 Open Interface: the driver `create2`.

This base obeys its last set-point for ever: it has no watchdog, and its commands have neither checksum nor answer.
What can be done about that is here (`last_words`, set-points that survive a lost byte, stops repeated until the
base says that it stands) and in omnibotd/io/stop_guard.py.
"""

from __future__ import annotations

import math

from firmware_bridge.bases.create2_stream import (
    FLUSH,
    FULL,
    REQUEST,
    SAFE,
    START,
    BootText,
    Mode,
    Report,
    StreamDecoder,
    drive_direct,
)
from firmware_bridge.bases.create2_wheel import MAX_SPEED, Wheel
from firmware_bridge.events import (
    BaseInfo,
    BridgeError,
    Connected,
    Disconnected,
    Event,
    LastWords,
    Telemetry,
)

WHEEL_RADIUS = 36.0  # mm, by which the base itself turns speeds into turns
TICKS_PER_REV = 508.8
HELLO_PERIOD = 0.5  # seconds; the base answers within a frame, or it sleeps
SILENCE = 0.3  # seconds: twenty frames missing is no noise
MODE_PERIOD = 0.2  # seconds between requests for one mode; the answer shows in the next frame or two
STOP_PERIOD = 0.05  # seconds between stops until the base says that it stands
CAUSE_LIMIT = 0.1  # seconds within which the sensors must say why the base left Safe mode
CHARGE_AFTER = 1.0  # seconds at rest on a charger after which the base is handed back to itself: else it won't charge
# A base left to itself sleeps after 5 minutes, and only a button, or a wire that many cables lack, wakes it again.
STAY_AWAKE = 240.0  # seconds in Passive mode, then for a moment in Safe mode
AWAKE = 0.5  # seconds of that moment
REFUSALS = 5  # requests for Safe mode; some bases on their dock grant only Full mode


class Create2Host:
    """Wakes the base, keeps it in Safe mode, turns its stream into events; implements `events.Driver`.

    A base that stopped by itself (cliff, wheel drop, charger) is taken back into Safe mode, but what it was doing then
    is not done again: then, and when hands have just been shaken, it takes a set-point of zero, or one straight or
    curved backwards, before others count. One that left Safe mode for no reason its sensors tell was taken over by
    somebody: Disconnected, then Connected.
    """

    last_words: LastWords | None = LastWords(stand=FLUSH + drive_direct(0, 0), leave=FLUSH + drive_direct(0, 0) + START)

    def __init__(self) -> None:
        self._decoder = StreamDecoder()
        self._sessions = 0
        self._latched = False  # emergency stop; outlives every restart of the base
        self._greeted = False
        self._hello_at = -math.inf
        self._greeting = b""
        self._forget()

    def _forget(self) -> None:
        """All that was known of the base as it was."""
        self._connected = False
        self._mode = Mode.OFF
        self._wheels = (Wheel(), Wheel())
        self._implausible = False
        self._heard_at = 0.0
        self._last: Report | None = None
        self._setpoint: tuple[int, int] | None = None  # mm/s
        self._refused = False  # set-points that go ahead count only after one that doesn't
        self._cause_at = -math.inf  # when the sensors last told a reason to leave Safe mode
        self._fell_at: float | None = None  # left Safe mode, and no reason known yet
        self._asked_at = -math.inf  # for motion
        self._backwards = False
        self._wanted = Mode.PASSIVE  # of the request for a mode under way
        self._mode_at = -math.inf
        self._requests = 0
        self._mode_request = b""
        self._mode_since = -math.inf
        self._stop_at = -math.inf

    def receive(self, data: bytes, now: float) -> list[Event]:
        """Take bytes from the base; whatever is no whole frame of the stream is dropped."""
        happened: list[Event] = []
        for found in self._decoder.feed(data):
            if isinstance(found, BootText):
                happened += self._disconnect("base restarted")
            elif self._greeted:  # else it may be the stream that an earlier host asked for
                happened += self._understand(found, now)
        return happened

    def poll(self, now: float) -> list[Event]:
        """Greet, notice silence, and see to it that a stop is a stop."""
        happened: list[Event] = []
        if self._connected and now - self._heard_at > SILENCE:
            happened += self._disconnect("silent")
        if not self._connected and now >= self._hello_at:
            self._hello_at = now + HELLO_PERIOD
            self._greeted = True
            self._greeting = FLUSH + drive_direct(0, 0) + START + REQUEST
        return happened

    def drive(self, left: float, right: float, now: float) -> None:
        """New set-points, rad/s; beyond 0.5 m/s both are reduced alike. Motion first asks for Safe mode."""
        if not (math.isfinite(left) and math.isfinite(right)):
            raise BridgeError(f"wheel speeds {left}, {right} rad/s are not finite")
        if not self._connected or self._latched:
            return
        left, right = left * WHEEL_RADIUS, right * WHEEL_RADIUS
        if max(left, right) <= 0.0:
            self._refused = False
        elif self._refused:
            left = right = 0.0
        if left or right:
            self._asked_at = now
            self._backwards = max(left, right) <= 0.0
        if self._mode in (Mode.SAFE, Mode.FULL):
            share = min(1.0, MAX_SPEED / max(abs(left), abs(right), MAX_SPEED))
            self._send_speeds(left * share, right * share, now)
        else:
            self._mind_mode(now)

    def emergency_stop(self, now: float) -> None:
        """Stop and ignore set-points until `release`; the latch is the driver's, this base has none."""
        self._latched = True
        self._send_speeds(0.0, 0.0, now)

    def release(self, now: float) -> None:
        self._latched = False

    def data_to_send(self) -> bytes:
        """One greeting or mode request, and one set-point, wait at most."""
        data = self._greeting + self._mode_request
        self._greeting = self._mode_request = b""
        if self._setpoint is not None:
            data += drive_direct(*self._setpoint)
            self._setpoint = None
        return data

    def _send_speeds(self, left: float, right: float, now: float) -> None:
        self._setpoint = self._wheels[0].ask(left, now), self._wheels[1].ask(right, now)

    def _understand(self, report: Report, now: float) -> list[Event]:
        if report.mode == Mode.OFF:
            return self._disconnect("switched off")
        if not all(w.plausible(raw, now) for w, raw in zip(self._wheels, report.encoders, strict=True)):
            return self._doubt()
        self._implausible = False
        self._heard_at = now
        happened = self._watch_mode(report, now) if self._connected else self._connect(report, now)
        if not self._connected:
            return happened
        self._last = report
        self._mind_mode(now)
        self._mind_stop(report, now)
        return [*happened, self._telemetry(report, now)]

    def _doubt(self) -> list[Event]:
        """One impossible count is noise; two are encoders that began anew."""
        if self._implausible:
            return self._disconnect("base restarted: its encoders jumped")
        self._implausible = True
        return []

    def _connect(self, report: Report, now: float) -> list[Event]:
        """The greeting leads to Passive mode: other reports are older than it."""
        if report.mode != Mode.PASSIVE:
            return []
        self._connected = True
        self._mode, self._mode_since = report.mode, now
        self._refused = True
        self._sessions += 1
        return [Connected(_info(self._sessions))]

    def _watch_mode(self, report: Report, now: float) -> list[Event]:
        """Notice that the base left Safe mode by itself, and why."""
        before, self._mode = self._mode, report.mode
        if report.cliff or report.wheel_drop or report.charging:
            self._cause_at = now
        if before != report.mode:
            self._mode_since = now
        if report.mode != Mode.PASSIVE:
            self._fell_at = None
        elif Mode.PASSIVE not in (before, self._wanted):
            self._fell_at = now
            self._refused = True
        if self._fell_at is None:
            return []
        if now - self._cause_at <= CAUSE_LIMIT:
            self._fell_at = None
        elif now - self._fell_at > CAUSE_LIMIT:
            return self._disconnect("left Safe mode without a reason: was a button of the base pressed?")
        return []

    def _mind_mode(self, now: float) -> None:
        """Ask for the mode that the base should be in, if it isn't."""
        wanted = self._right_mode(now)
        if wanted != self._wanted:
            self._wanted, self._mode_at, self._requests = wanted, -math.inf, 0
        if wanted == self._mode or now < self._mode_at or self._fell_at is not None:
            return
        self._mode_at = now + MODE_PERIOD
        self._requests += 1
        self._mode_request = {Mode.PASSIVE: START, Mode.FULL: FULL}.get(wanted, SAFE)

    def _right_mode(self, now: float) -> Mode:
        report = self._last
        if report is None or report.wheel_drop or report.plugged_in:
            return self._mode if self._mode == Mode.PASSIVE else Mode.SAFE  # it would fall back at once
        if not report.charging:
            return Mode.SAFE
        if now - self._asked_at < CHARGE_AFTER:
            stubborn = self._wanted == Mode.FULL or (self._wanted == Mode.SAFE and self._requests >= REFUSALS)
            return Mode.FULL if stubborn and self._backwards and self._mode != Mode.SAFE else Mode.SAFE
        return self._resting_mode(now)

    def _resting_mode(self, now: float) -> Mode:
        """On a charger: Passive, and every four minutes Safe for a moment."""
        since = now - self._mode_since
        if self._mode != Mode.PASSIVE:
            return Mode.SAFE if since < AWAKE else Mode.PASSIVE
        if since > STAY_AWAKE and self._wanted == Mode.SAFE and self._requests >= REFUSALS:
            self._mode_since = now  # it won't: try again in four minutes
        return Mode.SAFE if now - self._mode_since > STAY_AWAKE else Mode.PASSIVE

    def _mind_stop(self, report: Report, now: float) -> None:
        """An emergency stop is repeated until the base says that it stands."""
        if self._latched and any(report.requested) and now >= self._stop_at:
            self._stop_at = now + STOP_PERIOD
            self._send_speeds(0.0, 0.0, now)

    def _telemetry(self, report: Report, now: float) -> Telemetry:
        faults = {"motor_left": report.overcurrent_left, "motor_right": report.overcurrent_right}
        return Telemetry(
            stamp=now,
            left_ticks=self._wheels[0].count(report.encoders[0], report.requested[0], now),
            right_ticks=self._wheels[1].count(report.encoders[1], report.requested[1], now),
            bumper_left=report.bumper_left,
            bumper_right=report.bumper_right,
            cliff=report.cliff,
            wheel_drop=report.wheel_drop,
            charging=report.charging,
            battery=report.millivolts / 1000.0,
            emergency_stop=self._latched,
            faults=frozenset(name for name, present in faults.items() if present),
        )

    def _disconnect(self, reason: str) -> list[Event]:
        """Forget what was meant for the base as it was, and greet it at the next poll."""
        was_connected = self._connected
        self._forget()
        self._greeted = False
        self._hello_at = -math.inf
        self._greeting = b""
        return [Disconnected(reason)] if was_connected else []


def _info(session: int) -> BaseInfo:
    return BaseInfo(
        driver="create2",
        board="Create 2 or Roomba 600",
        firmware="Open Interface",
        boot_nonce=session,  # the base has none
        watchdog=0.0,
        ticks_per_rev=TICKS_PER_REV,
        capabilities=frozenset({"bumpers", "cliff", "wheel_drop", "charging", "battery"}),
    )
