"""Roots of many functions of one variable at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from omnibotd.core.optics.rigid import Floats

_ROUNDS = 60  # each at least halves the bracket: from pi to one part in 2^52 whatever the function
_CLOSE = 1e-15  # rad


def bracketed_root(function: Callable[[Floats], Floats], low: Floats, high: Floats) -> Floats:
    """Where `function` (elementwise) rises through 0 between `low` and `high` (Ridders); NaN where it does not.

    It is negative at `low` and positive at `high` if there is such a place.
    """
    at_low, at_high = function(low), function(high)
    root = np.where((at_low < 0.0) & (at_high > 0.0), 0.5 * (low + high), np.nan)
    for _ in range(_ROUNDS):
        middle = 0.5 * (low + high)
        at_middle = function(middle)
        bend = np.sqrt(at_middle**2 - at_low * at_high)
        last, root = root, np.where(np.isnan(root), np.nan, _ridders(low, middle, at_middle, bend))
        at_root = function(root)
        for x, y in ((middle, at_middle), (root, at_root)):
            below, above = (y <= 0.0) & (x > low), (y >= 0.0) & (x < high)
            low, at_low = np.where(below, x, low), np.where(below, y, at_low)
            high, at_high = np.where(above, x, high), np.where(above, y, at_high)
        if not np.any(np.abs(root - last) > _CLOSE):
            break
    return root


def _ridders(low: Floats, middle: Floats, at_middle: Floats, bend: Floats) -> Floats:
    with np.errstate(divide="ignore", invalid="ignore"):
        step = np.where(bend > 0.0, (middle - low) * at_middle / bend, 0.0)
    return np.asarray(middle - step, np.float64)
