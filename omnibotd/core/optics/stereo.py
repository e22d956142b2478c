"""Range from two lines of sight, and motion from one landmark (thesis, sections 2.3 and 4.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from omnibotd.core.optics.rigid import Floats
from omnibotd.core.optics.sensor import ConeSensor, Sights

_PARALLEL = 1e-8  # sine squared of the angle between two lines of sight: 0.006 degrees, 2 km for mirrors 0.2 m apart


@dataclass(frozen=True, slots=True, eq=False)
class Fixes:
    """Points (n, 3), and how far apart (n,) their lines of sight pass, metres; NaN where they meet nowhere ahead."""

    points: Floats
    gap: Floats


@dataclass(frozen=True, slots=True, eq=False)
class StereoPair:
    """Two sensors in one frame, for instance one above the other."""

    upper: ConeSensor
    lower: ConeSensor

    def locate(self, upper: Floats, lower: Floats) -> Fixes:
        """The points that appear at these pixels (n, 2) of the two pictures."""
        return triangulate(self.upper.sights(upper), self.lower.sights(lower))


def triangulate(first: Sights, second: Sights) -> Fixes:
    """The middle of the shortest segment between each two lines of sight."""
    base = second.origin - first.origin
    cos = np.sum(first.direction * second.direction, axis=1)
    ahead, back = (np.sum(base * direction, axis=1) for direction in (first.direction, second.direction))
    sin2 = 1.0 - cos**2
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (ahead - cos * back) / sin2
        s = (cos * ahead - back) / sin2
        meets = (sin2 > _PARALLEL) & (t > 0.0) & (s > 0.0)
    one, two = (at.origin + length[:, None] * at.direction for at, length in ((first, t), (second, s)))
    points = np.where(meets[:, None], 0.5 * (one + two), np.nan)
    return Fixes(points, np.where(meets, np.linalg.norm(two - one, axis=1), np.nan))


def translation(before: Floats, after: Floats, turn: float) -> Floats:
    """How far (2,) a robot went, in its first frame, from (range, bearing) of landmarks (n, 2) before and after.

    `turn`: how far it turned meanwhile. Eqs 4.11-4.16; the median of what the landmarks say.
    """
    if before.shape != after.shape or not len(before):
        raise ValueError(f"landmarks {before.shape} before and {after.shape} after: give the same ones, at least one")
    start, end = (
        polar[:, :1] * np.stack([np.cos(polar[:, 1]), np.sin(polar[:, 1])], axis=1) for polar in (before, after)
    )
    cos, sin = np.cos(turn), np.sin(turn)
    return np.asarray(np.median(start - end @ np.array([[cos, sin], [-sin, cos]]), axis=0), np.float64)
