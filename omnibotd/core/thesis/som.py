"""The self-organising map with the thesis' printed schedule (§2.5, Eqs 2.6-2.8): one sample at a time, on a torus.

Weights only ever move towards samples, so each stays a mixture of all samples and its own random start. Distances
then follow from products between samples alone: training keeps a unit's products with every sample and its mixture,
and never touches the 7986 features. In exact arithmetic this is the plain loop, at a fraction of its cost.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnibotd.core.errors import MapError
from omnibotd.core.mapping.som import torus_distances

Floats = NDArray[np.float64]

SIDE = 10
EPOCHS = 500
RATE = 0.9  # eta_0


def radius(epoch: int, epochs: int = EPOCHS, side: int = SIDE) -> float:
    """R_t (2.8); R_0 [assumed] is half the grid's side, the greatest distance along an axis of the torus."""
    return float(side / 2.0 * np.exp(-10.0 * (epoch / epochs) ** 2))


def rates(grid_distances: ArrayLike, epoch: int, epochs: int = EPOCHS, side: int = SIDE) -> Floats:
    """eta_t(r) (2.7) for units at these distances from the winner; 0 beyond R_t. The winner's factor is 1."""
    reach, apart = radius(epoch, epochs, side), np.asarray(grid_distances, np.float64)
    eta = RATE * np.exp(-((epoch / epochs) ** 2)) * np.exp(-((apart / reach) ** 2))
    return np.where(apart <= reach, eta, 0.0)


def train(
    samples: ArrayLike,
    *,
    side: int = SIDE,
    epochs: int = EPOCHS,
    seed: int = 0,
    progress: Callable[[float], None] = lambda share: None,
) -> NDArray[np.float32]:
    """Weights (side * side, q) for samples (n, q), deterministic by seed. MapError on empty or non-finite data.

    Random start within each dimension's range, and another order of the samples each epoch [assumed].
    """
    data = np.asarray(samples, np.float64)
    if data.ndim != 2 or data.size == 0 or not np.isfinite(data).all():
        raise MapError(f"samples of shape {data.shape}, expected (n, features), n > 0, all finite")
    rng = np.random.default_rng(seed)
    start = rng.uniform(data.min(0), data.max(0), (side * side, data.shape[1]))
    # Distances don't change with the origin, but products are the more exact the nearer it is.
    origin = data.mean(0)
    mixtures = _Mixtures(data - origin, start - origin)
    grid = torus_distances(side).astype(np.float64)
    for epoch in range(epochs):
        mixtures.epoch(rng.permutation(len(data)), rates(grid, epoch, epochs, side))
        progress((epoch + 1) / epochs)
    return np.asarray(mixtures.weights() + origin, np.float32)


class _Mixtures:
    """Units as mixtures of samples (n, q) and of each unit's own start (u, q)."""

    def __init__(self, data: Floats, start: Floats) -> None:
        count, units = len(data), len(start)
        self._data, self._start = data, start
        # Rows: products with every sample | shares of every sample | share of the start.
        self._samples = np.hstack([data @ data.T, np.eye(count), np.zeros((count, 1))])
        self._units = np.hstack([start @ data.T, np.zeros((units, count)), np.ones((units, 1))])
        self._squares = np.einsum("ij,ij->i", start, start)

    def epoch(self, order: NDArray[np.intp], rates: Floats) -> None:
        """Present the samples in this order; rates (u, u) from winner to unit."""
        reached = [np.flatnonzero(row) for row in rates]
        for sample in order:
            winner = int(np.argmin(self._squares - 2.0 * self._units[:, sample]))
            moved = reached[winner]
            self._move(moved, int(sample), rates[winner, moved])

    def _move(self, units: NDArray[np.intp], sample: int, rate: Floats) -> None:
        """Eq 2.6 for all `units` at once: w + rate (x - w), in products, shares and squares."""
        keep = 1.0 - rate
        product, own = self._units[units, sample], self._samples[sample, sample]
        self._squares[units] = keep**2 * self._squares[units] + 2.0 * rate * keep * product + rate**2 * own
        self._units[units] = keep[:, None] * self._units[units] + rate[:, None] * self._samples[sample]

    def weights(self) -> Floats:
        count = len(self._data)
        shares, from_start = self._units[:, count:-1], self._units[:, -1:]
        return np.asarray(shares @ self._data + from_start * self._start)
