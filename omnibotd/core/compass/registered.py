"""The heading by the registration of docking: each frame against a key view, a fifth of the height off at most.

It takes what is overhead for a plane, or for beams and walls that it understands, and looks at 115 degrees of it: where
little is seen there, as under bare photographed ceilings, the tracker is surer.
"""

from __future__ import annotations

import math

from omnibotd.core.compass.turn import NO_TURN, Turn
from omnibotd.core.docking.registration import CeilingRegistration
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame

# A new key view this far from the last (heights, rad): nearer there are more of them, whose errors add up; farther,
# beams and walls that are not understood move too much.
_APART, _TURNED = 0.2, 0.5
# From this correlation on a frame is recognised; after so many in a row that are not, a new key view is begun.
_RECOGNISED, _PATIENCE = 0.4, 3
_REACH = 0.5  # heights; of a search from nothing, which is never made


class Registered:
    """Follows one robot by frames alone."""

    def __init__(self, camera: CameraModel) -> None:
        self._camera = camera
        self._key: CeilingRegistration | None = None
        self._here, self._step = Pose2D(), Pose2D()  # from the key view, and since the last frame; in heights
        self._missed = 0

    def turn(self, frame: Frame) -> Turn:
        """Since the frame before; where this one is not recognised it is expected to move as it did last."""
        if self._key is None:
            self._begin(frame)
            return NO_TURN
        expected = self._here @ self._step
        fix = self._key.track(frame, expected)
        seen = fix.score >= _RECOGNISED
        here = fix.pose if seen else expected
        self._step, self._here = self._here.inverse() @ here, here
        self._missed = 0 if seen else self._missed + 1
        if self._missed >= _PATIENCE or (seen and self._far()):
            self._begin(frame)
        return Turn(wrap(self._step.yaw), 1, seen)

    def _far(self) -> bool:
        return math.hypot(self._here.x, self._here.y) > _APART or abs(self._here.yaw) > _TURNED

    def _begin(self, frame: Frame) -> None:
        self._key = CeilingRegistration(self._camera, frame, _REACH)
        self._here, self._missed = Pose2D(), 0
