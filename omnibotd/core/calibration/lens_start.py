"""A first guess of lens and poses from nothing but the corners: try lenses of every kind and width, and see which lets
the boards be flat and square.

A board's pose follows from the *rays* of its corners by linear algebra, so corners may lie 90 degrees off axis and
more. That is what a fit that starts from normalised image points (as OpenCV's does) can't do, and why it diverges.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.calibration import lens_model
from omnibotd.core.calibration.lens_fit import Fit, Observations

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Kind:
    """An ideal lens: its radius at a zenith angle, in focal lengths, and the widest angle (rad) worth trying."""

    radius: Callable[[Floats], Floats]
    widest: float


_KINDS = (
    _Kind(lambda theta: theta, math.radians(125)),  # equidistant
    _Kind(lambda theta: 2.0 * np.tan(theta / 2.0), math.radians(125)),  # stereographic
    _Kind(lambda theta: 2.0 * np.sin(theta / 2.0), math.radians(125)),  # equisolid
    _Kind(np.tan, math.radians(65)),  # pinhole
)
# Zenith angles (rad) tried for the outermost corner. 8 degrees apart: a fit converges from twice as far.
_NARROWEST, _APART = math.radians(12), math.radians(8)
# Share of corners that may lie farther out than a lens images anything: they may be no corners.
_BEYOND = 0.02
_TABLE = 64  # angles at which an ideal lens is put into coefficients


def likeliest(seen: Observations, centres: Sequence[Floats]) -> list[Floats]:
    """Lenses (8,) that may have taken the corners, with their axes at one of `centres` (px); the likeliest first."""
    scored = []
    for centre in centres:
        reach = float(np.hypot(*(seen.corners - centre).T).max())
        for lens in _lenses(reach, centre):
            fit = posed(lens, seen)
            if fit is not None:
                scored.append((float(np.median(fit.view_rms(seen))), lens))
    return [lens for _, lens in sorted(scored, key=lambda guess: guess[0])]


def _lenses(reach: float, centre: Floats) -> Iterator[Floats]:
    for kind in _KINDS:
        for theta in np.arange(_NARROWEST, kind.widest, _APART):
            angles = np.linspace(0.0, theta, _TABLE)
            r = kind.radius(angles)
            powers = angles[:, None] ** np.array([3.0, 5.0, 7.0, 9.0])
            coefficients = np.linalg.lstsq(powers, r - angles, rcond=1e-6)[0]
            f = reach / r[-1]
            yield np.array([f, f, *centre, *coefficients])


def posed(lens: Floats, seen: Observations) -> Fit | None:
    """The poses of all boards as this lens would have them; None where it can't have taken the corners."""
    flat = (seen.corners - lens[2:4]) / lens[:2]
    r = np.hypot(*flat.T)
    theta = lens_model.zenith(lens, r)
    beyond = np.isnan(theta)
    if beyond.mean() > _BEYOND:
        return None
    theta[beyond] = np.max(theta[~beyond])
    along = np.sin(theta) / np.maximum(r, 1e-12)
    rays = np.column_stack([flat * along[:, None], np.cos(theta)])
    return Fit(lens, *_poses(rays, seen))


def _poses(rays: Floats, seen: Observations) -> tuple[Floats, Floats]:
    """Rotations (views, 3, 3) and translations (views, 3) that turn each board's points into its rays' directions."""
    owners, counts = seen.owners, np.diff([*seen.starts, len(rays)])[:, None]
    centres = np.add.reduceat(seen.points, seen.starts) / counts
    shifted = seen.points - centres[owners]
    sizes = np.sqrt(np.add.reduceat(shifted**2, seen.starts).sum(1) / counts[:, 0])
    p = np.column_stack([shifted[:, :2] / sizes[owners][:, None], np.ones(len(rays))])
    # |ray x H p|^2 = (H p)' (1 - ray ray') (H p), a quadratic form in the nine entries of H
    blind = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    forms = np.einsum("nij,nk,nl->nikjl", blind, p, p).reshape(-1, 9, 9)
    vectors = np.linalg.eigh(np.add.reduceat(forms, seen.starts))[1]
    homographies = vectors[:, :, 0].reshape(-1, 3, 3)
    ahead = np.einsum("ni,nij,nj->n", rays, homographies[owners], p)
    homographies = homographies * np.where(np.add.reduceat(ahead, seen.starts) < 0.0, -1.0, 1.0)[:, None, None]
    rotations, translations = _decomposed(homographies)
    translations = translations * sizes[:, None] - np.einsum("vij,vj->vi", rotations, centres)
    return rotations, translations


def _decomposed(homographies: Floats) -> tuple[Floats, Floats]:
    """The nearest rotation to (h1, h2, h1 x h2) of equal lengths, and h3 in the same measure."""
    h1, h2, h3 = (homographies[:, :, k] for k in range(3))
    length = np.maximum((np.linalg.norm(h1, axis=1) + np.linalg.norm(h2, axis=1)) / 2.0, 1e-12)[:, None]
    axes = np.stack([h1 / length, h2 / length, np.cross(h1, h2) / length**2], axis=2)
    u, _, vt = np.linalg.svd(axes)
    flip = np.linalg.det(u @ vt)
    u[:, :, 2] *= flip[:, None]
    return u @ vt, h3 / length
