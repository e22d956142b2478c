"""How good a visual compass is, by the protocol of section 4.4."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tools.reproduction.compass_drive import RATE

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """Of one method on one drive: errors (true less estimated) in rad a frame, drift in rad/s, failed pairs, and the
    headings (n,) that it makes and that were true."""

    mean: float
    sigma: float
    pmcc: float
    drift: float
    failures: int
    heading: Floats
    true_heading: Floats

    @classmethod
    def of(cls, true: Floats, estimated: Floats, failures: int) -> Score:
        """From the turns (n - 1,) between frames."""
        error = true - estimated
        seconds = np.arange(1, len(error) + 1) / RATE
        drift = robust_slope(seconds, np.abs(np.cumsum(error)))
        headings = (np.concatenate([[0.0], np.cumsum(turns)]) for turns in (estimated, true))
        return cls(float(error.mean()), float(error.std()), pmcc(true, estimated), drift, failures, *headings)


def pmcc(true: Floats, estimated: Floats) -> float:
    """Pearson's correlation; 0 where one of the two never changes."""
    if min(true.std(), estimated.std()) < 1e-12:
        return 0.0
    return float(np.corrcoef(true, estimated)[0, 1])


def robust_slope(x: Floats, y: Floats) -> float:
    """Of a line through the points: iteratively reweighted least squares with bisquare weights (tuning 4.685)."""
    design, weight = np.column_stack([x, np.ones_like(x)]), np.ones_like(x)
    line = np.zeros(2)
    for _ in range(50):
        root = np.sqrt(weight)
        before, line = line, np.linalg.lstsq(design * root[:, None], y * root, rcond=None)[0]
        residual = y - design @ line
        scale = float(np.median(np.abs(residual - np.median(residual)))) / 0.6745
        relative = residual / (4.685 * max(scale, 1e-12))
        weight = np.where(np.abs(relative) < 1.0, (1.0 - relative**2) ** 2, 0.0)
        if math.dist(before, line) < 1e-12:
            break
    return float(line[0])
