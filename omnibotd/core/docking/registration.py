"""Where the base stands relative to a dock: registration of the ceiling seen now with the one seen there.

Thesis chapter 7, whose literal method finds one rotation and one whole-pixel shift; this one tries several and refines.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.docking.ceiling_view import ceiling_optics
from omnibotd.core.docking.coarse import CoarseRegistration
from omnibotd.core.docking.refinement import Refined, Refinement
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.percept import HomingEstimate, Verdict
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame

# Metres from the dock beyond which a fix is not looked for: the views share too little of the ceiling.
REACH = 1.3
# Correlation of the views: unrelated ones stay below the first, nearly all right ones above the second.
_MIN_SCORE, _SURE_SCORE = 0.2, 0.4
# The best of many unrelated ones, which a fix from nothing picks out, stays below this: of fixes at the dock in the
# dark, 16 of 20 below were wrong by more than a degree, 2 of 116 above.
_MIN_BEST_SCORE = 0.3
# Lead over the next best candidate below which a full fix may be another tile.
_MIN_MARGIN = 0.08
# Vaguer than this (1 sigma: m, rad) only a line is known that the base stands on, as below parallel beams.
_VAGUE, _VAGUE_YAW = 0.05, math.radians(2.0)
# Odometry from one frame to the next is right to this, and more (1 sigma: m, rad).
_PRIOR, _PRIOR_YAW = 0.02, math.radians(1.5)
# A tracked pose this far from the one expected is another tile, not a better estimate (m, rad).
_TRACK_GATE, _TRACK_YAW_GATE = 0.3, 0.35
# What no picture tells of (1 sigma). Beams, and walls not understood: position by distance, in ceiling heights, up to a
# most of it however far away; and rad of yaw with each of those heights.
_RELIEF, _MOST_RELIEF, _RELIEF_YAW = 0.08, 0.0072, 0.5
# An optical axis calibrated to 0.1 degrees and half a pixel, in ceiling heights when turned half round; a floor (rad).
_AXIS, _LEAST_YAW = 0.004, 0.0003


@dataclass(frozen=True, slots=True)
class CeilingFix:
    """Pose of the current camera in the target's axes, lengths in ceiling heights; `covariance` of (x, y, yaw)."""

    pose: Pose2D
    score: float
    margin: float
    covariance: NDArray[np.float64]


class CeilingRegistration:
    """Registers frames with one target frame, lengths in ceiling heights; `reach` bounds the search from nothing.

    Learns the walls the target stands at, if any, from the frames that they help to explain.
    """

    def __init__(self, camera: CameraModel, target: Frame, reach: float) -> None:
        self._optics = ceiling_optics(camera)
        view = self._optics.view(target)
        self._coarse = CoarseRegistration(view, reach)
        self._refinement = Refinement(view)

    def fix(self, frame: Frame) -> CeilingFix:
        """From nothing."""
        view = self._optics.view(frame)
        coarse = self._coarse.fix(view, self._refinement.walls)
        return _fix(self._refinement.refine(view, coarse.pose, None), coarse.margin)

    def track(self, frame: Frame, expected: Pose2D, spread: tuple[float, float] | None = None) -> CeilingFix:
        """From an expected pose, right to about a tenth of the height; nothing else is tried, so the margin is 1.

        `spread` (rad, ceiling heights; 1 sigma) tells how right, where it is known: then it counts as evidence.
        """
        view, start = self._optics.view(frame), np.array([expected.yaw, expected.y, -expected.x])
        if spread is None:
            start = self._coarse.nearby(view, start, self._refinement.walls)
        return _fix(self._refinement.refine(view, start, spread), 1.0)


def _fix(refined: Refined, margin: float) -> CeilingFix:
    yaw, u, v = (float(value) for value in refined.pose)
    pose = Pose2D(-v, u, wrap(yaw))
    # (yaw, u, v) to (x, y, yaw) = (-v, u, yaw).
    axes = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    covariance = axes @ refined.covariance @ axes.T + np.diag(_unseen(pose))
    return CeilingFix(pose, refined.correlation, margin, covariance)


def _unseen(pose: Pose2D) -> tuple[float, float, float]:
    """Variances of what no picture tells of."""
    away = _RELIEF * math.hypot(pose.x, pose.y)
    relief = away / (1.0 + away / _MOST_RELIEF)
    position = relief**2 + (_AXIS * math.sin(pose.yaw / 2.0)) ** 2
    return position, position, (_RELIEF_YAW * relief) ** 2 + _LEAST_YAW**2


class DockRegistration:
    """Estimates where the base stands relative to the pose at which the dock's snapshot was taken."""

    def __init__(self, camera: CameraModel, snapshot: Frame, ceiling_height: float) -> None:
        """`snapshot` full-size, as the camera took it; `ceiling_height` metres from camera to ceiling."""
        self._height = ceiling_height
        self._registration = CeilingRegistration(camera, snapshot, REACH / ceiling_height)

    def fix(self, frame: Frame, odom_from_base: Pose2D) -> HomingEstimate:
        """From nothing; `odom_from_base` belongs to the frame's stamp. A ceiling that shows nothing is REJECTED."""
        found = self._registration.fix(frame)
        estimate = self._estimate(frame, odom_from_base, found, found.margin >= _MIN_MARGIN)
        return estimate if found.score >= _MIN_BEST_SCORE else replace(estimate, verdict=Verdict.REJECTED)

    def track(self, frame: Frame, odom_from_base: Pose2D, prior: Pose2D) -> HomingEstimate:
        """From `prior`, the dock_from_base expected at the frame's stamp; REJECTED where the view doesn't fit there."""
        h = self._height
        found = self._registration.track(frame, Pose2D(prior.x / h, prior.y / h, prior.yaw), (_PRIOR_YAW, _PRIOR / h))
        estimate = self._estimate(frame, odom_from_base, found, sure=True)
        moved, turned = estimate.dock_from_base.distance(prior), wrap(estimate.dock_from_base.yaw - prior.yaw)
        near = moved < _TRACK_GATE and abs(turned) < _TRACK_YAW_GATE
        return estimate if near else replace(estimate, verdict=Verdict.REJECTED)

    def _estimate(self, frame: Frame, odom: Pose2D, found: CeilingFix, sure: bool) -> HomingEstimate:
        pose, h = found.pose, self._height
        scale = np.diag([h, h, 1.0])
        covariance = scale @ found.covariance @ scale
        sure = sure and found.score >= _SURE_SCORE and not _vague(covariance)
        verdict = Verdict.ACCEPTED if sure else Verdict.AMBIGUOUS
        return HomingEstimate(
            stamp=frame.stamp,
            odom_from_base=odom,
            dock_from_base=Pose2D(pose.x * h, pose.y * h, pose.yaw),
            score=found.score,
            margin=found.margin,
            verdict=verdict if found.score >= _MIN_SCORE else Verdict.REJECTED,
            covariance=covariance,
        )


def _vague(covariance: NDArray[np.float64]) -> bool:
    longest = math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    return longest > _VAGUE or math.sqrt(float(covariance[2, 2])) > _VAGUE_YAW
