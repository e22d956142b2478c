"""A view that later ones are compared with, at two resolutions: one finds, the other measures."""

from __future__ import annotations

from dataclasses import dataclass, replace

from omnibotd.core.compass.alignment import Expected, in_heights
from omnibotd.core.compass.contrast import COARSE, FINE, Contrast
from omnibotd.core.compass.key_layer import Fix, KeyLayer
from omnibotd.core.geometry import Pose2D
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import FloatImage, Frame

# What is recognised so well where it is expected need not be looked for elsewhere. On bare walls looking elsewhere
# first, coarsely, leads astray.
_SURE = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """What a frame shows."""

    fine: FloatImage
    coarse: FloatImage


class Looking:
    """Turns the frames of one camera into looks."""

    def __init__(self, camera: CameraModel) -> None:
        self.fine, self.coarse = Contrast(camera, FINE), Contrast(camera, COARSE)

    def __call__(self, frame: Frame) -> Look:
        """Raises FrameError where the frame can't be used."""
        return Look(self.fine(frame), self.coarse(frame))


class KeyView:
    """One look, and where that was in the frame of its user."""

    def __init__(self, pose: Pose2D, fine: KeyLayer, coarse: KeyLayer | None) -> None:
        self.pose = pose
        self._fine, self._coarse = fine, coarse

    @classmethod
    def of(cls, frame: Frame, looking: Looking, pose: Pose2D) -> KeyView | None:
        """None where there is too little to see."""
        look = looking(frame)
        fine = KeyLayer.of(look.fine, looking.fine)
        if fine is None:
            return None
        return cls(pose, fine, KeyLayer.of(look.coarse, looking.coarse))

    def inherit(self, older: KeyView, height: float) -> None:
        """Take over what an older one has learnt of how near things are, `height` m below the ceiling."""
        self._fine.inherit(older._fine, in_heights(older.pose.inverse() @ self.pose, height))

    def locate(self, look: Look, expected: Expected, *, learn: bool) -> Fix:
        """Where the robot is, from this view's place; `learn` of the nearness of things by it."""
        fix = self._fine.locate(look.fine, expected)
        if fix.score < _SURE and self._coarse is not None:
            found = self._coarse.locate(look.coarse, expected)
            if found.good:
                other = self._fine.locate(look.fine, replace(expected, start=found.pose))
                fix = max(fix, other, key=lambda each: each.score)
        if learn and fix.good:
            self._fine.learn(fix)
        return fix
