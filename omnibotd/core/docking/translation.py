"""Where the current view's axis stands in the target view, once it is turned: half-whitened correlation.

The ceiling in view moves as one; walls do not. So beside the whole target, parts of it are looked for: what would be
left of the ceiling if the dock stood at a wall on this or that side, or in a corner.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.vision.frame import FloatImage

Complexes = NDArray[np.complex64]
Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]

# 0 is plain correlation (broad peaks), 1 phase correlation (noise counts as much as structure).
_WHITENING = 0.6
# Neighbourhood of a peak, pixels, within which no second one is looked for; and how near two shifts are one.
_PEAK_RADIUS, _SAME = 2, 1.5
# Peaks kept of each part.
_PEAKS = 2
# The outer part of the view that fades out.
_RIM = 0.3
# A wall this far away (ceiling heights) is where a part ends, softly.
_WALL, _SOFTNESS = 0.35, 0.3


def ceiling_parts(u: Doubles, v: Doubles) -> FloatImage:
    """(9, ...) in [0, 1], which of the rays (u, v, 1) count: all, those on one of four sides, those of a quarter."""
    sides = [np.clip((_WALL - side) / _SOFTNESS, 0.0, 1.0) for side in (u, v, -u, -v)]
    quarters = [sides[k] * sides[(k + 1) % 4] for k in range(4)]
    return np.asarray([np.ones_like(u), *sides, *quarters], np.float32)


@dataclass(frozen=True, slots=True)
class ShiftHypothesis:
    """Position (target pixels) of the current view's axis; `part` of the target found there.

    `peak` in standard deviations of the correlation.
    """

    u: float
    v: float
    part: int
    peak: float


class ShiftSearch:
    """The target's side of the correlation, computed once; shifts up to `reach` pixels each way."""

    def __init__(self, target: FloatImage, focal: float, reach: float) -> None:
        """`target` is edge strength, square; `focal` pixels a ceiling height."""
        size = len(target)
        furthest = min(math.ceil(reach) + 1, size - 1)
        # Wrapped round, the correlation must not reach into the shifts looked at.
        self._padded = cv2.getOptimalDFTSize(size + furthest)
        u, v = np.meshgrid(*[np.arange(size) - (size - 1) / 2.0] * 2)
        self._window = np.clip((1.0 - np.hypot(u, v) / (size / 2.0)) / _RIM, 0.0, 1.0)
        parts = ceiling_parts(u / focal, v / focal)
        self._target = np.stack([self._spectrum(target, self._window * part) for part in parts])
        self._shifts = np.arange(-furthest, furthest + 1)
        # The inverse transform at those shifts alone; the spectrum's other half is conjugate to the one that is kept.
        wave = 2j * math.pi / self._padded
        row, column = np.arange(self._padded), np.arange(self._padded // 2 + 1)
        doubled = np.where((column == 0) | (2 * column == self._padded), 1.0, 2.0)
        self._rows = np.exp(wave * np.outer(self._shifts, row)).astype(np.complex64)
        self._columns = (doubled[:, None] * np.exp(wave * np.outer(column, self._shifts))).astype(np.complex64)

    def find(self, turned: FloatImage, count: int) -> list[ShiftHypothesis]:
        """The `count` best shifts of the current view, turned to face as the target does."""
        cross = self._target * np.conj(self._spectrum(turned, self._window))
        maps = np.ascontiguousarray((self._rows @ (cross @ self._columns)).real)
        maps /= maps.std((1, 2), keepdims=True) + np.float32(1e-9)
        return _distinct(sorted(self._peaks(maps), key=lambda shift: -shift.peak))[:count]

    def _spectrum(self, feature: FloatImage, window: Doubles) -> Complexes:
        mean = float((feature * window).sum()) / max(float(window.sum()), 1.0)
        spectrum = np.fft.rfft2((feature - mean) * window, (self._padded, self._padded))
        return np.asarray(spectrum / (np.abs(spectrum) ** _WHITENING + 1e-6), np.complex64)

    def _peaks(self, maps: Floats) -> list[ShiftHypothesis]:
        """The best of each part; strikes out what it finds."""
        found, parts, place = [], np.arange(len(maps)), np.arange(len(self._shifts))
        for _ in range(_PEAKS):
            row, column = np.divmod(maps.reshape(len(maps), -1).argmax(1), len(place))
            where = zip(self._shifts[column], self._shifts[row], parts, maps[parts, row, column], strict=True)
            found += [ShiftHypothesis(float(u), float(v), int(part), float(peak)) for u, v, part, peak in where]
            rows, columns = (np.abs(place - k[:, None]) <= _PEAK_RADIUS for k in (row, column))
            maps[rows[:, :, None] & columns[:, None, :]] = -np.inf
        return found


def _distinct(shifts: list[ShiftHypothesis]) -> list[ShiftHypothesis]:
    """Without those beside a better one; best first in, best first out."""
    kept: list[ShiftHypothesis] = []
    for shift in shifts:
        if all(math.hypot(shift.u - other.u, shift.v - other.v) > _SAME for other in kept):
            kept.append(shift)
    return kept
