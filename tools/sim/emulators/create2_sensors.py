"""The sensor packets of the Open Interface: which there are, how large, and what stands in them."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Sensors:
    """Everything that packets tell of; pairs are (left, right), encoders signed 16 bits, distance mm, angle degrees."""

    bumps: int = 0
    cliffs: tuple[int, int, int, int] = (0, 0, 0, 0)  # left, front left, front right, right
    millivolts: int = 15_600
    milliamperes: int = -240
    charging: int = 0
    sources: int = 0
    mode: int = 0
    requested: tuple[int, int] = (0, 0)
    encoders: tuple[int, int] = (0, 0)
    distance: float = 0.0
    angle: float = 0.0


# Bytes of each packet where not one: pairs of big-endian integers, u unsigned.
_WIDE = {
    **dict.fromkeys((19, 20, 23, 39, 40, 41, 42, 43, 44, 54, 55, 56, 57), "h"),
    **dict.fromkeys((22, 25, 26, 27, 28, 29, 30, 31, 33, 46, 47, 48, 49, 50, 51), "H"),
    24: "b",
}
_KINDS = {number: _WIDE.get(number, "B") for number in range(7, 59)}
GROUPS = {
    number: tuple(range(first, last + 1))
    for number, first, last in (
        *((0, 7, 26), (1, 7, 16), (2, 17, 20), (3, 21, 26), (4, 27, 34), (5, 35, 42), (6, 7, 42)),
        *((100, 7, 58), (101, 43, 58), (106, 46, 51), (107, 54, 58)),
    )
}
SIZES = {number: struct.calcsize(">" + kind) for number, kind in _KINDS.items()}
SIZES |= {number: sum(SIZES[member] for member in members) for number, members in GROUPS.items()}

_VALUES: dict[int, Callable[[Sensors], float]] = {
    7: lambda s: s.bumps,
    9: lambda s: s.cliffs[0],
    10: lambda s: s.cliffs[1],
    11: lambda s: s.cliffs[2],
    12: lambda s: s.cliffs[3],
    19: lambda s: s.distance,
    20: lambda s: s.angle,
    21: lambda s: s.charging,
    22: lambda s: s.millivolts,
    23: lambda s: s.milliamperes,
    24: lambda s: 24,
    25: lambda s: 1902,
    26: lambda s: 2068,
    **{number: (lambda s: 2400) for number in (28, 29, 30, 31)},  # the floor seen by the cliff sensors
    34: lambda s: s.sources,
    35: lambda s: s.mode,
    39: lambda s: (s.requested[0] + s.requested[1]) / 2,
    41: lambda s: s.requested[1],
    42: lambda s: s.requested[0],
    43: lambda s: s.encoders[0],
    44: lambda s: s.encoders[1],
    58: lambda s: 1 if sum(s.requested) > 0 else 0,
}


def pack(sensors: Sensors, number: int) -> bytes:
    """The data of a packet or group; what this base does not sense is zero."""
    if number in GROUPS:
        return b"".join(pack(sensors, member) for member in GROUPS[number])
    value = _VALUES[number](sensors) if number in _VALUES else 0
    return struct.pack(">" + _KINDS[number], round(value))
