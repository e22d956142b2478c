"""How high the ceiling is: the same displacement in metres by odometry and in ceiling heights by sight."""

from __future__ import annotations

import math

from omnibotd.core.docking.displacement import Displacement
from omnibotd.core.docking.fine import FineRegistration
from omnibotd.core.docking.registration import CeilingRegistration
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame

# Metres driven between the two frames: less drowns in odometry noise, more shares too little of a low ceiling.
_SHORTEST, _LONGEST = 0.2, 0.6
# Metres above the camera; a home has 2, a hall 6.
_LOWEST, _HIGHEST = 0.8, 10.0
# Sight must agree with odometry on the turn and on the direction (rad), or it found something else.
_TURN, _DIRECTION = math.radians(5.0), math.radians(15.0)
_MIN_SCORE, _MIN_MARGIN = 0.5, 0.05


def visual_height(camera: CameraModel, first: Frame, second: Frame, second_from_first: Pose2D) -> float | None:
    """Metres from camera to ceiling, from two frames and the odometry between them; None when they don't tell.

    One pair is good to the few percent of the odometry and of beams and walls in view: use the median of many.
    """
    driven = second_from_first.inverse()
    distance = math.hypot(driven.x, driven.y)
    if not _SHORTEST <= distance <= _LONGEST:
        return None
    found = CeilingRegistration(camera, first, distance / _LOWEST).fix(second)
    if found.margin < _MIN_MARGIN:
        return None
    seen, score = _measured(camera, first, second, found.pose)
    if score < _MIN_SCORE or not _agree(driven, seen):
        return None
    height = distance / math.hypot(seen.x, seen.y)
    return height if _LOWEST <= height <= _HIGHEST else None


def _measured(camera: CameraModel, first: Frame, second: Frame, found: Pose2D) -> tuple[Pose2D, float]:
    """The pose by the middle of the view alone, and the correlation: walls at its rim are nearer than the ceiling."""
    middle = FineRegistration(camera, first)
    f = middle.focal
    aligned = middle.align(middle.layer(second), Displacement.of_pose(found.yaw, found.y * f, -found.x * f))
    yaw, u, v = aligned.displacement.pose()
    return Pose2D(-v / f, u / f, yaw), aligned.score


def _agree(driven: Pose2D, seen: Pose2D) -> bool:
    if math.hypot(seen.x, seen.y) < _SHORTEST / _HIGHEST:
        return False
    direction = wrap(math.atan2(driven.y, driven.x) - math.atan2(seen.y, seen.x))
    return abs(wrap(driven.yaw - seen.yaw)) < _TURN and abs(direction) < _DIRECTION
