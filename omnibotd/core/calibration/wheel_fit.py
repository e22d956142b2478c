"""Wheels that explain what sight says of turns and drives: weighted least squares."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from omnibotd.core.calibration.panorama import Floats
from omnibotd.core.calibration.phases import Phase

# A wheel slips by so many metres per square root of a metre on a hard floor; sight errs by this share of a drive, and
# by so much in heading (rad).
_SLIP, _SIGHT, _HEADING = 4e-3, 5e-4, 5e-4
# These figures count as much as so many measurements do when errors are judged by what they turn out to be.
_TRUST = 4.0


@dataclass(frozen=True, slots=True)
class Seen:
    """What sight says of a phase: `turned` rad, and `driven` ceiling heights along the arc (0 of a turn)."""

    phase: Phase
    turned: float
    driven: float


@dataclass(frozen=True, slots=True)
class WheelFit:
    """Lengths in ceiling heights, sigmas as shares; `residual` is how much larger errors are than usual."""

    left: float
    right: float
    separation: float
    radius_sigma: float
    ratio_sigma: float
    separation_sigma: float
    residual: float

    @property
    def radius(self) -> float:
        return (self.left + self.right) / 2.0


def fitted(seen: Sequence[Seen], radius: float) -> WheelFit:
    """From turns and drives, at least one of each; `radius` (m) is about that of the wheels, to tell their slip."""
    height = _height(seen, radius)
    rows = [row for one in seen for row in _rows(one, radius, height)]
    sigma = np.array([row[4] for row in rows])
    design, right = np.array([row[:3] for row in rows]) / sigma[:, None], np.array([row[3] for row in rows]) / sigma
    lengths, *_ = np.linalg.lstsq(design, right, rcond=None)
    misfit = float(np.square(design @ lengths - right).sum())
    variance = (_TRUST + misfit) / (_TRUST + max(1, len(rows) - 3))
    covariance = variance * np.linalg.inv(design.T @ design)
    left, right_, separation = (float(length) for length in lengths)
    return WheelFit(
        left,
        right_,
        separation,
        _share(covariance, np.array([0.5, 0.5, 0.0]) / ((left + right_) / 2.0)),
        _share(covariance, np.array([1.0 / left, -1.0 / right_, 0.0])),
        _share(covariance, np.array([0.0, 0.0, 1.0 / separation])),
        math.sqrt(misfit / max(1, len(rows) - 3)),
    )


def _rows(seen: Seen, radius: float, height: float) -> list[tuple[float, float, float, float, float]]:
    """Factors of left, right and separation, what they should add up to, and its standard deviation, in heights."""
    left, right = seen.phase.left, seen.phase.right
    slip = _SLIP * math.sqrt(radius * seen.phase.rolled) / height  # of both wheels together
    separation = abs(radius * (right - left) / seen.turned) / height if seen.phase.turns else 0.0
    turn = (-left, right, -seen.turned, 0.0, math.hypot(slip, _HEADING * separation))
    if seen.phase.turns:
        return [turn]
    return [turn, (left / 2.0, right / 2.0, 0.0, seen.driven, math.hypot(slip / 2.0, _SIGHT * seen.driven))]


def _height(seen: Sequence[Seen], radius: float) -> float:
    """About how high the ceiling is, in metres."""
    drives = [one for one in seen if not one.phase.turns]
    return sum(radius * one.phase.rolled / 2.0 for one in drives) / sum(abs(one.driven) for one in drives)


def _share(covariance: Floats, factors: Floats) -> float:
    return math.sqrt(float(factors @ covariance @ factors))
