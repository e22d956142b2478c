"""What decoding a JPEG smaller saves, and whether it costs accuracy: of places and of docking estimates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import cv2
import numpy as np

from omnibotd.core.docking.registration import DockRegistration
from omnibotd.core.geometry import Pose2D
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame, Image
from omnibotd.core.vision.view import reduction_for
from omnibotd.presets import preset_of
from tools.benchmark import rooms
from tools.benchmark.cycle import DRIVE_SEED, PERIOD, STEP, Footage
from tools.benchmark.docking import CEILING, DOCK, PRIOR_ERROR, PRIOR_YAW, dock_poses, triple
from tools.benchmark.measuring import Times, settle

SETTLED = 30  # frames after which the localiser has found itself


class WholeFrame(Frame):
    """Decoded whole, then averaged down: what reduced decoding must not be worse than."""

    __slots__ = ()

    def grey(self, reduction: int = 1) -> Image:
        whole = Frame.grey(self)
        height, width = whole.shape
        size = (-(-width // reduction), -(-height // reduction))
        return np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), np.uint8)


class HalfFrame(Frame):
    """As a camera of half the size would send it."""

    __slots__ = ()

    def grey(self, reduction: int = 1) -> Image:
        return Frame.grey(self, 2 * reduction)


def measure(nodes: int, frames: int) -> dict[str, Any]:
    """Errors against the truth in mm, decoding and tracking in ms."""
    footage = Footage.of(frames)
    return {
        "reduction": reduction_for(rooms.CAMERA),
        "decoding": _decoding(footage.frames),
        "places": _places(nodes, frames, footage),
        "docking": _docking(frames),
    }


def _decoding(frames: Sequence[Frame]) -> dict[str, Any]:
    times = Times()
    settle()
    for frame in frames:
        for reduction in (1, 2, 4):
            times.measure(f"1/{reduction}", lambda frame=frame, reduction=reduction: frame.grey(reduction))
    return times.table()


def _places(nodes: int, frames: int, footage: Footage) -> dict[str, dict[str, float]]:
    topo_map = rooms.large_map(nodes)
    truth = [Pose2D(*pose) for pose in rooms.waypoints(frames, STEP, DRIVE_SEED, 0.8 * rooms.HALF)]
    result = {}
    for name, kind in (("reduced", Frame), ("whole", WholeFrame)):
        localizer = preset_of(topo_map).localizer(topo_map, rooms.CAMERA)
        errors = []
        for k, odom in enumerate(footage.odom_from_base):
            place = localizer.update(kind(PERIOD * k, footage.frames[k].data), odom)
            errors.append(place.map_from_base.distance(truth[k]))
        result[name] = _errors(errors[min(SETTLED, frames // 2) :])
    return result


def _docking(frames: int) -> dict[str, dict[str, float]]:
    poses = dock_poses(frames)
    jpegs = rooms.jpegs(np.array([triple(DOCK), *(triple(DOCK @ pose) for pose in poses)]), 0.4)
    half = rooms.CAMERA.reduced(2)
    return {
        "half": _tracked(half, [HalfFrame(float(k), jpeg) for k, jpeg in enumerate(jpegs)], poses),
        "whole": _tracked(rooms.CAMERA, [Frame(float(k), jpeg) for k, jpeg in enumerate(jpegs)], poses),
    }


def _tracked(camera: CameraModel, seen: Sequence[Frame], poses: Sequence[Pose2D]) -> dict[str, float]:
    registration = DockRegistration(camera, seen[0], CEILING)
    off, times = Pose2D(PRIOR_ERROR, 0.0, PRIOR_YAW), Times()
    away, turned = [], []
    for frame, pose in zip(seen[1:], poses, strict=True):
        found = times.measure("track", partial(registration.track, frame, Pose2D(), pose @ off))
        if found is not None:
            away.append(found.dock_from_base.distance(pose))
            turned.append(abs(math.degrees((pose.inverse() @ found.dock_from_base).yaw)))
    return _errors(away) | {"deg": float(np.median(turned)), "found": len(away), "ms": times.median("track") / 1e6}


def _errors(metres: Sequence[float]) -> dict[str, float]:
    return {"median_mm": 1e3 * float(np.median(metres)), "p95_mm": 1e3 * float(np.percentile(metres, 95))}
