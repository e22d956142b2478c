"""A camera in front of a conical mirror, however crooked: pixel to line of sight and back (thesis, section 4.6)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from omnibotd.core.optics.camera import Camera
from omnibotd.core.optics.cone import Cone
from omnibotd.core.optics.rigid import Floats, Rigid


@dataclass(frozen=True, slots=True, eq=False)
class Sights:
    """Lines of sight (n,): from where on the mirror (n, 3), in which unit direction (n, 3); NaN where there is none."""

    origin: Floats
    direction: Floats


@dataclass(frozen=True, slots=True, eq=False)
class ConeSensor:
    """A mirror, its camera, where the camera stands in the mirror's frame, and the mirror in the frame of its user."""

    cone: Cone
    camera: Camera
    cone_from_camera: Rigid
    frame_from_cone: Rigid = field(default_factory=Rigid.of)

    @classmethod
    def aligned(cls, cone: Cone, camera: Camera, distance: float) -> ConeSensor:
        """With the lens on the axis, `distance` m above the tip, which it looks at."""
        return cls(cone, camera, Rigid.of(shift=(0.0, 0.0, distance)))

    def sights(self, pixels: Floats) -> Sights:
        """Where pixels (n, 2) look; NaN where they miss the mirror."""
        rays = self.cone_from_camera.directions(self.camera.rays(pixels))
        struck = self.cone.struck(self.cone_from_camera.translation, rays)
        leaving = self.cone.reflected(struck, rays)
        return Sights(self.frame_from_cone.points(struck), self.frame_from_cone.directions(leaving))

    def pixels(self, points: Floats) -> Floats:
        """Where points (n, 3) appear (n, 2); NaN where the mirror does not show them."""
        in_cone = self.frame_from_cone.inverse().points(points)
        struck = self.cone.mirrored(self.cone_from_camera.translation, in_cone)
        return self.camera.pixels(self.cone_from_camera.inverse().points(struck))

    def tip(self) -> Floats:
        """Where the mirror's tip appears (2,): what an aligned sensor takes for the picture's centre."""
        tip = self.cone_from_camera.inverse().points(np.zeros((1, 3)))
        return np.asarray(self.camera.pixels(tip)[0], np.float64)
