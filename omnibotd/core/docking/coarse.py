"""From nothing to within a few pixels: hypotheses on a wide view, a small alignment each, the best wins."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from omnibotd.core.docking.alignment import Alignment, AlignmentTarget, Effort, Layer
from omnibotd.core.docking.displacement import NO_WALL, Displacement
from omnibotd.core.docking.features import edge_strength, unoccluded
from omnibotd.core.docking.rectification import Lookup, Rectification, rim_rays
from omnibotd.core.docking.rotation import RotationCues, RotationSignature, rotation_hypotheses
from omnibotd.core.docking.translation import ShiftSearch
from omnibotd.core.geometry import wrap
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame, Image

# The ceiling's edge is in view over 130 degrees, and breaks the symmetry of a grid of tiles.
FOV = math.radians(130.0)
SIZE = 160
_COARSE, _MIDDLE = 60, 80
# Half the resolution is still finer than the wide view's pixels.
_REDUCTION = 2
_RIM_ZENITHS = np.radians(np.linspace(50.0, 86.0, 13))
# Candidates that get three iterations, then those that get eight more; more never changed the winner.
_TRIED, _REFINED = 7, 3
_TRY = Effort(iterations=3, huber=2.0, with_scale=False, tolerance=1e-3)
_REFINE = Effort(iterations=8, huber=2.0, with_scale=False, tolerance=1e-3)
_DECIDE = Effort(iterations=12, huber=1.0, with_scale=True, tolerance=3e-3)
# What agreement of the rims is worth beside the correlation of the views.
_RIM_WEIGHT = 0.15
# Two candidates closer than this are one: 3 pixels of the coarse view, and an angle.
_SAME_SHIFT, _SAME_YAW = 3.0, 0.1


@dataclass(frozen=True, slots=True)
class WideView:
    """What one frame gives to the coarse fix."""

    whole: Layer
    coarse: Layer
    middle: Layer
    rotation: RotationSignature


class WideOptics:
    """Takes frames of one camera to wide views."""

    def __init__(self, camera: CameraModel) -> None:
        small = camera.reduced(_REDUCTION)
        self.rectify = Rectification(small, SIZE, FOV)
        self._cues = RotationCues(SIZE)
        self._rim = Lookup(small, rim_rays(_RIM_ZENITHS, 360))
        self._sees_walls = bool(self._rim.valid.all())

    def view(self, frame: Frame) -> WideView:
        grey = frame.grey(_REDUCTION)
        image = self.rectify(grey)
        layer = masked_layer(image, self.rectify.valid)
        rim = self._rim(grey) if self._sees_walls else None
        signature = self._cues.signature(image, layer.feature, layer.mask, rim)
        return WideView(layer, layer.resized(_COARSE), layer.resized(_MIDDLE), signature)


@lru_cache(maxsize=4)
def wide_optics(camera: CameraModel) -> WideOptics:
    """Tables are dear to compute and depend on the calibration only."""
    return WideOptics(camera)


def masked_layer(image: Image, valid: Image) -> Layer:
    """Edge strength and mask of a rectified image, without the people in it."""
    feature, free = edge_strength(image), unoccluded(image)
    if free is None:
        return Layer(feature, valid)
    mask = np.asarray(valid & free, np.uint8)
    feature[mask == 0] = feature[mask > 0].mean() if mask.any() else 0.0
    return Layer(feature, mask)


def inner_disc(layer: Layer) -> Layer:
    """Only the disc that stays in view whichever way the camera turns."""
    axis = np.arange(layer.size) - (layer.size - 1) / 2.0
    disc = np.hypot(*np.meshgrid(axis, axis)) < layer.size / 2.0 - 1.0
    return Layer(layer.feature, np.where(disc, layer.mask, 0).astype(np.uint8))


@dataclass(frozen=True, slots=True)
class Candidate:
    """A hypothesis on its way: where it got to, and its total (correlation plus what the rim says)."""

    alignment: Alignment
    bonus: float

    @property
    def total(self) -> float:
        return self.alignment.score + self.bonus


@dataclass(frozen=True, slots=True)
class CoarseFix:
    """yaw and position (ceiling heights, view axes u, v) of the camera in the target view; lead over the next."""

    yaw: float
    u: float
    v: float
    margin: float


class CoarseRegistration:
    """Registers frames with one target from nothing; `reach` is how far away it looks, in ceiling heights."""

    def __init__(self, camera: CameraModel, target: Frame, reach: float) -> None:
        self._optics = wide_optics(camera)
        self._reach = reach
        self._focal = self._optics.rectify.focal * _COARSE / SIZE
        self._view = self._optics.view(target)
        disc = inner_disc(self._view.whole)
        self._coarse, self._middle = (AlignmentTarget(disc.resized(size)) for size in (_COARSE, _MIDDLE))
        self._shifts = ShiftSearch(self._view.coarse, reach * self._focal)

    def fix(self, frame: Frame, wall: tuple[float, float] = NO_WALL) -> CoarseFix:
        """`wall`: towards the wall the target stands at, 1 / its distance in ceiling heights; or NO_WALL."""
        view = self._optics.view(frame)
        tried = [self._aligned(view, candidate, _TRY) for candidate in self._candidates(view, wall)]
        tried.sort(key=lambda candidate: -candidate.total)
        refined = [self._aligned(view, candidate, _REFINE) for candidate in _distinct(tried)[:_REFINED]]
        refined.sort(key=lambda candidate: -candidate.total)
        decided = [self._decided(view, candidate) for candidate in _distinct(refined)[:2]]
        decided.sort(key=lambda candidate: -candidate.total)
        margin = decided[0].total - decided[1].total if len(decided) > 1 else 1.0
        yaw, u, v = decided[0].alignment.displacement.pose()
        return CoarseFix(yaw, u / self._focal, v / self._focal, margin)

    def _candidates(self, view: WideView, wall: tuple[float, float]) -> list[Candidate]:
        found, near = [], (wall[0] / self._focal, wall[1] / self._focal)
        for turn in rotation_hypotheses(self._view.rotation, view.rotation):
            for shift in self._shifts.find(view.coarse, turn.yaw):
                start = Displacement.of_pose(turn.yaw, shift.u, shift.v, near)
                worth = shift.peak / 10.0 + 0.6 * turn.rim
                found.append((worth, Candidate(Alignment(start, 0.0), _RIM_WEIGHT * turn.rim)))
        found.sort(key=lambda pair: -pair[0])
        return [candidate for _, candidate in found[:_TRIED]]

    def _aligned(self, view: WideView, candidate: Candidate, effort: Effort) -> Candidate:
        alignment = self._coarse.align(view.coarse, candidate.alignment.displacement, effort)
        _, u, v = alignment.displacement.pose()
        if math.hypot(u, v) > 1.1 * self._reach * self._focal:
            alignment = Alignment(alignment.displacement, alignment.score - 0.5)
        return Candidate(alignment, candidate.bonus)

    def _decided(self, view: WideView, candidate: Candidate) -> Candidate:
        """Aligned once more on the middle layer, which tells neighbouring tiles apart better."""
        zoom = _MIDDLE / _COARSE
        finer = self._middle.align(view.middle, candidate.alignment.displacement.zoomed(zoom), _DECIDE)
        back = Alignment(finer.displacement.zoomed(1.0 / zoom), finer.score)
        return Candidate(back, candidate.bonus)


def _distinct(candidates: list[Candidate]) -> list[Candidate]:
    """Without those that ended where a better one did; best first in, best first out."""
    kept: list[Candidate] = []
    for candidate in candidates:
        if not any(_same(candidate.alignment.displacement, other.alignment.displacement) for other in kept):
            kept.append(candidate)
    return kept


def _same(first: Displacement, second: Displacement) -> bool:
    (yaw, u, v), (other_yaw, other_u, other_v) = first.pose(), second.pose()
    return abs(wrap(yaw - other_yaw)) < _SAME_YAW and math.hypot(u - other_u, v - other_v) < _SAME_SHIFT
