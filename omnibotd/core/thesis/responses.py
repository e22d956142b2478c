"""Response vectors: how far a perception is from each unit of the SOM (Eq 6.1), and nodes filed under their winner."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnibotd.core.errors import MapError
from omnibotd.core.mapping.topo_map import TopoMap

Floats = NDArray[np.float32]

_ITEM = np.dtype("<f4")


class Classifier:
    """Response vectors of perceptions to a codebook (u, q)."""

    def __init__(self, codebook: Floats) -> None:
        self._codebook = codebook

    def __call__(self, vector: ArrayLike) -> Floats:
        """(u,) distances of a vector (q,). By differences: from products, float32 would lose the small ones."""
        apart = self._codebook - np.asarray(vector, np.float32)
        return np.asarray(np.sqrt(np.einsum("ij,ij->i", apart, apart)), np.float32)


def pack(responses: Floats) -> NDArray[np.uint8]:
    """(N, u) response vectors as a map's snapshots: their bytes, (N, 4 u)."""
    return np.ascontiguousarray(responses, _ITEM).view(np.uint8)


def unpack(topo_map: TopoMap) -> Floats:
    """(N, u) response vectors of a map of method `thesis`. MapError where its snapshots are something else."""
    units, width = len(topo_map.codebook), topo_map.snapshots.shape[1]
    if topo_map.method != "thesis" or width != units * _ITEM.itemsize:
        raise MapError(
            f"map {topo_map.name!r} holds {width} bytes a node by method {topo_map.method!r}, not the "
            f"{units} responses of a thesis map: use it with its own method"
        )
    return np.ascontiguousarray(topo_map.snapshots).view(_ITEM).astype(np.float32, copy=False)


class Buckets:
    """Sub-nodes: the nodes filed under each unit of the SOM (§6.3.2)."""

    def __init__(self, units: NDArray[np.integer], side: int) -> None:
        if not len(units):
            raise MapError("the map has no node")
        self._nodes = [np.flatnonzero(units == unit) for unit in range(side * side)]
        row, column = np.divmod(np.arange(side * side), side)
        self._rings = np.maximum(_around(row, side), _around(column, side))

    def near(self, unit: int, reach: int = 0) -> NDArray[np.intp]:
        """Nodes of this unit and of `reach` rings round it, ascending; of more rings while there is none [assumed]."""
        found = self._within(unit, reach)
        while not len(found):
            reach += 1
            found = self._within(unit, reach)
        return np.sort(found)

    def _within(self, unit: int, reach: int) -> NDArray[np.intp]:
        return np.concatenate([self._nodes[k] for k in np.flatnonzero(self._rings[unit] <= reach)])


def _around(index: NDArray[np.intp], side: int) -> NDArray[np.intp]:
    """(n, n) steps between indices on a ring of `side`."""
    apart = np.abs(index[:, None] - index)
    return np.asarray(np.minimum(apart, side - apart))
