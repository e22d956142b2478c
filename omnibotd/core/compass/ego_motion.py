"""Odometry from the wheels and consecutive views of what is overhead, in one estimate (thesis, section 8.3)."""

from __future__ import annotations

import math

from omnibotd.core.compass.ceiling_tracker import CeilingTracker, Step, Tracked
from omnibotd.core.geometry import Pose2D
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame

# How far wheels may be off after a step, one standard deviation: a share of the way; rad, a share of the turn, and rad
# for the square root of each metre driven, for wheels slip at random.
_SHIFT_SHARE = 0.01
_TURN, _TURN_SHARE, _SLIP = 0.001, 0.03, 0.03


class EgoMotion:
    """Follows one robot from where it was first told of."""

    def __init__(self, camera: CameraModel, height: float, height_error: float) -> None:
        """`height`: m from camera to ceiling, which may be wrong by the share `height_error`."""
        self._tracker = CeilingTracker(camera, height, height_error)
        self._wheels: Pose2D | None = None

    def update(self, frame: Frame, odom_from_base: Pose2D) -> Tracked:
        """Take the next frame and the pose by the wheels when it was taken; FrameError: it can't be used.

        Where nothing is recognised the pose goes on by the wheels.
        """
        before = self._wheels or odom_from_base
        tracked = self._tracker.update(frame, wheel_step(before.inverse() @ odom_from_base))
        self._wheels = odom_from_base
        return tracked


def wheel_step(moved: Pose2D) -> Step:
    """A motion by the wheels, and how far that may be off."""
    way = math.hypot(moved.x, moved.y)
    turn = _TURN + _TURN_SHARE * abs(moved.yaw) + _SLIP * math.sqrt(way)
    return Step(moved, _SHIFT_SHARE * way, turn)
