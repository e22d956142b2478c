"""Device role of the native protocol: what the firmware does, for tests, emulator and simulated robots."""

from __future__ import annotations

from collections import deque

from firmware_bridge import messages
from firmware_bridge.events import BridgeError
from firmware_bridge.framing import Decoder
from firmware_bridge.messages import (
    NOTHING_AHEAD,
    Ack,
    Capability,
    Hello,
    HelloReply,
    Message,
    Range,
    Release,
    SetPoint,
    Status,
    Stop,
    Telemetry,
)

WATCHDOG = 0.25  # seconds without a new set-point until the wheels stop: 12 cm at 0.5 m/s
TELEMETRY_PERIOD = 0.02
LATE, EARLY = 250_000, 20_000  # us by which a set-point may be old; by which its host's reckoning may be ahead
# Answers that wait for the line: one to each kind of request twice over; an MCU has no room for more.
MAX_REPLIES = 8
# A device without wheels has nothing to configure.
ALL = Capability(sum(Capability)) & ~Capability.CONFIGURATION


class OmnibotDevice:
    """A base without wheels or wire: the owner moves the bytes, turns wheels by `target` and reports them.

    The clock may start anywhere. Encoders count from 0 at each boot, as those of an MCU do.
    """

    def __init__(
        self,
        ticks_per_rev: float,
        boot_nonce: int,
        *,
        board: str = "emulator",
        firmware: int = 0,
        capabilities: Capability = ALL,
    ) -> None:
        name = board.encode("ascii", errors="replace")
        if len(name) > 16:
            raise BridgeError(f"board name {board!r} is longer than 16 bytes")
        self._identity = (round(ticks_per_rev * 1000.0), firmware, name, capabilities)
        self._ticks = (0, 0)
        self._status = Status(0)
        self._battery_mv = 0
        self._ahead_mm: int | None = None
        self.reset(boot_nonce)

    def reset(self, nonce: int) -> None:
        """The MCU reboots: all forgotten but where the wheels stand; counts begin at 0."""
        self.boot_nonce = nonce
        self._decoder = Decoder()
        self._origin = self._ticks
        self._greeted = False
        self._latched = False
        self._setpoint = (0, 0)
        self._fed_at: float | None = None  # None: no set-point in force
        self._setpoint_seq: int | None = None
        self._booted_at: float | None = None
        self._telemetry_at: float | None = None
        self._seq = 0
        self._replies: deque[Message] = deque(maxlen=MAX_REPLIES)
        self._telemetry: Telemetry | None = None
        self._range: Range | None = None

    @property
    def target(self) -> tuple[int, int]:
        """Wheel speeds (left, right), ticks/s, as of the last `receive` or `poll`; 0 when not to move."""
        return self._setpoint if self._fed_at is not None else (0, 0)

    @property
    def emergency_stopped(self) -> bool:
        return self._latched

    def set_state(
        self,
        left_ticks: int,
        right_ticks: int,
        *,
        bumper_left: bool = False,
        bumper_right: bool = False,
        cliff: bool = False,
        wheel_drop: bool = False,
        charging: bool | None = None,
        battery_mv: int = 12000,
        range_ahead: float | None = None,
    ) -> None:
        """What the sensors say now; the ticks go on across a reset. `charging` None: no contact to tell.

        `range_ahead` in metres from the front edge, infinite where nothing is within reach, None without such a sensor.
        """
        self._ticks = (left_ticks, right_ticks)
        self._battery_mv = battery_mv
        self._ahead_mm = None if range_ahead is None else round(min(range_ahead * 1000.0, NOTHING_AHEAD))
        senses = {
            Status.BUMPER_LEFT: bumper_left,
            Status.BUMPER_RIGHT: bumper_right,
            Status.CLIFF: cliff,
            Status.WHEEL_DROP: wheel_drop,
            Status.CHARGING: bool(charging),
        }
        self._status = Status(sum(flag for flag, on in senses.items() if on))

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes from the host; what is broken or not for this boot changes nothing."""
        self._keep_time(now)
        for frame in self._decoder.feed(data):
            try:
                message = messages.parse(frame)
            except messages.MalformedMessage:
                continue
            self._obey(message, frame.seq, now)

    def poll(self, now: float) -> None:
        """Mind watchdog and telemetry; call at least every 10 ms."""
        self._keep_time(now)
        if self._telemetry_at is None or now < self._telemetry_at:
            return
        # A late poll skips reports instead of sending a burst of equal ones.
        self._telemetry_at = max(self._telemetry_at + TELEMETRY_PERIOD, now)
        self._telemetry = self._report(now)
        self._range = None if self._ahead_mm is None else Range(self.boot_nonce, self._ahead_mm)

    def data_to_send(self) -> bytes:
        """Frames that wait: answers, then the newest range and telemetry."""
        newest = (self._range, self._telemetry)
        waiting: list[Message] = [*self._replies, *(message for message in newest if message is not None)]
        self._replies.clear()
        self._range = self._telemetry = None
        return b"".join(messages.to_bytes(message, self._next_seq()) for message in waiting)

    def _next_seq(self) -> int:
        self._seq = (self._seq + 1) % 256
        return self._seq

    def _keep_time(self, now: float) -> None:
        if self._booted_at is None:
            self._booted_at = now
        if self._fed_at is not None and now - self._fed_at >= WATCHDOG:
            self._halt()

    def _halt(self) -> None:
        self._setpoint = (0, 0)
        self._fed_at = None

    def _obey(self, message: Message, seq: int, now: float) -> None:
        match message:
            case Hello(version):
                if version == messages.VERSION:
                    self._greet(now)
                self._replies.append(self._introduction())
            case SetPoint():
                self._on_setpoint(message, seq, now)
            case Stop():
                self._latched = True
                self._halt()
                self._replies.append(Ack(Stop.CODE, seq))
            case Release(boot_nonce) if boot_nonce == self.boot_nonce:
                self._latched = False
                self._replies.append(Ack(Release.CODE, seq))

    def _greet(self, now: float) -> None:
        """A host begins anew: it may have restarted, so its sequence numbers mean nothing yet."""
        self._halt()
        self._setpoint_seq = None
        if not self._greeted:
            self._greeted = True
            self._telemetry_at = now

    def _introduction(self) -> HelloReply:
        ticks, firmware, board, capabilities = self._identity
        return HelloReply(
            version=messages.VERSION,
            watchdog_ms=round(WATCHDOG * 1000.0),
            ticks_per_1000_rev=ticks,
            boot_nonce=self.boot_nonce,
            firmware=firmware,
            board=board,
            capabilities=capabilities,
        )

    def _on_setpoint(self, message: SetPoint, seq: int, now: float) -> None:
        if self._latched or not self._greeted or message.boot_nonce != self.boot_nonce or not self._newer(seq):
            return
        if (message.left, message.right) != (0, 0) and self._untimely(message.mcu_us, now):
            return
        self._setpoint = (message.left, message.right)
        self._setpoint_seq = seq
        self._fed_at = now

    def _newer(self, seq: int) -> bool:
        """Half the circle is newer; once the watchdog has stopped the wheels, all but a repetition is."""
        if self._setpoint_seq is None:
            return True
        ahead = (seq - self._setpoint_seq) % 256
        return 0 < ahead < 128 or (self._fed_at is None and ahead != 0)

    def _untimely(self, mcu_us: int, now: float) -> bool:
        """Modulo 2**32, as the clock counts."""
        return (self._clock(now) - mcu_us + EARLY) % 2**32 > LATE + EARLY

    def _clock(self, now: float) -> int:
        assert self._booted_at is not None
        return int((now - self._booted_at) * 1e6) % 2**32

    def _report(self, now: float) -> Telemetry:
        status = self._status
        if self._latched:
            status |= Status.EMERGENCY_STOP
        if self._fed_at is not None:
            status |= Status.MOVING_ALLOWED
        left, right = (_signed32(ticks - origin) for ticks, origin in zip(self._ticks, self._origin, strict=True))
        return Telemetry(
            boot_nonce=self.boot_nonce,
            mcu_us=self._clock(now),
            left_ticks=left,
            right_ticks=right,
            pwm_left=0,  # no motor driver here, so no PWM and no faults
            pwm_right=0,
            status=status,
            faults=0,
            battery_mv=self._battery_mv,
            setpoint_seq=self._setpoint_seq or 0,
            crc_errors=(self._decoder.crc_errors + self._decoder.garbage) % 2**16,
            overruns=self._decoder.overruns % 2**16,
        )


def _signed32(count: int) -> int:
    return (count + 2**31) % 2**32 - 2**31
