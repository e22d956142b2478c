"""How far a robot drove and turned, by the ceiling alone: in ceiling heights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from omnibotd.core.calibration.panorama import Floats
from omnibotd.core.docking.alignment import Layer
from omnibotd.core.docking.displacement import Displacement
from omnibotd.core.docking.fine import FineRegistration
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import FloatImage, Frame

# Ceiling heights from a key view after which the next one serves: errors of a view add up, so not too soon; parallax of
# beams and walls grows, so not too late.
_KEY_DISTANCE = 0.2
# Correlation below which a view was not recognised.
_LEAST_SCORE = 0.35
# Heights are compared on patches this many pixels wide, and to this share: a patch of one height and an edge.
_PATCH, _HEIGHT_NOISE = 20, 0.01
# Shares of the height within which patches are of one plane, and farther off than which they are of another.
_SAME, _OTHER = 0.015, 0.025


@dataclass(frozen=True, slots=True)
class Way:
    """A straight drive by sight, in ceiling heights: `end` in the axes of its start.

    `patches` (n, 2): how much nearer than taken for each patch of the ceiling is, as a share; and its weight.
    """

    end: Pose2D
    patches: Floats

    @property
    def turned(self) -> float:
        return wrap(self.end.yaw)

    @property
    def length(self) -> float:
        """Along an arc of one curvature, negative backwards."""
        chord = math.copysign(math.hypot(self.end.x, self.end.y), self.end.x)
        return chord if abs(self.turned) < 1e-9 else chord * (self.turned / 2.0) / math.sin(self.turned / 2.0)

    def of_base(self, camera: Floats) -> Way:
        """The way of the base, from that of a camera at this place (2,) in its axes."""
        base_from_camera = Pose2D(float(camera[0]), float(camera[1]))
        return replace(self, end=base_from_camera @ self.end @ base_from_camera.inverse())


def seen_way(frames: Sequence[Frame], camera: CameraModel) -> Way | None:
    """From the first frame to the last; None where a view was not recognised.

    Frames follow closely (a tenth of the ceiling's height at most): each starts from where the ones before it lead.
    """
    key, start_from_key = FineRegistration(camera, frames[0]), Pose2D()
    key_layer, poses, patches = key.layer(frames[0]), [Pose2D()], [np.zeros((0, 2))]
    for frame in frames[1:]:
        layer = key.layer(frame)
        moved = registered(key, layer, start_from_key.inverse() @ _onward(poses))
        if moved is None:
            return None
        poses.append(start_from_key @ moved)
        if math.hypot(moved.x, moved.y) > _KEY_DISTANCE:
            patches.append(_nearness(key_layer, layer, _displacement(moved, key.focal)))
            key, key_layer, start_from_key = FineRegistration(camera, frame), layer, poses[-1]
    return Way(poses[-1], np.concatenate(patches))


def registered(key: FineRegistration, layer: Layer, expected: Pose2D) -> Pose2D | None:
    """Where the layer was seen from, in the key's axes and ceiling heights; None where it is not recognised."""
    found = key.align(layer, _displacement(expected, key.focal))
    yaw, u, v = found.displacement.pose()
    return Pose2D(-v / key.focal, u / key.focal, yaw) if found.score >= _LEAST_SCORE else None


def ceiling_of(patches: Floats) -> tuple[float, float]:
    """The nearness of the plane that most of the ceiling lies in, and how much there is of any other to one of it.

    The first is next to nothing for a ceiling without steps. The second is some tenths where it shows little.
    """
    if not len(patches):
        return 0.0, 0.0
    nearness, weight = patches.T
    within = np.abs(nearness[:, None] - nearness[None, :]) < _SAME
    shares = within @ weight
    best = int(np.argmax(shares))
    plane = float(np.average(nearness, weights=weight * within[best]))
    others = shares[np.abs(nearness - plane) > _OTHER]
    return plane, float(others.max(initial=0.0) / shares[best])


def _nearness(target: Layer, current: Layer, displacement: Displacement) -> Floats:
    """(patches, 2): how much more than the whole each patch has moved along the way, as a share; and its weight."""
    feature, mask = current.warped(displacement)
    seen = ((mask & target.mask) > 0).astype(np.float32)
    difference = (feature - target.feature) * seen
    way = np.linalg.solve(displacement.linear(), (displacement.u, displacement.v))
    length = float(np.hypot(*way))
    mean = (feature + target.feature) / np.float32(2.0)
    slope = (cv2.Sobel(mean, cv2.CV_32F, 1, 0, scale=1 / 8.0) * np.float32(way[0] / length)) * seen
    slope += (cv2.Sobel(mean, cv2.CV_32F, 0, 1, scale=1 / 8.0) * np.float32(way[1] / length)) * seen
    information, pull = _by_patch(slope * slope), _by_patch(slope * difference)
    variance = _by_patch(difference * difference) / np.maximum(_by_patch(seen), 1.0)
    nearness = -pull / np.maximum(information, 1e-6) / length
    told = information / np.maximum(variance, 1e-3) * length**2
    return np.stack([nearness, told / (1.0 + _HEIGHT_NOISE**2 * told)], -1)


def _by_patch(pixels: FloatImage) -> Floats:
    n = len(pixels) // _PATCH
    return np.asarray(pixels.reshape(n, _PATCH, n, _PATCH).sum((1, 3), dtype=np.float64)).ravel()


def _onward(poses: Sequence[Pose2D]) -> Pose2D:
    """Another step like the one before."""
    return poses[-1] if len(poses) < 2 else poses[-1] @ (poses[-2].inverse() @ poses[-1])


def _displacement(pose: Pose2D, focal: float) -> Displacement:
    return Displacement.of_pose(pose.yaw, pose.y * focal, -pose.x * focal)
