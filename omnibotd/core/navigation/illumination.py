"""What another light leaves of the likeness of a right pose: learnt over metres on which nothing else comes near.

By night a right pose correlates at 0.35 to 0.7, and everything else far less. A room seen from outside the map, half a
turn round, correlates at 0.5 to 0.7 too; but there something else comes near, or the pose does not follow odometry.
"""

from __future__ import annotations

import math

from omnibotd.core.navigation.sight import Sight, covered, ramp

# The share is never taken for less; metres to learn that it is less, and more.
_DARKEST, _DARKER, _BRIGHTER = 0.4, 0.5, 0.3
# Lead over everything elsewhere, as a share of the score and on the average of so many metres, that teaches not at all
# and fully where look-alikes score 0.5; where they score more, it must be more by this factor.
_LEADING, _LEADING_LENGTH, _REPETITIVE = (0.36, 0.46), 0.7, 1.5
# The same where the rim seconds it, which correlates that much: walls look the same by lamp and by window.
_SECONDED, _RIM = (0.15, 0.3), (0.5, 0.65)
# Root of the squared corrections (m) of the last decimetres, up to which and from which a pose does not follow odometry
# (a right one makes 0.005 in a metre, a wrong one 0.01 to 0.2); what wheels off by so much explain is no correction.
_FOLLOWING, _FOLLOWING_LENGTH, _WHEELS_OFF = (0.04, 0.06), 0.35, 0.1
# Loss of likeness from which, and from which fully, look-alikes are what came near in this light, and so much more.
_ANOTHER_LIGHT, _LOOK_ALIKES = (0.2, 0.4), 0.1


class Illumination:
    """The `share` of the expected likeness that is left in the present light."""

    def __init__(self, chance: float) -> None:
        """`chance` is the score that look-alikes reach in this map."""
        self.share = 1.0
        more = _REPETITIVE * (chance - 0.5)
        self._leading = _LEADING[0] + more, _LEADING[1] + more
        self.start_again()

    def start_again(self) -> None:
        """Another pose is tracked from now on."""
        self._lead, self._squares = 0.0, _FOLLOWING[1] ** 2

    def chance(self, taught: float, score: float) -> float:
        """The score that look-alikes reach in this light, where they reached `taught` while it was taught and the
        tracked pose has `score` now, both as in that light: lamps that are off make no places look alike."""
        left = min(taught, score * (1.0 - self._lead) + _LOOK_ALIKES)
        return taught + (left - taught) * ramp(1.0 - self.share, *_ANOTHER_LIGHT)

    def doubt(self, kept: float) -> None:
        """The tracked pose may have been wrong, and what was learnt with it."""
        self.share = 1.0 - (1.0 - self.share) * kept

    def learn(self, sight: Sight, expected: float) -> None:
        """Take in a frame of the tracked pose, which should score `expected`."""
        lead = max(0.0, sight.score - max(sight.elsewhere, 0.0)) / max(sight.score, 0.1)
        self._lead += (lead - self._lead) * _learnt(sight.moved, _LEADING_LENGTH)
        self._squares *= 1.0 - _learnt(sight.moved, _FOLLOWING_LENGTH)
        self._squares += max(0.0, sight.corrected - _WHEELS_OFF * sight.moved) ** 2
        self._squares = min(self._squares, _FOLLOWING[1] ** 2)
        following = 1.0 - ramp(math.sqrt(self._squares), *_FOLLOWING)
        seconded = sight.at_rim(*_RIM, unseen=0.0) * ramp(self._lead, *_SECONDED)
        worth = following * max(ramp(self._lead, *self._leading), seconded) * covered(sight.unexplained)
        left = min(max(sight.score / max(expected, 0.1), _DARKEST), 1.0)
        self.share += (left - self.share) * worth * _learnt(sight.moved, _DARKER if left < self.share else _BRIGHTER)


def _learnt(moved: float, length: float) -> float:
    return 1.0 - math.exp(-moved / length)
