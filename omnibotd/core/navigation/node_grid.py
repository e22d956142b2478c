"""Nodes by where they are: square cells, so that a look round a pose costs the same in a map of any size."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

CELL = 0.25  # m; the distances asked for are one to two cells


class NodeGrid:
    """Read-only index of positions (N, 2) in metres."""

    def __init__(self, positions: NDArray[np.floating]) -> None:
        self._positions = positions
        cells = np.floor(positions / CELL).astype(np.int64)
        self._low = cells.min(axis=0)
        self._shape = cells.max(axis=0) - self._low + 1
        keys = (cells[:, 0] - self._low[0]) * self._shape[1] + cells[:, 1] - self._low[1]
        self._order = np.argsort(keys, kind="stable")
        self._keys = keys[self._order]

    def near(self, x: float, y: float, radius: float) -> NDArray[np.int64]:
        """Nodes within `radius` metres of (x, y)."""
        nodes = self._square(x, y, radius)
        away = self._positions[nodes] - (x, y)
        return np.asarray(nodes[np.einsum("nk,nk->n", away, away) <= radius * radius])

    def nearest(self, x: float, y: float) -> int:
        """The node nearest to (x, y), however far."""
        radius = CELL
        while radius < 16.0 * CELL:
            nodes = self.near(x, y, radius)
            if len(nodes):
                return int(nodes[self._away(nodes, x, y).argmin()])
            radius *= 2.0
        return int(self._away(slice(None), x, y).argmin())

    def _away(self, nodes: NDArray[np.int64] | slice, x: float, y: float) -> NDArray[np.float64]:
        return np.asarray(np.hypot(self._positions[nodes, 0] - x, self._positions[nodes, 1] - y))

    def _square(self, x: float, y: float, radius: float) -> NDArray[np.int64]:
        """Nodes of all cells that a square of twice the radius meets."""
        rows = self._span(x, radius, 0)
        columns = self._span(y, radius, 1)
        if not rows or not columns:
            return np.empty(0, np.int64)
        # The cells of one row lie side by side: one run of nodes a row.
        first = np.array([row * self._shape[1] + columns[0] for row in rows])
        starts = np.searchsorted(self._keys, first)
        ends = np.searchsorted(self._keys, first + len(columns))
        return np.concatenate([self._order[start:end] for start, end in zip(starts, ends, strict=True)])

    def _span(self, value: float, radius: float, axis: int) -> range:
        low = math.floor((value - radius) / CELL) - int(self._low[axis])
        high = math.floor((value + radius) / CELL) - int(self._low[axis])
        return range(max(low, 0), min(high, int(self._shape[axis]) - 1) + 1)
