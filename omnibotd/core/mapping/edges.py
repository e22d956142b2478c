"""The links of the finished map: driven, seen again, and adjacent."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from omnibotd.core.mapping.links import Links
from omnibotd.core.mapping.relaxation import Floats
from omnibotd.core.mapping.topo_map import EdgeKind, Edges

# Two centres of a base closer than this have no wall between them: the base itself is wider.
_ADJACENT = 0.3
# Adjacent nodes of other passes kept a node: plenty of ways across, and memory grows with the nodes, not their density.
_ADJACENT_KEPT, _ADJACENT_ASKED = 6, 40
# Nodes this near in sequence are joined by driven links already.
_SAME_PASS = 8


def make_edges(poses: Floats, links: Links) -> Edges:
    """Each pair of nodes once, by the strongest kind."""
    nodes = len(poses)
    driven = np.column_stack([np.arange(nodes - 1), np.arange(1, nodes)])
    place = np.array(links.place, bool)
    similar = np.column_stack([np.array(links.earlier, np.intp)[place], np.array(links.later, np.intp)[place]])
    similar = similar[_length(poses, similar) < _ADJACENT]
    adjacent = _adjacent(poses)
    pairs = np.concatenate([driven, similar, adjacent]).astype(np.int32)
    kinds = np.repeat(
        [EdgeKind.ODOMETRY, EdgeKind.SIMILARITY, EdgeKind.PROXIMITY],
        [len(driven), len(similar), len(adjacent)],
    )
    # np.unique keeps the first of equal pairs, so the order above is the order of strength.
    _, first = np.unique(pairs, axis=0, return_index=True)
    kept = np.sort(first)
    return Edges(pairs[kept, 0], pairs[kept, 1], kinds[kept].astype(np.uint8))


def _adjacent(poses: Floats) -> NDArray[np.intp]:
    """Pairs (M, 2), lower index first, of nodes close by that were not driven one after the other."""
    asked = min(_ADJACENT_ASKED, len(poses))
    distance, other = cKDTree(poses[:, :2]).query(poses[:, :2], asked, distance_upper_bound=_ADJACENT)
    node = np.broadcast_to(np.arange(len(poses))[:, None], other.shape)
    usable = np.isfinite(distance) & (np.abs(node - other) > _SAME_PASS)
    usable &= np.cumsum(usable, axis=1) <= _ADJACENT_KEPT
    return np.unique(np.sort(np.column_stack([node[usable], other[usable]]), axis=1), axis=0)


def _length(poses: Floats, pairs: NDArray[np.integer]) -> Floats:
    difference = poses[pairs[:, 1], :2] - poses[pairs[:, 0], :2]
    return np.asarray(np.hypot(difference[:, 0], difference[:, 1]))
