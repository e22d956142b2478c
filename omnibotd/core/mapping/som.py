"""Self-organising map on a torus (thesis §2.5), trained in batches: the index of the topological map."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnibotd.core.errors import MapError

Floats = NDArray[np.float32]

# Smallest side of the torus, that of the thesis; larger maps get a unit for so many nodes, so that a bucket, and with
# it the cost of looking a view up, stays the same.
_LEAST_SIDE, _NODES_A_UNIT = 10, 40
# Batch training settles in few epochs; more changes nothing measurable (the thesis' online schedule needs 500).
_EPOCHS = 30
# The neighbourhood shrinks geometrically from a third of the torus to hardly beyond the unit itself; stopping at 0.4
# keeps neighbours alike, which probing several units relies on.
_FINAL_RADIUS = 0.4


def side_for(nodes: int) -> int:
    """Side of the square torus that indexes so many nodes."""
    return max(_LEAST_SIDE, math.ceil(math.sqrt(nodes / _NODES_A_UNIT)))


@dataclass(frozen=True)
class Som:
    """codebook (side * side, features) float32, unit k at row k // side, column k % side of a torus."""

    codebook: Floats

    @property
    def side(self) -> int:
        return math.isqrt(len(self.codebook))

    @classmethod
    def train(cls, samples: ArrayLike, side: int = _LEAST_SIDE, seed: int = 0) -> Som:
        """Batch training on (n, features), deterministic by seed. MapError on empty or non-finite data."""
        data = _checked(samples)
        rng = np.random.default_rng(seed)
        codebook = data[rng.choice(len(data), side * side, replace=len(data) < side * side)]
        start = max(0.35 * side, 2.0 * _FINAL_RADIUS)
        squared = torus_distances(side) ** 2
        for radius in np.geomspace(start, _FINAL_RADIUS, _EPOCHS):
            codebook = _epoch(data, codebook, np.exp(-squared / (2.0 * radius**2)).astype(np.float32))
        return cls(codebook)

    def distances(self, samples: ArrayLike) -> Floats:
        """(n, units): the response vectors of the thesis, Eq 6.1."""
        data = _checked(samples)
        if data.shape[1] != self.codebook.shape[1]:
            raise MapError(f"samples of {data.shape[1]} features, the map has {self.codebook.shape[1]}")
        return np.sqrt(_squared_distances(data, self.codebook))

    def bmu(self, samples: ArrayLike) -> NDArray[np.intp]:
        """(n,) best matching units; ties go to the lowest index."""
        return np.asarray(self.distances(samples).argmin(1))

    def quantization_error(self, samples: ArrayLike) -> float:
        """Mean distance to the best matching unit."""
        return float(self.distances(samples).min(1).mean())

    def topographic_error(self, samples: ArrayLike) -> float:
        """Share of samples whose two best units are not among each other's eight neighbours on the torus."""
        best = np.argsort(self.distances(samples), axis=1, kind="stable")[:, :2]
        row, column = np.divmod(best, self.side)
        apart = np.maximum(_around(row[:, 0] - row[:, 1], self.side), _around(column[:, 0] - column[:, 1], self.side))
        return float((apart > 1).mean())


def torus_distances(side: int) -> Floats:
    """(side * side, side * side) Euclidean grid distances between units, edges wrapped."""
    row, column = np.divmod(np.arange(side * side), side)
    rows = _around(row[:, None] - row, side)
    columns = _around(column[:, None] - column, side)
    return np.hypot(rows, columns).astype(np.float32)


def _around(difference: NDArray[np.intp], side: int) -> NDArray[np.intp]:
    apart = np.abs(difference)
    return np.asarray(np.minimum(apart, side - apart))


def _epoch(data: Floats, codebook: Floats, neighbourhood: Floats) -> Floats:
    """Every unit becomes the mean of all samples, weighted by how near their winner is on the torus."""
    winners = _squared_distances(data, codebook).argmin(1)
    order = np.argsort(winners, kind="stable")
    units, starts = np.unique(winners[order], return_index=True)
    sums = np.add.reduceat(data[order], starts, axis=0)
    counts = np.diff(np.append(starts, len(data))).astype(np.float32)
    influence = neighbourhood[:, units]
    total = influence @ counts
    reached = total > 1e-6
    updated = codebook.copy()
    updated[reached] = (influence[reached] @ sums) / total[reached, None]
    return updated


def _squared_distances(data: Floats, codebook: Floats) -> Floats:
    products = data @ codebook.T
    squares = (data * data).sum(1)[:, None] + (codebook * codebook).sum(1) - 2.0 * products
    return np.asarray(np.maximum(squares, 0.0), np.float32)


def _checked(samples: ArrayLike) -> Floats:
    data = np.asarray(samples, np.float32)
    if data.ndim != 2 or data.size == 0:
        raise MapError(f"samples of shape {data.shape}, expected (n, features) with n > 0")
    if not np.isfinite(data).all():
        raise MapError("samples hold NaN or infinity")
    return data
