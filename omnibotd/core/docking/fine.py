"""From a few pixels to a hundredth of one: alignment on finer and finer layers, and the wall the dock stands at."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

from omnibotd.core.docking.alignment import Alignment, AlignmentTarget, Effort, Layer
from omnibotd.core.docking.coarse import inner_disc, masked_layer
from omnibotd.core.docking.displacement import Displacement
from omnibotd.core.docking.rectification import Rectification
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame

FOV = math.radians(100.0)
# Coarse to fine: each layer's valley is as wide as the error the layer before leaves.
_LAYERS = (60, 120, 240)
_EFFORTS = (
    Effort(iterations=8, huber=2.0, with_scale=False, tolerance=1e-3),
    Effort(iterations=12, huber=1.0, with_scale=True, tolerance=3e-3),
    Effort(iterations=8, huber=1.0, with_scale=True, tolerance=3e-3),
)
_WALL_EFFORTS = tuple(replace(effort, with_scale=True, with_wall=True) for effort in _EFFORTS)
# Walls tried from nothing: every 45 degrees, at 1/10 and 1/4 of the ceiling's height; alignment finds the rest.
_WALLS = tuple(
    (nearness * math.cos(k * math.pi / 4.0), nearness * math.sin(k * math.pi / 4.0))
    for k in range(8)
    for nearness in (4.0, 10.0)
)
# What was found without knowing of the wall is too far, by its parallax: tried as it is and this much nearer.
_NEARER = (1.0, 0.7)
_WALL_TRY = Effort(iterations=5, huber=2.0, with_scale=False, tolerance=1e-3)
_WALLS_REFINED, _WALLS_FINISHED = 4, 2
# A wall nearer than 1/25 of the height would be inside the robot.
_NEAREST = 25.0


class FineRegistration:
    """Aligns frames with one target at 100 degrees of view; displacements in pixels of the finest layer."""

    def __init__(self, camera: CameraModel, target: Frame) -> None:
        self._rectify = fine_optics(camera)
        self.focal = self._rectify.focal
        whole = inner_disc(self.layer(target))
        self._targets = tuple(AlignmentTarget(whole.resized(size)) for size in _LAYERS)

    def layer(self, frame: Frame) -> Layer:
        return masked_layer(self._rectify(frame.grey()), self._rectify.valid)

    def align(self, layer: Layer, start: Displacement) -> Alignment:
        """Through all layers; the wall stays as it is in `start`."""
        return self._through(layer, start, _EFFORTS)

    def align_wall(self, layer: Layer, start: Displacement) -> Alignment:
        """Through all layers, the wall with the rest. Needs some parallax: about a tenth of the ceiling's height."""
        result = self._through(layer, start, _WALL_EFFORTS)
        sane = math.hypot(*result.displacement.wall) * self.focal < _NEAREST
        return result if sane else Alignment(result.displacement, -1.0)

    def find_wall(self, layer: Layer, start: Displacement) -> Alignment:
        """As `align_wall`, with no idea where the wall is: the best of several."""
        starts = (
            replace(start, u=start.u * nearer, v=start.v * nearer, wall=(u / self.focal, v / self.focal))
            for u, v in _WALLS
            for nearer in _NEARER
        )
        tried = [self._on(0, layer, candidate, _WALL_TRY) for candidate in starts]
        tried.sort(key=lambda alignment: -alignment.score)
        refined = [self._on(0, layer, a.displacement, _WALL_EFFORTS[0]) for a in tried[:_WALLS_REFINED]]
        refined.sort(key=lambda alignment: -alignment.score)
        finished = [self.align_wall(layer, a.displacement) for a in refined[:_WALLS_FINISHED]]
        return max(finished, key=lambda alignment: alignment.score)

    def _through(self, layer: Layer, start: Displacement, efforts: Sequence[Effort]) -> Alignment:
        result = Alignment(start, -1.0)
        for level, effort in enumerate(efforts):
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
