"""From nothing to within a few centimetres: hypotheses on a wide view, a small alignment each, the best wins."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.docking.ceiling_view import COARSE, MIDDLE, CeilingView
from omnibotd.core.docking.matching import Floats, Poses, Sample, align, residuals
from omnibotd.core.docking.rotation import RotationCues, RotationSignature, rotation_hypotheses
from omnibotd.core.docking.translation import ShiftSearch, ceiling_parts
from omnibotd.core.docking.walls import Walls
from omnibotd.core.geometry import wrap
from omnibotd.core.vision.frame import FloatImage

# Pixels a side on which rotations are compared.
_TURNING = 120
# Cells a side from which one point each is sampled.
_COARSE_CELLS, _MIDDLE_CELLS = 24, 32
# Shifts tried of each rotation, and candidates that are aligned once more on the middle layer; more changed nothing.
_SHIFTS, _REFINED = 3, 4
_TRY, _REFINE, _NEARBY = 4, 6, 8
# What agreement of the rims is worth beside the misfit of the views.
_RIM_WEIGHT = 0.15
# Two candidates closer than this are one: pixels of the coarse layer, and an angle.
_SAME_SHIFT, _SAME_YAW = 1.5, 0.1
# Farther than looked for by this: a pose nobody asked for.
_BEYOND = 1.1


@dataclass(frozen=True, slots=True)
class CoarseFix:
    """`pose` (yaw, u, v); `margin` is by how much more the next best one misfits."""

    pose: Poses
    margin: float


@dataclass(frozen=True, slots=True)
class _Candidates:
    """Rows: poses (k, 3), the part of the target that each was found by, what its rim is worth, and its misfit."""

    poses: Poses
    parts: NDArray[np.intp]
    bonus: Poses
    misfit: Poses

    def __getitem__(self, which: list[int]) -> _Candidates:
        return _Candidates(self.poses[which], self.parts[which], self.bonus[which], self.misfit[which])


class CoarseRegistration:
    """Registers views with one target from nothing; `reach` is how far away it looks, in ceiling heights."""

    def __init__(self, target: CeilingView, reach: float) -> None:
        self._reach = reach
        self._cues = RotationCues(_TURNING)
        self._signature = self._signed(target)
        coarse = target.layer(COARSE)
        self._focal = coarse.focal
        self._shifts = ShiftSearch(target.feature(COARSE), coarse.focal, reach * coarse.focal)
        self._samples = {
            COARSE: Sample.of(coarse, _COARSE_CELLS),
            MIDDLE: Sample.of(target.layer(MIDDLE), _MIDDLE_CELLS),
        }
        self._parts = {size: ceiling_parts(*sample.at.astype(np.float64)) for size, sample in self._samples.items()}

    def fix(self, view: CeilingView, walls: Walls) -> CoarseFix:
        """`walls` are those known to stand round the target."""
        tried = self._aligned(view, COARSE, self._candidates(view), walls, _TRY)
        refined = self._aligned(view, MIDDLE, tried[self._distinct(tried)[:_REFINED]], walls, _REFINE)
        best = refined[self._distinct(refined)]
        margin = float(best.misfit[1] - best.misfit[0]) if len(best.misfit) > 1 else 1.0
        return CoarseFix(best.poses[0], margin)

    def nearby(self, view: CeilingView, start: Poses, walls: Walls) -> Poses:
        """The pose (3,) that `start` leads to; it may be off by a tenth of the ceiling's height."""
        sample = self._samples[COARSE]
        everywhere: Floats = np.ones((1, 1), np.float32)
        poses = align(sample, view.layer(COARSE), start[None], walls.nearness(sample.at), everywhere, _NEARBY)
        return np.asarray(poses[0], np.float64)

    def _signed(self, view: CeilingView) -> RotationSignature:
        image, feature = (
            cv2.resize(picture, (_TURNING, _TURNING), interpolation=cv2.INTER_AREA)
            for picture in (view.image, view.feature(len(view.image)))
        )
        return self._cues.signature(
            np.asarray(image, np.uint8), np.asarray(feature, np.float32), view.mask(_TURNING), view.rim
        )

    def _candidates(self, view: CeilingView) -> _Candidates:
        feature, mask = view.feature(COARSE), view.mask(COARSE)
        if (mask == 0).any():
            feature = np.where(mask > 0, feature, feature[mask > 0].mean() if mask.any() else 0.0).astype(np.float32)
        poses, parts, bonus = [], [], []
        for turn in rotation_hypotheses(self._signature, self._signed(view)):
            for shift in self._shifts.find(_turned(feature, turn.yaw), _SHIFTS):
                poses.append((turn.yaw, shift.u / self._focal, shift.v / self._focal))
                parts.append(shift.part)
                bonus.append(_RIM_WEIGHT * turn.rim)
        return _Candidates(np.array(poses), np.array(parts), np.array(bonus), np.zeros(len(poses)))

    def _aligned(
        self, view: CeilingView, size: int, candidates: _Candidates, walls: Walls, iterations: int
    ) -> _Candidates:
        """On the layer of `size`: by the part that each was found by, judged by the whole."""
        sample, layer = self._samples[size], view.layer(size)
        nearness = walls.nearness(sample.at)
        weight: Floats = np.ones((1, 1), np.float32) if len(walls) else self._parts[size][candidates.parts]
        poses = align(sample, layer, candidates.poses, nearness, weight, iterations)
        misfit = residuals(sample, layer, poses, nearness).misfit(sample.chance) - candidates.bonus
        misfit += np.hypot(poses[:, 1], poses[:, 2]) > _BEYOND * self._reach
        return _Candidates(poses, candidates.parts, candidates.bonus, misfit)

    def _distinct(self, candidates: _Candidates) -> list[int]:
        """Rows, best first, without those that ended where a better one did."""
        kept: list[int] = []
        for row in np.argsort(candidates.misfit):
            if not any(self._same(candidates.poses[row], candidates.poses[other]) for other in kept):
                kept.append(int(row))
        return kept

    def _same(self, first: Poses, second: Poses) -> bool:
        apart = math.hypot(*(first[1:] - second[1:]))
        return apart * self._focal < _SAME_SHIFT and abs(wrap(float(first[0] - second[0]))) < _SAME_YAW


def _turned(feature: FloatImage, yaw: float) -> FloatImage:
    """The view as it would look if it faced as the target does."""
    size = len(feature)
    centre = (size - 1) / 2.0
    c, s = math.cos(yaw), math.sin(yaw)
    affine = np.array([[c, s, centre * (1.0 - c - s)], [-s, c, centre * (1.0 - c + s)]])
    smooth = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    turned = cv2.warpAffine(feature, affine, (size, size), flags=smooth, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(turned, np.float32)
