"""Routes through the map: one uniform-cost search from the goal, used until the goal changes (thesis §6.3.3)."""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation.floor import CORRIDOR, DrivenFloor

# Metres charged for each link: of two ways equally long the one with fewer links has fewer errors.
HOP_COST = 0.02
# Nodes looked ahead along the route for a straight short cut: at one a decimetre, more than a room's diagonal.
LOOK_AHEAD = 80
JOIN = 0.25  # m; within the corridor, so that the way to the node is free
BESIDE = 0.6  # m; a place so near to driven floor was reached by somebody, though not while teaching


class Route:
    """Cost-to-go and next node for every node of a map, towards one goal pose."""

    def __init__(self, topo_map: TopoMap, goal: Pose2D, floor: DrivenFloor) -> None:
        self._map = topo_map
        self._goal = goal
        self._floor = floor
        self._positions = np.asarray(topo_map.poses[:, :2], np.float64)
        end = self._nearest(goal)
        if topo_map.pose(end).distance(goal) < BESIDE:
            floor.open(goal.x, goal.y, CORRIDOR)
        self._cost, self._next = self._search(end) if floor.straight(goal, topo_map.pose(end)) else self._nowhere()

    def carrot(self, here: Pose2D) -> Pose2D | None:
        """The farthest point of the route that can be reached in a straight line; None where no route leads on."""
        if self._floor.straight(here, self._goal):
            return self._goal
        node = self._entry(here)
        if not np.isfinite(self._cost[node]):
            return None
        best = self._map.pose(node)
        for _ in range(LOOK_AHEAD):
            node = int(self._next[node])
            if node < 0:
                break
            ahead = self._map.pose(node)
            if not self._floor.straight(here, ahead):
                break
            best = ahead
        return best

    def distance(self, here: Pose2D) -> float:
        """Metres left to drive from here (straight where that is possible), inf where no route leads."""
        if self._floor.straight(here, self._goal):
            return here.distance(self._goal)
        node = self._entry(here)
        return float(self._cost[node]) + here.distance(self._map.pose(node))

    def _entry(self, here: Pose2D) -> int:
        """Where to join the route: of the nodes near by, the one with the least way to go through it.

        The nearest alone would jump to and fro between links that lead round opposite ways.
        """
        away = np.hypot(self._positions[:, 0] - here.x, self._positions[:, 1] - here.y)
        near = away < max(JOIN, float(away.min()) + 1e-6)
        return int(np.argmin(np.where(near, away + self._cost, np.inf)))

    def _nearest(self, pose: Pose2D) -> int:
        away = np.hypot(self._positions[:, 0] - pose.x, self._positions[:, 1] - pose.y)
        return int(np.argmin(away))

    def _nowhere(self) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        return np.full(len(self._map), np.inf), np.full(len(self._map), -1, np.int32)

    def _search(self, goal: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        """Dijkstra from the goal over links whose straight line is free, in both directions."""
        neighbours, lengths, starts = self._adjacency()
        cost, following = self._nowhere()
        cost[goal] = 0.0
        queue = [(0.0, goal)]
        while queue:
            reached, node = heapq.heappop(queue)
            if reached > cost[node]:
                continue
            for k in range(starts[node], starts[node + 1]):
                other, total = neighbours[k], reached + lengths[k]
                if total < cost[other]:
                    cost[other], following[other] = total, node
                    heapq.heappush(queue, (total, other))
        return cost, following

    def _adjacency(self) -> tuple[list[int], list[float], list[int]]:
        """Links as lists (neighbours, lengths) with the start of each node's share, blocked ones left out."""
        edges = self._map.edges
        a, b = np.r_[edges.first, edges.second], np.r_[edges.second, edges.first]
        middle = (self._positions[a] + self._positions[b]) / 2.0
        free = self._floor.contains(middle) & self._floor.contains(self._positions[b])
        a, b = a[free], b[free]
        order = np.argsort(a, kind="stable")
        a, b = a[order], b[order]
        lengths = np.linalg.norm(self._positions[a] - self._positions[b], axis=1) + HOP_COST
        starts = np.searchsorted(a, np.arange(len(self._map) + 1))
        return b.tolist(), lengths.tolist(), starts.tolist()
