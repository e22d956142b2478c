"""Where the robot may drive: floor near which it was driven while teaching, less what it has bumped into since."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D

CELL = 0.05  # m
# A robot that was driven along a line may leave it by this much; about its own radius and a bit of steering error.
CORRIDOR = 0.3


class DrivenFloor:
    """Raster of known-free floor made from node positions (N, 2) in metres."""

    def __init__(self, positions: NDArray[np.float32], corridor: float = CORRIDOR) -> None:
        border = 3.0 * corridor + CELL  # room for places beside the floor that was driven
        self._origin = positions.min(axis=0) - border
        shape = np.ceil((positions.max(axis=0) - self._origin + border) / CELL).astype(int)
        self._free = np.zeros((int(shape[0]), int(shape[1])), bool)
        cells = np.unique(self._cells(positions), axis=0)
        for offset in self._disc(corridor):
            inside = cells + offset
            self._free[inside[:, 0], inside[:, 1]] = True

    def contains(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of the points (..., 2) lie on free floor."""
        cells = self._cells(points)
        inside = np.all((cells >= 0) & (cells < self._free.shape), axis=-1)
        clipped = np.clip(cells, 0, np.array(self._free.shape) - 1)
        return np.asarray(inside & self._free[clipped[..., 0], clipped[..., 1]])

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
        cells = self._cells(np.array([x, y])) + self._disc(radius)
        keep = np.all((cells >= 0) & (cells < self._free.shape), axis=-1)
        self._free[cells[keep, 0], cells[keep, 1]] = free

    def _cells(self, points: NDArray[np.floating]) -> NDArray[np.int64]:
        cells = np.floor((np.asarray(points, np.float64) - self._origin) / CELL)
        return np.asarray(cells, np.int64)

    @staticmethod
    def _disc(radius: float) -> NDArray[np.int64]:
        reach = math.ceil(radius / CELL)
        grid = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1).T
        return np.asarray(grid[np.hypot(grid[:, 0], grid[:, 1]) * CELL <= radius], np.int64)
