"""Relaxing the map: headings first, then positions, each by robust sparse least squares over measured differences.

Both are linear once headings are known, so no iteration over angles is needed (thesis §6.2 leaves the map unrelaxed).
Imports scipy: for the training process only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csc_matrix, csr_matrix, diags
from scipy.sparse.linalg import SuperLU, splu

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]

# Residuals beyond two standard deviations count as doubtful (Cauchy).
_DOUBT = 2.0
# Conjugate gradients end at this relative error, micrometres here; they take 10 to 30 steps, each a hundredth of a
# factorisation.
_EXACT, _ITERATIONS = 1e-7, 100


@dataclass(frozen=True)
class Differences:
    """M measurements of `second` minus `first`: values (M,) or (M, 2), standard deviations `sigma` (M,)."""

    first: Ints
    second: Ints
    value: Floats
    sigma: Floats

    def __len__(self) -> int:
        return len(self.first)

    def rows(self, nodes: int, held: int = 0) -> csr_matrix:
        """The sparse (M, nodes - held) matrix that takes changes of all but the first `held` nodes to differences."""
        m = np.arange(len(self))
        signs = np.repeat([1.0, -1.0], len(self))
        columns = np.concatenate([self.second, self.first]) - held
        free = columns >= 0
        entries = signs[free], (np.tile(m, 2)[free], columns[free])
        return coo_matrix(entries, shape=(len(self), nodes - held)).tocsr()

    def misfit(self, values: Floats) -> Floats:
        """(M,) or (M, 2): measured less what `values` at the nodes (N,) or (N, 2) predict."""
        return np.asarray(self.value - (values[self.second] - values[self.first]))


def joined(parts: list[Differences]) -> Differences:
    return Differences(
        np.concatenate([p.first for p in parts]),
        np.concatenate([p.second for p in parts]),
        np.concatenate([p.value for p in parts]),
        np.concatenate([p.sigma for p in parts]),
    )


def relaxed(rows: csr_matrix, values: Floats, sigma: Floats, trusted: int, rounds: int = 6) -> Floats:
    """(N, d) with rows @ result = values (M, d) as nearly as sigma (M,) asks.

    Reweighted: the first `trusted` rows keep their weight, the others lose it as their residual grows.
    """
    weights = 1.0 / sigma**2
    result = np.zeros((rows.shape[1], values.shape[1]))
    factors = None
    for _ in range(rounds):
        weighted = diags(weights) @ rows
        normal, right = (rows.T @ weighted).tocsc(), weighted.T @ values
        if factors is None:
            factors = _factorised(normal)
            result = np.asarray(factors.solve(right))
        else:  # other weights, much the same matrix: its first factors make conjugate gradients fast
            result = np.stack([_solved(normal, b, x, factors) for b, x in zip(right.T, result.T, strict=True)], 1)
        residual = np.linalg.norm(rows @ result - values, axis=1) / sigma
        doubt = 1.0 + (residual / _DOUBT) ** 2
        doubt[:trusted] = 1.0
        weights = 1.0 / (sigma**2 * doubt)
    return result


def _factorised(normal: csc_matrix) -> SuperLU:
    """Of a symmetric positive definite matrix: no pivoting and minimum degree order are several times faster here."""
    return splu(normal, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def _solved(normal: csc_matrix, right: Floats, start: Floats, factors: SuperLU) -> Floats:
    """(N,) by conjugate gradients, preconditioned with a similar matrix's factors; factorised where that is slow."""
    result, residual = start.copy(), right - normal @ start
    direction = step = factors.solve(residual)
    energy, enough = float(residual @ step), _EXACT**2 * float(right @ factors.solve(right))
    for _ in range(_ITERATIONS):
        if energy <= enough:
            return result
        along = normal @ direction
        length = energy / float(direction @ along)
        result, residual = result + length * direction, residual - length * along
        step = factors.solve(residual)
        energy, before = float(residual @ step), energy
        direction = step + (energy / before) * direction
    return np.asarray(_factorised(normal).solve(right))


def relax_headings(measured: Differences, start: Floats, rounds: int = 6, held: int = 1) -> Floats:
    """Headings (N,) that fit the measured turns, from a guess good to well within half a turn; `held` of them stay."""
    misfit = measured.misfit(start)
    wrapped = np.arctan2(np.sin(misfit), np.cos(misfit))
    change = relaxed(measured.rows(len(start), held), wrapped[:, None], measured.sigma, 0, rounds)
    return np.concatenate([start[:held], start[held:] + change[:, 0]])


def relax_positions(measured: Differences, start: Floats, trusted: int, rounds: int = 6, held: int = 1) -> Floats:
    """Positions (N, 2) that fit measured offsets in map axes, whatever the `start` of all but the first `held`.

    The first `trusted` offsets (odometry) are never doubted.
    """
    change = relaxed(measured.rows(len(start), held), measured.misfit(start), measured.sigma, trusted, rounds)
    return np.concatenate([start[:held], start[held:] + change])
