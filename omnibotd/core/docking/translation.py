"""Where the current view's axis stands in the target view, once it is turned: half-whitened correlation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.docking.alignment import Layer
from omnibotd.core.docking.displacement import Displacement
from omnibotd.core.vision.frame import FloatImage

# 0 is plain correlation (broad peaks), 1 phase correlation (noise counts as much as structure).
_WHITENING = 0.6
# Neighbourhood of a peak, pixels, within which no second one is looked for.
_PEAK_RADIUS = 2


@dataclass(frozen=True, slots=True)
class ShiftHypothesis:
    """Position (target pixels) of the current view's axis; `peak` in standard deviations of the correlation."""

    u: float
    v: float
    peak: float


class ShiftSearch:
    """The target's side of the correlation, computed once; shifts up to `reach` pixels each way."""

    def __init__(self, target: Layer, reach: float) -> None:
        self._size = target.size
        self._reach = min(math.ceil(reach) + 2, self._size - 1)
        axis = (np.arange(self._size) - (self._size - 1) / 2.0) / (self._size / 2.0)
        radius = np.hypot(*np.meshgrid(axis, axis))
        self._window = np.cos(np.clip(radius, 0.0, 1.0) * (math.pi / 2.0)).astype(np.float32)
        self._target = self._transform(target.feature)

    def find(self, current: Layer, yaw: float, count: int = 2) -> list[ShiftHypothesis]:
        """The `count` best shifts of the current view, turned by `yaw` to face as the target does."""
        turned, _ = current.warped(Displacement.of_pose(yaw, 0.0, 0.0))
        cross = self._target * np.conj(self._transform(turned))
        cross /= np.abs(cross) ** _WHITENING + 1e-6
        correlation = np.fft.fftshift(np.fft.irfft2(cross))
        middle, reach = self._size, self._reach
        near = slice(middle - reach, middle + reach + 1)
        return self._peaks(correlation[near, near].copy(), count)

    def _transform(self, feature: FloatImage) -> NDArray[np.complex128]:
        padded = (2 * self._size, 2 * self._size)
        return np.asarray(np.fft.rfft2((feature - feature.mean()) * self._window, padded), np.complex128)

    def _peaks(self, correlation: NDArray[np.float64], count: int) -> list[ShiftHypothesis]:
        spread = float(correlation.std()) + 1e-9
        found = []
        for _ in range(count):
            row, column = (int(k) for k in np.unravel_index(np.argmax(correlation), correlation.shape))
            height = float(correlation[row, column]) / spread
            found.append(ShiftHypothesis(float(column - self._reach), float(row - self._reach), height))
            rows, columns = (slice(max(0, k - _PEAK_RADIUS), k + _PEAK_RADIUS + 1) for k in (row, column))
            correlation[rows, columns] = -1e9
        return found
