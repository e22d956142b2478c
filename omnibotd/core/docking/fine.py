"""Two views of a ceiling from nearby, aligned to a hundredth of a pixel: every pixel counts, coarse to fine."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from omnibotd.core.docking.alignment import Alignment, AlignmentTarget, Effort, Layer
from omnibotd.core.docking.displacement import Displacement
from omnibotd.core.docking.features import edge_strength, unoccluded
from omnibotd.core.docking.rectification import Rectification
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame, Image

FOV = math.radians(100.0)
# Coarse to fine: each layer's valley is as wide as the error the layer before leaves.
_LAYERS = (60, 120, 240)
_EFFORTS = (
    Effort(iterations=8, huber=2.0, with_scale=False, tolerance=1e-3),
    Effort(iterations=12, huber=1.0, with_scale=True, tolerance=3e-3),
    Effort(iterations=8, huber=1.0, with_scale=True, tolerance=3e-3),
)


class FineRegistration:
    """Aligns frames with one target at 100 degrees of view; displacements in pixels of the finest layer."""

    def __init__(self, camera: CameraModel, target: Frame) -> None:
        self._rectify = fine_optics(camera)
        self.focal = self._rectify.focal
        whole = _inner_disc(self.layer(target))
        self._targets = tuple(AlignmentTarget(whole.resized(size)) for size in _LAYERS)

    def layer(self, frame: Frame) -> Layer:
        return _masked(self._rectify(frame.grey()), self._rectify.valid)

    def align(self, layer: Layer, start: Displacement) -> Alignment:
        """Through all layers."""
        result = Alignment(start, -1.0)
        for level, effort in enumerate(_EFFORTS):
            result = self._on(level, layer, result.displacement, effort)
            if result.score <= -1.0:
                break
        return result

    def _on(self, level: int, layer: Layer, start: Displacement, effort: Effort) -> Alignment:
        target = self._targets[level]
        zoom = target.layer.size / layer.size
        result = target.align(layer.resized(target.layer.size), start.zoomed(zoom), effort)
        return Alignment(result.displacement.zoomed(1.0 / zoom), result.score)


@lru_cache(maxsize=4)
def fine_optics(camera: CameraModel) -> Rectification:
    """Tables are dear to compute and depend on the calibration only."""
    return Rectification(camera, _LAYERS[-1], FOV)


def _masked(image: Image, valid: Image) -> Layer:
    """Edge strength and mask of a rectified image, without the people in it."""
    feature, free = edge_strength(image), unoccluded(image)
    if free is None:
        return Layer(feature, valid)
    mask = np.asarray(valid & free, np.uint8)
    feature[mask == 0] = feature[mask > 0].mean() if mask.any() else 0.0
    return Layer(feature, mask)


def _inner_disc(layer: Layer) -> Layer:
    """Only the disc that stays in view whichever way the camera turns."""
    axis = np.arange(layer.size) - (layer.size - 1) / 2.0
    disc = np.hypot(*np.meshgrid(axis, axis)) < layer.size / 2.0 - 1.0
    return Layer(layer.feature, np.where(disc, layer.mask, 0).astype(np.uint8))
