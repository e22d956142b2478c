"""A simulated teaching drive: random way-points under a rendered ceiling, noisy odometry."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.mapping.training import TeachingSample
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from tools.sim.world import World

CAMERA = CameraModel.equidistant(640, 480, math.radians(190.0))
DT = 0.2  # s between frames
SPEED, TURN_RATE = 0.3, 1.0


@dataclass(frozen=True)
class Drive:
    """True poses of the samples, and the samples."""

    truth: list[Pose2D]
    samples: list[TeachingSample]


def waypoint_drive(
    world: World,
    seconds: float,
    half: float,
    seed: int,
    scale: float = 1.0,
    veer: float = 0.0,
    centre: tuple[float, float] = (0.0, 0.0),
    odom: Pose2D = Pose2D(),  # noqa: B008 - frozen
) -> Drive:
    """Within `half` metres of `centre`; odometry starts at `odom`, measures `scale` times the distance and `veer` rad a
    metre too much of turn, with 1 % noise."""
    rng = np.random.default_rng(seed)
    truth = [Pose2D(pose.x + centre[0], pose.y + centre[1], pose.yaw) for pose in waypoints(seconds, half, rng)]
    samples = []
    for number, pose in enumerate(truth):
        if number:
            step = truth[number - 1].inverse() @ pose
            noisy = scale * (1.0 + 0.01 * rng.standard_normal())
            yaw = step.yaw * (1.0 + 0.01 * rng.standard_normal()) + 0.002 * rng.standard_normal() + veer * step.x
            odom = odom @ Pose2D(step.x * noisy, step.y * noisy, yaw)
        samples.append(TeachingSample(number * DT, odom, frame(world, pose, number * DT)))
    return Drive(truth, samples)


def waypoints(seconds: float, half: float, rng: np.random.Generator) -> list[Pose2D]:
    """Poses DT apart of a base that turns towards a random point, drives there, and so on."""
    pose = Pose2D(rng.uniform(-half, half), rng.uniform(-half, half), rng.uniform(-3.0, 3.0))
    goal = Pose2D(rng.uniform(-half, half), rng.uniform(-half, half))
    poses = [pose]
    while len(poses) * DT < seconds:
        if pose.distance(goal) < 0.1:
            goal = Pose2D(rng.uniform(-half, half), rng.uniform(-half, half))
        off = pose.bearing(goal)
        turn = max(-TURN_RATE * DT, min(TURN_RATE * DT, off))
        ahead = SPEED * DT if abs(off) < 0.5 else 0.0
        pose = pose @ Pose2D(ahead * math.cos(turn / 2), ahead * math.sin(turn / 2), turn)
        poses.append(pose)
    return poses


def frame(world: World, pose: Pose2D, stamp: float) -> Frame:
    picture = world.render(pose.x, pose.y, pose.yaw, stamp)
    return Frame(stamp, cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes())


def error(map_from_base: Pose2D, truth: Pose2D, origin: Pose2D) -> tuple[float, float]:
    """Metres and radians between an estimate and the truth, the map's origin being the true pose `origin`."""
    expected = origin.inverse() @ truth
    return map_from_base.distance(expected), abs(wrap(map_from_base.yaw - expected.yaw))
