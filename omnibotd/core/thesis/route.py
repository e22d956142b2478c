"""The way to a target node: one uniform-cost search over link variances, from the target outwards (§6.5.5).

The thesis searches from the robot's node in every cycle. Every link works both ways, so one search from the target
holds the same routes for all nodes, while the target stands.
"""

from __future__ import annotations

import heapq
import math

import numpy as np

from omnibotd.core.thesis.links import Floats, Links


class Route:
    """For each of `nodes` nodes: z, the sum of offsets along its route to `target` (m), and r, the sum of variances."""

    def __init__(self, links: Links, nodes: int, target: int) -> None:
        self._variance = np.full(nodes, math.inf)
        self._offset = np.zeros((nodes, 2))
        neighbours, starts = _adjacency(links, nodes)
        self._variance[target] = 0.0
        queue = [(0.0, target)]
        while queue:
            reached, node = heapq.heappop(queue)
            if reached > self._variance[node]:
                continue
            for k in range(starts[node], starts[node + 1]):
                other, variance, dx, dy = neighbours[k]
                if reached + variance < self._variance[other]:
                    self._variance[other] = reached + variance
                    self._offset[other] = self._offset[node] - (dx, dy)
                    heapq.heappush(queue, (reached + variance, other))

    def measurement(self, node: int) -> tuple[Floats, float] | None:
        """(z, r) from this node to the target in compass axes; None where no route leads."""
        variance = float(self._variance[node])
        return (self._offset[node], variance) if math.isfinite(variance) else None


def _adjacency(links: Links, nodes: int) -> tuple[list[tuple[int, float, float, float]], list[int]]:
    """Links both ways as (neighbour, variance, offset to it x, y), and where each node's share starts."""
    start, end = np.r_[links.first, links.second], np.r_[links.second, links.first]
    offsets, variances = np.vstack([links.offsets, -links.offsets]), np.r_[links.variances, links.variances]
    order = np.argsort(start, kind="stable")
    columns = (end[order].tolist(), variances[order].tolist(), *offsets[order].T.tolist())
    starts = np.searchsorted(start[order], np.arange(nodes + 1))
    return list(zip(*columns, strict=True)), starts.tolist()
