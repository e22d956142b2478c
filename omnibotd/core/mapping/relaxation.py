"""Relaxing the map: headings first, then positions, each by robust sparse least squares over measured differences.

Both are linear once headings are known, so no iteration over angles is needed (thesis §6.2 leaves the map unrelaxed).
Imports scipy: for the training process only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csc_matrix, csr_matrix, diags
from scipy.sparse.linalg import splu

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]

# Residuals beyond two standard deviations count as doubtful (Cauchy).
_DOUBT = 2.0
# Holds node 0 where it is: firm against every measurement, weak enough for the arithmetic.
_ANCHOR = 1e6


@dataclass(frozen=True)
class Differences:
    """M measurements of `second` minus `first`: values (M,) or (M, 2), standard deviations `sigma` (M,)."""

    first: Ints
    second: Ints
    value: Floats
    sigma: Floats

    def __len__(self) -> int:
        return len(self.first)

    def rows(self, nodes: int) -> csr_matrix:
        """The sparse (M, nodes) matrix that takes values at the nodes to predicted differences."""
        m = np.arange(len(self))
        signs = np.repeat([1.0, -1.0], len(self))
        columns = np.concatenate([self.second, self.first])
        return coo_matrix((signs, (np.tile(m, 2), columns)), shape=(len(self), nodes)).tocsr()


def joined(parts: list[Differences]) -> Differences:
    return Differences(
        np.concatenate([p.first for p in parts]),
        np.concatenate([p.second for p in parts]),
        np.concatenate([p.value for p in parts]),
        np.concatenate([p.sigma for p in parts]),
    )


def relaxed(
    rows: csr_matrix, values: Floats, sigma: Floats, trusted: int, rounds: int = 6, held: tuple[int, ...] = (0,)
) -> Floats:
    """(N, d) with rows @ result = values (M, d) as nearly as sigma (M,) asks, result[held] near 0.

    Reweighted: the first `trusted` rows keep their weight, the others lose it as their residual grows.
    """
    anchor = coo_matrix(([_ANCHOR] * len(held), (held, held)), shape=(rows.shape[1],) * 2).tocsc()
    weights = 1.0 / sigma**2
    result = np.zeros((rows.shape[1], values.shape[1]))
    for _ in range(rounds):
        weighted = diags(weights) @ rows
        result = _solved((rows.T @ weighted + anchor).tocsc(), weighted.T @ values)
        residual = np.linalg.norm(rows @ result - values, axis=1) / sigma
        doubt = 1.0 + (residual / _DOUBT) ** 2
        doubt[:trusted] = 1.0
        weights = 1.0 / (sigma**2 * doubt)
    return np.asarray(result)


def _solved(normal: csc_matrix, right: Floats) -> Floats:
    """Of a symmetric positive definite matrix: no pivoting and minimum degree order are several times faster here."""
    factors = splu(normal, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return np.asarray(factors.solve(right))


def relax_headings(measured: Differences, start: Floats, rounds: int = 6) -> Floats:
    """Headings (N,) that fit the measured turns, from a starting guess good to well within half a turn."""
    rows = measured.rows(len(start))
    residual = measured.value - rows @ start
    wrapped = np.arctan2(np.sin(residual), np.cos(residual))
    return start + relaxed(rows, wrapped[:, None], measured.sigma, 0, rounds)[:, 0]


def relax_positions(measured: Differences, nodes: int, trusted: int, rounds: int = 6) -> Floats:
    """Positions (N, 2) that fit measured offsets in map axes; the first `trusted` (odometry) are never doubted."""
    return relaxed(measured.rows(nodes), measured.value, measured.sigma, trusted, rounds)
