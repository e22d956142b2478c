"""The firmware in lockstep: nothing happens but by `run`, and the same calls have the same effect to the cycle."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import POINTER, c_char, c_char_p, c_double, c_int, c_int64, c_uint8, c_uint16, c_uint32, c_uint64, c_void_p
from functools import cache
from types import TracebackType
from typing import Any, Self

from tools.avr import building
from tools.avr.boards import UNO, Board

HZ = 16_000_000
BYTE = 1389 / HZ  # s on the line at 115200 baud
FULL_SPEED = 4000.0  # ticks/s at full PWM: what the firmware takes for granted until it is configured
_READ_SIZE = 65536

LEFT, RIGHT = 0, 1


BATTERY_DIVIDER = 43.0 / 10.0  # 33 k and 10 k


class _Pin(ctypes.Structure):
    _fields_ = (("port", c_char), ("bit", c_uint8))

    @classmethod
    def named(cls, name: str) -> _Pin:
        return cls(name[0].encode(), int(name[1]))


class _Layout(ctypes.Structure):
    _fields_ = (
        ("standby", _Pin),
        *((name, _Pin * 2) for name in ("pwm", "forward", "backward", "channel_a", "channel_b")),
    )

    @classmethod
    def of(cls, board: Board) -> _Layout:
        pairs = (board.pwm, board.forward, board.backward, board.channel_a, board.channel_b)
        return cls(_Pin.named(board.standby), *((_Pin * 2)(*map(_Pin.named, pair)) for pair in pairs))


_FUNCTIONS: dict[str, tuple[Any, ...]] = {
    # name: (result, arguments after the robot ...)
    "robot_free": (None,),
    "robot_reset": (None,),
    "robot_run": (c_int, c_uint64),
    "robot_cycle": (c_uint64,),
    "robot_driven": (c_uint64,),
    "robot_resets": (c_uint64,),
    "robot_reset_at": (c_uint64,),
    "robot_lost_bytes": (c_uint64,),
    "robot_deaf_longest": (c_uint64,),
    "robot_duty": (c_double, c_int),
    "robot_awake": (c_int,),
    "robot_edge": (c_int64, c_int),
    "robot_speed": (c_double, c_int),
    "robot_send": (None, c_char_p, c_uint32),
    "robot_sending": (c_uint32,),
    "robot_receive": (c_uint32, c_char_p, c_uint32),
    "robot_show": (None, c_char, c_uint8, c_int),
    "robot_volts": (None, c_uint8, c_uint32),
    "robot_motor": (None, c_int, c_double, c_double, c_double),
    "robot_spin": (None, c_int, c_double),
    "robot_roll": (None, c_int, c_int64, c_double),
    "robot_unplug": (None, c_int, c_int),
    "robot_eeprom_read": (c_int, c_uint16),
    "robot_eeprom_write": (None, c_uint16, c_uint8),
    "robot_program_counter": (c_uint32,),
    "robot_interruptible": (c_int,),
    "robot_instruction": (c_uint16, c_uint32),
    "robot_set_instruction": (None, c_uint32, c_uint16),
}


@cache
def _library() -> ctypes.CDLL:
    library = ctypes.CDLL(str(building.shim()))
    library.robot_new.argtypes = [c_char_p, c_char_p, c_uint32, POINTER(_Layout)]
    library.robot_new.restype = c_void_p
    for name, (result, *arguments) in _FUNCTIONS.items():
        function = getattr(library, name)
        function.argtypes = [c_void_p, *arguments]
        function.restype = result
    return library


class Crashed(RuntimeError):
    """The MCU ran into something that is no program."""


class AvrRobot:
    """A board with the firmware, two motors with encoders, bumpers, a dock's contact and a battery. Close it after use.

    Times are seconds since power-up, speeds ticks/s, sides LEFT and RIGHT.
    """

    def __init__(self, board: Board = UNO, flash: bytes | None = None) -> None:
        """Powers up. `flash` None: the firmware of this checkout. building.ToolsMissing, building.BuildError."""
        self.board = board
        self._lib = _library()
        code = building.firmware(board.name) if flash is None else flash
        self._me = self._lib.robot_new(board.mcu.encode(), code, len(code), _Layout.of(board))
        if not self._me:
            raise RuntimeError(f"simavr could not make an {board.mcu}")
        self._buffer = ctypes.create_string_buffer(_READ_SIZE)
        self.bump(False, False)
        self.dock(False)
        self.battery(12.0)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Frees the simulator; harmless when done already."""
        if self._me:
            self._call("free")
            self._me = None

    @property
    def now(self) -> float:
        return int(self._call("cycle")) / HZ

    @property
    def up(self) -> float:
        """Seconds since it started last."""
        return (int(self._call("cycle")) - int(self._call("reset_at"))) / HZ

    def run(self, seconds: float) -> None:
        """Lets so much time pass, to within an instruction."""
        self.run_until(self.now + seconds)

    def run_until(self, time: float) -> None:
        """Lets time pass until `time`; nothing where that is over."""
        if not self._call("run", round(time * HZ)):
            raise Crashed(f"at cycle {self._call('cycle')}, program counter 0x{self._call('program_counter'):05x}")

    def reset(self) -> None:
        """Presses the reset button."""
        self._call("reset")

    def send(self, data: bytes) -> None:
        """Bytes from the host, at the speed of the line; those of an earlier call go first."""
        self._call("send", data, len(data))

    def deliver(self, data: bytes) -> None:
        """Sends and lets time pass until the last byte has arrived."""
        self.send(data)
        while self._call("sending"):
            self.run(BYTE)
        self.run(BYTE)

    def receive(self) -> bytes:
        """What the firmware has sent since the last call; it keeps six seconds of a full line."""
        count = self._call("receive", self._buffer, _READ_SIZE)
        return self._buffer.raw[:count]

    # ---- the body

    @property
    def duty(self) -> tuple[float, float]:
        """Share of the supply on each motor, forward positive."""
        return self._call("duty", LEFT), self._call("duty", RIGHT)

    @property
    def awake(self) -> bool:
        """Whether the motor driver is out of standby."""
        return bool(self._call("awake"))

    @property
    def ticks(self) -> tuple[int, int]:
        """Encoder edges since power-up: the truth."""
        return self._call("edge", LEFT), self._call("edge", RIGHT)

    @property
    def speeds(self) -> tuple[float, float]:
        return self._call("speed", LEFT), self._call("speed", RIGHT)

    @property
    def driven_at(self) -> float:
        """When a motor was last driven, to 0.1 ms."""
        return int(self._call("driven")) / HZ

    @property
    def resets(self) -> int:
        """How often it started anew after power-up, by the button or by the hardware watchdog."""
        return int(self._call("resets"))

    @property
    def lost_bytes(self) -> int:
        """Bytes that the UART had no room for."""
        return int(self._call("lost_bytes"))

    @property
    def longest_deaf(self) -> float:
        """The longest time for which interrupts were off, since boot."""
        return int(self._call("deaf_longest")) / HZ

    def motor(self, side: int, full_speed: float = FULL_SPEED, lag: float = 0.08, friction: float = 0.0) -> None:
        """Another motor: speed at full PWM (negative: wires swapped), lag (s), share of PWM lost to friction."""
        self._call("motor", side, full_speed, lag, friction)

    def spin(self, side: int, speed: float) -> None:
        """Turns a wheel by hand from now on, whatever its motor does."""
        self._call("spin", side, speed)

    def roll(self, side: int, ticks: int, seconds: float) -> None:
        """Turns a wheel by hand, evenly, until it has made `ticks` since power-up in `seconds`; there it stays."""
        self._call("roll", side, ticks, seconds)

    def unplug(self, side: int, *, unplugged: bool = True) -> None:
        """Pulls an encoder's plug."""
        self._call("unplug", side, int(unplugged))

    def bump(self, left: bool, right: bool) -> None:
        """Bumper switches to ground."""
        for name, pressed in zip(self.board.bumpers, (left, right), strict=True):
            self._show(name, not pressed)

    def dock(self, docked: bool) -> None:
        """The charging contact."""
        self._show(self.board.charger, docked)

    def battery(self, volts: float) -> None:
        self._call("volts", self.board.battery, round(volts * 1000.0 / BATTERY_DIVIDER))

    # ---- the laboratory

    def eeprom(self, address: int, count: int) -> bytes:
        return bytes(self._call("eeprom_read", address + i) for i in range(count))

    def write_eeprom(self, address: int, data: bytes) -> None:
        for i, byte in enumerate(data):
            self._call("eeprom_write", address + i, byte)

    def hang(self, *, in_interrupt: bool = False) -> Callable[[], None]:
        """The program runs in circles where it stands, in its main loop or in an interrupt; returns what repairs it."""
        while bool(self._call("interruptible")) == in_interrupt:
            self.run(1.0 / HZ)
        address = self._call("program_counter")
        before = self._call("instruction", address)
        self._call("set_instruction", address, 0xCFFF)  # rjmp to itself
        return lambda: self._call("set_instruction", address, before)

    def _show(self, pin: str, high: bool) -> None:
        self._call("show", pin[0].encode(), int(pin[1]), int(high))

    def _call(self, name: str, *arguments: Any) -> Any:
        if not self._me:
            raise RuntimeError("this robot was closed")
        return getattr(self._lib, f"robot_{name}")(self._me, *arguments)
