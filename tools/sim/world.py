"""A square room under a fisheye camera that looks up: what the robot sees and where it can stand.

The room is a box: a ceiling, four walls in one strip (counter-clockwise from the corner at xmin, ymin), in some
rooms beams under the ceiling. Every pixel's ray ends at the first of these that it meets.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from tools.sim.atlas import Atlas, PlaneMap
from tools.sim.lens import Floats, Image, Lens, Sensor

SIDE = 6.0  # m, the room is square and centred on the origin
CEILING = 2.7  # m above the floor
CAMERA = 0.5
CEILING_SCALE = 100.0  # texels a metre; the camera sees 66 px a metre straight above
WALL_SCALE = 64.0
WALL_FOOT = 0.3  # m of floor below the wall's strip: rays below the horizon end there
HEADROOM = 1.45  # textures are rendered darker by this, so that lamps stay saturated under vignetting

_AZIMUTHS = 16384  # of the table of distances to the walls: 0.1 px at the image's rim
_EDGES = 1000  # texels a metre of the table of beam edges


@dataclass(frozen=True)
class Beams:
    """Beams along y, hanging `drop` m below the ceiling: `spans` in x, and how undersides and flanks look."""

    spans: tuple[tuple[float, float], ...]
    drop: float
    underside: Image
    flank: Image


@dataclass(frozen=True)
class Surfaces:
    """Textures (H, W, 3): ceiling (x, y from its corner), walls (round the room, downwards), beams."""

    ceiling: Image
    walls: Image
    beams: Beams | None = None


class World:
    """A room seen by a camera 0.5 m above its floor; the same seed gives the same pictures."""

    def __init__(self, surfaces: Surfaces, seed: int, lens: Lens | None = None) -> None:
        self.lens = lens or Lens()
        self._sensor = Sensor(self.lens, seed, HEADROOM)
        theta, bearing = self.lens.rays()
        self._shape = theta.shape
        theta, bearing = theta.ravel(), bearing.ravel()
        self._tan = np.tan(np.minimum(theta, math.radians(89.0))).astype(np.float32)
        self._cot = (1.0 / np.tan(np.maximum(theta, 1e-4))).astype(np.float32)
        self._azimuth = np.rint(bearing % (2 * math.pi) * (_AZIMUTHS / (2 * math.pi))).astype(np.intp) % _AZIMUTHS
        self._outside = np.flatnonzero(theta > math.radians(self.lens.fov_deg / 2.0))
        self._rise = CEILING - CAMERA
        atlas = Atlas()
        self._ceiling = self._plane(theta, bearing, self._rise, atlas, surfaces.ceiling)
        self._walls = atlas.add(surfaces.walls, WALL_SCALE)
        self._beams = None
        if surfaces.beams is not None:
            self._beams = _BeamCaster(self, surfaces.beams, atlas, theta, bearing)
        self._black = atlas.add(np.zeros((4, 4, 3), np.uint8), 1.0)
        self._atlas = atlas.picture()
        station = np.random.default_rng((seed, 7302)).uniform(-1.5, 1.5)
        self._dock = (SIDE / 2 - 0.22, round(float(station), 3), 0.0)

    @property
    def fov_deg(self) -> float:
        return self.lens.fov_deg

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(xmin, ymin, xmax, ymax) of the floor, metres."""
        return (-SIDE / 2, -SIDE / 2, SIDE / 2, SIDE / 2)

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
        inside = SIDE / 2 - 0.01
        x, y = min(max(x, -inside), inside), min(max(y, -inside), inside)
        cos, sin = math.cos(yaw), math.sin(yaw)
        across, along_wall = self._walls_around(x, y, yaw)
        reach = across.take(self._azimuth)
        to = self._ceiling.coordinates(x + SIDE / 2, y + SIDE / 2, cos, sin)
        hit = self._tan * np.float32(self._rise)
        if self._beams is not None:
            self._beams.cast(to, hit, x, y, yaw)
        self._map_walls(to, hit > reach, reach, along_wall)
        to[:, self._outside] = np.array([[self._black.column + 2], [self._black.row + 2]], np.float32)
        columns, rows = to[0].reshape(self._shape), to[1].reshape(self._shape)
        block = cv2.remap(self._atlas, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        canvas = np.zeros((self.lens.height, self.lens.width, 3), np.uint8)
        return self._sensor.expose(np.asarray(block, np.uint8), canvas, self.lens, (t, x, y, yaw))

    def seen_scale(self, theta: Floats, rise: float) -> Floats:
        """Pixels a metre at which a plane `rise` m above the camera appears (geometric mean of both axes)."""
        angle = np.clip(theta, 1e-3, math.radians(89.0))
        radial = self.lens.focal * np.cos(angle) ** 2 / rise
        tangential = self.lens.focal * angle / (rise * np.tan(angle))
        return np.asarray(np.sqrt(radial * tangential), np.float32)

    def _plane(self, theta: Floats, bearing: Floats, rise: float, atlas: Atlas, texture: Image) -> PlaneMap:
        patches = atlas.add_pyramid(texture, CEILING_SCALE)
        return PlaneMap(self._tan * np.float32(rise), bearing, self.seen_scale(theta, rise), patches)

    def _walls_around(self, x: float, y: float, yaw: float) -> tuple[Floats, Floats]:
        """For each azimuth of the table: metres to the wall, and metres round the room to the point hit."""
        world = np.arange(_AZIMUTHS) * (2 * math.pi / _AZIMUTHS) + yaw
        cos, sin = np.cos(world), np.sin(world)
        half = SIDE / 2
        with np.errstate(divide="ignore"):
            to_x = (np.copysign(half, cos) - x) / cos
            to_y = (np.copysign(half, sin) - y) / sin
        across = np.minimum(to_x, to_y)
        hit_x, hit_y = x + across * cos, y + across * sin
        south_north = np.where(sin < 0, half + hit_x, 2 * SIDE + half - hit_x)
        east_west = np.where(cos > 0, SIDE + half + hit_y, 3 * SIDE + half - hit_y)
        return across.astype(np.float32), np.where(to_y < to_x, south_north, east_west).astype(np.float32)

    def _map_walls(self, to: Floats, wall: NDArray[np.bool_], reach: Floats, along_wall: Floats) -> None:
        """Points the pixels of the mask `wall` at the walls' strip, in place; `reach` is used up."""
        patch = self._walls
        scale, row = np.float32(patch.scale), np.float32(patch.row)
        columns = along_wall * scale + np.float32(patch.column)
        np.copyto(to[0], columns.take(self._azimuth), where=wall)
        rows = np.multiply(reach, self._cot, out=reach)  # metres above the camera
        rows *= -scale
        rows += row + scale * np.float32(self._rise)
        np.clip(rows, row, row + scale * np.float32(CEILING + WALL_FOOT), out=rows)
        np.copyto(to[1], rows, where=wall)


class _BeamCaster:
    """Finds which rays end on a beam: on its underside, or on the flank met between underside and ceiling."""

    def __init__(self, world: World, beams: Beams, atlas: Atlas, theta: Floats, bearing: Floats) -> None:
        self._drop = np.float32(beams.drop)
        self._low = np.float32(CEILING - CAMERA - beams.drop)
        self._tan, self._bearing = world._tan, bearing
        self._cos, self._sin = np.cos(bearing), np.sin(bearing)
        self._plane = world._plane(theta, bearing, float(self._low), atlas, beams.underside)
        self._flank = atlas.add(beams.flank, CEILING_SCALE)
        at = (np.arange(int(SIDE * _EDGES)) + 0.5) / _EDGES - SIDE / 2
        starts, ends = np.array(beams.spans).T
        self._under = np.any((at >= starts[:, None]) & (at < ends[:, None]), axis=0)
        next_start = np.searchsorted(starts, at)
        self._ahead = np.append(starts, np.inf)[next_start].astype(np.float32)
        self._behind = np.append(-np.inf, ends)[np.searchsorted(ends, at)].astype(np.float32)

    def cast(self, to: Floats, hit: Floats, x: float, y: float, yaw: float) -> None:
        """Corrects in place what is hit (`to`, atlas coordinates) and how far across the floor (`hit`)."""
        cos, sin = np.float32(math.cos(yaw)), np.float32(math.sin(yaw))
        east = self._cos * cos - self._sin * sin
        enters = self._tan * self._low * east + np.float32(x)
        cell = np.clip((enters + SIDE / 2) * _EDGES, 0, SIDE * _EDGES - 1).astype(np.intp)
        edge = np.where(east > 0, self._ahead.take(cell), self._behind.take(cell))
        flank = np.flatnonzero((edge - (hit * east + np.float32(x))) * np.sign(east) < 0)
        across = (edge[flank] - np.float32(x)) / east[flank]
        north = self._sin[flank] * cos + self._cos[flank] * sin
        up = (across / self._tan[flank] - self._low) / self._drop
        patch = self._flank
        to[0, flank] = (across * north + np.float32(y + SIDE / 2)) * patch.scale + patch.column
        to[1, flank] = np.clip(up, 0.0, 1.0) * self._drop * patch.scale + patch.row
        hit[flank] = across
        under = np.flatnonzero(self._under.take(cell))
        low = self._plane.coordinates(x + SIDE / 2, y + SIDE / 2, float(cos), float(sin))
        to[:, under] = low[:, under]
        hit[under] = self._tan[under] * self._low
