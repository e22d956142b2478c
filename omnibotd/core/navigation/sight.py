"""What one frame says about the tracked pose, and what it should say of a right one."""

from __future__ import annotations

import math
from dataclasses import dataclass

# Unexplained variance from which less, and nothing, is expected of a match.
_COVERED, _UNCOVERED = 0.2, 0.7
# Correlation expected at a pose, from the variance that its nodes leave unexplained: that much, and noise, and what the
# coding of snapshots costs.
_NOISE, _EXPLAINED, _CODED = 0.08, 1.2, 0.93


@dataclass(frozen=True, slots=True)
class Sight:
    """What one frame says about the tracked pose: `score` there, best score `elsewhere`, share of variance left
    `unexplained` by the nodes there, metres `moved` since the frame before, metres by which the pose was `corrected`
    then, whether the frame `continues` that one, and how the `rim` of the view correlates there (NaN where the lens
    does not see that far)."""

    score: float
    elsewhere: float
    unexplained: float
    moved: float
    corrected: float = 0.0
    continues: bool = True
    rim: float = math.nan

    def at_rim(self, low: float, high: float, *, unseen: float) -> float:
        """0 where the rim correlates at `low` or less, 1 from `high` on, `unseen` where there is none to see."""
        return unseen if math.isnan(self.rim) else ramp(self.rim, low, high)


def expected_score(unexplained: float) -> float:
    """Correlation with the predicted view that a right pose reaches in unchanged light."""
    return _CODED * math.sqrt(max(0.0, 1.0 - _EXPLAINED * (unexplained + _NOISE)))


def covered(unexplained: float) -> float:
    """1 where nodes are near enough that a view must fit, 0 where none is."""
    return 1.0 - ramp(unexplained, _COVERED, _UNCOVERED)


def ramp(value: float, low: float, high: float) -> float:
    """0 up to `low`, 1 from `high`, straight between."""
    return min(max((value - low) / (high - low), 0.0), 1.0)
