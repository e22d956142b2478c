"""The map as localisation reads it: nodes by what they look like, and by where they are."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.errors import MapError
from omnibotd.core.mapping import snapshots
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation.node_grid import NodeGrid
from omnibotd.core.vision.descriptor import FEATURES, Descriptor, Harmonics, correlate_views, turned, weighted_norms
from omnibotd.core.vision.view import View

Floats = NDArray[np.float32]
Nodes = NDArray[np.intp]

# Best matching units searched: more finds hardly more.
_PROBES = 6
# Nodes unpacked at a time: bounds the memory that loading needs to some 20 MB.
_BLOCK = 500
# Views are kept in map axes as int8: the codec errs by more than 1/25.
_SCALE = 25.0


class NodeIndex:
    """Read-only search structures of one map; 1.8 KB a node."""

    def __init__(self, topo_map: TopoMap) -> None:
        if topo_map.codebook.shape[1] != FEATURES:
            raise MapError(
                f"map {topo_map.name!r}: codebook of {topo_map.codebook.shape[1]} features, expected {FEATURES}: "
                "train it again"
            )
        self.poses = topo_map.poses
        nodes = len(topo_map)
        self._aligned = np.empty((nodes, *snapshots.unpack(topo_map.snapshots[:1]).shape[1:]), np.int8)
        self._norms = np.empty(nodes, np.float32)
        spectra = np.empty((nodes, FEATURES), np.float32)
        for start in range(0, nodes, _BLOCK):
            block = slice(start, start + _BLOCK)
            views = snapshots.unpack(topo_map.snapshots[block])
            spectra[block] = Descriptor.spectrum(views)
            aligned = turned(views, topo_map.poses[block, 2])
            self._aligned[block] = np.clip(np.rint(aligned * _SCALE), -127, 127)
            self._norms[block] = weighted_norms(self.aligned(block))
        self._grid = NodeGrid(topo_map.poses[:, :2])
        self._order = np.argsort(topo_map.units, kind="stable")
        self._spectra = spectra[self._order]
        self._squares = np.einsum("nf,nf->n", self._spectra, self._spectra)
        self._index_units(topo_map)

    def _index_units(self, topo_map: TopoMap) -> None:
        """Buckets of the SOM (thesis §6.3.2): contiguous runs of nodes; units that won none are left out."""
        units = topo_map.units[self._order]
        used, starts = np.unique(units, return_index=True)
        self._starts, self._ends = starts, np.append(starts[1:], len(units))
        self._codebook = topo_map.codebook[used]
        self._codebook_norm = (self._codebook**2).sum(1)

    def alike(self, spectrum: Floats, count: int) -> Nodes:
        """Up to `count` nodes whose spectra are nearest (F,), searched in the buckets of the nearest units."""
        response = self._codebook_norm - 2.0 * (self._codebook @ spectrum)
        probes = min(_PROBES, len(response))
        nearest = np.argpartition(response, probes - 1)[:probes]
        # Each bucket where it lies: to gather the spectra in one array first costs ten times the products.
        buckets = [slice(int(self._starts[unit]), int(self._ends[unit])) for unit in nearest]
        nodes = np.concatenate([self._order[bucket] for bucket in buckets])
        if len(nodes) > count:
            double = 2.0 * spectrum
            unlike = np.concatenate([self._squares[bucket] - self._spectra[bucket] @ double for bucket in buckets])
            nodes = nodes[np.argpartition(unlike, count)[:count]]
        return np.asarray(nodes)

    def near(self, x: float, y: float, radius: float, count: int) -> Nodes:
        """Up to `count` nodes nearest to (x, y) and within `radius` metres."""
        nodes, squares = self._grid.within(x, y, radius)
        if len(nodes) > count:
            nodes = nodes[np.argpartition(squares, count)[:count]]
        return nodes

    def distance(self, x: float, y: float, radius: float) -> float:
        """Metres from (x, y) to the nearest node; `radius` where none is nearer."""
        _, squares = self._grid.within(x, y, radius)
        return math.sqrt(squares.min(initial=radius * radius))

    def compare(self, query: Harmonics, nodes: Nodes) -> tuple[Floats, Floats]:
        """Map heading (M,) at which the query fits each node best, and the correlation (M,) there."""
        return correlate_views(query, self.aligned(nodes), self._norms[nodes])

    def aligned(self, nodes: Nodes | slice) -> View:
        """(M, RINGS, SECTORS) views in map axes."""
        return self._aligned[nodes].astype(np.float32) * np.float32(1.0 / _SCALE)
