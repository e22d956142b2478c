"""How near what a key view shows is: the ceiling where it must be, walls where they turn out to be.

Nearness is the inverse of the distance along a ray; the unit of length is the height of the ceiling above the camera,
so that the ceiling's plane has nearness z in a ray of height z. What is nearer moves more when the robot drives, and
how much more is learnt cell by cell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.compass.contrast import Contrast
from omnibotd.core.compass.key_points import KeyPoints, cell_names
from omnibotd.core.geometry import Pose2D
from omnibotd.core.vision.frame import FloatImage

Floats = NDArray[np.float64]

# Overhead: within 5 % or so of the plane. From 40 to 55 degrees off the zenith walls begin, 1.3 heights off, more or
# less.
_PLANE, _WALL = 0.05, 0.6
_WALLS_FROM, _WALLS_ALL = math.radians(40.0), math.radians(55.0)
_TYPICAL_WALL = 0.75
# Of the zenith angles below which all is ceiling, a few cells at least say how high that is.
_OVERHEAD, _FEWEST = math.cos(_WALLS_FROM), 3
# A cell's things are not all equally near: however many frames say so, it is known to no better than this share. Known
# better, errors of the sides outvote what is ahead and behind, and driving leaks into the turn.
_MIXED = 0.05
# A cell seen from a new place holds other points, too: what was known of it counts half.
_HANDED_ON = 2.0
# What is known to this share of the plane, and no more off it, may be ceiling. Where half of what is low may be, this
# is a hall, and all that may be ceiling is, exact to the second share: left free, a lens centred a few pixels wrong is
# taken for nearness, and a part of every turn with it. The median of what is low is off by 0.18 under a real lamp grid,
# by 0.05 in simulated halls, and by 0.6 and more in rooms, which walls stand round (single frames: 0.34).
_AT_PLANE, _EXACT = 0.25, 0.002
# Frames compared with one key view share its noise: each counts as a fifth of a new one.
_NEW = 0.2


@dataclass(slots=True, eq=False)
class Nearness:
    """Of each cell of a key view: how near the ceiling's plane is, how much nearer it is, and the variance."""

    plane: Floats
    excess: Floats
    variance: Floats

    @classmethod
    def guessed(cls, points: KeyPoints) -> Nearness:
        """Before anything moved."""
        plane = np.bincount(points.cell, points.z) / np.bincount(points.cell)
        zenith = np.arccos(plane)
        wall = np.clip((zenith - _WALLS_FROM) / (_WALLS_ALL - _WALLS_FROM), 0.0, 1.0)
        excess = wall * np.maximum(0.0, _TYPICAL_WALL * np.sin(zenith) - np.cos(zenith))
        return cls(plane, excess, (_PLANE + wall * _WALL) ** 2)

    def at(self, points: KeyPoints) -> FloatImage:
        """(N,) of each point."""
        return np.asarray(points.z + self.excess[points.cell], np.float32)

    def believed(self) -> Nearness:
        """What to locate by: as learnt, but in a hall the plane itself for all that may be on it."""
        low, near = self.plane <= _OVERHEAD, _AT_PLANE * self.plane
        ceiling = (np.abs(self.excess) < near) & (self.variance < near**2)
        if 2 * np.count_nonzero(ceiling & low) <= np.count_nonzero(low):
            return self
        excess = np.where(ceiling, 0.0, self.excess)
        return Nearness(self.plane, excess, np.where(ceiling, (_EXACT * self.plane) ** 2, self.variance))

    def learn(self, excess: Floats, information: Floats) -> None:
        """Take in what one frame says of each cell's excess, and how surely."""
        information = _NEW * information
        share = information / (information + 1.0 / self.variance)
        self.excess += share * (excess - self.excess)
        self.variance *= 1.0 - share
        self._hold()

    def _hold(self) -> None:
        """All nearer and all motion shorter looks the same: what is overhead holds the scale, by its median."""
        near = self.plane + self.excess
        overhead = self.plane > _OVERHEAD
        if np.count_nonzero(overhead) >= _FEWEST:
            near /= np.median(near[overhead] / self.plane[overhead])
        self.excess = near - self.plane
        self.variance = np.maximum(self.variance, (_MIXED * near) ** 2)

    def inherit(
        self, points: KeyPoints, older: Nearness, its: KeyPoints, older_from_this: Pose2D, contrast: Contrast
    ) -> None:
        """Take over what another key view has learnt of the same things, seen from where that one stands."""
        near, (x, y, z) = older.at(its), seen_from(older_from_this, its, older.at(its))
        away = np.sqrt(x * x + y * y + z * z)  # in units of the distance it had
        across = np.maximum(np.hypot(x, y), 1e-9)
        radius = contrast.focal * np.arctan2(across, z)
        names = cell_names(radius * x / across, radius * y / across, contrast)
        place = np.minimum(np.searchsorted(points.names, names), len(points.names) - 1)
        same = points.names[place] == names
        excess = ((near - z) / away)[same]
        self._take(place[same], excess, 1.0 / (_HANDED_ON * older.variance[its.cell[same]]))

    def _take(self, cells: NDArray[np.intp], excess: FloatImage, weight: Floats) -> None:
        count, total = (np.bincount(cells, w, len(self.excess)) for w in (None, weight))
        known = np.flatnonzero(count)
        mean = np.bincount(cells, weight * excess, len(self.excess))[known] / total[known]
        square = np.bincount(cells, weight * excess**2, len(self.excess))[known] / total[known]
        # Where a cell holds near and far things, their spread is what it is unsure by.
        variance = count[known] / total[known] + np.maximum(square - mean**2, 0.0)
        self.excess[known] = mean
        self.variance[known] = np.minimum(variance, self.variance[known])


def seen_from(pose: Pose2D, points: KeyPoints, near: FloatImage) -> tuple[FloatImage, FloatImage, FloatImage]:
    """Rays to the points' things from another place, in units of the distance they had."""
    cos, sin = np.float32(math.cos(pose.yaw)), np.float32(math.sin(pose.yaw))
    dx, dy = points.x - near * np.float32(pose.x), points.y - near * np.float32(pose.y)
    return np.asarray(cos * dx + sin * dy, np.float32), np.asarray(cos * dy - sin * dx, np.float32), points.z
