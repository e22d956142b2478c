"""Pictures taken on the way, each with the odometry at its stamp: what calibrations work on."""

from __future__ import annotations

import math
from dataclasses import dataclass

from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.vision.frame import Frame

# Turned (rad) or driven (m) since the look before: 50 looks a turn, and views that overlap almost wholly.
_TURN, _WAY = math.radians(6.5), 0.05
# A base that has moved less than this (rad, m) between two frames stands: where it stands, odometry owes no lag.
_STILL = 1e-4
# A calibration of the base takes 600, more where wheels are badly wrong; about 28 MB of JPEG.
CAPACITY = 700


@dataclass(frozen=True, slots=True)
class Look:
    """A full-size frame and the wheels' odom_from_base at its stamp."""

    frame: Frame
    odom_from_base: Pose2D


class Looks:
    """Collects looks while a calibration moves: give it every frame, it keeps those that show something new."""

    def __init__(self) -> None:
        self._kept: list[Look] = []
        self._last: Pose2D | None = None

    @property
    def kept(self) -> tuple[Look, ...]:
        return tuple(self._kept)

    def take(self, frame: Frame, odom_from_base: Pose2D) -> None:
        """Keep the frame if the base has gone on since the last one kept, or has just come to rest."""
        moving = self._last is not None and _moved(self._last, odom_from_base, _STILL, _STILL)
        self._last = odom_from_base
        if len(self._kept) < CAPACITY and self._new(odom_from_base, at_rest=not moving):
            self._kept.append(Look(frame, odom_from_base))

    def _new(self, odom_from_base: Pose2D, at_rest: bool) -> bool:
        if not self._kept:
            return True
        before = self._kept[-1].odom_from_base
        return _moved(before, odom_from_base, *((_STILL, _STILL) if at_rest else (_TURN, _WAY)))


def _moved(before: Pose2D, now: Pose2D, turn: float, way: float) -> bool:
    """Whether the base has turned or driven that far."""
    return abs(wrap(now.yaw - before.yaw)) >= turn or before.distance(now) >= way
