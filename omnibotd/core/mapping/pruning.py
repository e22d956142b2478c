"""Fewer nodes for the same floor: the node that the others explain best goes first.

A node is explained by others of the same light that stand near. So nodes get even, and the floor stays covered in every
light that it was taught in. For the training process only (scipy).
"""

from __future__ import annotations

import heapq
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from omnibotd.core.errors import MapError
from omnibotd.core.mapping import snapshots
from omnibotd.core.mapping.relaxation import Floats, Ints
from omnibotd.core.mapping.topo_map import EdgeKind, Edges, TopoMap
from omnibotd.core.vision.descriptor import Descriptor

# Wherever a node was, one must stay within this distance (m), and half a cell: then nodes driven one after the other
# have heirs within twice the corridor that planning takes as free floor, and no way is lost.
_COVER, _CELL = 0.22, 0.05
# Nodes of two drives this near (m): median difference of their spectra 3.9 to 4.4 in one light, 5.8 to 8.3 in two.
_SAME_SPOT, _OTHER_LIGHT, _FEWEST_SPOTS = 0.05, 5.1, 5
# Lights are kept apart as if they were so far away (m) from each other.
_APART = 1e4
# Neighbours that may explain a node; when all are gone they are looked up anew.
_EXPLAINING = 12
# A link taken over from nodes that went may not be longer (m), unless it was driven.
_LONGEST_LINK = 0.6
# Nodes nearest to each place and dock that stay: regression needs some there.
_ABOUT_PLACES = 5


def prune(topo_map: TopoMap, max_nodes: int) -> TopoMap:
    """The map with at most `max_nodes` nodes, the same one where it has no more. Poses, places and docks don't change.

    MapError where so few can't cover the floor that was driven, or where another method made the map.
    """
    if len(topo_map) <= max_nodes:
        return topo_map
    if topo_map.method != "default":
        raise MapError(f"map {topo_map.name!r} was made by method {topo_map.method!r}, which can't do with fewer nodes")
    kept = _Thinning(topo_map).run(max_nodes)
    edges = _contracted(topo_map, kept)
    return replace(
        topo_map,
        units=topo_map.units[kept],
        snapshots=topo_map.snapshots[kept],
        poses=topo_map.poses[kept],
        sessions=topo_map.sessions[kept],
        edges=edges,
        statistics={**topo_map.statistics, **_link_counts(edges)},
    )


class _Thinning:
    """Takes nodes out one by one, the best explained first."""

    def __init__(self, topo_map: TopoMap) -> None:
        self._name = topo_map.name
        self._space = np.column_stack([topo_map.poses[:, :2].astype(np.float64), _APART * _lights(topo_map)])
        self._kept = np.ones(len(topo_map), bool)
        self._staying = _staying(topo_map)
        cells = np.unique(np.rint(self._space / _CELL), axis=0, return_index=True)[1]
        near = cKDTree(self._space[cells]).query_ball_point(self._space, _COVER)
        self._covers = [np.array(part) for part in near]  # cells that each node covers, and how many cover each cell:
        self._cover = np.bincount(np.concatenate(self._covers), minlength=len(cells))

    def run(self, max_nodes: int) -> Ints:
        """Numbers of the nodes that stay, in order."""
        while (left := int(self._kept.sum())) > max_nodes:
            # Neighbours get farther as nodes go: half of what is too many, then look them up anew.
            removed = self._sweep(-(-(left - max_nodes) // 2))
            if not removed:
                raise MapError(
                    f"map {self._name!r} can't do with {max_nodes} nodes: {left} are needed to cover the floor that "
                    f"was driven, in every light, one every {_COVER} m"
                )
        return np.flatnonzero(self._kept)

    def _sweep(self, most: int) -> int:
        """Take out up to `most` nodes; returns how many."""
        nodes = np.flatnonzero(self._kept)
        distance, near = cKDTree(self._space[nodes]).query(self._space[nodes], min(_EXPLAINING + 1, len(nodes)))
        own = near == np.arange(len(nodes))[:, None]
        order = np.argsort(np.where(own, -1.0, distance), axis=1, kind="stable")  # twins may come before oneself
        distance, near = np.take_along_axis(distance, order, 1), np.take_along_axis(near, order, 1)
        queue = [
            (float(distance[row, 1]), float(distance[row, 2:3].sum()), 1, row)
            for row in np.flatnonzero(~self._staying[nodes])
        ]
        heapq.heapify(queue)
        removed = 0
        while queue and removed < most:
            _, _, rank, row = heapq.heappop(queue)
            alive = rank + np.flatnonzero(self._kept[nodes[near[row, rank:]]])
            if not len(alive):
                continue
            if alive[0] > rank:
                second = float(distance[row, alive[1]]) if len(alive) > 1 else np.inf
                heapq.heappush(queue, (float(distance[row, alive[0]]), second, int(alive[0]), row))
            elif self._take_out(int(nodes[row])):
                removed += 1
        return removed

    def _take_out(self, node: int) -> bool:
        """Unless a cell that was driven would be left alone."""
        cells = self._covers[node]
        if self._cover[cells].min() < 2:
            return False
        self._cover[cells] -= 1
        self._kept[node] = False
        return True


def _lights(topo_map: TopoMap) -> Ints:
    """(N,) a number for the light each node was taught in; drives in which the same spots look alike share it."""
    spectra = Descriptor.spectrum(snapshots.unpack(topo_map.snapshots))
    positions, sessions = topo_map.poses[:, :2].astype(np.float64), topo_map.sessions
    lights = np.zeros(len(topo_map), np.intp)
    known: list[int] = []
    for session in np.unique(sessions):
        mine = np.flatnonzero(sessions == session)
        alike = (light for light in known if _same_light(positions, spectra, mine, np.flatnonzero(lights == light)))
        light = next(alike, int(session) + 1)
        lights[mine] = light
        known += [light] if light not in known else []
    return lights


def _same_light(positions: Floats, spectra: NDArray[np.float32], mine: Ints, others: Ints) -> bool:
    distance, nearest = cKDTree(positions[others]).query(positions[mine], distance_upper_bound=_SAME_SPOT)
    shared = np.isfinite(distance)
    if shared.sum() < _FEWEST_SPOTS:
        return False
    difference = np.linalg.norm(spectra[mine[shared]] - spectra[others[nearest[shared]]], axis=1)
    return bool(np.median(difference) < _OTHER_LIGHT)


def _staying(topo_map: TopoMap) -> NDArray[np.bool_]:
    """(N,) nodes about places and docks, and the ends of drives: there it matters most."""
    staying = np.ones(len(topo_map), bool)
    staying[1:-1] = (np.diff(topo_map.sessions[:-1]) != 0) | (np.diff(topo_map.sessions[1:]) != 0)
    poses = [*topo_map.places.values(), *(dock.map_from_dock for dock in topo_map.docks.values())]
    for pose in poses:
        apart = np.hypot(topo_map.poses[:, 0] - pose.x, topo_map.poses[:, 1] - pose.y)
        staying[np.argsort(apart, kind="stable")[:_ABOUT_PLACES]] = True
    return staying


def _contracted(topo_map: TopoMap, kept: Ints) -> Edges:
    """Links of nodes that went go over to the nearest ones that stay: what was connected is connected."""
    positions = topo_map.poses[:, :2].astype(np.float64)
    heir = cKDTree(positions[kept]).query(positions)[1]
    heir[kept] = np.arange(len(kept))
    edges = topo_map.edges
    pairs = np.sort(np.column_stack([heir[edges.first], heir[edges.second]]), axis=1)
    length = np.hypot(*(positions[kept][pairs[:, 0]] - positions[kept][pairs[:, 1]]).T)
    usable = (pairs[:, 0] < pairs[:, 1]) & ((length < _LONGEST_LINK) | (edges.kind == EdgeKind.ODOMETRY))
    # Each pair once by its strongest kind: np.unique keeps the first.
    order = np.flatnonzero(usable)[np.argsort(edges.kind[usable], kind="stable")]
    _, first = np.unique(pairs[order], axis=0, return_index=True)
    chosen = order[np.sort(first)]
    return Edges(pairs[chosen, 0].astype(np.int32), pairs[chosen, 1].astype(np.int32), edges.kind[chosen])


def _link_counts(edges: Edges) -> dict[str, float]:
    return {f"{kind.name.lower()}_links": float((edges.kind == kind).sum()) for kind in EdgeKind}
