"""What a V4L2 camera offers, and what is best taken of it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction

# In order of preference: a JPEG is passed on as it came, recorded as it came, and decoded just as large as needed;
# of the others the brightness is taken, grey first, for it has no colours to carry.
FORMATS = ("MJPG", "JPEG", "GREY", "NV12", "NV21", "YU12", "YV12", "YUYV", "UYVY")


@dataclass(frozen=True, slots=True)
class Wanted:
    """Size and rate to come as near to as the camera can; None for exposure (s) and white balance (K): automatic."""

    width: int
    height: int
    fps: float
    exposure: float | None = None
    white_balance: int | None = None


@dataclass(frozen=True, slots=True)
class Mode:
    """One way to stream: pixel format, size, seconds from frame to frame."""

    fourcc: str
    width: int
    height: int
    interval: Fraction

    @property
    def fps(self) -> float:
        return float(1 / self.interval)

    def __str__(self) -> str:
        return f"{self.fourcc} {self.width}x{self.height} at {self.fps:g} Hz"


@dataclass(frozen=True, slots=True)
class Stream:
    """What a camera that was opened settled on; exposure (s) and white balance (K) where they are locked."""

    card: str
    mode: Mode
    exposure: float | None = None
    white_balance: int | None = None
    warnings: tuple[str, ...] = ()


def best(modes: Iterable[Mode], wanted: Wanted) -> Mode | None:
    """The mode to use, None where all have formats that we can't read.

    The size counts most, for the lens is known at one size only; then that the rate is not below the wanted one; then
    the format; then that no frames come that nobody looks at.
    """
    usable = [mode for mode in modes if mode.fourcc in FORMATS]
    return min(usable, key=lambda mode: _cost(mode, wanted), default=None)


def _cost(mode: Mode, wanted: Wanted) -> tuple[float, float, int, float]:
    size = abs(math.log(mode.width / wanted.width)) + abs(math.log(mode.height / wanted.height))
    too_slow = max(0.0, wanted.fps / mode.fps - 1.0)
    return round(size, 6), round(too_slow, 3), FORMATS.index(mode.fourcc), mode.fps


def differences(mode: Mode, wanted: Wanted) -> tuple[str, ...]:
    """What of the wanted the camera does not do, and what that means, for a person."""
    told = []
    if (mode.width, mode.height) != (wanted.width, wanted.height):
        told.append(
            f"the camera has no {wanted.width}x{wanted.height}: it gives {mode.width}x{mode.height}; set camera.width "
            "and camera.height to that, and calibrate at that size"
        )
    if mode.fps < 0.95 * wanted.fps:
        told.append(f"the camera gives {mode.fps:g} frames a second at this size, not {wanted.fps:g}")
    return tuple(told)
