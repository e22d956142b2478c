"""Self-organising map on a torus (thesis §2.5), trained in batches: the index of the topological map."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnibotd.core.errors import MapError

Floats = NDArray[np.float32]

# Smallest side of the torus, that of the thesis; larger maps get a unit for so many nodes, so that a bucket, and with
# it the cost of looking a view up, stays the same.
_LEAST_SIDE, _NODES_A_UNIT = 10, 40
# The neighbourhood shrinks geometrically from a third of the torus to hardly beyond the unit itself, and stays there
# until units settle (the thesis' online schedule takes 500 epochs).
_SHRINKING, _HELD = 30, 10
_FIRST_SHARE, _FINAL_RADIUS = 0.35, 0.325
# While it shrinks each epoch sees another random part of the samples: fitted on all at once, units sit still early on,
# 4 % farther from the samples in the end.
_PART = 0.37
# How well the torus unfolds is chance: of several attempts the best is kept, as to probe several neighbouring units
# relies on it.
_ATTEMPTS = 4
# Samples compared with all units at a time: bounds the memory to some 10 MB, however large the map.
_BLOCK = 2000


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
        middle = data.mean(0)  # far from zero, small differences would drown in rounding
        centred = data - middle
        attempts = [cls(_attempt(centred, side, rng)) for _ in range(_ATTEMPTS)]
        best = min(attempts, key=lambda som: som.topographic_error(centred))
        return cls(best.codebook + middle)

    def distances(self, samples: ArrayLike) -> Floats:
        """(n, units): the response vectors of the thesis, Eq 6.1."""
        return np.asarray(np.sqrt(np.concatenate(list(self._squared(samples)))))

    def bmu(self, samples: ArrayLike) -> NDArray[np.intp]:
        """(n,) best matching units; ties go to the lowest index."""
        return np.concatenate([squares.argmin(1) for squares in self._squared(samples)])

    def quantization_error(self, samples: ArrayLike) -> float:
        """Mean distance to the best matching unit."""
        return float(np.sqrt(np.concatenate([squares.min(1) for squares in self._squared(samples)])).mean())

    def topographic_error(self, samples: ArrayLike) -> float:
        """Share of samples whose two best units are not among each other's eight neighbours on the torus."""
        best, second = np.concatenate([_two_nearest(squares) for squares in self._squared(samples)], axis=1)
        (row, column), (other_row, other_column) = np.divmod(best, self.side), np.divmod(second, self.side)
        apart = np.maximum(_around(row - other_row, self.side), _around(column - other_column, self.side))
        return float((apart > 1).mean())

    def _squared(self, samples: ArrayLike) -> Iterator[Floats]:
        """Squared distances (block, units), block by block. MapError on data that do not fit."""
        data = _checked(samples)
        if data.shape[1] != self.codebook.shape[1]:
            raise MapError(f"samples of {data.shape[1]} features, the map has {self.codebook.shape[1]}")
        return _squared_distances(data, self.codebook)


def torus_distances(side: int) -> Floats:
    """(side * side, side * side) Euclidean grid distances between units, edges wrapped."""
    row, column = np.divmod(np.arange(side * side), side)
    rows = _around(row[:, None] - row, side)
    columns = _around(column[:, None] - column, side)
    return np.hypot(rows, columns).astype(np.float32)


def _around(difference: NDArray[np.intp], side: int) -> NDArray[np.intp]:
    apart = np.abs(difference)
    return np.asarray(np.minimum(apart, side - apart))


def _attempt(data: Floats, side: int, rng: np.random.Generator) -> Floats:
    """A codebook trained from units that random samples start."""
    codebook = data[rng.choice(len(data), side * side, replace=len(data) < side * side)]
    squared = torus_distances(side) ** 2
    part = max(math.ceil(_PART * len(data)), min(len(data), len(codebook)))  # fewer would make units copies
    first = max(_FIRST_SHARE * side, 2.0 * _FINAL_RADIUS)
    for radius in np.geomspace(first, _FINAL_RADIUS, _SHRINKING):
        seen = data[rng.choice(len(data), part, replace=False)]
        codebook = _epoch(seen, codebook, _neighbourhood(squared, radius))
    for _ in range(_HELD):
        codebook = _epoch(data, codebook, _neighbourhood(squared, _FINAL_RADIUS))
    return codebook


def _neighbourhood(squared: Floats, radius: float) -> Floats:
    return np.asarray(np.exp(squared * np.float32(-0.5 / radius**2)))


def _epoch(data: Floats, codebook: Floats, neighbourhood: Floats) -> Floats:
    """Every unit becomes the mean of all samples, weighted by how near their winner is on the torus."""
    winners = np.concatenate([squares.argmin(1) for squares in _squared_distances(data, codebook)])
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


def _squared_distances(data: Floats, codebook: Floats) -> Iterator[Floats]:
    """(block, units), block by block."""
    of_units = (codebook * codebook).sum(1)
    for start in range(0, len(data), _BLOCK):
        block = data[start : start + _BLOCK]
        squares = (block * block).sum(1)[:, None] + of_units - 2.0 * (block @ codebook.T)
        yield np.maximum(squares, 0.0)


def _two_nearest(squares: Floats) -> NDArray[np.intp]:
    """(2, n) nearest and second nearest unit of each row (n, units)."""
    nearest = squares.argmin(1)
    rest = squares.copy()
    rest[np.arange(len(rest)), nearest] = np.inf
    return np.stack([nearest, rest.argmin(1)])


def _checked(samples: ArrayLike) -> Floats:
    data = np.asarray(samples, np.float32)
    if data.ndim != 2 or data.size == 0:
        raise MapError(f"samples of shape {data.shape}, expected (n, features) with n > 0")
    if not np.isfinite(data).all():
        raise MapError("samples hold NaN or infinity")
    return data
