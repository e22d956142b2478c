"""Where the robot may drive: floor near which it was driven while teaching, less what it has bumped into since."""

from __future__ import annotations

import math
from copy import copy

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D

CELL = 0.05  # m
# A robot that was driven along a line may leave it by this much; about its own radius and a bit of steering error.
CORRIDOR = 0.3


class DrivenFloor:
    """Raster of known-free floor made from node positions (N, 2) in metres."""

    def __init__(self, positions: NDArray[np.floating], corridor: float = CORRIDOR) -> None:
        border = 3.0 * corridor + CELL  # room for places beside the floor that was driven
        self._origin = np.asarray(positions.min(axis=0), np.float64) - border
        shape = np.ceil((positions.max(axis=0) - self._origin + border) / CELL).astype(int)
        driven = np.zeros((int(shape[0]), int(shape[1])), np.uint8)
        cells = self._cells(positions)
        driven[cells[:, 0], cells[:, 1]] = 1
        self._free = cv2.dilate(driven, _disc(corridor).astype(np.uint8)).astype(bool)

    def copy(self) -> DrivenFloor:
        """Another floor alike, to be blocked and opened by itself."""
        other = copy(self)
        other._free = self._free.copy()
        return other

    def contains(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of the points (..., 2) lie on free floor."""
        cells = self._cells(points)
        i, j = cells[..., 0], cells[..., 1]
        rows, columns = self._free.shape
        inside = (i >= 0) & (i < rows) & (j >= 0) & (j < columns)
        return np.asarray(inside & self._free[np.where(inside, i, 0), np.where(inside, j, 0)])

    def straight(self, start: Pose2D, end: Pose2D) -> bool:
        """Whether the straight line between two poses stays on free floor."""
        steps = max(2, math.ceil(start.distance(end) / CELL) + 1)
        share = np.linspace(0.0, 1.0, steps)[:, None]
        line = np.array([start.x, start.y]) * (1.0 - share) + np.array([end.x, end.y]) * share
        return bool(self.contains(line).all())

    def block(self, x: float, y: float, radius: float) -> None:
        """Take a disc out: something stands there."""
        self._paint(x, y, radius, False)

    def open(self, x: float, y: float, radius: float) -> None:
        """Add a disc: somebody says that the robot can stand there."""
        self._paint(x, y, radius, True)

    def _paint(self, x: float, y: float, radius: float, free: bool) -> None:
        disc = _disc(radius)
        cells = self._cells(np.array([x, y])) + np.argwhere(disc) - disc.shape[0] // 2
        keep = np.all((cells >= 0) & (cells < self._free.shape), axis=-1)
        self._free[cells[keep, 0], cells[keep, 1]] = free

    def _cells(self, points: NDArray[np.floating]) -> NDArray[np.int64]:
        return np.asarray(np.floor((points - self._origin) / CELL), np.int64)


def _disc(radius: float) -> NDArray[np.bool_]:
    """Square raster, odd in size, with a disc in its middle."""
    reach = math.ceil(radius / CELL)
    rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return np.asarray(np.hypot(rows, columns) * CELL <= radius)
