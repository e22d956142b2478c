"""Lenses on the axis of a 90 degree cone: the closed forms of the thesis' sections 2.2.1 and 2.3.

Image distances are pixels from the picture of the tip outwards; lengths metres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from omnibotd.core.optics.rigid import Floats


def focal_length(distance: float, radius: float, image_radius: float) -> float:
    """Pixels, from how large (px) a mirror of `radius` appears `distance` m before the lens (Eq 2.2)."""
    return (distance / radius + 1.0) * image_radius


def stereo_range(upper: ArrayLike, lower: ArrayLike, focal: float, distance: float, separation: float) -> Floats:
    """Metres from the axis to what two coaxial mirrors, tips `separation` apart, show at these pixels (Eq 2.1).

    For cameras above their mirrors; below them, swap the two. NaN where the disparity is not positive.
    """
    disparity = np.asarray(upper, np.float64) - np.asarray(lower, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        away = focal * separation / disparity - distance
    return np.where(disparity > 0.0, away, np.nan)


def depth_below_tip(image_distance: ArrayLike, away: ArrayLike, focal: float, distance: float) -> Floats:
    """Metres that an object `away` m from the axis is below the tip of the mirror that shows it."""
    return np.asarray(image_distance, np.float64) * (np.asarray(away, np.float64) + distance) / focal
