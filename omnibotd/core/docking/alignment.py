"""Fine alignment of two views: Gauss-Newton with averaged gradients (ESM) and Huber weights."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.docking.displacement import Displacement, axes
from omnibotd.core.vision.frame import FloatImage, Image

Floats = NDArray[np.float64]

# Bounds on one step keep the linearisation honest (a step of 0.15 rad moves the rim of a 60 px view by 4.5 px).
_MAX_TURN = 0.15
_MAX_SHIFT = 6.0
# Less than a fifth of the target in view says nothing.
_MIN_OVERLAP = 0.2


@dataclass(frozen=True, slots=True)
class Alignment:
    """Result of an alignment; `score` is the robust correlation in [-1, 1], -1 when the views don't overlap."""

    displacement: Displacement
    score: float


@dataclass(frozen=True, slots=True)
class Layer:
    """A view of the ceiling at one resolution: edge strength and the mask (255) of what is seen."""

    feature: FloatImage
    mask: Image

    @property
    def size(self) -> int:
        return len(self.feature)

    def resized(self, size: int) -> Layer:
        """The same view, size x size, smoothed a little to widen the valley of the alignment."""
        if size == self.size:
            return self
        feature = cv2.resize(self.feature, (size, size), interpolation=cv2.INTER_AREA)
        mask = cv2.resize(self.mask, (size, size), interpolation=cv2.INTER_NEAREST)
        return Layer(np.asarray(cv2.GaussianBlur(feature, (0, 0), 0.7), np.float32), np.asarray(mask, np.uint8))

    def warped(self, displacement: Displacement) -> tuple[FloatImage, Image]:
        """Feature and mask as the target would see them."""
        affine, size = displacement.affine(self.size), (self.size, self.size)
        smooth, nearest = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        feature = cv2.warpAffine(self.feature, affine, size, flags=smooth, borderMode=cv2.BORDER_REPLICATE)
        mask = cv2.warpAffine(self.mask, affine, size, flags=nearest)
        return np.asarray(feature, np.float32), np.asarray(mask, np.uint8)


@dataclass(frozen=True, slots=True)
class Effort:
    """How hard to try: `huber` in robust standard deviations of the residual, `tolerance` in pixels of a 60 px view."""

    iterations: int
    huber: float
    with_scale: bool
    tolerance: float


class AlignmentTarget:
    """The target's side of an alignment, computed once."""

    def __init__(self, layer: Layer) -> None:
        self.layer = layer
        self._gradient = _sobel(layer.feature)
        self._pixels = int(np.count_nonzero(layer.mask))

    def align(self, current: Layer, start: Displacement, effort: Effort) -> Alignment:
        """Minimise the robust difference between the target and the warped current view, from `start`."""
        displacement, score = start, -1.0
        unit = effort.tolerance * self.layer.size / 60.0
        for _ in range(effort.iterations):
            feature, mask = current.warped(displacement)
            seen = (mask & self.layer.mask) > 0
            if np.count_nonzero(seen) < _MIN_OVERLAP * self._pixels:
                return Alignment(displacement, -1.0)
            score, step = self._step(feature, seen, effort)
            displacement = displacement.stepped(step)
            if abs(step[0]) * self.layer.size / 2.0 < unit and math.hypot(step[1], step[2]) < unit:
                break
        return Alignment(displacement, score)

    def _step(self, feature: FloatImage, seen: NDArray[np.bool_], effort: Effort) -> tuple[float, Floats]:
        """Score before the step, and the step."""
        current, gain = _centred(feature, seen)
        target, target_gain = _centred(self.layer.feature, seen)
        current *= target_gain / gain
        residual = current - target
        # Every 7th pixel is ample for a median.
        sample = np.abs(residual.ravel()[::7][seen.ravel()[::7]])
        sigma = 1.4826 * float(np.median(sample)) + 1e-4
        weight = np.minimum(np.float32(1.0), effort.huber * sigma / np.maximum(np.abs(residual), 1e-6))
        weight *= seen
        weighted = weight * current
        correlation = float(np.vdot(weighted, target))
        energy = float(np.vdot(weighted, current)) * float(np.vdot(weight * target, target))
        step = _solve(self._jacobian(feature, effort), weight, residual)
        return correlation / math.sqrt(energy + 1e-9), _bounded(step)

    def _jacobian(self, feature: FloatImage, effort: Effort) -> FloatImage:
        """(parameters, pixels) change of the warped view with each parameter of the step."""
        u, v = axes(self.layer.size)
        gu, gv = (_half_sum(a, b) for a, b in zip(_sobel(feature), self._gradient, strict=True))
        rows = [gv * u - gu * v, gu, gv]
        if effort.with_scale:
            rows.append(gu * u + gv * v)
        return np.stack(rows).reshape(len(rows), -1).astype(np.float32, copy=False)


def _solve(jacobian: FloatImage, weight: FloatImage, residual: FloatImage) -> Floats:
    weighted = jacobian * weight.reshape(1, -1)
    normal = (weighted @ jacobian.T).astype(np.float64)
    # The ridge keeps a flat ceiling (no gradient at all) solvable: it then takes no step.
    normal[np.diag_indices(len(normal))] = normal.diagonal() * (1.0 + 1e-4) + 1e-6
    return np.asarray(-np.linalg.solve(normal, (weighted @ residual.ravel()).astype(np.float64)), np.float64)


def _half_sum(first: FloatImage, second: FloatImage) -> FloatImage:
    return np.asarray((first + second) * np.float32(0.5), np.float32)


def _sobel(feature: FloatImage) -> tuple[FloatImage, FloatImage]:
    du = cv2.Sobel(feature, cv2.CV_32F, 1, 0, scale=1 / 8.0)
    dv = cv2.Sobel(feature, cv2.CV_32F, 0, 1, scale=1 / 8.0)
    return np.asarray(du, np.float32), np.asarray(dv, np.float32)


def _centred(feature: FloatImage, seen: NDArray[np.bool_]) -> tuple[FloatImage, float]:
    """Zero mean over what is seen, zero elsewhere; and the standard deviation there."""
    count = np.count_nonzero(seen)
    inside = np.where(seen, feature, np.float32(0.0))
    inside -= inside.sum() / np.float32(count) * seen
    return inside, math.sqrt(float(np.vdot(inside, inside)) / count) + 1e-6


def _bounded(step: Floats) -> Floats:
    turn, shift = abs(step[0]), math.hypot(step[1], step[2])
    if turn > _MAX_TURN:
        step = step * (_MAX_TURN / turn)
        shift *= _MAX_TURN / turn
    return step * (_MAX_SHIFT / shift) if shift > _MAX_SHIFT else step
