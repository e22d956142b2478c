"""The same way driven several times, out and back: what is seen at its two ends ties all the drives together.

Along the way steps and beams of the ceiling falsify the length seen, by a percent or so, and not the same each time. At
either end the robot comes to stand a few centimetres from where it stood before, and how far is seen exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from omnibotd.core.calibration.sightline import Way, registered
from omnibotd.core.docking.fine import FineRegistration
from omnibotd.core.geometry import Pose2D
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame

# Ceiling heights that the robot may stand off from where it stood before: more, and it is another place.
_SAME_PLACE = 0.15


def tied(ways: Sequence[Way], ends: Sequence[Frame], camera: CameraModel) -> list[Way] | None:
    """The ways with ends that agree; `ends` has a frame from before the first, and one from after each.

    All share one length along the way, the mean; None where a place was not recognised or is another.
    """
    first_from_end = [Pose2D()]
    for way in ways:
        first_from_end.append(first_from_end[-1] @ way.end)
    near, far = (_places(first_from_end[side::2], ends[side::2], camera) for side in (0, 1))
    if near is None or far is None:
        return None
    # Of every end, its pose from where the robot first stood on that side.
    stood = [(near, far)[i % 2][i // 2] for i in range(len(ends))]
    across = _mean([_across(i, way.end, stood) for i, way in enumerate(ways)])
    sides = (Pose2D(), across)
    poses = [sides[i % 2] @ pose for i, pose in enumerate(stood)]
    return [replace(way, end=a.inverse() @ b) for way, (a, b) in zip(ways, pairwise(poses), strict=True)]


def _places(believed: Sequence[Pose2D], frames: Sequence[Frame], camera: CameraModel) -> list[Pose2D] | None:
    """Of each frame in the axes of the first, from where it is believed to be; None where one is elsewhere."""
    key, found = FineRegistration(camera, frames[0]), [Pose2D()]
    for pose, frame in zip(believed[1:], frames[1:], strict=True):
        place = registered(key, key.layer(frame), believed[0].inverse() @ pose)
        if place is None or math.hypot(place.x, place.y) > _SAME_PLACE:
            return None
        found.append(place)
    return found


def _across(i: int, end: Pose2D, stood: Sequence[Pose2D]) -> Pose2D:
    """From the first stand on the near side to that on the far side, as the i-th way has it."""
    whole = stood[i] @ end @ stood[i + 1].inverse()
    return whole if i % 2 == 0 else whole.inverse()


def _mean(poses: Sequence[Pose2D]) -> Pose2D:
    """Of poses that hardly differ."""
    x, y, yaw = np.mean([(pose.x, pose.y, pose.yaw) for pose in poses], axis=0)
    return Pose2D(float(x), float(y), float(yaw))
