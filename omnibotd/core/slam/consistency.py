"""Is a filter as good as it says? Innovations while it runs, errors against truth where there is one."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
# The 97.5 % point of the standard normal distribution.
_TWO_SIDED = 1.959964
# Bearings that a verdict rests on: a few views, so that one misread one does not decide, and trouble shows in seconds.
WINDOW, ENOUGH = 60, 20
# Shares of refused bearings. A sensor misreads a few in a hundred; where a third does not fit, map or pose is wrong.
REFUSED_STRAINED, REFUSED_DIVERGED = 0.15, 0.33
# A mean square innovation so many times the expected one is no tuning error any more.
RATIO_DIVERGED = 3.0
# m, standard deviation of the position: who may be so far off is lost in a room, however well innovations fit.
VAGUE = 0.6


class State(Enum):
    """What is to be thought of a filter's pose.

    `BLIND`: next to no bearing helps, the pose is dead reckoning; `VAGUE`: it says itself that it may be far off;
    `STRAINED`: less sure than it says; `DIVERGED`: do not use its pose.
    """

    BLIND = "blind"
    VAGUE = "vague"
    CONSISTENT = "consistent"
    STRAINED = "strained"
    DIVERGED = "diverged"


@dataclass(frozen=True, slots=True)
class Health:
    """Of the last bearings: mean square of normalised innovations (1 is expected), share refused; why, for people."""

    state: State
    innovation: float
    refused: float
    reason: str


class InnovationMonitor:
    """Keeps the last `WINDOW` bearings of mapped landmarks, refused ones too; a divergence once seen is remembered.

    A strain that a whole window does not end is a divergence: real filters that went metres wrong fitted their wrong
    map passably, and were never worse than strained.
    """

    def __init__(self) -> None:
        self._squares: deque[float] = deque(maxlen=WINDOW)
        self._refused: deque[bool] = deque(maxlen=WINDOW)
        self._mapped: deque[bool] = deque(maxlen=WINDOW)
        self._diverged = ""
        self._strained = 0  # bearings since the strain began

    def see(self, mapped: int, unmapped: int) -> None:
        """So many bearings of one view were of landmarks in the map, so many were not."""
        self._mapped.extend([True] * mapped + [False] * unmapped)

    def add(self, squares: Floats, accepted: NDArray[np.bool_]) -> None:
        """Whether each bearing was used, and independent squares (of variance 1) of the innovations that were."""
        self._squares.extend(map(float, squares))
        self._refused.extend(map(bool, ~accepted))
        before, health = self._strained, self._now()
        # A strain begins with the bearings that showed it: only those after them prolong it.
        self._strained = 0 if health.state is not State.STRAINED else before + len(accepted) if before else 1
        if health.state is State.DIVERGED:
            self.fail(health.reason)
        elif self._strained > WINDOW:
            self.fail(f"strained for {self._strained} bearings: {health.reason}")

    def fail(self, reason: str) -> None:
        """Something else proved the filter wrong."""
        self._diverged = self._diverged or reason

    @property
    def health(self) -> Health:
        now = self._now()
        if not self._diverged:
            return now
        return Health(State.DIVERGED, now.innovation, now.refused, self._diverged)

    def _now(self) -> Health:
        refused = sum(self._refused) / len(self._refused) if self._refused else 0.0
        mean = sum(self._squares) / len(self._squares) if self._squares else 1.0
        state, reason = self._verdict(mean, refused)
        return Health(state, mean, refused, reason)

    def _verdict(self, mean: float, refused: float) -> tuple[State, str]:
        if self._mapped.count(True) < ENOUGH:
            return State.BLIND, f"{self._mapped.count(True)} of the last {len(self._mapped)} bearings are in the map"
        if refused > REFUSED_DIVERGED:
            return State.DIVERGED, f"{refused:.0%} of the last {len(self._refused)} bearings contradict the map"
        if mean > RATIO_DIVERGED:
            return State.DIVERGED, f"innovations are {mean:.1f} times their expected square"
        upper = chi_square_band(len(self._squares))[1]
        if refused > REFUSED_STRAINED or mean > upper:
            return State.STRAINED, f"innovations {mean:.1f} times their expected square, {refused:.0%} refused"
        return State.CONSISTENT, "innovations are as expected"


def squared_error(error: Floats, covariance: Floats) -> float:
    """NEES: the square of an error in units of its own covariance; its expectation is the length of `error`."""
    return float(error @ np.linalg.solve(covariance, error))


def chi_square_band(freedom: int, samples: int = 1) -> tuple[float, float]:
    """The central 95 % of the mean over `samples` of chi^2 / `freedom` (Wilson and Hilferty: within 1 % from 10 up)."""
    spread = 2.0 / (9.0 * max(freedom * samples, 1))
    low, high = (1.0 - spread + sign * _TWO_SIDED * math.sqrt(spread) for sign in (-1.0, 1.0))
    return max(low, 0.0) ** 3, high**3
