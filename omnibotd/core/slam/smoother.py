"""The reference: all poses and landmarks by least squares over the same bearings and wheel steps, in growing batches.

A batch over a whole recording, started from dead reckoning, ends in a wrong minimum as often as not. One that grows by
half a minute starts each part from a good beginning.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from omnibotd.core.geometry import Pose2D
from omnibotd.core.slam.bearing import of_points, wrapped
from omnibotd.core.slam.motion import WheelNoise, WheelStep
from omnibotd.core.slam.several import triangulated
from omnibotd.core.slam.sighting import Bearing

Floats = NDArray[np.float64]
# Seconds that a batch grows by: dead reckoning is still good after them.
GROWTH = 30.0
# Least squares ends after so many steps, few while it grows, or when the cost falls by less than this.
_STEPS, _GROWING_STEPS, _SETTLED = 60, 6, 1e-6
# A bearing so many standard deviations off counts half (Cauchy).
_MISFIT = 2.0
# What ties down the frame: the first pose, m and rad; what keeps landmarks with little parallax from running off, m.
_ANCHOR, _LOOSE = 1e-4, 30.0
# Bearings to begin a landmark from: many enough, and no more than make sense.
_LEAST, _MOST = 3, 60
# A misread bearing among them spoils the beginning, so parts of them are tried until one suits most of the rest (rad).
_PARTS, _ROUGHLY = 6, 0.2
# A solution is doubtful where more bearings than this fit nothing: sensors misread a few in a hundred.
DOUBTFUL = 0.15


@dataclass(frozen=True, slots=True)
class Smoothed:
    """`poses` (n, 3) in the frame of the first, landmarks (2,) m by name, share of bearings that fit nothing."""

    poses: Floats
    landmarks: dict[Hashable, Floats]
    outliers: float

    @property
    def doubtful(self) -> bool:
        """Too many bearings don't fit: the trajectory may be wrong."""
        return self.outliers > DOUBTFUL


def smoothed(
    stamps: Floats, steps: Sequence[WheelStep], views: Sequence[Sequence[Bearing]], noise: WheelNoise, bearing: float
) -> Smoothed:
    """Of n views at `stamps` (s) and the n - 1 steps between; `bearing` (rad) is one bearing's standard deviation."""
    batch = _Batch(stamps, steps, views, noise, bearing)
    end = float(stamps[0])
    while batch.size < len(stamps):
        end += GROWTH
        batch.grow(max(int(np.searchsorted(stamps, end, "right")), 1))
        batch.solve(_GROWING_STEPS)
    batch.solve(_STEPS)
    return Smoothed(
        batch.poses, {batch.names[i]: batch.points[i] for i in np.flatnonzero(batch.mapped)}, batch.outliers()
    )


class _Batch:
    """Poses (size, 3), landmarks `points` (m, 2), of which those `mapped` take part."""

    def __init__(
        self,
        stamps: Floats,
        steps: Sequence[WheelStep],
        views: Sequence[Sequence[Bearing]],
        noise: WheelNoise,
        bearing: float,
    ) -> None:
        self._steps = steps
        self._moves = np.array([(step.move.x, step.move.y, step.move.yaw) for step in steps]).reshape(-1, 3)
        self._move_weights = 1.0 / np.array([noise.variances(step) for step in steps]).reshape(-1, 3)
        seen = [(k, one.name, one.angle) for k, view in enumerate(views) for one in view]
        self.names: list[Hashable] = list(dict.fromkeys(name for _, name, _ in seen))
        index = {name: i for i, name in enumerate(self.names)}
        self._from = np.array([k for k, _, _ in seen], dtype=np.intp)
        self._to = np.array([index[name] for _, name, _ in seen], dtype=np.intp)
        self._angles = np.array([angle for _, _, angle in seen])
        self._sigma = bearing
        self.poses = np.zeros((1, 3))
        self.points = np.zeros((len(self.names), 2))
        self.mapped = np.zeros(len(self.names), dtype=bool)

    @property
    def size(self) -> int:
        return len(self.poses)

    def grow(self, size: int) -> None:
        """Takes more poses in, by dead reckoning from the last, and the landmarks that have parallax by now."""
        last = Pose2D(*self.poses[-1])
        added = [self.poses]
        for step in self._steps[self.size - 1 : size - 1]:
            last = last @ step.move
            added.append(np.array([[last.x, last.y, last.yaw]]))
        self.poses = np.concatenate(added)
        for name in np.flatnonzero(~self.mapped):
            self._begin(int(name))

    def _begin(self, landmark: int) -> None:
        rows = np.flatnonzero((self._to == landmark) & (self._from < self.size))
        if len(rows) < _LEAST:
            return
        rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), _MOST)).astype(int)]
        parts = min(max(len(rows) // _LEAST, 1), _PARTS)
        for part in range(parts):
            some = rows[part::parts]
            point = triangulated(self.poses[self._from[some]], self._angles[some])
            if point is None:
                continue
            off = wrapped(self._angles[rows] - of_points(self.poses[self._from[rows]], point[None]).bearings)
            if np.median(np.abs(off)) < _ROUGHLY:
                self.points[landmark], self.mapped[landmark] = point, True
                return

    def solve(self, steps: int) -> None:
        """Levenberg and Marquardt."""
        damping, cost = 1e-4, self._cost(self.poses, self.points)
        for _ in range(steps):
            by_pose, by_point = self._step(damping)
            poses, points = self.poses + by_pose, self.points + by_point
            new = self._cost(poses, points)
            if new > cost:
                damping *= 10.0
                if damping > 1e6:
                    return
                continue
            fall, cost, damping = cost - new, new, max(damping / 10.0, 1e-9)
            self.poses, self.points = poses, points
            if fall < _SETTLED * new:
                return

    def outliers(self) -> float:
        """Share of all bearings that fit nothing: over three standard deviations off, or of landmarks never mapped."""
        rows = self._rows()
        fit = (np.abs(self._misfits(rows, self.poses, self.points)) <= 3.0).sum()
        return float(1.0 - fit / max(len(self._angles), 1))

    def _rows(self) -> NDArray[np.intp]:
        return np.flatnonzero((self._from < self.size) & self.mapped[self._to])

    def _misfits(self, rows: NDArray[np.intp], poses: Floats, points: Floats) -> Floats:
        """Of bearings, in standard deviations."""
        seen = of_points(poses[self._from[rows]], points[self._to[rows]])
        return wrapped(self._angles[rows] - seen.bearings) / self._sigma

    def _cost(self, poses: Floats, points: Floats) -> float:
        misfits = self._misfits(self._rows(), poses, points)
        moves = _move_errors(poses, self._moves)[0]
        anchor = (poses[0] ** 2).sum() / _ANCHOR**2 + (points**2).sum() / _LOOSE**2
        robust = _MISFIT**2 * np.log1p((misfits / _MISFIT) ** 2).sum()
        return float(robust + (moves**2 * self._move_weights[: len(moves)]).sum() + anchor)

    def _step(self, damping: float) -> tuple[Floats, Floats]:
        """Of poses and landmarks: the poses' chain is a band, the few landmarks are eliminated last."""
        n, m = self.size, len(self.points)
        band, cross, corner = np.zeros((6, 3 * n)), np.zeros((3 * n, 2 * m)), np.eye(2 * m) / _LOOSE**2
        right, bottom = np.zeros(3 * n), -self.points.ravel() / _LOOSE**2
        blocks = np.zeros((n, 3, 3))
        self._add_moves(blocks, band, right)
        self._add_bearings(blocks, cross, corner, right, bottom)
        blocks[0] += np.eye(3) / _ANCHOR**2
        right[:3] -= self.poses[0] / _ANCHOR**2
        for i in range(3):
            for j in range(i, 3):
                band[5 + i - j, j::3] = blocks[:, i, j]
        band[5] *= 1.0 + damping
        corner[np.diag_indices(2 * m)] *= 1.0 + damping
        solved = solveh_banded(band, np.column_stack([right, cross]), overwrite_b=True, check_finite=False)
        by_point = np.linalg.solve(corner - cross.T @ solved[:, 1:], bottom - cross.T @ solved[:, 0])
        return (solved[:, 0] - solved[:, 1:] @ by_point).reshape(n, 3), by_point.reshape(m, 2)

    def _add_moves(self, blocks: Floats, band: Floats, right: Floats) -> None:
        errors, by_first, by_second = _move_errors(self.poses, self._moves)
        weights = self._move_weights[: len(errors)]
        first, second = (by * weights[:, :, None] for by in (by_first, by_second))
        blocks[:-1] += np.einsum("kai,kaj->kij", first, by_first)
        blocks[1:] += np.einsum("kai,kaj->kij", second, by_second)
        off = np.einsum("kai,kaj->kij", first, by_second)  # rows of the earlier pose, columns of the later
        for i in range(3):
            for j in range(3):
                band[2 + i - j, 3 + j :: 3] = off[:, i, j]
        rights = right.reshape(-1, 3)
        rights[:-1] -= np.einsum("kai,ka->ki", first, errors)
        rights[1:] -= np.einsum("kai,ka->ki", second, errors)

    def _add_bearings(self, blocks: Floats, cross: Floats, corner: Floats, right: Floats, bottom: Floats) -> None:
        rows = self._rows()
        k, m = self._from[rows], self._to[rows]
        seen = of_points(self.poses[k], self.points[m])
        errors = wrapped(self._angles[rows] - seen.bearings) / self._sigma
        weights = seen.valid / (1.0 + (errors / _MISFIT) ** 2)
        by_pose, by_point = seen.by_pose / self._sigma, seen.by_landmark / self._sigma
        weighted_pose, weighted_point = by_pose * weights[:, None], by_point * weights[:, None]
        np.add.at(blocks, k, weighted_pose[:, :, None] * by_pose[:, None, :])
        size = len(self.points)
        crosses = cross.reshape(-1, 3, size, 2).transpose(0, 2, 1, 3)
        corners = corner.reshape(size, 2, size, 2).transpose(0, 2, 1, 3)
        np.add.at(crosses, (k, m), weighted_pose[:, :, None] * by_point[:, None, :])
        np.add.at(corners, (m, m), weighted_point[:, :, None] * by_point[:, None, :])
        np.add.at(right.reshape(-1, 3), k, weighted_pose * errors[:, None])
        np.add.at(bottom.reshape(-1, 2), m, weighted_point * errors[:, None])


def _move_errors(poses: Floats, moves: Floats) -> tuple[Floats, Floats, Floats]:
    """What poses (n, 3) say of steps less what wheels said (n - 1, 3), and derivatives by both poses (n - 1, 3, 3)."""
    first, second = poses[:-1], poses[1:]
    c, s = np.cos(first[:, 2]), np.sin(first[:, 2])
    dx, dy = (second[:, :2] - first[:, :2]).T
    moved = np.stack([c * dx + s * dy, c * dy - s * dx, second[:, 2] - first[:, 2]], axis=1)
    errors = moved - moves[: len(moved)]
    errors[:, 2] = wrapped(errors[:, 2])
    by_second = np.zeros((len(first), 3, 3))
    by_second[:, 0, 0] = by_second[:, 1, 1] = c
    by_second[:, 0, 1], by_second[:, 1, 0], by_second[:, 2, 2] = s, -s, 1.0
    by_first = -by_second
    by_first[:, 0, 2], by_first[:, 1, 2] = moved[:, 1], -moved[:, 0]
    return errors, by_first, by_second
