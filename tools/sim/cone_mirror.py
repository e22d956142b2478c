"""What a conical mirror shows of a simulated room (thesis, sections 2.2.1 and 4.4).

A mirror has no single viewpoint, so each ray starts at its own place; a ray's texel is found as `casting` does, surface
by surface, for all rays at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from omnibotd.core.optics.aligned import focal_length
from omnibotd.core.optics.camera import Pinhole
from omnibotd.core.optics.cone import Cone
from omnibotd.core.optics.rigid import Rigid
from omnibotd.core.optics.sensor import ConeSensor
from tools.sim.atlas import Atlas, Patch
from tools.sim.casting import SunPatch
from tools.sim.lens import Floats, Image, Rays, Sensor
from tools.sim.room import CEILING_SCALE, WALL_FOOT, WALL_SCALE, Bar, Bars, Recess
from tools.sim.world import World

_FINER = 2  # rays a pixel each way: what the mirror shrinks would flicker under one


def upright(height: float = 0.5, width: int = 640, rows: int = 480) -> ConeSensor:
    """A 90 degree cone of 5 cm radius, tip down and `height` m above the floor, over a camera 10 cm below it.

    It shows the room from the tip's height up to 18 degrees above. The robot's front is at the picture's right and its
    left at the bottom, so that a bearing b (CCW) is at (cx + r cos b, cy + r sin b).
    """
    cone, distance = Cone(0.05), 0.10
    focal = focal_length(distance, cone.radius, 0.48 * min(width, rows))
    base_from_cone = Rigid.of((math.pi, 0.0, 0.0), (0.0, 0.0, height))
    camera = Pinhole(focal, (width - 1) / 2.0, (rows - 1) / 2.0)
    return ConeSensor(cone, camera, Rigid.of(shift=(0.0, 0.0, distance)), base_from_cone)


class ConeMirror:
    """A world's room seen in a mirror that the robot carries; renders as the world does."""

    def __init__(self, world: World, sensor: ConeSensor, width: int = 640, rows: int = 480) -> None:
        """`sensor`: its frame is the robot's base on the floor."""
        self._shape, self._seed, self._noise = (rows, width), world.seed, world.noise
        v, u = np.mgrid[0 : rows * _FINER, 0 : width * _FINER].reshape(2, -1)
        sights = sensor.sights(np.stack([u, v], axis=1) / _FINER - 0.5 + 0.5 / _FINER)
        self._shown = np.flatnonzero(np.isfinite(sights.origin[:, 0]))
        self._origin = sights.origin[self._shown].T.astype(np.float32)
        self._direction = sights.direction[self._shown].T.astype(np.float32)
        atlas = Atlas()
        self._scene = _Scene(world, atlas)
        self._atlas = atlas.picture()
        sun = world.surfaces.sunlight
        self._sun = SunPatch(sun, world.surfaces.walls, self._scene.walls) if sun else None

    def render(self, x: float, y: float, yaw: float, t: float) -> Image:
        """The camera's picture (H, W, 3) BGR from (x, y, yaw) in metres and radians at `t` seconds."""
        if self._sun:
            self._sun.paint(self._atlas, t)
        eye = _turned(self._origin, yaw)
        eye[:2] += np.array([[x], [y]], np.float32)
        texels = self._scene.cast(eye, _turned(self._direction, yaw))
        count = texels.shape[1]
        pairs = np.zeros((-(-count // Rays.ROW) * Rays.ROW, 2), np.float32)
        pairs[:count] = texels.T
        rows, width = self._shape
        fine = np.zeros((rows * _FINER, width * _FINER, 3), np.uint8)
        seen = np.empty((len(pairs) // Rays.ROW, Rays.ROW, 4), np.uint8)
        cv2.remap(self._atlas, pairs.reshape(-1, Rays.ROW, 2), None, cv2.INTER_LINEAR, dst=seen)
        fine.reshape(-1, 3)[self._shown] = seen.reshape(-1, 4)[:count, :3]
        picture = cv2.resize(fine, (width, rows), interpolation=cv2.INTER_AREA)
        return self._exposed(np.asarray(picture, np.uint8), (t, x, y, yaw))

    def _exposed(self, picture: Image, shot: tuple[float, ...]) -> Image:
        rng = np.random.default_rng((self._seed, hash(shot) % 2**32))
        noise = rng.standard_normal(picture.shape, np.float32) * np.float32(self._noise)
        return np.clip(np.rint(picture * np.float32(Sensor.HEADROOM) + noise), 0, 255).astype(np.uint8)


def _turned(vectors: Floats, yaw: float) -> Floats:
    """Vectors (3, n) turned about the vertical."""
    cos, sin = np.float32(math.cos(yaw)), np.float32(math.sin(yaw))
    x, y, z = vectors
    return np.stack([cos * x - sin * y, sin * x + cos * y, z])


@dataclass(frozen=True, slots=True)
class _Slab:
    """A bar and where its flank is; `axis`: the one it lies across."""

    axis: int
    bar: Bar
    flank: Patch
    underside: Patch


class _Scene:
    """Finds the texels at which rays end; points and directions are (3, n), metres from the middle of the floor."""

    def __init__(self, world: World, atlas: Atlas) -> None:
        self._room, surfaces = world.room, world.surfaces
        self._size = np.array([self._room.width, self._room.depth], np.float32)
        self._ceiling = atlas.add(surfaces.ceiling, CEILING_SCALE)
        self._slabs = [slab for bars in surfaces.bars for slab in _slabs(bars, atlas)]
        self._recesses = [
            (r, atlas.add(r.top, CEILING_SCALE), atlas.add(r.sides, WALL_SCALE)) for r in surfaces.recesses
        ]
        self.walls = atlas.add(surfaces.walls, WALL_SCALE)

    def cast(self, eye: Floats, ray: Floats) -> Floats:
        """Atlas coordinates (2, n)."""
        reach, along = _meet_sides(self._size, eye[:2], ray[:2])
        down = self._room.height - (eye[2] + reach * ray[2])
        lowest = np.float32(
            self._room.height + WALL_FOOT
        )  # as in the fisheye's pictures, the foot stands for the floor
        texels = _texels(self.walls, along, np.minimum(down, lowest))
        above = np.flatnonzero(down < 0.0)
        reach[above] = (self._room.height - eye[2, above]) / ray[2, above]
        place = eye[:2, above] + reach[above] * ray[:2, above]
        texels[:, above] = _texels(self._ceiling, *(place + self._size[:, None] / 2))
        for recess, top, sides in self._recesses:
            self._enter(recess, (top, sides), above, place, ray, texels)
        for slab in self._slabs:
            self._strike(slab, eye, ray, reach, texels)
        return texels

    def _enter(
        self,
        recess: Recess,
        patches: tuple[Patch, Patch],
        above: np.ndarray,
        place: Floats,
        ray: Floats,
        texels: Floats,
    ) -> None:
        """Sends rays that meet the ceiling (those listed, at `place`) within the recess on into it."""
        first, last = np.array(recess.area, np.float32).reshape(2, 2, 1)
        inside = np.flatnonzero(((place > first) & (place < last)).all(axis=0))
        rays, start = above[inside], place[:, inside]
        slope = ray[:2, rays] / ray[2, rays]  # metres aside for each metre up
        up, along = _meet_sides(np.asarray((last - first)[:, 0], np.float32), start - (first + last) / 2, slope)
        top = start + slope * recess.depth - first
        strip = _texels(patches[1], along, recess.depth - up)
        texels[:, rays] = np.where(up < recess.depth, strip, _texels(patches[0], *top))

    def _strike(self, slab: _Slab, eye: Floats, ray: Floats, reach: Floats, texels: Floats) -> None:
        """Ends rays at a bar that is nearer than what they met, and shortens their `reach`."""
        bar, axis = slab.bar, slab.axis
        low, high = (np.float32(self._room.height - drop) for drop in (bar.bottom, bar.top))
        with np.errstate(divide="ignore"):
            across = [(np.float32(end) - eye[axis]) / ray[axis] for end in bar.span]
            upwards = [(level - eye[2]) / ray[2] for level in (low, high)]
        side, under = np.minimum(*across), np.minimum(*upwards)
        enters = np.maximum(side, under)
        leaves = np.minimum(np.maximum(*across), np.maximum(*upwards))
        rays = np.flatnonzero((enters < leaves) & (enters > 0.0) & (enters < reach))
        reach[rays] = enters[rays]
        at = eye[:, rays] + reach[rays] * ray[:, rays]
        flank = _texels(slab.flank, at[1 - axis] + self._size[1 - axis] / 2, at[2] - low)
        underside = _texels(slab.underside, *(at[:2] + self._size[:, None] / 2))
        texels[:, rays] = np.where(side[rays] > under[rays], flank, underside)


def _slabs(bars: Bars, atlas: Atlas) -> list[_Slab]:
    underside = atlas.add(bars.underside, CEILING_SCALE)
    axis = 0 if bars.along == "y" else 1
    return [_Slab(axis, bar, atlas.add(bar.flank, CEILING_SCALE), underside) for bar in bars.bars]


def _texels(patch: Patch, across: Floats, down: Floats) -> Floats:
    """Atlas coordinates (2, n) of places on a texture, metres from its first corner."""
    scale = np.float32(patch.scale)
    return np.stack([across * scale + np.float32(patch.column), down * scale + np.float32(patch.row)])


def _meet_sides(size: Floats, start: Floats, ray: Floats) -> tuple[Floats, Floats]:
    """Where rays (2, n) leave a rectangle round the origin: after how many lengths of themselves, and how far round its
    edge (m), counter-clockwise from the corner of smallest x and y."""
    half, (width, depth) = size[:, None] / 2, size
    with np.errstate(divide="ignore"):
        to_x, to_y = (np.copysign(half, ray) - start) / ray
    reach = np.minimum(to_x, to_y)
    x, y = start + reach * ray + half
    south_north = np.where(ray[1] < 0.0, x, 2 * width + depth - x)
    east_west = np.where(ray[0] > 0.0, width + y, 2 * (width + depth) - y)
    return reach, np.where(to_y < to_x, south_north, east_west)
