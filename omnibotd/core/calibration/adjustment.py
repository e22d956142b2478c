"""The turn that explains best where pictures show things: least squares, robust, over all looks and blocks at once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.calibration.mismatch import Mismatch
from omnibotd.core.calibration.panorama import SECTORS, Floats, Grid
from omnibotd.core.calibration.turn import Turn, expected_nearness

# Standard deviations assumed before anything is measured: centre (px), tilt (rad), offset from the turning point
# (ceiling heights: 20 cm under 2 m), shutter (s a row: 48 ms for 480 rows).
_MOUNT = np.array([100.0, 100.0, 0.1, 0.1, 0.1, 0.1, 1e-4])
# Heading 0 is anywhere, so next to nothing holds it (rad). The turning point wanders from look to look, and in all, by
# so many ceiling heights: wheels slip a millimetre.
_HEADING, _DRIFT_STEP, _DRIFT = 1.0, 5e-4, 1e-2
# Of a block's nearness: ceilings have steps and beams, walls stand anywhere. From this zenith angle (rad) on, walls.
_CEILING_NEARNESS, _WALL_NEARNESS, _WALLS = 0.2, 0.5, 0.8
_FARTHEST, _NEAREST = 0.05, 5.0
# Stands for "not to be changed".
_HELD = 1e-9
# What blocks disagree by however sharp they are (rad): depth within a block, lens and light.
_BLOCK_NOISE = 1e-3
# Rounds of weighing; misfits (times the usual one) beyond which a block counts half: people, switched lamps.
_ROUNDS, _MISFIT = 4, 2.0
# The median of chi^2 with two degrees of freedom; and the share of blocks too bare to say how well things fit.
_MEDIAN, _BARE = 1.386, 0.3
# Parts of the world left out in turn to see how much hangs on each.
_PARTS = 12


@dataclass(frozen=True, slots=True)
class Adjusted:
    """A better turn. `misfit` (rad) is how far its blocks are still displaced.

    `covariance` (4, 4) of centre (px) and tilt (rad): from leaving out a twelfth of the world at a time, so that it
    knows of all that fits no model.
    """

    turn: Turn
    misfit: float
    covariance: Floats


def centred(turn: Turn, grid: Grid, mismatch: Mismatch) -> Turn:
    """The turn with better headings and centre, all else as it is: a beginning from far off."""
    problem = _Problem(turn, grid, mismatch, hold=True)
    return problem.moved(problem.solution())


def adjusted(turn: Turn, grid: Grid, mismatch: Mismatch) -> Adjusted:
    """The turn with everything better; what was measured is taken to be linear."""
    problem = _Problem(turn, grid, mismatch, hold=False)
    step = problem.solution()
    return Adjusted(problem.moved(step), problem.misfit(step), problem.jackknife(step))


@dataclass(frozen=True, slots=True)
class _Step:
    """Changes: of the mount and all looks (7 + 3 n,), of the blocks' nearness, and each block's weight (n, blocks)."""

    common: Floats
    nearness: Floats
    weight: Floats


class _Problem:
    """The normal equations: the blocks' nearness, which hangs on nothing else, is eliminated (Schur)."""

    def __init__(self, turn: Turn, grid: Grid, mismatch: Mismatch, *, hold: bool) -> None:
        """`hold` everything but headings and centre."""
        self._turn = turn
        self._sensitivity = mismatch.sensitivity
        soft = np.linalg.inv(np.eye(2) + _BLOCK_NOISE**2 * mismatch.information)
        self._information = soft @ mismatch.information
        self._pull = np.einsum("kbij,kbj->kbi", soft, mismatch.pull)
        self._seen = _displacement(mismatch)
        told = np.trace(mismatch.information, axis1=-2, axis2=-1)
        self._telling: NDArray[np.bool_] = told > max(float(np.quantile(told, _BARE)), 1e-9)
        self._prior, self._prior_pull = _prior(turn, hold)
        zenith, _ = grid.blocks()
        spread = np.where(zenith < _WALLS, _CEILING_NEARNESS, _WALL_NEARNESS) if not hold else _HELD
        self._nearness_prior = np.broadcast_to(np.square(1.0 / spread), zenith.shape)
        self._nearness_pull = self._nearness_prior * (expected_nearness(grid) - turn.nearness)

    def solution(self) -> _Step:
        """Reweighed until those that fit nothing hardly count."""
        step = _Step(np.zeros(0), np.zeros(0), np.ones(self._telling.shape))
        for _ in range(_ROUNDS):
            step = self._solve(step.weight)
            misfit = self._misfits(step)
            usual = float(np.median(misfit[self._telling])) / _MEDIAN if self._telling.any() else 1.0
            step = replace(step, weight=1.0 / (1.0 + misfit / (_MISFIT**2 * usual + 1e-12)))
        return step

    def moved(self, step: _Step) -> Turn:
        turn, mount, look = self._turn, step.common[:7], step.common[7:].reshape(-1, 3)
        tilt = (turn.camera.tilt[0] + float(mount[2]), turn.camera.tilt[1] + float(mount[3]))
        cx, cy = turn.camera.cx + float(mount[0]), turn.camera.cy + float(mount[1])
        return Turn(
            replace(turn.camera, cx=cx, cy=cy, tilt=tilt),
            turn.heading + look[:, 0],
            turn.rate,
            turn.offset + mount[4:6],
            turn.drift + look[:, 1:],
            np.clip(turn.nearness + step.nearness, _FARTHEST, _NEAREST),
            turn.shutter + float(mount[6]),
        )

    def misfit(self, step: _Step) -> float:
        """Root mean square (rad) of what is left unexplained, where anything is told and little is out of line."""
        counts = step.weight * self._telling
        left = np.square(self._left(step)).sum(-1)
        return float(np.sqrt((counts * left).sum() / max(2.0 * counts.sum(), 1e-9)))

    def jackknife(self, step: _Step) -> Floats:
        """(4, 4) covariance of centre and tilt."""
        whole, pull, *_ = self._reduced(step.weight, slice(None))
        changes = []
        for part in range(_PARTS):
            blocks = np.flatnonzero(np.arange(self._telling.shape[1]) % SECTORS * _PARTS // SECTORS == part)
            without, without_pull, *_ = self._reduced(step.weight, blocks)
            rest = np.linalg.solve(whole - without + self._prior, pull - without_pull + self._prior_pull)
            changes.append((rest - step.common)[:4])
        spread = np.stack(changes)
        return np.asarray((_PARTS - 1) / _PARTS * spread.T @ spread)

    def _solve(self, weight: Floats) -> _Step:
        matrix, pull, coupling, own, own_pull = self._reduced(weight, slice(None))
        common = np.asarray(np.linalg.solve(matrix + self._prior, pull + self._prior_pull), np.float64)
        return _Step(common, (own_pull - coupling @ common) / own, weight)

    def _left(self, step: _Step) -> Floats:
        """(n, blocks, 2) displacements that the step does not explain."""
        s = self._sensitivity
        explained = s.mount @ step.common[:7] + np.einsum("kbij,kj->kbi", s.look, step.common[7:].reshape(-1, 3))
        return np.asarray(self._seen - explained - s.nearness * step.nearness[:, None])

    def _misfits(self, step: _Step) -> Floats:
        left = self._left(step)
        return np.asarray(np.einsum("kbi,kbij,kbj->kb", left, self._information, left))

    def _reduced(
        self, weight: Floats, blocks: slice | NDArray[np.intp]
    ) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Of these blocks: matrix and right side without nearness; its coupling, its own diagonal and right side."""
        s, weight = self._sensitivity, weight[:, blocks]
        mount, look, nearness = s.mount[:, blocks], s.look[:, blocks], s.nearness[:, blocks]
        information = self._information[:, blocks] * weight[..., None, None]
        pull = self._pull[:, blocks] * weight[..., None]
        by_mount, by_look = information @ mount, information @ look
        by_nearness = np.einsum("kbij,kbj->kbi", information, nearness)
        matrix = _arrow(
            np.einsum("kbim,kbin->mn", mount, by_mount, optimize=True),
            np.einsum("kbim,kbin->kmn", mount, by_look, optimize=True),
            np.einsum("kbim,kbin->kmn", look, by_look, optimize=True),
        )
        right = np.concatenate([np.einsum("kbim,kbi->m", mount, pull), np.einsum("kbim,kbi->km", look, pull).ravel()])
        with_looks = np.einsum("kbim,kbi->bkm", look, by_nearness).reshape(by_nearness.shape[1], -1)
        coupling = np.hstack([np.einsum("kbim,kbi->bm", mount, by_nearness), with_looks])
        own = np.einsum("kbi,kbi->b", nearness, by_nearness) + self._nearness_prior[blocks]
        own_pull = np.einsum("kbi,kbi->b", nearness, pull) + self._nearness_pull[blocks]
        share = coupling / own[:, None]
        return matrix - share.T @ coupling, right - share.T @ own_pull, coupling, own, own_pull


def _displacement(mismatch: Mismatch) -> Floats:
    """(n, blocks, 2) rad; next to nothing along an edge that says nothing."""
    information = mismatch.information
    ridge = 1e-3 * np.trace(information, axis1=-2, axis2=-1) + 1e-6
    solvable = information + ridge[..., None, None] * np.eye(2)
    return np.asarray(np.linalg.solve(solvable, mismatch.pull[..., None])[..., 0])


def _arrow(mount: Floats, between: Floats, looks: Floats) -> Floats:
    """The matrix of the mount (7, 7), each look's own block (n, 3, 3) and their coupling (n, 7, 3)."""
    n = len(looks)
    matrix = np.zeros((7 + 3 * n, 7 + 3 * n))
    matrix[:7, :7] = mount
    for k in range(n):
        own = slice(7 + 3 * k, 10 + 3 * k)
        matrix[:7, own], matrix[own, :7], matrix[own, own] = between[k], between[k].T, looks[k]
    return matrix


def _prior(turn: Turn, hold: bool) -> tuple[Floats, Floats]:
    """Matrix and right side of what is assumed beforehand."""
    n = len(turn.heading)
    matrix = np.zeros((7 + 3 * n, 7 + 3 * n))
    matrix[np.diag_indices(7)] = np.square(1.0 / (np.where(np.arange(7) < 2, _MOUNT, _HELD) if hold else _MOUNT))
    matrix[7::3, 7::3] = np.eye(n) / _HEADING**2
    wandering = np.diff(np.eye(n), axis=0) / (_HELD if hold else _DRIFT_STEP)
    drift = wandering.T @ wandering + np.eye(n) / (_HELD if hold else _DRIFT) ** 2
    matrix[8::3, 8::3] = matrix[9::3, 9::3] = drift
    # Centre, tilt and headings are held where they are, the others to nothing at all.
    now = np.zeros(len(matrix))
    now[4:7] = *turn.offset, turn.shutter
    now[8::3], now[9::3] = turn.drift.T
    return matrix, np.asarray(-matrix @ now)
