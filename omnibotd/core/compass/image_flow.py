"""Flow of a one-dimensional image (thesis, section 4.2.2, algorithm 4.2, its misprints put right)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.compass.round_view import RoundView
from omnibotd.core.compass.turn import BACK, FRONT, SECTOR, Turn

Floats = NDArray[np.float64]

_BIN = math.radians(1.0)
_BINS = round(SECTOR / _BIN) + 1
# Steps below this (bins) end the search, as do 50 of them or a shift of a quarter of the sector [assumed].
_STILL, _STEPS, _FARTHEST = 0.001, 50, (_BINS - 1) / 4.0
# [assumed] Where both slopes agree the weight would be infinite: this share of the mean slope is added.
_SOFTENING = 1e-3


@dataclass(frozen=True, slots=True)
class Shift:
    """Bins by which one signature is shifted against another; not `converged`, the last guess, or 0 where none."""

    bins: float
    converged: bool


class ImageFlow:
    """Algorithm 4.2. Blind where the mean along each radius is the same."""

    def turn(self, before: RoundView, now: RoundView) -> Turn:
        shifts = [displacement(signature(before, middle), signature(now, middle)) for middle in (FRONT, BACK)]
        mean = sum(shift.bins for shift in shifts) / len(shifts)
        return Turn(mean * _BIN, len(shifts) * _BINS, all(shift.converged for shift in shifts))


def signature(view: RoundView, middle: float) -> Floats:
    """Mean brightness (61,) along the radii of the sector round a bearing, a degree apart (Eq 4.7, 4.8)."""
    return np.asarray(view.unrolled(middle - SECTOR / 2.0, _BIN, _BINS).mean(axis=0), np.float64)


def displacement(before: Floats, now: Floats) -> Shift:
    """Bins h for which before(x + h) is now(x), by Lucas and Kanade's steps (Eq 4.10)."""
    bins, shift = np.arange(len(before)), 0.0
    slope, slope_now = np.diff(before), np.diff(now)
    weight = 1.0 / (np.abs(slope_now - slope) + _SOFTENING * float(np.abs(slope).mean()) + 1e-12)
    for _ in range(_STEPS):
        inside = np.flatnonzero((bins[:-1] + shift >= 0.0) & (bins[:-1] + shift <= len(slope) - 1))
        at = inside + shift
        steep = np.interp(at, bins[:-1], slope)
        along = weight[inside] * steep
        energy = float(along @ steep)
        if energy <= 1e-12:
            return Shift(0.0, False)
        step = float(along @ (now[inside] - np.interp(at, bins, before))) / energy
        shift += step
        if abs(shift) > _FARTHEST:
            return Shift(0.0, False)
        if abs(step) < _STILL:
            return Shift(shift, True)
    return Shift(shift, False)
