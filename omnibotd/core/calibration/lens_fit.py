"""Bundle adjustment of one lens and the poses of many boards: Levenberg-Marquardt with the poses eliminated.

Robust: residuals larger than `tolerance` px count linearly (Huber). Boards lie in their plane z = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.calibration import lens_model

Floats = NDArray[np.float64]

# Believed of any lens before a corner is seen, with standard deviations: square pixels to 1 %, and coefficients that
# reach from the pinhole over the stereographic to the orthographic lens. Decides only what the corners leave open.
_ASPECT_SIGMA = 0.01
_COEFFICIENT_SIGMA = np.array([0.3, 0.1, 0.03, 0.01])
# Residuals count linearly from here, in standard deviations: nearly all that good corners say is used.
TOLERANCE = 2.0
# Steps without end in sight; a fit from a fair start takes 10-20.
_MOST_STEPS = 60
# A step that gains less than this share of the cost ends the fit.
_ENOUGH = 1e-7
_STIFFEST = 1e8
# The median distance of a normal error in the plane, in standard deviations of a coordinate.
_RAYLEIGH_MEDIAN = 1.1774
# No corner is found better than to this (px), drawn ones included.
_FINEST = 0.02
# Corners that determine a pose.
_POSE_CORNERS = 6


@dataclass(frozen=True, slots=True)
class Observations:
    """Corners (n, 2) px of boards, their points (n, 3) on the board, and where each board's begin: starts (views,)."""

    corners: Floats
    points: Floats
    starts: NDArray[np.intp]

    @classmethod
    def of(cls, corners: Sequence[Floats], points: Sequence[Floats]) -> Observations:
        """From the corners (n_i, 2) and the plane points (n_i, 2) of each view."""
        sizes = [len(part) for part in corners]
        flat = np.vstack(points)
        return cls(np.vstack(corners), np.column_stack([flat, np.zeros(len(flat))]), np.cumsum([0, *sizes[:-1]]))

    def only(self, views: NDArray[np.intp]) -> Observations:
        """Those of some views, by index."""
        ends = np.append(self.starts[1:], len(self.corners))
        rows = [np.arange(self.starts[i], ends[i]) for i in views]
        starts = np.cumsum([0, *(len(row) for row in rows[:-1])])
        return Observations(self.corners[np.concatenate(rows)], self.points[np.concatenate(rows)], starts)

    def without(self, bad: NDArray[np.bool_]) -> Observations:
        """Fewer corners; a view that would keep too few for its pose keeps all."""
        owners = self.owners
        left = np.bincount(owners[~bad], minlength=len(self.starts))
        kept = ~bad | (left < _POSE_CORNERS)[owners]
        starts = np.searchsorted(owners[kept], np.arange(len(self.starts)))
        return Observations(self.corners[kept], self.points[kept], starts)

    @property
    def owners(self) -> NDArray[np.intp]:
        """(n,) the view of each corner."""
        return np.repeat(np.arange(len(self.starts)), np.diff([*self.starts, len(self.corners)]))


@dataclass(frozen=True, slots=True)
class Fit:
    """A lens (8,), and where each board is: rotations (views, 3, 3) and translations (views, 3), camera from board."""

    lens: Floats
    rotations: Floats
    translations: Floats

    def in_camera(self, seen: Observations) -> Floats:
        """(n, 3) the boards' points in the camera's axes."""
        turned = np.einsum("nij,nj->ni", self.rotations[seen.owners], seen.points)
        return np.asarray(turned + self.translations[seen.owners])

    def residuals(self, seen: Observations) -> Floats:
        """(n, 2) px, model less corner."""
        return lens_model.project(self.lens, self.in_camera(seen)) - seen.corners

    def view_rms(self, seen: Observations) -> Floats:
        """(views,) rms distance of corner and model, px."""
        counts = np.diff([*seen.starts, len(seen.corners)])
        return np.sqrt(np.add.reduceat((self.residuals(seen) ** 2).sum(1), seen.starts) / counts)

    def view_median(self, seen: Observations) -> Floats:
        """(views,) median distance of corner and model, px: what a view's stray corners can't raise."""
        off = np.hypot(*self.residuals(seen).T)
        return np.array([np.median(part) for part in np.split(off, seen.starts[1:])])

    def spread(self, seen: Observations) -> float:
        """Standard deviation of a good corner's coordinate, px; from the median, so that bad ones don't count."""
        return max(float(np.median(np.hypot(*self.residuals(seen).T))) / _RAYLEIGH_MEDIAN, _FINEST)

    def only(self, views: NDArray[np.intp]) -> Fit:
        """Of some views, by index."""
        return Fit(self.lens, self.rotations[views], self.translations[views])


@dataclass(frozen=True, slots=True)
class Normal:
    """The normal equations about a fit: lens (8), poses (views, 6), their coupling, and what poses leave of the lens.

    `scores` (views, 8) are the views' shares of the reduced gradient: how far each would pull the lens.
    """

    reduced: Floats
    gradient: Floats
    coupling: Floats
    poses: Floats
    pose_gradient: Floats
    scores: Floats


def adjust(start: Fit, seen: Observations, tolerance: float) -> Fit:
    """The fit of least cost near `start`."""
    fit, best, stiffness = start, cost(start, seen, tolerance), 1e-3
    for _ in range(_MOST_STEPS):
        system = normal_equations(fit, seen, tolerance, stiffness)
        trial = _moved(fit, system)
        trial_cost = cost(trial, seen, tolerance)
        if not trial_cost < best:
            stiffness *= 8.0
            if stiffness > _STIFFEST:
                break
            continue
        gain, fit, best, stiffness = 1.0 - trial_cost / best, trial, trial_cost, max(stiffness / 5.0, 1e-9)
        if gain < _ENOUGH:
            break
    return fit


def cost(fit: Fit, seen: Observations, tolerance: float) -> float:
    """Half the sum of robust squared distances, in px^2, with the prior's share; infinite where the lens is none."""
    if not (fit.lens[:2] > 0.0).all():
        return float("inf")
    off = np.hypot(*fit.residuals(seen).T)
    robust = np.where(off <= tolerance, off**2, tolerance * (2.0 * off - tolerance))
    missing = _prior(fit.lens, tolerance)[1]
    total = 0.5 * float(robust.sum() + (missing**2).sum())
    return total if np.isfinite(total) else float("inf")


def _prior(lens: Floats, tolerance: float) -> tuple[Floats, Floats]:
    """Rows (5, 8) and residuals (5,) of what is believed beforehand, in units of the corners' residuals."""
    rows = np.zeros((5, 8))
    rows[0, :2] = np.array([1.0, -1.0]) / (lens[0] * _ASPECT_SIGMA)
    rows[1:, 4:] = np.diag(1.0 / _COEFFICIENT_SIGMA)
    residuals = np.concatenate([[(lens[0] - lens[1]) / (lens[0] * _ASPECT_SIGMA)], lens[4:] / _COEFFICIENT_SIGMA])
    return rows * tolerance, residuals * tolerance


def normal_equations(fit: Fit, seen: Observations, tolerance: float, stiffness: float = 0.0) -> Normal:
    """Of the robust cost about `fit`, the diagonal raised by `stiffness` (Marquardt)."""
    points = fit.in_camera(seen)
    by_lens, by_point = lens_model.derivatives(fit.lens, points)
    by_pose = np.concatenate([by_point @ _turning(points - fit.translations[seen.owners]), by_point], axis=2)
    off = lens_model.project(fit.lens, points) - seen.corners
    weights = np.minimum(1.0, tolerance / np.maximum(np.hypot(*off.T), 1e-9))
    weighted_lens, weighted_pose = by_lens * weights[:, None, None], by_pose * weights[:, None, None]

    def summed(left: Floats, right: Floats) -> Floats:
        return np.asarray(np.add.reduceat(np.einsum("nki,nkj->nij", left, right), seen.starts, axis=0))

    lens_block = summed(weighted_lens, by_lens)
    coupling, poses = summed(weighted_lens, by_pose), summed(weighted_pose, by_pose)
    lens_gradient = summed(weighted_lens, off[:, :, None])[:, :, 0]
    pose_gradient = summed(weighted_pose, off[:, :, None])[:, :, 0]
    poses = poses * (1.0 + stiffness * np.eye(6)) + 1e-12 * np.eye(6)
    through = np.linalg.solve(poses, np.swapaxes(coupling, 1, 2))  # (views, 6, 8)
    scores = lens_gradient - np.einsum("vij,vi->vj", through, pose_gradient)
    rows, missing = _prior(fit.lens, tolerance)
    whole = (lens_block.sum(0) + rows.T @ rows) * (1.0 + stiffness * np.eye(8))
    reduced = whole - np.einsum("vij,vjk->ik", coupling, through)
    return Normal(reduced, scores.sum(0) + rows.T @ missing, coupling, poses, pose_gradient, scores)


def _turning(points: Floats) -> Floats:
    """(n, 3, 3) d (turned point) / d (small rotation vector) = -[point]x."""
    x, y, z = points.T
    zero = np.zeros_like(x)
    return np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=1).reshape(-1, 3, 3)


def _moved(fit: Fit, system: Normal) -> Fit:
    by_lens = -np.linalg.solve(system.reduced, system.gradient)
    pulled = system.pose_gradient + np.einsum("vij,i->vj", system.coupling, by_lens)
    by_pose = -np.linalg.solve(system.poses, pulled[:, :, None])[:, :, 0]
    turns = np.stack([cv2.Rodrigues(turn)[0] for turn in by_pose[:, :3]])
    return replace(
        fit,
        lens=fit.lens + by_lens,
        rotations=turns @ fit.rotations,
        translations=fit.translations + by_pose[:, 3:],
    )
