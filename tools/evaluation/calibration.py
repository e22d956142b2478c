"""Is a confidence of 95 % right 95 times in 100? Place estimates beside the truth: reliability and its error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import fmean

RIGHT = 0.25  # m: what the confidence of a place estimate is about
# Finer where it matters: whether 0.9 or 0.99 was meant decides how often a robot may be wrong.
EDGES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 1.0)


@dataclass(frozen=True, slots=True)
class Estimate:
    """What a place estimate claimed, and how far (m) from the truth it was."""

    confidence: float
    error_m: float


@dataclass(frozen=True, slots=True)
class Bin:
    """Estimates with confidences in [low, high), the last with its end: the mean, and the share that was right."""

    low: float
    high: float
    confidence: float
    right: float
    count: int


@dataclass(frozen=True, slots=True)
class Calibration:
    """Bins that hold anything; `error` is the expected calibration error, the mean gap weighted by counts."""

    n: int
    error: float
    bins: tuple[Bin, ...]

    @classmethod
    def of(cls, estimates: Sequence[Estimate]) -> Calibration:
        bins = tuple(made for low, high in pairwise(EDGES) if (made := _bin(estimates, low, high)))
        gap = sum(b.count * abs(b.right - b.confidence) for b in bins)
        return cls(len(estimates), gap / len(estimates) if estimates else 0.0, bins)


def _bin(estimates: Sequence[Estimate], low: float, high: float) -> Bin | None:
    inside = [e for e in estimates if low <= e.confidence < high or e.confidence == high == EDGES[-1]]
    if not inside:
        return None
    right = sum(e.error_m <= RIGHT for e in inside) / len(inside)
    return Bin(low, high, fmean(e.confidence for e in inside), right, len(inside))
