"""The Open Interface's bytes: the commands the driver `create2` uses, and the sensor stream it asks for.

After iRobot Create 2 Open Interface (2016); big-endian. The stream has a frame and a checksum, commands have neither.
"""

from __future__ import annotations

import enum
import struct
from dataclasses import dataclass

# Zeros are no command. As many as the longest command can still wait for (a list of all 52 packets; a song has 34
# bytes) complete any that was cut short, by a lost byte or by a host that died in the middle of it; four do for a
# set-point.
FLUSH, SHORT_FLUSH = bytes(53), bytes(4)
START, SAFE, FULL = bytes((128,)), bytes((131,)), bytes((132,))  # START leads to Passive from any mode
_DRIVE_DIRECT, _STREAM = 145, 148

# Packets of the stream: id and how its data is packed. In order: bumpers and wheel drops, four cliffs, overcurrent,
# charging state, millivolts, charging sources, mode, requested speeds right and left, encoders left and right.
_PACKETS = (
    *((7, "B"), (9, "B"), (10, "B"), (11, "B"), (12, "B"), (14, "B"), (21, "B"), (22, "H"), (34, "B"), (35, "B")),
    *((41, "h"), (42, "h"), (43, "H"), (44, "H")),
)
_LAYOUT = struct.Struct(">" + "".join(f"B{kind}" for _, kind in _PACKETS))
_IDS = tuple(packet for packet, _ in _PACKETS)
_HEAD = bytes((19, _LAYOUT.size))
FRAME = len(_HEAD) + _LAYOUT.size + 1
REQUEST = bytes((_STREAM, len(_IDS), *_IDS))

# Random bytes look so much like text once in a year of a full line; a corrupted frame, full of ids, never does.
TEXT_RUN = 32
_TEXT = frozenset((*range(32, 127), 9, 10, 13))


class Mode(enum.IntEnum):
    """Who has the base: nobody, its own buttons, or the host with or without the base's own safety."""

    OFF = 0
    PASSIVE = 1
    SAFE = 2
    FULL = 3


@dataclass(frozen=True, slots=True)
class Report:
    """One frame of the stream; encoders as they came (16 bits), requested speeds in mm/s."""

    bumper_left: bool
    bumper_right: bool
    cliff: bool
    wheel_drop: bool
    overcurrent_left: bool
    overcurrent_right: bool
    charging: bool
    plugged_in: bool  # a charger in the socket; the contacts of the home base are none
    millivolts: int
    mode: Mode
    requested: tuple[int, int]
    encoders: tuple[int, int]


@dataclass(frozen=True, slots=True)
class BootText:
    """The base prints what it prints when it starts."""


def drive_direct(left: int, right: int) -> bytes:
    """Wheel speeds in mm/s, behind whatever a set-point cut short still waits for."""
    return SHORT_FLUSH + struct.pack(">Bhh", _DRIVE_DIRECT, right, left)


class StreamDecoder:
    """Finds the frames of REQUEST among anything; holds back less than one frame."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._text = 0  # characters in a row that belong to no frame

    def feed(self, data: bytes) -> list[Report | BootText]:
        """What `data` completes, in order."""
        self._buffer += data
        found: list[Report | BootText] = []
        start = 0
        while (head := self._buffer.find(_HEAD[0], start)) >= 0 and head + FRAME <= len(self._buffer):
            report = _parse(self._buffer[head : head + FRAME])
            end = head if report else head + 1
            found += self._skipped(start, end)
            start = end
            if report:
                found.append(report)
                start, self._text = head + FRAME, 0
        end = head if head >= 0 else len(self._buffer)
        found += self._skipped(start, end)
        del self._buffer[:end]
        return found

    def _skipped(self, start: int, end: int) -> list[BootText]:
        found = []
        for byte in self._buffer[start:end]:
            self._text = self._text + 1 if byte in _TEXT else 0
            if self._text == TEXT_RUN:
                found.append(BootText())
        return found


def _parse(frame: bytes | bytearray) -> Report | None:
    """None for what is no whole frame of the packets asked for."""
    if frame[:2] != _HEAD or sum(frame) & 0xFF:
        return None
    fields = _LAYOUT.unpack_from(frame, len(_HEAD))
    if fields[::2] != _IDS:
        return None
    return _report(*fields[1::2])


def _report(bumps: int, *rest: int) -> Report | None:
    cliffs, (current, charging, millivolts, sources, mode, right, left, *encoders) = rest[:4], rest[4:]
    if bumps > 15 or max(cliffs) > 1 or charging > 5 or sources > 3 or mode > Mode.FULL:
        return None  # bits that do not exist: two errors that the sum could not tell
    return Report(
        bumper_left=bool(bumps & 2),
        bumper_right=bool(bumps & 1),
        cliff=any(cliffs),
        wheel_drop=bool(bumps & 12),
        overcurrent_left=bool(current & 16),
        overcurrent_right=bool(current & 8),
        charging=bool(sources) or charging in (1, 2, 3),
        plugged_in=bool(sources & 1),
        millivolts=millivolts,
        mode=Mode(mode),
        requested=(left, right),
        encoders=(encoders[0], encoders[1]),
    )
