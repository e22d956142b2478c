"""What a bearing says of a landmark: of a point (Eq 5.5), of a ray with inverse depth, and of two bearings together."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
# A landmark nearer than a centimetre stands in the robot: its bearing says nothing.
AT_THE_ROBOT = 1e-2


@dataclass(frozen=True, slots=True)
class Predicted:
    """Bearings (m,) of m landmarks, derivatives by the pose (m, 3) and by each landmark (m, k); `valid` (m,)."""

    bearings: Floats
    by_pose: Floats
    by_landmark: Floats
    valid: NDArray[np.bool_]


def wrapped(angles: Floats) -> Floats:
    """The same angles in [-pi, pi)."""
    return (angles + np.pi) % (2.0 * np.pi) - np.pi


def of_points(pose: Floats, points: Floats) -> Predicted:
    """Of landmarks (x, y), (m, 2), seen from `pose` (3,), or each from its own pose (m, 3)."""
    dx, dy = (points - pose[..., :2]).T
    square = dx * dx + dy * dy
    valid = square > AT_THE_ROBOT**2
    square = np.where(valid, square, 1.0)
    by_point = np.stack([-dy / square, dx / square], axis=1)
    by_pose = np.column_stack([-by_point, np.full(len(dx), -1.0)])
    return Predicted(wrapped(np.arctan2(dy, dx) - pose[..., 2]), by_pose, by_point, valid)


def of_rays(pose: Floats, rays: Floats) -> Predicted:
    """Of landmarks (x0, y0, direction, inverse depth), (m, 4): a ray from where it was first seen, and 1/m along it."""
    x0, y0, direction, inverse = rays.T
    c, s = np.cos(direction), np.sin(direction)
    a, b = inverse * (x0 - pose[0]) + c, inverse * (y0 - pose[1]) + s
    square = a * a + b * b
    valid = square > (AT_THE_ROBOT * inverse) ** 2
    square = np.where(valid, square, 1.0)
    da, db = -b / square, a / square
    by_pose = np.stack([-inverse * da, -inverse * db, np.full(len(rays), -1.0)], axis=1)
    by_depth = (x0 - pose[0]) * da + (y0 - pose[1]) * db
    by_ray = np.stack([inverse * da, inverse * db, c * db - s * da, by_depth], axis=1)
    return Predicted(wrapped(np.arctan2(b, a) - pose[2]), by_pose, by_ray, valid)


def ray_point(ray: Floats) -> tuple[Floats, Floats]:
    """The point (2,) at the ray's depth, and its derivative by the ray (2, 4)."""
    x0, y0, direction, inverse = ray
    c, s, depth = math.cos(direction), math.sin(direction), 1.0 / inverse
    jacobian = np.array([[1.0, 0.0, -s * depth, -c * depth**2], [0.0, 1.0, c * depth, -s * depth**2]])
    return np.array([x0 + c * depth, y0 + s * depth]), jacobian


@dataclass(frozen=True, slots=True)
class Crossing:
    """Where two bearings meet, ranges to it (m, negative: behind), derivatives by poses (2, 3) and bearings (2,)."""

    point: Floats
    ranges: tuple[float, float]
    by_first: Floats
    by_second: Floats
    by_bearings: tuple[Floats, Floats]


def crossing(first: Floats, bearing1: float, second: Floats, bearing2: float) -> Crossing | None:
    """Of the bearings from two poses (specification of §5.2.3); None where they are parallel."""
    a1, a2 = first[2] + bearing1, second[2] + bearing2
    c1, s1, c2, s2 = math.cos(a1), math.sin(a1), math.cos(a2), math.sin(a2)
    sine = s2 * c1 - c2 * s1
    if abs(sine) < 1e-9:
        return None
    dx, dy = second[:2] - first[:2]
    r1, r2 = (dx * s2 - dy * c2) / sine, (dx * s1 - dy * c1) / sine
    along1, along2 = np.array([c2, s2]) / sine, -np.array([c1, s1]) / sine
    return Crossing(
        first[:2] + r1 * np.array([c1, s1]),
        (float(r1), float(r2)),
        np.outer(along1, (-s1, c1, r1)),
        np.outer(along2, (-s2, c2, r2)),
        (along1 * r1, along2 * r2),
    )
