"""Finding the lens's image circle: the bright disc in a dark surround, where no calibration says it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.vision.frame import Frame, Image

Floats = NDArray[np.float64]

# Worked out at half size: noise halves, and the fit over hundreds of points is far finer than a pixel anyway.
_REDUCTION = 2
# The surround must be this much darker than the picture's middle, in grey values: else nothing tells the disc's edge.
_LEAST_STEP = 15.0
# Directions in which the edge is looked for, and how many must find it.
_DIRECTIONS, _FEWEST = 180, 40
# An edge this near the image border (px, reduced) is the border.
_BORDER = 3
# Points farther off the circle than this (px, reduced) are not its edge: a dark corner of the room, a lamp's flare.
_TOLERANCE = 2.0
_TRIALS = 200


def find(frames: Sequence[Frame]) -> tuple[float, float, float] | None:
    """(cx, cy, radius) in pixels of the frames, or None where no dark surround shows a circle.

    The brightest of many frames tells the disc from a dark corner of the room; one bright frame is enough.
    """
    if not frames:
        return None
    brightest = np.maximum.reduce([_smooth(frame) for frame in frames])
    points = _edge_points(brightest)
    circle = _robust_circle(points) if len(points) >= _FEWEST else None
    if circle is None or not _plausible(circle, brightest.shape):
        return None
    cx, cy, radius = circle
    return (cx + 0.5) * _REDUCTION - 0.5, (cy + 0.5) * _REDUCTION - 0.5, radius * _REDUCTION


def _smooth(frame: Frame) -> Image:
    return np.asarray(cv2.medianBlur(frame.grey(_REDUCTION), 5), np.uint8)


def _edge_points(image: Image) -> Floats:
    """(n, 2) outermost places, on rays from the bright area's centre, where the picture rises out of the dark."""
    height, width = image.shape
    patch = max(4, min(height, width) // 16)
    corners = [image[:patch, :patch], image[:patch, -patch:], image[-patch:, :patch], image[-patch:, -patch:]]
    dark = float(np.median([np.median(corner) for corner in corners]))
    bright = float(np.median(image[height // 3 : -height // 3, width // 3 : -width // 3]))
    if bright - dark < _LEAST_STEP:
        return np.zeros((0, 2))
    moments = cv2.moments((image > (dark + bright) / 2).astype(np.uint8), binaryImage=True)
    centre = np.array([moments["m10"], moments["m01"]]) / max(moments["m00"], 1.0)
    found = [_outermost(image, centre, 2.0 * math.pi * k / _DIRECTIONS, dark) for k in range(_DIRECTIONS)]
    return np.array([point for point in found if point is not None]).reshape(-1, 2)


def _outermost(image: Image, centre: Floats, angle: float, dark: float) -> tuple[float, float] | None:
    """Where the ray from `centre` leaves the disc, to a fraction of a pixel; None at the image border."""
    height, width = image.shape
    steps = np.arange(0.0, math.hypot(height, width), 0.5)
    u, v = centre[0] + steps * math.cos(angle), centre[1] + steps * math.sin(angle)
    inside = (u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1)
    u, v = u[inside], v[inside]
    profile = cv2.remap(image.astype(np.float32), u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR).ravel()
    lit = np.flatnonzero(profile > dark + _LEAST_STEP)
    if not len(lit):
        return None
    # Half-way between the dark and what lies just inside the rim: vignetting makes the rim darker than the middle.
    rim = float(np.median(profile[max(0, lit[-1] - 16) : lit[-1] + 1]))
    edge = int(np.flatnonzero(profile > (dark + rim) / 2)[-1])
    x, y = float(u[edge]), float(v[edge])
    if min(x, y, width - 1 - x, height - 1 - y) < _BORDER:
        return None
    return x, y


def _robust_circle(points: Floats) -> tuple[float, float, float] | None:
    """The circle most points lie on (RANSAC, fixed seed), fitted to those; None where fewer than half agree."""
    rng = np.random.default_rng(0)
    best = np.zeros(len(points), bool)
    for _ in range(_TRIALS):
        agreeing = _near(points, _fitted(points[rng.choice(len(points), 3, replace=False)]))
        if agreeing.sum() > best.sum():
            best = agreeing
    if best.sum() < max(_FEWEST, len(points) / 2):
        return None
    return _fitted(points[best])


def _fitted(points: Floats) -> tuple[float, float, float]:
    """Least squares on x^2 + y^2 = 2 cx x + 2 cy y + c."""
    design = np.column_stack([2.0 * points, np.ones(len(points))])
    (cx, cy, c), *_ = np.linalg.lstsq(design, (points**2).sum(1), rcond=None)
    return float(cx), float(cy), math.sqrt(max(float(c + cx * cx + cy * cy), 0.0))


def _near(points: Floats, circle: tuple[float, float, float]) -> NDArray[np.bool_]:
    cx, cy, radius = circle
    return np.asarray(np.abs(np.hypot(points[:, 0] - cx, points[:, 1] - cy) - radius) < _TOLERANCE)


def _plausible(circle: tuple[float, float, float], shape: tuple[int, ...]) -> bool:
    """The centre in the middle half of the picture, the radius between a quarter and all of the smaller side."""
    height, width = shape[0], shape[1]
    cx, cy, radius = circle
    central = abs(cx - width / 2) < width / 4 and abs(cy - height / 2) < height / 4
    return central and 0.25 * min(height, width) < radius < min(height, width)
