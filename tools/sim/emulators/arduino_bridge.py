"""A board with the ros_arduino_bridge firmware, as its device role: bytes in, bytes out, time as an argument.

Written from the firmware's behaviour: one letter, up to two arguments, CR; speeds taken over at control frames of 33
ms; stopped 2 s after the last speed; deaf and still while it boots. Its closed-loop control is taken as perfect: the
stock gains (20:12:0:50, integers) leave a dead band of two ticks a frame that is not modelled here.
"""

from __future__ import annotations

BAUD = b"57600"
FRAME = 0.033  # s
AUTO_STOP = 2.0  # s since the last speed; asking for encoders does not count
ARGUMENT_SIZE = 32  # bytes of each argument's buffer, which the firmware does not guard
REPLY_LIMIT = 512  # bytes not yet fetched; the UART holds 64 and then the firmware waits, here the newest are lost
TICKS_LIMIT = 2**15  # what its atoi wraps at


class ArduinoBridgeBoard:
    """The owner moves the bytes, turns wheels by `target` and reports them with `set_state`.

    `overflows` counts bytes written beyond an argument's buffer: on a real board they destroy other variables.
    """

    def __init__(self, *, boot_time: float = 1.6, greeting: bytes = b"") -> None:
        """`boot_time` (s): boot loader and set-up; `greeting`: what a fork prints when it is ready."""
        self._boot_time = boot_time
        self._greeting = greeting
        self._turned = (0, 0)
        self.overflows = 0
        self.reset()

    def reset(self, nonce: int = 0) -> None:
        """DTR or power: motors off, all forgotten, counts begin at 0. It has no use for a nonce."""
        self._ready_at: float | None = None
        self._ready = False
        self._origin = self._turned
        self._replies = bytearray()
        self._wanted = (0, 0)
        self._in_force = (0, 0)
        self._moving = False
        self._fed_at = 0.0
        self._frame_at = 0.0
        self._clear_request()

    @property
    def target(self) -> tuple[float, float]:
        """Wheel speeds (left, right), ticks/s, as of the last `receive` or `poll`."""
        return self._in_force[0] / FRAME, self._in_force[1] / FRAME

    def set_state(self, left_ticks: int, right_ticks: int, **senses: object) -> None:
        """How far the wheels have turned, going on across a reset; it has no other senses."""
        self._turned = (left_ticks, right_ticks)

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes from the host; what comes while it boots is lost."""
        self.poll(now)
        if self._ready:
            for byte in data:
                self._take(byte, now)

    def poll(self, now: float) -> None:
        """Boot, mind the frames and the auto-stop; call at least every 10 ms."""
        if not self._ready:
            self._boot(now)
            return
        while self._frame_at <= now:
            self._frame_at += FRAME
            self._in_force = self._wanted if self._moving else (0, 0)
        if now - self._fed_at > AUTO_STOP:
            self._halt()

    def data_to_send(self) -> bytes:
        data = bytes(self._replies)
        self._replies.clear()
        return data

    def _boot(self, now: float) -> None:
        if self._ready_at is None:
            self._ready_at = now + self._boot_time
        if now >= self._ready_at:
            self._ready = True
            self._frame_at = self._fed_at = now
            self._say(self._greeting)

    def _halt(self) -> None:
        self._moving = False
        self._in_force = (0, 0)

    def _clear_request(self) -> None:
        self._command = b""
        self._arguments = (bytearray(), bytearray())
        self._argument = 0

    def _take(self, byte: int, now: float) -> None:
        """Before the first space each byte replaces the command; after the second, spaces separate nothing."""
        if byte == 0x0D:
            self._say(self._run(now))
            self._clear_request()
        elif byte == 0x20:
            self._argument = min(self._argument + 1, 2)
        elif self._argument == 0:
            self._command = bytes((byte,))
        elif len(self._arguments[self._argument - 1]) < ARGUMENT_SIZE - 1:
            self._arguments[self._argument - 1].append(byte)
        else:
            self.overflows += 1

    def _run(self, now: float) -> bytes:
        match self._command:
            case b"b":
                return BAUD
            case b"e":
                counts = (turned - origin for turned, origin in zip(self._turned, self._origin, strict=True))
                return b"%d %d" % tuple((count + 2**31) % 2**32 - 2**31 for count in counts)
            case b"r":
                self._origin = self._turned
                self._wanted = (0, 0)
            case b"m":
                self._on_speeds(_atoi(self._arguments[0]), _atoi(self._arguments[1]), now)
            case b"u":
                pass  # gains of a control loop that is perfect here
            case b"a" | b"d" | b"p":
                return b"0"  # nothing is wired to its pins
            case _:
                return b"Invalid Command"
        return b"OK"

    def _on_speeds(self, left: int, right: int, now: float) -> None:
        self._fed_at = now
        self._wanted = (left, right)
        self._moving = (left, right) != (0, 0)
        if not self._moving:
            self._halt()

    def _say(self, line: bytes) -> None:
        if line and len(self._replies) + len(line) + 2 <= REPLY_LIMIT:
            self._replies += line + b"\r\n"


def _atoi(text: bytearray) -> int:
    """As C does it on the board: a sign, digits up to the first other byte, 16 bits; 0 for none."""
    sign, digits = (-1, text[1:]) if text[:1] == b"-" else (1, text[1:] if text[:1] == b"+" else text)
    value = 0
    for byte in digits:
        if not 0x30 <= byte <= 0x39:
            break
        value = value * 10 + byte - 0x30
    return (sign * value + TICKS_LIMIT) % (2 * TICKS_LIMIT) - TICKS_LIMIT
