"""What is compared between two views of a ceiling: edges, blind to brightness, contrast and sign."""

from __future__ import annotations

import cv2
import numpy as np

from omnibotd.core.vision.frame import FloatImage, Image

# Side of the box over which edge strength is evened out, in pixels of the layer: just wider than an edge. Of two edges
# side by side (of a beam, a lamp) none must outweigh the other when the light comes from elsewhere, or they seem moved.
_BOX = 9
# And where views of one light are aligned with it alone: there a wide box lets the alignment begin from farther off.
_WIDE_BOX = 31
# Side of the box whose mean is taken off the picture first. Light that falls off over the ceiling adds its own slope to
# one side of every groove and takes it from the other: by night it seemed to move a grid of panels by 13 mm.
_SHADING_BOX = 15
# Grey levels a pixel below which an edge drowns in sensor noise; keeps a flat ceiling near zero.
_NOISE_FLOOR = 1.5
# A person: darker than half the median, over 1.5 % of the view, and reaching in from its border.
_OCCLUDER_GRID = 80
_OCCLUDER_CELLS = 100


def gradients(view: Image, blur: float) -> tuple[FloatImage, FloatImage]:
    """Scharr derivatives along columns and rows, grey levels a pixel, after a Gaussian of `blur` pixels."""
    return _slopes(_smoothed(view, blur))


def gradient_magnitude(view: Image) -> FloatImage:
    """Grey levels a pixel."""
    return np.asarray(cv2.magnitude(*gradients(view, 1.0)), np.float32)


def edges(view: Image) -> FloatImage:
    """As `gradient_magnitude`, of what stands out of the shading."""
    smooth = _smoothed(view, 1.0)
    standing_out = np.asarray(smooth - cv2.blur(smooth, (_SHADING_BOX, _SHADING_BOX)), np.float32)
    return np.asarray(cv2.magnitude(*_slopes(standing_out)), np.float32)


def _smoothed(view: Image, blur: float) -> FloatImage:
    return np.asarray(cv2.GaussianBlur(view.astype(np.float32), (0, 0), blur), np.float32)


def _slopes(smooth: FloatImage) -> tuple[FloatImage, FloatImage]:
    dx = cv2.Scharr(smooth, cv2.CV_32F, 1, 0, scale=1 / 16.0)
    dy = cv2.Scharr(smooth, cv2.CV_32F, 0, 1, scale=1 / 16.0)
    return np.asarray(dx, np.float32), np.asarray(dy, np.float32)


def evened(magnitude: FloatImage, box: int = _BOX) -> FloatImage:
    """Edge strength: gradient magnitude over its local mean, about 1 on average on structure, 0 on a flat ceiling."""
    return np.asarray(magnitude / (cv2.blur(magnitude, (box, box)) + _NOISE_FLOOR), np.float32)


def edge_strength(view: Image) -> FloatImage:
    """That of a view, evened out widely."""
    return evened(gradient_magnitude(view), _WIDE_BOX)


def unoccluded(view: Image) -> Image | None:
    """255 where no person leans into the view, 0 where one does; None when nobody is there."""
    small = cv2.resize(view, (_OCCLUDER_GRID, _OCCLUDER_GRID), interpolation=cv2.INTER_AREA)
    dark = (small < 0.5 * np.median(small)).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(dark)
    x, y, w, h, area = stats.T
    at_border = (x == 0) | (y == 0) | (x + w == _OCCLUDER_GRID) | (y + h == _OCCLUDER_GRID)
    people = at_border & (area > _OCCLUDER_CELLS)
    people[0] = False  # label 0 is everything that is not dark
    if not people.any():
        return None
    hidden = cv2.dilate(np.where(people[labels], 255, 0).astype(np.uint8), np.ones((5, 5), np.uint8))
    whole = cv2.resize(hidden, view.shape[::-1], interpolation=cv2.INTER_NEAREST)
    return np.asarray(255 - whole, np.uint8)
