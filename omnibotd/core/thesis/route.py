"""The way to a target node: one uniform-cost search over link variances, from the target outwards (§6.5.5).

The thesis searches from the robot's node in every cycle. Every link works both ways, so one search from the target
holds the same routes for all nodes, while the target stands.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.thesis.links import Floats, Links


@dataclass(frozen=True)
class Ways:
    """The cheapest way from each of n nodes to one target: `cost` (n,), inf where none leads, and where it begins.

    `link` (n,) is the first link of the way, -1 where there is none and at the target; `order` lists the nodes that
    have a way, cheapest first, so that each comes after the one its link leads to.
    """

    cost: Floats
    link: NDArray[np.intp]
    order: list[int]


def ways_to(target: int, first: NDArray[np.int32], second: NDArray[np.int32], costs: Floats, nodes: int) -> Ways:
    """By links (M,) from `first` to `second`, each to be taken either way."""
    cost, way = np.full(nodes, math.inf), np.full(nodes, -1, np.intp)
    neighbours, starts = _adjacency(first, second, costs, nodes)
    cost[target] = 0.0
    queue, order = [(0.0, target)], []
    while queue:
        reached, node = heapq.heappop(queue)
        if reached > cost[node]:
            continue
        order.append(node)
        for k in range(starts[node], starts[node + 1]):
            other, more, link = neighbours[k]
            if reached + more < cost[other]:
                cost[other], way[other] = reached + more, link
                heapq.heappush(queue, (reached + more, other))
    return Ways(cost, way, order)


class Route:
    """For each of `nodes` nodes: z, the sum of offsets along its route to `target` (m), and r, the sum of variances."""

    def __init__(self, links: Links, nodes: int, target: int) -> None:
        ways = ways_to(target, links.first, links.second, links.variances, nodes)
        self._variance = ways.cost
        self._offset = np.zeros((nodes, 2))
        for node in ways.order[1:]:
            link = ways.link[node]
            if links.first[link] == node:
                self._offset[node] = self._offset[links.second[link]] + links.offsets[link]
            else:
                self._offset[node] = self._offset[links.first[link]] - links.offsets[link]

    def measurement(self, node: int) -> tuple[Floats, float] | None:
        """(z, r) from this node to the target in compass axes; None where no route leads."""
        variance = float(self._variance[node])
        return (self._offset[node], variance) if math.isfinite(variance) else None


def _adjacency(
    first: NDArray[np.int32], second: NDArray[np.int32], costs: Floats, nodes: int
) -> tuple[list[tuple[int, float, int]], list[int]]:
    """Links both ways as (neighbour, cost, number), and where each node's share starts."""
    start, end, numbers = np.r_[first, second], np.r_[second, first], np.tile(np.arange(len(first)), 2)
    order = np.argsort(start, kind="stable")
    starts = np.searchsorted(start[order], np.arange(nodes + 1))
    columns = (end[order].tolist(), costs[numbers[order]].tolist(), numbers[order].tolist())
    return list(zip(*columns, strict=True)), starts.tolist()
