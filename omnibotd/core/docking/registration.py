"""Where the base stands relative to a dock: registration of the ceiling seen now with the one seen there.

Thesis chapter 7, whose literal method finds one rotation and one whole-pixel shift; this one tries several and refines.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from omnibotd.core.docking.alignment import Alignment, Layer
from omnibotd.core.docking.coarse import CoarseRegistration
from omnibotd.core.docking.displacement import NO_WALL, Displacement
from omnibotd.core.docking.fine import FineRegistration
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.percept import HomingEstimate, Verdict
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame

# Metres from the dock beyond which a fix is not looked for: the views share too little of the ceiling.
REACH = 1.3
# Correlation of the finest layer: unrelated views stay below the first, nearly all right ones above the second.
_MIN_SCORE, _SURE_SCORE = 0.35, 0.5
# Lead over the next best candidate below which a full fix may be another tile.
_MIN_MARGIN = 0.05
# A tracked pose this far from the one expected is another tile, not a better estimate (m, rad).
_TRACK_GATE, _TRACK_YAW_GATE = 0.3, 0.35
# A wall shows by parallax: distance from the dock, in ceiling heights, from which one is looked for.
_WALL_PARALLAX = 0.06
# Correlation that no wall need explain; and below which the wall remembered may be the wrong one.
_EXPLAINED, _SUSPICIOUS = 0.93, 0.80
# What another wall must add to the correlation to be believed, and what the same one moved a little.
_WALL_GAIN, _TUNING_GAIN = 0.03, 0.01
# Frames to leave walls alone after a look that bettered nothing, doubled each time: one takes ten times a tracking.
_WALL_REST, _LONGEST_WALL_REST = 10, 80


@dataclass(frozen=True, slots=True)
class CeilingFix:
    """Pose of the current camera in the target's axes, lengths in ceiling heights."""

    pose: Pose2D
    score: float
    margin: float


class CeilingRegistration:
    """Registers frames with one target frame, lengths in ceiling heights; `reach` bounds the search from nothing.

    Learns the wall the target stands at, if any, from the frames that it helps to explain.
    """

    def __init__(self, camera: CameraModel, target: Frame, reach: float) -> None:
        self._fine = FineRegistration(camera, target)
        self._coarse = CoarseRegistration(camera, target, reach)
        self._wall = NO_WALL
        self._rest, self._patience = 0, _WALL_REST

    def fix(self, frame: Frame) -> CeilingFix:
        """From nothing."""
        coarse = self._coarse.fix(frame, self._wall)
        return self._fix(frame, self._displacement(coarse.yaw, coarse.u, coarse.v), coarse.margin)

    def track(self, frame: Frame, expected: Pose2D) -> CeilingFix:
        """From an expected pose, right to about a tenth of the height; nothing else is tried, so the margin is 1."""
        return self._fix(frame, self._displacement(expected.yaw, expected.y, -expected.x), 1.0)

    def _displacement(self, yaw: float, u: float, v: float) -> Displacement:
        f = self._fine.focal
        return Displacement.of_pose(yaw, u * f, v * f, (self._wall[0] / f, self._wall[1] / f))

    def _fix(self, frame: Frame, start: Displacement, margin: float) -> CeilingFix:
        layer = self._fine.layer(frame)
        found = self._fine.align(layer, start)
        self._rest = max(0, self._rest - 1)
        if self._rest == 0 and self._unexplained(found):
            found = self._walled(layer, start, found)
        yaw, u, v = found.displacement.pose()
        return CeilingFix(Pose2D(-v / self._fine.focal, u / self._fine.focal, yaw), found.score, margin)

    def _walled(self, layer: Layer, start: Displacement, found: Alignment) -> Alignment:
        """What was found; or with the known wall moved a little, or another one, if that explains the frame better."""
        best = found
        if self._wall != NO_WALL:
            best = self._better(found, self._fine.align_wall(layer, found.displacement), _TUNING_GAIN)
        if self._wall == NO_WALL or best.score < _SUSPICIOUS:
            best = self._better(best, self._fine.find_wall(layer, start), _WALL_GAIN)
        self._patience = _WALL_REST if best is not found else min(2 * self._patience, _LONGEST_WALL_REST)
        self._rest = self._patience if best is found else 0
        return best

    def _unexplained(self, found: Alignment) -> bool:
        """Whether a wall might explain more, and is seen from far enough away to tell."""
        parallax = math.hypot(found.displacement.u, found.displacement.v) / self._fine.focal
        return parallax > _WALL_PARALLAX and found.score < _EXPLAINED

    def _better(self, found: Alignment, walled: Alignment, gain: float) -> Alignment:
        """The one to believe; a wall believed is remembered."""
        if walled.score < found.score + gain:
            return found
        u, v = walled.displacement.wall
        self._wall = (u * self._fine.focal, v * self._fine.focal)
        return walled


class DockRegistration:
    """Estimates where the base stands relative to the pose at which the dock's snapshot was taken."""

    def __init__(self, camera: CameraModel, snapshot: Frame, ceiling_height: float) -> None:
        """`snapshot` full-size, as the camera took it; `ceiling_height` metres from camera to ceiling."""
        self._height = ceiling_height
        self._registration = CeilingRegistration(camera, snapshot, REACH / ceiling_height)

    def fix(self, frame: Frame, odom_from_base: Pose2D) -> HomingEstimate:
        """From nothing; `odom_from_base` belongs to the frame's stamp. A ceiling that shows nothing is REJECTED."""
        found = self._registration.fix(frame)
        sure = found.margin >= _MIN_MARGIN and found.score >= _SURE_SCORE
        verdict = Verdict.ACCEPTED if sure else Verdict.AMBIGUOUS
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
