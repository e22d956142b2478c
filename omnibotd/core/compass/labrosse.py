"""The visual compass of Labrosse (2006): turn a panorama until it is most like the other (thesis, section 3.2.1.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.compass.round_view import RoundView
from omnibotd.core.compass.turn import BACK, FRONT, NO_TURN, SECTOR, Turn
from omnibotd.core.geometry import wrap
from omnibotd.core.vision.frame import FloatImage

Floats = NDArray[np.float64]

_COLUMN = math.radians(1.0)
_COLUMNS = round(SECTOR / _COLUMN) + 1
_FULL_TURN = round(2.0 * math.pi / _COLUMN)
# [assumed] Columns searched to each side before looking all round; how finely the best is told.
_REACH, _FINER = 10, 20
# [assumed] Grey levels of spread below which a panorama shows nothing.
_FLAT = 1.0
# [assumed] A reference is given up when it is this many times as far off as it was at first, or turned so far away.
_WORN, _TURNED = 1.2, math.radians(8.0)


@dataclass(frozen=True, slots=True)
class Match:
    """The turn (rad) and how far apart the two are there: root mean square, grey levels."""

    turn: float
    distance: float


class Labrosse:
    """As the thesis used it: consecutive frames, strong interpolation, patches ahead and behind."""

    def turn(self, before: RoundView, now: RoundView) -> Turn:
        found = match(before, now, 0.0)
        return NO_TURN if found is None else Turn(found.turn, 2 * _COLUMNS)


class ReferenceLabrosse:
    """With a reference that is kept while it matches, so that errors add up by reference and not by frame.

    Made for one drive: `before` must be the view that was `now` the last time.
    """

    def __init__(self) -> None:
        self._reference: RoundView | None = None
        self._turned = 0.0  # since the reference
        self._at_first = math.inf

    def turn(self, before: RoundView, now: RoundView) -> Turn:
        if self._reference is None:
            self._refer_to(before)
        found = match(self._reference or before, now, self._turned)
        if found is None or self._worn(found):
            self._refer_to(before)
            found = match(before, now, 0.0)
        if found is None:
            return NO_TURN
        self._at_first = min(self._at_first, found.distance)
        step, self._turned = wrap(found.turn - self._turned), found.turn
        return Turn(step, 2 * _COLUMNS)

    def _refer_to(self, view: RoundView) -> None:
        self._reference, self._turned, self._at_first = view, 0.0, math.inf

    def _worn(self, found: Match) -> bool:
        return found.distance > _WORN * self._at_first or abs(found.turn) > _TURNED


def match(reference: RoundView, now: RoundView, expected: float) -> Match | None:
    """The turn from the one to the other, looked for near the one expected, else all round; None on a flat view."""
    patches = [now.unrolled(middle - SECTOR / 2.0, _COLUMN, _COLUMNS) for middle in (FRONT, BACK)]
    if max(float(patch.std()) for patch in patches) < _FLAT:
        return None
    around = reference.unrolled(0.0, _COLUMN, _FULL_TURN)
    middle = round(expected / _COLUMN)
    shifts = np.arange(middle - _REACH, middle + _REACH + 1)
    best = int(np.argmin(_distances(around, patches, shifts)))
    if best in (0, len(shifts) - 1):
        shifts = np.arange(_FULL_TURN)
        best = int(np.argmin(_distances(around, patches, shifts)))
    return _refined(reference, patches, wrap(shifts[best] * _COLUMN))


def _distances(around: FloatImage, patches: list[FloatImage], shifts: NDArray[np.int_]) -> Floats:
    """Mean squared differences at turns of whole columns."""
    first = [round((middle - SECTOR / 2.0) / _COLUMN) for middle in (FRONT, BACK)]
    columns = np.arange(_COLUMNS)
    return np.array(
        [
            sum(
                float(((around[:, (start + shift + columns) % _FULL_TURN] - patch) ** 2).mean())
                for start, patch in zip(first, patches, strict=True)
            )
            for shift in shifts
        ]
    )


def _refined(reference: RoundView, patches: list[FloatImage], coarse: float) -> Match:
    """Among twentieths of a column, to one side and the other of a coarse turn."""
    step = _COLUMN / _FINER
    fine = [
        reference.unrolled(middle - SECTOR / 2.0 + coarse - _COLUMN, step, (_COLUMNS + 1) * _FINER + 1)
        for middle in (FRONT, BACK)
    ]
    columns = np.arange(_COLUMNS) * _FINER
    distances = [
        sum(float(((lines[:, k + columns] - patch) ** 2).mean()) for lines, patch in zip(fine, patches, strict=True))
        for k in range(2 * _FINER + 1)
    ]
    best = int(np.argmin(distances))
    return Match(wrap(coarse + (best - _FINER) * step), math.sqrt(distances[best] / 2.0))
