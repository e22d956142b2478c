"""Kannala and Brandt's fisheye (OpenCV's `fisheye`) with its derivatives: what a least-squares fit needs of it.

r(theta) = theta + k1 theta^3 + k2 theta^5 + k3 theta^7 + k4 theta^9; u = fx r cos(phi) + cx, v = fy r sin(phi) + cy.
A lens is the array (fx, fy, cx, cy, k1, k2, k3, k4). Points are in the camera's axes: u right, v down, optical axis.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_POWERS = np.array([3.0, 5.0, 7.0, 9.0])
# Zenith angles at which a lens is tabulated to be inverted.
_ANGLES = np.linspace(0.0, np.pi, 2000)
# Where a lens hardly grows, a step of Newton's method would lead anywhere.
_LEAST_SLOPE = 0.02


def radius(lens: Floats, theta: Floats) -> Floats:
    """r in focal lengths, of zenith angles of any shape."""
    return np.asarray(theta + (theta[..., None] ** _POWERS) @ lens[4:])


def slope(lens: Floats, theta: Floats) -> Floats:
    """dr / dtheta."""
    return np.asarray(1.0 + (theta[..., None] ** (_POWERS - 1.0)) @ (_POWERS * lens[4:]))


def zenith(lens: Floats, r: Floats) -> Floats:
    """The zenith angle of r, in focal lengths; NaN where the lens images nothing so far out."""
    table = radius(lens, _ANGLES)
    folds = np.flatnonzero(np.diff(table) <= 0.0)
    rising = slice(None, folds[0] + 1 if len(folds) else None)
    theta = np.interp(r, table[rising], _ANGLES[rising], right=np.nan)
    for _ in range(2):  # of Newton's method: from a thousandth of a radian to a millionth of a millionth
        theta = theta - (radius(lens, theta) - r) / np.maximum(slope(lens, theta), _LEAST_SLOPE)
    return np.asarray(theta)


def project(lens: Floats, points: Floats) -> Floats:
    """Pixels (n, 2) of points (n, 3)."""
    across = np.maximum(np.hypot(points[:, 0], points[:, 1]), 1e-12)
    r = radius(lens, np.arctan2(across, points[:, 2]))
    return np.asarray(lens[2:4] + lens[:2] * (r / across)[:, None] * points[:, :2])


def derivatives(lens: Floats, points: Floats) -> tuple[Floats, Floats]:
    """d pixel / d lens (n, 2, 8) and d pixel / d point (n, 2, 3)."""
    across = np.maximum(np.hypot(points[:, 0], points[:, 1]), 1e-12)
    theta = np.arctan2(across, points[:, 2])
    heading = points[:, :2] / across[:, None]
    r = radius(lens, theta)
    by_lens = np.zeros((len(points), 2, 8))
    by_lens[:, [0, 1], [0, 1]] = r[:, None] * heading
    by_lens[:, [0, 1], [2, 3]] = 1.0
    by_lens[:, :, 4:] = (lens[:2] * heading)[:, :, None] * (theta[:, None] ** _POWERS)[:, None, :]
    distance2 = across**2 + points[:, 2] ** 2
    r_by_across = slope(lens, theta) * points[:, 2] / distance2
    r_by_depth = -slope(lens, theta) * across / distance2
    outward = heading[:, :, None] * heading[:, None, :]
    by_point = np.empty((len(points), 2, 3))
    by_point[:, :, :2] = r_by_across[:, None, None] * outward + (r / across)[:, None, None] * (np.eye(2) - outward)
    by_point[:, :, 2] = r_by_depth[:, None] * heading
    return by_lens, by_point * lens[:2][:, None]
