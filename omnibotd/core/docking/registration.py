"""Where the base stands relative to a dock: registration of the ceiling seen now with the one seen there (thesis ch. 7)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

from omnibotd.core.docking.alignment import AlignmentTarget, Effort, Layer, Similarity
from omnibotd.core.docking.coarse import CoarseRegistration, inner_disc, masked_layer
from omnibotd.core.docking.rectification import Rectification
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.percept import HomingEstimate, Verdict
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
# Metres from the dock beyond which a fix is not looked for: the views share too little of the ceiling.
REACH = 1.3
# Correlation of the finest layer: right fixes have more, whatever the light; unrelated views less.
_MIN_SCORE = 0.35
# Lead over the next best candidate below which a full fix may be another tile.
_MIN_MARGIN = 0.05
# A tracked pose this far from the one expected is another tile, not a better estimate (m, rad).
_TRACK_GATE, _TRACK_YAW_GATE = 0.3, 0.35


@dataclass(frozen=True, slots=True)
class CeilingFix:
    """Pose of the current camera in the target's axes, lengths in ceiling heights."""

    pose: Pose2D
    score: float
    margin: float


class CeilingRegistration:
    """Registers frames with one target frame, lengths in ceiling heights; `reach` bounds the search from nothing."""

    def __init__(self, camera: CameraModel, target: Frame, reach: float) -> None:
        self._rectify = fine_optics(camera)
        self._coarse = CoarseRegistration(camera, target, reach)
        whole = inner_disc(self._layer(target))
        self._targets = tuple(AlignmentTarget(whole.resized(size)) for size in _LAYERS)

    def fix(self, frame: Frame) -> CeilingFix:
        """From nothing."""
        coarse = self._coarse.fix(frame)
        pose, score = self._refine(frame, coarse.yaw, coarse.u, coarse.v)
        return CeilingFix(pose, score, coarse.margin)

    def track(self, frame: Frame, expected: Pose2D) -> CeilingFix:
        """From an expected pose, right to about a tenth of the height; nothing else is tried, so the margin is 1."""
        pose, score = self._refine(frame, expected.yaw, expected.y, -expected.x)
        return CeilingFix(pose, score, 1.0)

    def _layer(self, frame: Frame) -> Layer:
        return masked_layer(self._rectify(frame.grey()), self._rectify.valid)

    def _refine(self, frame: Frame, yaw: float, u: float, v: float) -> tuple[Pose2D, float]:
        layer, focal = self._layer(frame), self._rectify.focal
        similarity, score = Similarity.of_pose(yaw, u * focal, v * focal), -1.0
        for target, effort in zip(self._targets, _EFFORTS, strict=True):
            zoom = target.layer.size / layer.size
            result = target.align(layer.resized(target.layer.size), similarity.zoomed(zoom), effort)
            similarity, score = result.similarity.zoomed(1.0 / zoom), result.score
            if score <= -1.0:
                break
        yaw, u, v = similarity.pose()
        return Pose2D(-v / focal, u / focal, yaw), score


class DockRegistration:
    """Estimates where the base stands relative to the pose at which the dock's snapshot was taken."""

    def __init__(self, camera: CameraModel, snapshot: Frame, ceiling_height: float) -> None:
        """`snapshot` full-size, as the camera took it; `ceiling_height` metres from camera to ceiling."""
        self._height = ceiling_height
        self._registration = CeilingRegistration(camera, snapshot, REACH / ceiling_height)

    def fix(self, frame: Frame, odom_from_base: Pose2D) -> HomingEstimate:
        """From nothing; `odom_from_base` belongs to the frame's stamp. A ceiling that shows nothing is REJECTED."""
        found = self._registration.fix(frame)
        verdict = Verdict.ACCEPTED if found.margin >= _MIN_MARGIN else Verdict.AMBIGUOUS
        return self._estimate(frame, odom_from_base, found, verdict)

    def track(self, frame: Frame, odom_from_base: Pose2D, prior: Pose2D) -> HomingEstimate:
        """From `prior`, the dock_from_base expected at the frame's stamp; REJECTED where it leads elsewhere."""
        h = self._height
        found = self._registration.track(frame, Pose2D(prior.x / h, prior.y / h, prior.yaw))
        moved = h * math.hypot(found.pose.x - prior.x / h, found.pose.y - prior.y / h)
        near = moved < _TRACK_GATE and abs(wrap(found.pose.yaw - prior.yaw)) < _TRACK_YAW_GATE
        return self._estimate(frame, odom_from_base, found, Verdict.ACCEPTED if near else Verdict.REJECTED)

    def _estimate(self, frame: Frame, odom: Pose2D, found: CeilingFix, verdict: Verdict) -> HomingEstimate:
        pose, h = found.pose, self._height
        dock_from_base = Pose2D(pose.x * h, pose.y * h, pose.yaw)
        trusted = verdict if found.score >= _MIN_SCORE else Verdict.REJECTED
        return HomingEstimate(frame.stamp, odom, dock_from_base, found.score, found.margin, trusted)


@lru_cache(maxsize=4)
def fine_optics(camera: CameraModel) -> Rectification:
    """Tables are dear to compute and depend on the calibration only."""
    return Rectification(camera, _LAYERS[-1], FOV)
