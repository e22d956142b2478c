"""Am I lost? Trust in the tracked pose: earned over metres of agreement, lost within a second or so of disagreement."""

from __future__ import annotations

import math
from dataclasses import dataclass

# A match at the tracked pose of 0.45 says nothing, of 0.65 all it can.
_POOR, _GOOD = 0.45, 0.65
# A better match elsewhere contradicts: by how much better, and how good it must be itself.
_BETTER, _MUCH_BETTER = 0.1, 0.3
_CREDIBLE, _STRONG = 0.45, 0.65
# Lead over everything elsewhere that settles the matter.
_CLEAR_LEAD = 0.15
# Metres of agreement to be convinced, with no lead and with a clear one.
_SLOW, _FAST = 1.5, 0.15
# Fit times lead at which a view that broke off counts as found again.
_REGAINED = 0.6
# What the first frame can earn at once, and what a frame at rest with a clear lead is worth in metres.
_AT_FIRST, _AT_REST = 0.75, 0.02
# Shares of trust lost a frame: contradicted by another place; or nothing fits where nodes are near. At 5 to 10 frames a
# second a kidnapped robot doubts within half a second, and so does one under a cover.
_CONTRADICTED, _UNFIT = 0.6, 0.25
# Between the paths driven while teaching nothing is expected to fit, and trust lasts these metres of odometry.
_BLIND = 3.0
# Distances to the nearest node (m) from which less and nothing is expected.
_COVERED, _UNCOVERED = 0.12, 0.35


@dataclass(frozen=True, slots=True)
class Sight:
    """What one frame says about the tracked pose: `score` there, best score `elsewhere`, metres to the `nearest` node,
    metres `moved` since the frame before, and whether this frame `continues` that one."""

    score: float
    elsewhere: float
    nearest: float
    moved: float
    continues: bool = True


class Trust:
    """A number in [0, 1] for one tracked pose."""

    def __init__(self) -> None:
        self.value = 0.0
        self._fresh = True
        self.broken = False  # the view changed at once and has fitted nothing since: covered, or carried away

    def start_again(self) -> None:
        """Another pose is tracked from now on."""
        self._fresh = True

    def update(self, sight: Sight) -> float:
        """Take a frame into account; returns the new value."""
        fit = ramp(sight.score, _POOR, _GOOD)
        lead = ramp(sight.score - sight.elsewhere, 0.0, _CLEAR_LEAD)
        contradicted = ramp(sight.elsewhere - sight.score, _BETTER, _MUCH_BETTER)
        contradicted *= ramp(sight.elsewhere, _CREDIBLE, _STRONG)
        self.broken = (self.broken or not sight.continues) and fit * lead < _REGAINED
        if self._fresh:
            self._fresh = False
            self.value = _AT_FIRST * fit * lead
            return self.value
        length = _SLOW + (_FAST - _SLOW) * lead
        gained = 1.0 - math.exp(-(sight.moved + _AT_REST * lead) / length)
        self.value += (1.0 - self.value) * fit * (1.0 - contradicted) * gained
        self.value *= 1.0 - _CONTRADICTED * contradicted
        expected = 1.0 if self.broken else covered(sight.nearest)
        self.value *= 1.0 - _UNFIT * (1.0 - fit) * expected
        self.value *= math.exp(-sight.moved / _BLIND * (1.0 - fit))
        return self.value


def covered(nearest: float) -> float:
    """1 where a node is near enough that its view must fit, 0 where none is."""
    return 1.0 - ramp(nearest, _COVERED, _UNCOVERED)


def ramp(value: float, low: float, high: float) -> float:
    """0 up to `low`, 1 from `high`, straight between."""
    return min(max((value - low) / (high - low), 0.0), 1.0)
