"""Am I lost? Trust in the tracked pose: earned over metres of agreement, lost within a second or so of disagreement."""

from __future__ import annotations

import math
from dataclasses import replace

from omnibotd.core.navigation.illumination import Illumination
from omnibotd.core.navigation.sight import Sight, covered, expected_score, ramp

# A match is as good as can be expected from so much below what the nodes round about predict, and no match at all from
# so much more: changed lamps cost 0.05 to 0.15 of correlation, a low sun 0.3.
_SLACK, _TOO_LOW = 0.15, 0.35
# Nor is what look-alikes reach a match, down to so much below what is expected.
_SURPASSING = 0.2
# Where half a room is like the other half, a pose in the wrong one matches under the ceiling as a right one does in
# another light, but not at the walls. So the rim must fit, from and up to these correlations, unless the whole fits to
# within so much of what is expected: furniture is moved, and people stand about.
_RIM_FITS, _WHOLE_FITS = (0.35, 0.6), (0.12, 0.04)
# Where lamps are all alike the whole fits under each of them, and the rim half: by so much more it must fit there. Of
# rendered halls the right one's correlates at 0.75 or more, others' at 0.64 at most.
_RIM_UNLIKE = (0.25, 0.15)
# A rim that fits so well is as good as a clear lead, also where one lamp is like the next.
_RIM_LEADS = (0.65, 0.85)
# Share of the way from the look-alikes' level to a perfect match at which a match can be no look-alike.
_DISTINCT = 0.4
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
# Share of a correction's log odds that trust is lowered by.
_SHAKEN = 0.25
# Belief to confidence, fitted on 48,000 frames in six simulated rooms in five lights, carried every 20 s; those from
# outside the map count two and a half times. Log odds added, more of them where look-alikes stay below the first level
# and no longer from the second on, and a factor. Log odds taken off from there to where a ceiling is the same again and
# again: a robot carried off in a hall believed in the wrong lamp.
_MODESTY, _CAUTION, _REPETITIVE, _SPREAD = 1.7, 1.4, (0.55, 0.8), 0.85
_PERIODIC, _DOUBLES = 1.2, (0.72, 0.82)


class Trust:
    """A number in [0, 1] for one tracked pose; `chance` is the score that look-alikes reach in this map."""

    def __init__(self, chance: float) -> None:
        self.value = 0.0
        self.broken = False  # the view changed at once and has fitted nothing since: covered, or carried away
        self._chance = chance
        self.light = Illumination(chance)
        self._anew = 0.0  # trust earned since the view broke off
        self._fresh = True

    def _break_off(self, continues: bool, fitting: float) -> None:
        """A view that changed at once: until it fits as before, or was agreed with anew, the old trust is not spent."""
        if not self.broken and not continues:
            self.broken, self._anew = True, 0.0
        if self.broken and fitting >= _REGAINED:
            self.broken = False
        elif self.broken and self._anew >= _REGAINED:
            self.broken, self.value = False, self._anew

    def start_again(self) -> None:
        """Another pose is tracked from now on."""
        self._fresh, self._anew = True, 0.0
        self.light.start_again()

    def shake(self, strain: float) -> None:
        """The tracked pose had to be corrected by more than odometry errs: `strain` is the log odds against that."""
        shaken = math.exp(-_SHAKEN * strain)
        self.value, self._anew = self.value * shaken, self._anew * shaken
        self.light.doubt(shaken)

    def update(self, sight: Sight) -> float:
        """Take a frame into account; returns the new value."""
        expected = expected_score(sight.unexplained)
        self.light.learn(sight, expected)
        whole = ramp(sight.score, expected - _WHOLE_FITS[0], expected - _WHOLE_FITS[1])
        # As it would be in the light of the teaching drive.
        sight = replace(sight, score=sight.score / self.light.share, elsewhere=sight.elsewhere / self.light.share)
        chance = self.light.chance(self._chance, sight.score)
        repetitive = ramp(chance, *_REPETITIVE)
        no_better = min(chance, expected - _SURPASSING)
        fit = ramp(sight.score, max(expected - _TOO_LOW, no_better, 0.3), max(expected - _SLACK, 0.5))
        low, high = (limit + repetitive * more for limit, more in zip(_RIM_FITS, _RIM_UNLIKE, strict=True))
        fit *= max(sight.at_rim(low, high, unseen=1.0), whole * (1.0 - repetitive))
        distinct = ramp(sight.score, chance, chance + _DISTINCT * (1.0 - chance))
        lead = ramp(sight.score - sight.elsewhere, 0.0, _CLEAR_LEAD) * distinct
        lead = max(lead, sight.at_rim(*_RIM_LEADS, unseen=0.0))
        contradicted = ramp(sight.elsewhere - sight.score, _BETTER, _MUCH_BETTER)
        contradicted *= ramp(sight.elsewhere, _CREDIBLE, _STRONG)
        self._break_off(sight.continues, fit * lead)
        if self._fresh:
            self._fresh = False
            self.value = _AT_FIRST * fit * lead
            return self.value
        length = _SLOW + (_FAST - _SLOW) * lead
        gained = 1.0 - math.exp(-(sight.moved + _AT_REST * lead) / length)
        self.value += (1.0 - self.value) * fit * (1.0 - contradicted) * gained
        kept = (1.0 - _CONTRADICTED * contradicted) * math.exp(-sight.moved / _BLIND * (1.0 - fit))
        kept *= 1.0 - _UNFIT * (1.0 - fit) * (1.0 if self.broken else covered(sight.unexplained))
        self.value *= kept
        if not self.broken:
            return self.value
        self._anew = (self._anew + (1.0 - self._anew) * fit * (1.0 - contradicted) * gained) * kept
        return max(self.value * fit * lead, self._anew)


def calibrated(belief: float, chance: float) -> float:
    """The share of poses held with so much belief that are right: trust counts evidence cautiously, and too cautiously
    where no place looks like another."""
    odds = _MODESTY + _CAUTION * (1.0 - ramp(chance, *_REPETITIVE)) - _PERIODIC * ramp(chance, *_DOUBLES)
    odds += _SPREAD * math.log((belief + 1e-6) / (1.0 - belief + 1e-6))
    return 1.0 / (1.0 + math.exp(-odds))
