"""How far a robot has turned from look to look, by sight, however wrong its wheels and its camera's centre."""

from __future__ import annotations

import math

import numpy as np

from omnibotd.core.calibration.panorama import COLUMN_STEP, COLUMNS, Floats, Grid, Pictures, contrast
from omnibotd.core.calibration.turn import Turn
from omnibotd.core.vision.camera_model import CameraModel

# Smooth enough (cells) to bear a centre that is 10 px off.
_BLUR = 2.5
# Wheels err by less than this share of a turn; and a picture's stamp by less than so many cells of turning.
_WHEEL_ERROR, _STAMP_ERROR = 0.3, 8


def seen_headings(camera: CameraModel, grid: Grid, pictures: Pictures, wheel_headings: Floats) -> Floats:
    """(n,) rad, the first 0, not wrapped; `wheel_headings` (n,) rad say where to look, not wrapped either."""
    turn = Turn.start(camera, grid, np.zeros(1), np.zeros(1))
    zenith, bearing, nearness = grid.nodes(turn.nearness)
    places = grid.between_nodes(turn.pixels(0, zenith, bearing, nearness))
    views = (contrast(pictures.view(k, *places), _BLUR).cells for k in range(len(pictures.grey)))
    spectra = (np.fft.rfft(grid.worth * each, axis=1) for each in views)
    headings, before = [0.0], next(spectra)
    for spectrum, wheels in zip(spectra, np.diff(wheel_headings), strict=True):
        alike = np.fft.irfft((spectrum.conj() * before).sum(0), COLUMNS)
        headings.append(headings[-1] + _best_shift(alike, float(wheels) / COLUMN_STEP) * COLUMN_STEP)
        before = spectrum
    return np.array(headings)


def _best_shift(alike: Floats, expected: float) -> float:
    """Columns, near those expected, by which two views are most alike; to a fraction (parabola)."""
    middle, reach = round(expected), _STAMP_ERROR + math.ceil(_WHEEL_ERROR * abs(expected))
    shifts = np.arange(middle - reach, middle + reach + 1)
    best = int(shifts[np.argmax(alike[shifts % COLUMNS])])
    before, peak, after = alike[np.arange(best - 1, best + 2) % COLUMNS]
    bend = before - 2.0 * peak + after
    return best + (0.0 if bend >= 0.0 else min(0.5, max(-0.5, 0.5 * (before - after) / bend)))
