"""A room under a fisheye camera that looks up: what the robot sees and where it can stand.

The room is a box; below its ceiling may hang bars, and parts of the ceiling may be recessed. Every pixel's ray
ends at the first of these that it meets.
"""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np

from tools.sim.atlas import Atlas
from tools.sim.casting import Coffer, Complexes, Eye, Lattice, Plane, SunPatch, Walls
from tools.sim.lens import Floats, Image, Lens, Rays, Sensor
from tools.sim.room import Room, Surfaces


class World:
    """A room seen by a camera 0.5 m above its floor; the same seed gives the same pictures.

    Pictures are made in buffers of the world's own: one thread at a time.
    """

    def __init__(
        self,
        surfaces: Surfaces,
        seed: int,
        lens: Lens | None = None,
        room: Room | None = None,
        noise: float = Sensor.NOISE,
    ) -> None:
        """`noise`: of the sensor, standard deviation in grey values."""
        self.surfaces, self.seed, self.noise = surfaces, seed, noise
        self.lens, self.room = lens or Lens(), room or Room()
        self._rays = rays = Rays(self.lens)
        self._sensor = Sensor(rays, seed, noise)
        atlas = Atlas()
        black = atlas.add(np.zeros((4, 4, 3), np.uint8), 1.0)
        corner = (-self.room.width / 2, -self.room.depth / 2)
        self._ceiling = Plane(rays, atlas, surfaces.ceiling, self.room.rise, corner)
        self._coffers = [Coffer(rays, atlas, recess, self.room.rise) for recess in surfaces.recesses]
        self._lattices = [Lattice(rays, atlas, bars, self.room) for bars in surfaces.bars]
        self._walls = Walls(rays, atlas, surfaces.walls, self.room)  # last: below its strip the floor goes on
        self._atlas = atlas.picture()
        sun = surfaces.sunlight
        self._sun = SunPatch(sun, surfaces.walls, self._walls.patch) if sun else None
        self._to = np.full(rays.padded, complex(black.column + 2, black.row + 2), np.complex64)
        self._pixels = np.empty((rays.padded // rays.ROW, rays.ROW, 4), np.uint8)
        station = np.random.default_rng((seed, 7302)).uniform(-0.25, 0.25) * self.room.depth
        self._dock = (self.room.width / 2 - 0.22, round(float(station), 3), 0.0)

    @property
    def fov_deg(self) -> float:
        return self.lens.fov_deg

    @property
    def camera_info(self) -> dict[str, Any] | None:
        """The calibration in the ROS layout; None where the image circle just fills the picture."""
        lens = self.lens
        if lens.offset == (0.0, 0.0) and lens.radius == min(lens.width, lens.height) / 2:
            return None
        cx, cy = (lens.width - 1) / 2 + lens.offset[0], (lens.height - 1) / 2 + lens.offset[1]
        return {
            "image_width": lens.width,
            "image_height": lens.height,
            "distortion_model": "equidistant",
            "camera_matrix": {"rows": 3, "cols": 3, "data": [lens.focal, 0.0, cx, 0.0, lens.focal, cy, 0.0, 0.0, 1.0]},
            "distortion_coefficients": {"rows": 1, "cols": 4, "data": [0.0] * 4},
        }

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(xmin, ymin, xmax, ymax) of the floor, metres."""
        x, y = self.room.width / 2, self.room.depth / 2
        return (-x, -y, x, y)

    @property
    def dock(self) -> tuple[float, float, float]:
        """(x, y, yaw) of a docked robot: facing the wall at xmax, 5 cm short of touching it."""
        return self._dock

    def free(self, x: float, y: float, radius: float) -> bool:
        """Whether a disc of `radius` m at (x, y) touches nothing."""
        xmin, ymin, xmax, ymax = self.bounds
        return xmin + radius <= x <= xmax - radius and ymin + radius <= y <= ymax - radius

    def render(self, x: float, y: float, yaw: float, t: float) -> Image:
        """The camera's picture (H, W, 3) BGR from (x, y, yaw) in metres and radians at `t` seconds.

        A place outside the room is moved just inside its walls: there is nothing to see beyond.
        """
        xmax, ymax = self.bounds[2] - 0.01, self.bounds[3] - 0.01
        self._cast(Eye(min(max(x, -xmax), xmax), min(max(y, -ymax), ymax), yaw))
        if self._sun:
            self._sun.paint(self._atlas, t)
        pairs = self._to.view(np.float32).reshape(*self._pixels.shape[:2], 2)
        cv2.remap(self._atlas, pairs, None, cv2.INTER_LINEAR, dst=self._pixels, borderMode=cv2.BORDER_REPLICATE)
        return self._sensor.expose(self._pixels, (t, x, y, yaw))

    def _cast(self, eye: Eye) -> None:
        """Finds for every ray the texel that it ends at: from some angle on that can only be a wall's."""
        reach = (self.room.width / 2 - abs(eye.x), self.room.depth / 2 - abs(eye.y))
        farthest = math.hypot(self.room.width - reach[0], self.room.depth - reach[1])
        lowest = min((lattice.lowest for lattice in self._lattices), default=self.room.rise)
        maybe = self._rays.within(math.atan(min(reach) / self.room.rise))
        only = self._rays.beyond(math.atan(farthest / lowest))
        heights = self._cast_overhead(self._to[:only], eye)
        table = self._walls.table(eye)
        walls = np.empty(only - maybe, np.complex64)
        self._walls.cast(walls, table, maybe)
        below = self._walls.below(walls, heights[maybe:])
        np.copyto(self._to[maybe:only], walls, where=below)
        self._walls.cast(self._to[only : self._rays.count], table, only)

    def _cast_overhead(self, to: Complexes, eye: Eye) -> Floats:
        """Points rays at the ceiling and what is in and under it; returns how high above the camera they end."""
        self._ceiling.cast(to, eye)
        heights = np.full(len(to), self.room.rise, np.float32)
        for coffer in self._coffers:
            coffer.cast(to, eye)
        for lattice in self._lattices:
            lattice.cast(to, heights, eye)
        return heights
