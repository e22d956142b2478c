"""Am I lost? Trust in the tracked pose: earned over metres of agreement, lost within a second or two of disagreement."""

from __future__ import annotations

import math

# A match at the tracked pose of 0.45 says nothing, of 0.65 all it can.
_POOR, _GOOD = 0.45, 0.65
# A candidate elsewhere better than the tracked pose by this contradicts it.
_CONTRADICTED = 0.1
# Lead over everything elsewhere that settles the matter.
_CLEAR_LEAD = 0.15
# Metres of agreement to be convinced, with no lead and with a clear one.
_SLOW, _FAST = 1.5, 0.15
# What the first frame can earn at once.
_AT_FIRST = 0.75
# Share of trust lost a frame when nothing fits; at 5 to 10 frames a second half is gone within a second.
_LOSS = 0.12


class Trust:
    """A number in [0, 1]."""

    def __init__(self) -> None:
        self._value = 0.0
        self._fresh = True

    def update(self, score: float, best: float, margin: float, moved: float) -> float:
        """`score` at the tracked pose, `best` anywhere, `margin` over elsewhere, metres `moved` since the last frame."""
        fit = _ramp(score, _POOR, _GOOD)
        agreement = fit * (1.0 - _ramp(best - score, 0.0, _CONTRADICTED))
        lead = _ramp(margin, 0.0, _CLEAR_LEAD)
        if self._fresh:
            self._fresh = False
            self._value = _AT_FIRST * agreement * lead
        elif agreement >= 0.5:
            length = _SLOW + (_FAST - _SLOW) * lead
            self._value += (1.0 - self._value) * agreement * (1.0 - math.exp(-moved / length))
        else:
            self._value *= 1.0 - _LOSS * (1.0 - 2.0 * agreement)
        return self._value


def _ramp(value: float, low: float, high: float) -> float:
    return min(max((value - low) / (high - low), 0.0), 1.0)
