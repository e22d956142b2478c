"""How well the current view fits a sample of the target's points, and how it would fit from nearby poses.

Poses are rows (yaw, u, v): how far the current view is turned against the target's, and where its axis stands in the
target view, in ceiling heights. A point q of the target is then seen at R(-yaw) (q - nearness (u, v)): what is nearer
than the ceiling moves by more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.docking.ceiling_view import Layer

Floats = NDArray[np.float32]
Poses = NDArray[np.float64]

# Residuals fade out from twice their mean on: lamps that went out and what is in the way shall not pull.
_FADING = 2.0
# For comparing poses the scale must be fixed: one standard deviation of the view.
_MISFIT = 1.0
# Bounds of one step keep the linearisation honest (rad, pixels).
_MAX_TURN, _MAX_SHIFT = 0.1, 1.5
# Steps below this many pixels change no candidate's rank.
_ENOUGH = 0.05
# Views that share less than this of the sample say nothing about each other.
_LEAST_SEEN = 0.2
# Keeps a flat ceiling (no slope at all) solvable: it then takes no step.
_RIDGE = 0.1


@dataclass(frozen=True, slots=True)
class Sample:
    """Points of the target: rays `at` (2, n) in ceiling heights, edge strength there, its slope (2, n) a height.

    `steepness` (n,) is the slope's length. `worth` (n,): every solid angle counts alike, for the view magnifies its
    rim, where the lens is known least.
    `chance` is the misfit of a view that has nothing to do with the target.
    """

    at: Floats
    value: Floats
    slope: Floats
    steepness: Floats
    worth: Floats
    chance: float

    @classmethod
    def of(cls, layer: Layer, cells: int) -> Sample:
        """The steepest pixel in each of cells x cells squares, over the disc that stays in view at any heading.

        Spread evenly: the strongest edges are those of lamps, which change most with the light.
        """
        axis = np.arange(layer.size) - (layer.size - 1) / 2.0
        inside = np.hypot(*np.meshgrid(axis, axis)) < layer.size / 2.0 - 1.5
        row, column = np.nonzero(inside & (layer.picture[..., 3] == 1.0))
        value, du, dv, _ = layer.picture[row, column].T
        square = (row * cells // layer.size) * cells + column * cells // layer.size
        order = np.lexsort((-np.hypot(du, dv), square))
        chosen = order[np.diff(square[order], prepend=-1) > 0]
        at = (np.stack([axis[column[chosen]], axis[row[chosen]]]) / layer.focal).astype(np.float32)
        slope = np.stack([du[chosen], dv[chosen]]) * np.float32(layer.focal)
        worth = (1.0 + (at**2).sum(0)) ** np.float32(-1.5)
        return cls(at, value[chosen].copy(), slope, np.hypot(*slope), worth, _chance(value[chosen]))


def _chance(value: Floats) -> float:
    if not len(value):
        return 1.0
    other = np.random.default_rng(0).permutation(value)
    excess = ((value - other) / (_MISFIT * (value.std() + 1e-3))) ** 2
    return max(float((excess / (1.0 + excess)).mean()), 1e-3)


@dataclass(frozen=True, slots=True)
class Residuals:
    """Of k poses at n points, (k, n) but for `nearness` (n,): what is out of view has no weight.

    `current` and `target` are the views' edge strengths in their standard deviations; `own_slope` and `target_slope`
    (2, k, n) half of how each changes a height along the target's axes; `off_u`, `off_v` the points as seen from the
    pose, in those axes.
    """

    current: Floats
    target: Floats
    seen: Floats
    weight: Floats
    own_slope: Floats
    target_slope: Floats
    off_u: Floats
    off_v: Floats
    nearness: Floats

    @property
    def difference(self) -> Floats:
        return self.current - self.target

    @property
    def slope(self) -> Floats:
        """(2, k, n): the mean of both views' slopes converges like a second-order method (ESM)."""
        return self.own_slope + self.target_slope

    def jacobian(self) -> Floats:
        """(k, 3, n) change of the difference with yaw, u, v."""
        slope_u, slope_v = self.slope
        turn = slope_u * self.off_v - slope_v * self.off_u
        return np.stack([turn, -self.nearness * slope_u, -self.nearness * slope_v], 1)

    def alikeness(self) -> Floats:
        """(k, n): 1 where the views slope alike, 0 where they don't: there no shift makes one of the other."""
        product = np.einsum("akn,akn->kn", self.own_slope, self.target_slope)
        squares = (self.own_slope**2).sum(0) + (self.target_slope**2).sum(0)
        return np.asarray(np.maximum(2.0 * product, 0.0) / (squares + np.float32(1e-6)), np.float32)

    def misfit(self, chance: float) -> Poses:
        """(k,): 0 fits, 1 is `chance`, the sample's."""
        excess = (self.difference / np.float32(_MISFIT)) ** 2
        excess /= np.float32(1.0) + excess
        return np.asarray(1.0 + (self.seen * (excess - np.float32(chance))).mean(1) / chance, np.float64)

    def correlation(self) -> Poses:
        """(k,) over what is seen, -1 where hardly anything is."""
        share = self.seen.mean(1)
        product = np.einsum("kn,kn->k", self.current, self.target) / self.seen.shape[1]
        return np.asarray(np.where(share < _LEAST_SEEN, -1.0, product / np.maximum(share, _LEAST_SEEN)), np.float64)


def residuals(sample: Sample, layer: Layer, poses: Poses, nearness: Floats) -> Residuals:
    """`poses` (k, 3); `nearness` (n,): the ceiling's height over that of each point."""
    yaw, u, v = (poses[:, k : k + 1].astype(np.float32) for k in range(3))
    c, s, focal, centre = np.cos(yaw), np.sin(yaw), np.float32(layer.focal), np.float32((layer.size - 1) / 2.0)
    off_u, off_v = sample.at[0] - nearness * u, sample.at[1] - nearness * v
    # Both maps float32: OpenCV 5 returns garbage, silently, when one is float64.
    column, row = (c * off_u + s * off_v) * focal + centre, (c * off_v - s * off_u) * focal + centre
    found = cv2.remap(layer.picture, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0.0)
    value, du, dv, inside = (np.asarray(part, np.float32) for part in cv2.split(found))
    seen = (inside > 0.99).astype(np.float32)
    current, gain = _standard(value, seen)
    target, target_gain = _standard(sample.value, seen)
    half, half_target = np.float32(0.5) * focal / gain, np.float32(0.5) / target_gain
    hc, hs = half * c, half * s
    return Residuals(
        current=current,
        target=target,
        seen=seen,
        weight=_fading(current - target, seen, sample),
        own_slope=np.stack([hc * du - hs * dv, hs * du + hc * dv]),
        target_slope=half_target * sample.slope[:, None],
        off_u=off_u,
        off_v=off_v,
        nearness=nearness,
    )


def align(sample: Sample, layer: Layer, poses: Poses, nearness: Floats, weight: Floats, iterations: int) -> Poses:
    """Gauss-Newton from each of `poses` (k, 3) by itself; `weight` (k, n) says which points count."""
    for _ in range(iterations):
        found = residuals(sample, layer, poses, nearness)
        jacobian = found.jacobian()
        weighted = jacobian * (found.weight * weight)[:, None]
        normal = (weighted @ jacobian.transpose(0, 2, 1)).astype(np.float64) + _RIDGE * np.eye(3)
        pull = (weighted @ found.difference[..., None]).astype(np.float64)
        steps = np.asarray(-np.linalg.solve(normal, pull)[..., 0], np.float64)
        poses = np.add(poses, bounded(steps, layer.focal))
        if np.abs(steps).max() * layer.focal < _ENOUGH:
            break
    return poses


def bounded(steps: Poses, focal: float) -> Poses:
    """Steps (k, 3) cut to what the linearisation can bear."""
    steps = steps * np.minimum(1.0, _MAX_TURN / np.maximum(np.abs(steps[:, :1]), 1e-9))
    shift = np.hypot(steps[:, 1:2], steps[:, 2:3]) * focal
    return np.asarray(steps * np.minimum(1.0, _MAX_SHIFT / np.maximum(shift, 1e-9)), np.float64)


def shifted(pose: Poses) -> float:
    """Ceiling heights between the axes of the two views."""
    return math.hypot(float(pose[1]), float(pose[2]))


def _standard(value: Floats, seen: Floats) -> tuple[Floats, Floats]:
    """Zero mean and unit spread over what is seen, zero elsewhere; and the spread (k, 1)."""
    count = np.maximum(seen.sum(1, keepdims=True), np.float32(1.0))
    centred = (value - (value * seen).sum(1, keepdims=True) / count) * seen
    spread = np.sqrt(np.einsum("kn,kn->k", centred, centred)[:, None] / count) + np.float32(1e-3)
    return centred / spread, spread


def _fading(difference: Floats, seen: Floats, sample: Sample) -> Floats:
    """Geman-McClure weights; the usual residual is that of edges, for between lamps on black all fits anyhow."""
    told = seen * sample.steepness
    whole = np.maximum(told.sum(1, keepdims=True), np.float32(1e-6))
    usual = np.maximum(np.einsum("kn,kn->k", told, np.abs(difference))[:, None] / whole, np.float32(0.05))
    share = (difference / (np.float32(_FADING) * usual)) ** 2
    share += np.float32(1.0)
    return np.asarray(seen * sample.worth / (share * share), np.float32)
