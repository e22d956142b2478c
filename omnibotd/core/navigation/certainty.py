"""What the place estimates of one job add up to: whether they agree, since when, and over how much motion."""

from __future__ import annotations

import math

from omnibotd.core.decision import Observation
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.percept import PlaceEstimate

SURE = 0.9  # confidence from which a place estimate steers
UNSURE_DISTANCE = 1.5  # m driven without a sure estimate before the robot stops and searches
UNSURE_TIME = 4.0  # s the same, for a robot that stands or creeps
# Two estimates agree when odometry between them explains the second to this much: m, rad, and a share of metres driven
# and angle turned, for wheels that nobody calibrated.
_AGREEMENT, _AGREEMENT_YAW, _AGREEMENT_DRIFT = 0.2, 0.3, 0.1
# Estimates are held against one from before so much motion (m, rad), or a creeping error would pass.
_ANCHOR_METRES, _ANCHOR_TURN = 1.0, math.tau
# In a row, before anything is believed: one lucky frame must not set a robot off.
_IN_A_ROW = 3
# Motion (m, rad) during which estimates must have agreed before a lost robot counts as found: more than the agreement,
# or a place that does not move with the robot would do.
_FOUND_METRES, _FOUND_TURN = 0.3, 0.35
# And before it may say "arrived", so much of the one or the other or both in parts (m, rad): half a metre is two cells
# of a usual ceiling, the other is one turn on the spot.
_PROOF_METRES, _PROOF_TURN = 0.5, math.tau


class Certainty:
    """Follows the estimates of a run: as long as each sure one agrees with those before it."""

    def __init__(self) -> None:
        self.latest: PlaceEstimate | None = None
        self.sure: PlaceEstimate | None = None  # the newest sure one
        self.in_a_row = 0
        self.metres = self.turned = 0.0  # since the run's first sure estimate
        self._odom: Pose2D | None = None
        self._anchor: PlaceEstimate | None = None
        self._anchored = (0.0, 0.0)  # metres and turned when the anchor was dropped
        self._accepted = False

    def restart(self) -> None:
        """What was seen so far proves nothing any more; when it was last sure is remembered."""
        self.in_a_row, self.metres, self.turned = 0, 0.0, 0.0
        self._anchor = None

    def take(self, seen: Observation, here: Pose2D | None) -> None:
        """Once a tick; `here` is the filtered pose after this observation."""
        if self._odom is not None and self._anchor is not None:
            self.metres += self._odom.distance(seen.odom_from_base)
            self.turned += abs(wrap(seen.odom_from_base.yaw - self._odom.yaw))
        self._odom = seen.odom_from_base
        place = seen.place
        if place is None or place is self.latest:
            return
        self.latest = place
        if place.confidence < SURE:
            self.in_a_row = 0
            return
        self._hold_against_anchor(place)
        self.in_a_row += 1
        self.sure = place
        self._accepted = here is not None and _alike(here, carried(place, seen.odom_from_base))

    def _hold_against_anchor(self, place: PlaceEstimate) -> None:
        if self._anchor is not None:
            moved = self._anchor.odom_from_base.distance(place.odom_from_base)
            turned = self.turned - self._anchored[1]
            if not _alike(carried(self._anchor, place.odom_from_base), place.map_from_base, moved, turned):
                self.restart()
        metres, turned = self._anchored if self._anchor is not None else (0.0, 0.0)
        old = self.metres - metres > _ANCHOR_METRES or self.turned - turned > _ANCHOR_TURN
        if self._anchor is None or old:
            self._anchor, self._anchored = place, (self.metres, self.turned)

    def recent(self, seen: Observation) -> bool:
        """Whether the last sure estimate is new enough to go on, in metres and in seconds."""
        seconds, metres = self.since_sure(seen)
        return seconds < UNSURE_TIME and metres < UNSURE_DISTANCE

    def since_sure(self, seen: Observation) -> tuple[float, float]:
        """Seconds and metres since the last sure estimate; infinite where there was none."""
        if self.sure is None:
            return math.inf, math.inf
        return seen.stamp - self.sure.stamp, self.sure.odom_from_base.distance(seen.odom_from_base)

    @property
    def steady(self) -> bool:
        """Several sure estimates in a row that agree with each other, the last one with the filter too."""
        return self.in_a_row >= _IN_A_ROW and self._accepted

    @property
    def found(self) -> bool:
        """Steady, and over some motion: enough to set out."""
        return self.steady and (self.metres >= _FOUND_METRES or self.turned >= _FOUND_TURN)

    @property
    def proven(self) -> bool:
        """Over so much motion that a look-alike place would have shown itself: enough to arrive."""
        return self._accepted and self.metres / _PROOF_METRES + self.turned / _PROOF_TURN >= 1.0


def carried(place: PlaceEstimate, odom_from_base: Pose2D) -> Pose2D:
    """Where an estimate puts the base once it has moved on to `odom_from_base`."""
    return place.map_from_base @ (place.odom_from_base.inverse() @ odom_from_base)


def _alike(expected: Pose2D, pose: Pose2D, moved: float = 0.0, turned: float = 0.0) -> bool:
    near = expected.distance(pose) < _AGREEMENT + _AGREEMENT_DRIFT * moved
    return near and abs(wrap(expected.yaw - pose.yaw)) < _AGREEMENT_YAW + _AGREEMENT_DRIFT * turned
