"""Routes through the map: one uniform-cost search from the goal, used until the goal changes (thesis §6.3.3).

The search goes on a few nodes at a time, so that a control tick can plan without being late.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation.floor import CORRIDOR, DrivenFloor
from omnibotd.core.navigation.node_grid import NodeGrid

# Metres charged for each link: of two ways equally long the one with fewer links has fewer errors.
HOP_COST = 0.02
# Nodes looked ahead along the route for a straight short cut: at one a decimetre, more than a room's diagonal.
LOOK_AHEAD = 80
JOIN = 0.25  # m; within the corridor, so that the way to the node is free
BESIDE = 0.6  # m; a place so near to driven floor was reached by somebody, though not while teaching
# Nodes expanded at once: the fewer, the less is expanded twice; the more, the less each costs.
BATCH = 256

Floats = NDArray[np.float64]
Nodes = NDArray[np.int64]


class Roads:
    """What all routes through one map share: its links in rows, its nodes by place, and its floor; read-only."""

    def __init__(self, topo_map: TopoMap) -> None:
        self.edges = topo_map.edges
        self.poses = topo_map.poses
        self.positions = np.asarray(topo_map.poses[:, :2], np.float64)
        self.grid = NodeGrid(self.positions)
        self.floor = DrivenFloor(self.positions)
        first, second = self.edges.first, self.edges.second
        source, self.target = np.r_[first, second], np.r_[second, first]
        order = np.argsort(source, kind="stable")
        source, self.target = source[order], self.target[order]
        self.lengths = np.linalg.norm(self.positions[source] - self.positions[self.target], axis=1) + HOP_COST
        self.starts = np.searchsorted(source, np.arange(len(self.positions) + 1))

    def nearest(self, here: Pose2D) -> Pose2D:
        """Where the node nearest to a pose is; its heading says nothing."""
        x, y = self.positions[self.grid.nearest(here.x, here.y)]
        return Pose2D(float(x), float(y))

    def leaving(self, nodes: Nodes) -> tuple[Nodes, Nodes]:
        """Rows of all links that leave `nodes`, and the node each leaves."""
        counts = self.starts[nodes + 1] - self.starts[nodes]
        source = np.repeat(nodes, counts)
        rows = np.arange(len(source)) - np.repeat(np.cumsum(counts) - counts, counts) + self.starts[source]
        return rows, source


_latest: Roads | None = None


def roads_of(topo_map: TopoMap) -> Roads:
    """The roads of a map; kept for the map used last, whose nodes and links outlive edits of its places."""
    global _latest
    roads = _latest
    if roads is None or roads.edges is not topo_map.edges or roads.poses is not topo_map.poses:
        roads = _latest = Roads(topo_map)
    return roads


class Route:
    """Cost-to-go and next node for every node of a map, towards one goal pose; complete once `advance` says so."""

    def __init__(self, roads: Roads, goal: Pose2D, floor: DrivenFloor) -> None:
        """`floor` is this trip's own; a goal just beside it is added to it."""
        self._roads = roads
        self._goal = goal
        self._floor = floor
        self._end = roads.grid.nearest(goal.x, goal.y)
        if self._node(self._end).distance(goal) < BESIDE:
            floor.open(goal.x, goal.y, CORRIDOR)
        self.restart()

    def restart(self) -> None:
        """Search anew: the floor has changed."""
        count = len(self._roads.positions)
        self._cost: Floats = np.full(count, np.inf)
        self._next = np.full(count, -1, np.int32)
        self._waiting: Nodes = np.empty(0, np.int64)
        if self._floor.straight(self._goal, self._node(self._end)):
            self._cost[self._end] = 0.0
            self._waiting = np.array([self._end])

    def advance(self, nodes: int | None = None) -> bool:
        """Expand about `nodes` more nodes, or all; returns whether the search is complete."""
        left = math.inf if nodes is None else nodes
        while len(self._waiting) and left > 0:
            left -= self._expand()
        return not len(self._waiting)

    def _expand(self) -> int:
        """Relax the links of the cheapest nodes that wait; returns how many nodes those were."""
        cheapest = self._waiting
        if len(cheapest) > BATCH:
            order = np.argpartition(self._cost[cheapest], BATCH)
            cheapest, later = cheapest[order[:BATCH]], cheapest[order[BATCH:]]
        else:
            later = cheapest[:0]
        rows, source = self._roads.leaving(cheapest)
        target, total = self._roads.target[rows], self._cost[source] + self._roads.lengths[rows]
        better = total < self._cost[target]
        source, target, total = source[better], target[better], total[better]
        free = self._free(source, target)
        source, target, total = source[free], target[free], total[free]
        np.minimum.at(self._cost, target, total)
        won = total == self._cost[target]
        self._next[target[won]] = source[won]
        self._waiting = np.union1d(later, target[won])
        return len(cheapest)

    def _free(self, source: Nodes, target: Nodes) -> NDArray[np.bool_]:
        """Which links lead over free floor: so do their far ends and their middles."""
        ends = self._roads.positions[target]
        return self._floor.contains(ends) & self._floor.contains((self._roads.positions[source] + ends) / 2.0)

    def known(self, here: Pose2D) -> bool:
        """Whether the search has come far enough to say how to go on from here."""
        if not len(self._waiting) or self._floor.straight(here, self._goal):
            return True
        # Cheapest first: what costs less than all that waits will get no cheaper.
        return bool(self._cost[self._entry(here)] <= self._cost[self._waiting].min())

    def carrot(self, here: Pose2D) -> Pose2D | None:
        """The farthest point of the route that can be reached in a straight line; None where no route leads on."""
        if self._floor.straight(here, self._goal):
            return self._goal
        node = self._entry(here)
        if not math.isfinite(self._cost[node]):
            return None
        ahead = self._ahead(node)
        # Gallop along the route, then halve: a dozen lines to look along instead of eighty.
        reached, step, growing = 0, 1, True
        while step:
            farther = reached + step < len(ahead) and self._floor.straight(here, self._node(ahead[reached + step]))
            reached += step if farther else 0
            growing = growing and farther
            step = step * 2 if growing else step // 2
        return self._node(ahead[reached])

    def distance(self, here: Pose2D) -> float:
        """Metres left to drive from here (straight where that is possible), inf where no route leads."""
        if self._floor.straight(here, self._goal):
            return here.distance(self._goal)
        node = self._entry(here)
        return float(self._cost[node]) + here.distance(self._node(node))

    def _ahead(self, node: int) -> list[int]:
        """This node and the next ones of its route."""
        nodes = [node]
        while len(nodes) <= LOOK_AHEAD and (node := int(self._next[node])) >= 0:
            nodes.append(node)
        return nodes

    def _entry(self, here: Pose2D) -> int:
        """Where to join the route: of the nodes near by, the one with the least way to go through it.

        The nearest alone would jump to and fro between links that lead round opposite ways.
        """
        near = self._roads.grid.near(here.x, here.y, JOIN)
        if not len(near):
            return self._roads.grid.nearest(here.x, here.y)
        away = np.hypot(*(self._roads.positions[near] - (here.x, here.y)).T)
        return int(near[np.argmin(away + self._cost[near])])

    def _node(self, node: int) -> Pose2D:
        x, y = self._roads.positions[node]
        return Pose2D(float(x), float(y))
