"""Wheel odometry that sight puts right: the wheels say what moved since the last frame, sight where that frame was."""

from __future__ import annotations

import math
from typing import Protocol

from omnibotd.core.compass.ceiling_tracker import CeilingTracker
from omnibotd.core.compass.ego_motion import EgoMotion, wheel_step
from omnibotd.core.compass.image_flow import ImageFlow
from omnibotd.core.compass.labrosse import Labrosse
from omnibotd.core.compass.registered import Registered
from omnibotd.core.compass.round_view import Levelling, RoundView
from omnibotd.core.compass.turn import NO_TURN, Compass, Turn
from omnibotd.core.compass.two_point import TwoPointFlow
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.odometry import WheelOdometry
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame

# Of each compass of two frames: how far a turn may be off (rad, one standard deviation under simulated ceilings).
_COMPASSES: dict[str, tuple[type[Compass], float]] = {
    "two_point": (TwoPointFlow, 0.004),
    "image_flow": (ImageFlow, 0.006),
    "labrosse": (Labrosse, 0.002),
}
_REGISTRATION_SPREAD = 0.001  # rad, the same for the registration of docking
# Turns that differ by so many standard deviations are no two measurements of one: sight saw something else.
_APART = 4.0
# How many times smaller than its frames a picture is that the compasses of the thesis look at.
_REDUCTION = 2


class SightedOdometry:
    """As WheelOdometry, moved by the last correction."""

    def __init__(self, wheels: WheelOdometry) -> None:
        self._wheels = wheels
        self._odom_from_wheels = Pose2D()

    @property
    def odom_from_base(self) -> Pose2D:
        return self._odom_from_wheels @ self._wheels.odom_from_base

    @property
    def distance(self) -> float:
        """Metres driven, by the wheels."""
        return self._wheels.distance

    def at(self, stamp: float) -> Pose2D:
        """odom_from_base at `stamp`, by what is known now."""
        return self._odom_from_wheels @ self._wheels.at(stamp)

    def correct(self, seen: Pose2D, by_wheels: Pose2D) -> None:
        """Where the wheels had the base at `by_wheels`, it was at `seen`."""
        self._odom_from_wheels = seen @ by_wheels.inverse()


class Sight(Protocol):
    """What tells where the base is, by frames and wheels."""

    def update(self, frame: Frame, by_wheels: Pose2D) -> Pose2D:
        """odom_from_base when the frame was taken, wheels having it at `by_wheels`. FrameError: unusable frame."""
        ...


class FrameCompass(Protocol):
    """What tells by how much the robot turned since the frame before."""

    def turn(self, frame: Frame) -> Turn: ...


class WholePose:
    """The ceiling tracker led by the wheels: heading and position."""

    def __init__(self, camera: CameraModel, height: float, height_error: float) -> None:
        self._motion = EgoMotion(camera, height, height_error)
        self._odom_from_first: Pose2D | None = None  # the robot may have driven before there was a picture

    def update(self, frame: Frame, by_wheels: Pose2D) -> Pose2D:
        first_from_base = self._motion.update(frame, by_wheels).pose
        if self._odom_from_first is None:
            self._odom_from_first = by_wheels @ first_from_base.inverse()
        return self._odom_from_first @ first_from_base


class HeadingOnly:
    """Heading by a compass, lengths by the wheels; where the compass can't tell, the wheels' heading, too."""

    def __init__(self, compass: FrameCompass, spread: float | None = None) -> None:
        """With a `spread` (rad, one standard deviation of its turns) the compass is weighed against the wheels."""
        self._compass, self._spread = compass, spread
        self._pose: Pose2D | None = None
        self._wheels = Pose2D()

    def update(self, frame: Frame, by_wheels: Pose2D) -> Pose2D:
        seen = self._compass.turn(frame)
        if self._pose is None:
            self._pose, self._wheels = by_wheels, by_wheels
            return by_wheels
        moved = self._wheels.inverse() @ by_wheels
        turn = self._weighed(seen, moved)
        # Half of what the heading is put right by was there on the way already.
        way = Pose2D(0.0, 0.0, (turn - moved.yaw) / 2.0).transform(moved.x, moved.y)
        self._pose, self._wheels = self._pose @ Pose2D(*way, turn), by_wheels
        return self._pose

    def _weighed(self, seen: Turn, moved: Pose2D) -> float:
        if not seen.ok:
            return moved.yaw
        if self._spread is None:
            return seen.angle
        off, wheels = wrap(seen.angle - moved.yaw), wheel_step(moved).turn
        if abs(off) > _APART * math.hypot(wheels, self._spread):
            return moved.yaw
        return moved.yaw + off * wheels**2 / (wheels**2 + self._spread**2)


class TwoFrames:
    """A compass of the thesis, on levelled frames."""

    def __init__(self, camera: CameraModel, compass: Compass) -> None:
        self._levelled, self._compass = Levelling(camera, _REDUCTION), compass
        self._before: RoundView | None = None

    def turn(self, frame: Frame) -> Turn:
        before, self._before = self._before, self._levelled(frame)
        return NO_TURN if before is None else self._compass.turn(before, self._before)


class Tracking:
    """The ceiling tracker by itself, as a compass."""

    def __init__(self, camera: CameraModel, height: float) -> None:
        self._tracker, self._heading = CeilingTracker(camera, height), 0.0

    def turn(self, frame: Frame) -> Turn:
        tracked = self._tracker.update(frame)
        before, self._heading = self._heading, tracked.pose.yaw
        return Turn(wrap(self._heading - before), 1, tracked.seen)


def sight(heading: str, compass: str, camera: CameraModel, height: float, height_error: float) -> Sight:
    """By the names in the configuration: heading `compass` or `fused`; compass `tracker`, `registration` or one of the
    thesis'.

    `height`: m from camera to ceiling, which may be wrong by the share `height_error`.
    """
    fused = heading == "fused"
    if compass == "tracker":
        return WholePose(camera, height, height_error) if fused else HeadingOnly(Tracking(camera, height))
    if compass == "registration":
        return HeadingOnly(Registered(camera), _REGISTRATION_SPREAD if fused else None)
    make, spread = _COMPASSES[compass]
    return HeadingOnly(TwoFrames(camera, make()), spread if fused else None)
