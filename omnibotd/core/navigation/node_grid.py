"""Nodes by where they are: square cells, so that a look round a pose costs the same in a map of any size."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

CELL = 0.6  # m; of the distances asked for in every frame the largest: nine cells are looked at

Nodes = NDArray[np.int64]
Squares = NDArray[np.floating]


class NodeGrid:
    """Read-only index of positions (N, 2) in metres."""

    def __init__(self, positions: NDArray[np.floating]) -> None:
        cells = np.floor(positions / CELL).astype(np.int64)
        self._low = cells.min(axis=0).tolist()
        self._shape = (cells.max(axis=0) - self._low + 1).tolist()
        keys = (cells[:, 0] - self._low[0]) * self._shape[1] + cells[:, 1] - self._low[1]
        self._order = np.argsort(keys, kind="stable")
        self._keys = keys[self._order]
        # In the order of the cells: those of one row that lie side by side are one slice.
        self._positions = np.ascontiguousarray(positions[self._order].T)
        self._latest = ((0.0, 0.0, CELL), self._look(0.0, 0.0, CELL))

    def near(self, x: float, y: float, radius: float) -> Nodes:
        """Nodes within `radius` metres of (x, y)."""
        return self.within(x, y, radius)[0]

    def within(self, x: float, y: float, radius: float) -> tuple[Nodes, Squares]:
        """Nodes within `radius` metres of (x, y), and the squares of their distances."""
        asked = (x, y, max(radius, CELL))
        known, found = self._latest
        if asked != known:  # about the likeliest pose every frame asks three times
            found = self._look(*asked)
            self._latest = (asked, found)
        nodes, squares = found
        close = np.flatnonzero(squares <= radius * radius)
        return nodes[close], squares[close]

    def nearest(self, x: float, y: float) -> int:
        """The node nearest to (x, y), however far."""
        radius = CELL
        while radius < 16.0 * CELL:
            nodes, squares = self.within(x, y, radius)
            if len(nodes):
                return int(nodes[squares.argmin()])
            radius *= 2.0
        return int(self._order[_squares(self._positions, x, y).argmin()])

    def _look(self, x: float, y: float, radius: float) -> tuple[Nodes, Squares]:
        """Nodes of all cells that a square of twice the radius meets, and the squares of their distances."""
        rows, columns = self._span(x, radius, 0), self._span(y, radius, 1)
        first = np.arange(rows.start, rows.stop) * self._shape[1] + columns.start
        starts, ends = self._keys.searchsorted(first).tolist(), self._keys.searchsorted(first + len(columns)).tolist()
        runs = [slice(start, end) for start, end in zip(starts, ends, strict=True)] or [slice(0)]
        positions = np.concatenate([self._positions[:, run] for run in runs], axis=1)
        return np.concatenate([self._order[run] for run in runs]), _squares(positions, x, y)

    def _span(self, value: float, radius: float, axis: int) -> range:
        low = math.floor((value - radius) / CELL) - self._low[axis]
        high = math.floor((value + radius) / CELL) - self._low[axis]
        return range(max(low, 0), min(high, self._shape[axis] - 1) + 1)


def _squares(positions: NDArray[np.floating], x: float, y: float) -> Squares:
    """(N,) squared distances of (x, y) from positions (2, N)."""
    away = positions - np.array([[x], [y]])
    away *= away
    return np.asarray(away[0] + away[1])
