"""Where the rays of one picture end: each caster points those that meet its surface at its texture in the atlas.

Texture coordinates are complex numbers, column + i row, one for each listed ray: OpenCV reads them as pairs of
floats. Along one ray a lower hit is a nearer hit, so the height above the camera serves as depth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from tools.sim.atlas import Atlas, Patch
from tools.sim.lens import Floats, Image, Rays
from tools.sim.room import CEILING_SCALE, WALL_SCALE, Bar, Bars, Recess, Room, Sunlight

Complexes = NDArray[np.complex64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Eye:
    """The camera: metres from the room's centre, and its heading."""

    x: float
    y: float
    yaw: float

    def tangents(self, rays: Rays, which: slice | Indices) -> tuple[Floats, Floats]:
        """Metres (east, north) that these rays go for each metre they rise."""
        cos, sin = np.float32(math.cos(self.yaw)), np.float32(math.sin(self.yaw))
        ahead, left = rays.ahead[which], rays.left[which]
        return ahead * cos - left * sin, ahead * sin + left * cos


class Plane:
    """A horizontal plane `rise` m above the camera; its texture's corner is at `corner`."""

    def __init__(self, rays: Rays, atlas: Atlas, texture: Image, rise: float, corner: tuple[float, float]) -> None:
        self._patches = atlas.add_pyramid(texture, CEILING_SCALE)
        self._corner = corner
        self._reach = np.stack([rays.ahead * rise, rays.left * rise], axis=1).astype(np.float32)
        wanted = 2.0 * np.log2(CEILING_SCALE / np.maximum(rays.lens.seen_scale(rays.theta, rise), 1e-3))
        level = np.clip(np.rint(wanted), 0, len(self._patches) - 1).astype(np.intp)
        self._level = np.maximum.accumulate(level)  # rays of one ring differ a little: make every level a slice
        self._starts = np.searchsorted(self._level, np.arange(len(self._patches) + 1)).tolist()

    def cast(self, to: Complexes, eye: Eye) -> None:
        """Points the first len(to) rays at the plane."""
        cos, sin = math.cos(eye.yaw), math.sin(eye.yaw)
        turn = np.array([[cos, -sin, eye.x - self._corner[0]], [sin, cos, eye.y - self._corner[1]]])
        pairs = to.view(np.float32).reshape(1, -1, 2)
        for patch, start, end in zip(self._patches, self._starts, self._starts[1:], strict=False):
            stop = min(end, len(to))
            if start < stop:
                affine = turn * patch.scale
                affine[:, 2] += patch.column, patch.row
                cv2.transform(self._reach[None, start:stop], affine, dst=pairs[:, start:stop])

    def texels(self, rays: Indices, x: Floats, y: Floats) -> Complexes:
        """Atlas coordinates of the points (x, y) of the room, as sharp as those rays see them."""
        scale, column, row = np.array([(p.scale, p.column, p.row) for p in self._patches], np.float32).T
        level = self._level[rays]
        return _complex(
            (x - np.float32(self._corner[0])) * scale[level] + column[level],
            (y - np.float32(self._corner[1])) * scale[level] + row[level],
        )


class Walls:
    """The four walls of a room, found for each of a table of azimuths."""

    AZIMUTHS = 16384  # 0.1 px at the image's rim

    def __init__(self, rays: Rays, atlas: Atlas, texture: Image, room: Room) -> None:
        self._room, self.patch = room, atlas.add(texture, WALL_SCALE)
        step = 2.0 * math.pi / self.AZIMUTHS
        self._cos, self._sin = (f(np.arange(self.AZIMUTHS) * step).astype(np.float32) for f in (np.cos, np.sin))
        self._azimuth = np.rint(rays.bearing / step).astype(np.intp) % self.AZIMUTHS
        cot = 1.0 / np.tan(np.maximum(rays.theta, 1e-4))
        self._stretch = np.stack([np.ones_like(cot), cot], axis=1).astype(np.float32)

    def table(self, eye: Eye) -> Complexes:
        """For each azimuth: the column that it meets, and as imaginary part minus the texels to the wall."""
        half_width, half_depth = self._room.width / 2, self._room.depth / 2
        off = [half_depth + eye.y, half_width - eye.x, half_depth - eye.y, half_width + eye.x]  # from each wall
        facing = [(i - 1) * (math.pi / 2) - eye.yaw for i in range(4)]
        corners = [self._entry(facing[i] - math.atan2(off[i - 1], off[i])) for i in range(4)]
        out = np.empty((self.AZIMUTHS, 2), np.float32)
        for i, (start, _) in enumerate(self._room.walls):
            first, last = corners[i], corners[(i + 1) % 4]
            for part in (slice(first, last),) if first <= last else (slice(first, None), slice(0, last)):
                self._fill(out[part], part, facing[i], off[i], start + off[i - 1])
        return out.view(np.complex64)[:, 0]

    def _entry(self, angle: float) -> int:
        """The table's first entry at or after an angle."""
        return math.ceil(angle % (2.0 * math.pi) * (self.AZIMUTHS / (2.0 * math.pi)))

    def _fill(self, out: Floats, part: slice, facing: float, off: float, foot: float) -> None:
        """Entries that meet one wall, `off` m away at the bearing `facing`, whose foot is at `foot` of the strip."""
        cos, sin = np.float32(math.cos(facing)), np.float32(math.sin(facing))
        ahead = self._cos[part] * cos + self._sin[part] * sin
        left = self._sin[part] * cos - self._cos[part] * sin
        scale = np.float32(self.patch.scale)
        texels = np.divide(np.float32(-off) * scale, ahead, out=ahead)
        np.multiply(texels, left, out=left)
        np.subtract(np.float32(foot) * scale + np.float32(self.patch.column), left, out=out[:, 0])
        out[:, 1] = texels

    def cast(self, to: Complexes, table: Complexes, start: int) -> None:
        """Points len(to) rays from the `start`th on at the walls, as if nothing were in front of them."""
        stop = start + len(to)
        table.take(self._azimuth[start:stop], out=to, mode="clip")
        pairs = to.view(np.float32).reshape(-1, 2)
        np.multiply(pairs, self._stretch[start:stop], out=pairs)
        to += np.complex64(1j * self._row(0.0))

    def below(self, to: Complexes, height: Floats | float) -> NDArray[np.bool_]:
        """Which of the rays that `cast` pointed end lower than `height` above the camera."""
        return np.asarray(to.imag > self._row(height), np.bool_)

    def _row(self, height: Floats | float) -> Floats | float:
        return self.patch.row + self.patch.scale * self._room.rise - self.patch.scale * height


class SunPatch:
    """A slanting patch of sunlight painted over the walls in the atlas, where it is at a time."""

    _WIDTH = 1.2  # m
    _SLANT = 0.4  # m to the side from top to bottom
    _SPEED = 0.0004  # m/s: a quarter of a degree a minute seen from 5 m

    def __init__(self, sun: Sunlight, walls: Image, patch: Patch) -> None:
        self._sun, self._left = sun, round(patch.column + 0.5)
        self._rows = slice(*(round(edge * WALL_SCALE) for edge in (sun.top, sun.bottom)))
        row = round(patch.row + 0.5)
        self._target = slice(row + self._rows.start, row + self._rows.stop)
        self._shaded, self._sunny = walls[self._rows], sun.walls[self._rows]
        height, width = self._shaded.shape[0], round((self._WIDTH + self._SLANT) * WALL_SCALE)
        slant = round(self._SLANT * WALL_SCALE)
        lit = np.zeros((height, width), np.uint8)
        cv2.fillPoly(lit, [np.array([[0, 0], [width - slant, 0], [width, height], [slant, height]])], 1)
        self._lit, self._columns = lit.astype(np.bool_)[:, :, None], np.arange(0)

    def paint(self, atlas: Image, t: float) -> None:
        """Moves the patch in the atlas (H, W, 4) to where it is at `t` seconds."""
        first = round((self._sun.start + self._SPEED * t) * WALL_SCALE)
        columns = (first + np.arange(self._lit.shape[1])) % self._shaded.shape[1]
        if not np.array_equal(columns, self._columns):
            atlas[self._target, self._left + self._columns, :3] = self._shaded[:, self._columns]
            atlas[self._target, self._left + columns, :3] = np.where(
                self._lit, self._sunny[:, columns], self._shaded[:, columns]
            )
            self._columns = columns


class Coffer:
    """What is seen through the opening of a recess: its top, and the sides between the ceiling and the top."""

    def __init__(self, rays: Rays, atlas: Atlas, recess: Recess, rise: float) -> None:
        x0, y0, x1, y1 = recess.area
        self._centre = ((x0 + x1) / 2, (y0 + y1) / 2)
        self._size = (x1 - x0, y1 - y0)
        self._rise, self._high = np.float32(rise), np.float32(rise + recess.depth)
        self._rays = rays
        self._top = Plane(rays, atlas, recess.top, rise + recess.depth, (x0, y0))
        self._sides = atlas.add(recess.sides, WALL_SCALE)

    def cast(self, to: Complexes, eye: Eye) -> None:
        """Redirects those of the len(to) first rays that enter the recess."""
        east, north = eye.tangents(self._rays, slice(len(to)))
        x, y = np.float32(eye.x - self._centre[0]), np.float32(eye.y - self._centre[1])
        half_width, half_depth = (np.float32(size / 2) for size in self._size)
        enters = np.abs(east * self._rise + x) < half_width
        enters &= np.abs(north * self._rise + y) < half_depth
        rays = np.flatnonzero(enters)
        east, north = east[rays], north[rays]
        side, along = _meet_sides(*self._size, (x, y), east, north)
        top_x, top_y = (np.float32(c) + a * self._high for c, a in ((eye.x, east), (eye.y, north)))
        target = self._top.texels(rays, top_x, top_y)
        scale = np.float32(self._sides.scale)
        strip = _complex(along * scale + self._sides.column, (self._high - side) * scale + self._sides.row)
        to[rays] = np.where(side < self._high, strip, target)


class Lattice:
    """Bars of one direction: which face a ray meets depends on one number, the metres it goes across them for each
    metre it rises. For each eye a table over that number names the face: 0 none, 2i + 1 the underside of bar i, 2i + 2
    its flank.
    """

    _CELL = 5e-4  # of the table: 0.1 px at the zenith, finer elsewhere

    def __init__(self, rays: Rays, atlas: Atlas, bars: Bars, room: Room) -> None:
        self._rays, self._along_y = rays, bars.along == "y"
        length, width = (room.depth, room.width) if self._along_y else (room.width, room.depth)
        self._start = -length / 2
        self._spans = [bar.span for bar in bars.bars]
        self._low, self._high = ([room.rise - drop for drop in drops] for drops in _drops(bars.bars))
        self.lowest = min(self._low)
        self._steepest = width / self.lowest
        middle = sum(self._low) / len(self._low)
        self._underside = Plane(rays, atlas, bars.underside, middle, (-room.width / 2, -room.depth / 2))
        flanks = [atlas.add(bar.flank, CEILING_SCALE) for bar in bars.bars]
        self._columns = np.array([patch.column for patch in flanks], np.float32).repeat(2)
        self._rows = np.array([patch.row - CEILING_SCALE * low for patch, low in zip(flanks, self._low, strict=True)])
        self._rows = self._rows.astype(np.float32).repeat(2)

    def cast(self, to: Complexes, heights: Floats, eye: Eye) -> None:
        """Redirects those of the len(to) first rays that end on a bar, and lowers what `heights` says of them."""
        table, level, edge = self._faces(eye.x if self._along_y else eye.y)
        named = table.take(self._cells(eye, len(to)), mode="clip")
        rays = np.flatnonzero(named > 0)  # of bytes it takes five times as long
        face = named[rays].astype(np.intp) - 1
        east, north = eye.tangents(self._rays, rays)
        across = east if self._along_y else north
        height = level[face] + edge[face] / np.where(across == 0.0, np.float32(1.0), across)
        nearer = np.flatnonzero(height < heights[rays])  # not behind a bar of another direction
        rays, face, height = rays[nearer], face[nearer], height[nearer]
        heights[rays] = height
        x, y = east[nearer] * height + np.float32(eye.x), north[nearer] * height + np.float32(eye.y)
        under = self._underside.texels(rays, x, y)
        to[rays] = np.where(face % 2, self._flank(face, y if self._along_y else x, height), under)

    def _flank(self, face: Indices, along: Floats, height: Floats) -> Complexes:
        scale = np.float32(CEILING_SCALE)
        return _complex(
            (along - np.float32(self._start)) * scale + self._columns[face], height * scale + self._rows[face]
        )

    def _cells(self, eye: Eye, count: int) -> Indices:
        """The table's cell for each of the first `count` rays."""
        turn = eye.yaw if self._along_y else eye.yaw - math.pi / 2
        cells = self._rays.ahead[:count] * np.float32(math.cos(turn) / self._CELL)
        cells -= self._rays.left[:count] * np.float32(math.sin(turn) / self._CELL)
        cells += np.float32(self._steepest / self._CELL)
        return cells.astype(np.intp)

    def _faces(self, here: float) -> tuple[NDArray[np.uint8], Floats, Floats]:
        """The table seen from `here`, and each face's height: level + edge / across."""
        table = np.zeros(round(2 * self._steepest / self._CELL), np.uint8)
        level, edge = np.zeros((2, 2 * len(self._spans)), np.float32)
        nearest_last = sorted(range(len(self._spans)), key=lambda i: -abs(sum(self._spans[i]) / 2 - here))
        for i in nearest_last:
            low, high = self._low[i], self._high[i]
            start, stop = (end - here for end in self._spans[i])
            level[2 * i] = low
            self._paint(table, start / low, stop / low, 2 * i + 1)
            if start > 0:
                edge[2 * i + 1] = start
                self._paint(table, start / high, start / low, 2 * i + 2)
            elif stop < 0:
                edge[2 * i + 1] = stop
                self._paint(table, stop / low, stop / high, 2 * i + 2)
        return table, level, edge

    def _paint(self, table: NDArray[np.uint8], start: float, stop: float, face: int) -> None:
        first, last = (max(0, round((end + self._steepest) / self._CELL)) for end in (start, stop))
        table[first:last] = face


def _drops(bars: tuple[Bar, ...]) -> tuple[list[float], list[float]]:
    return [bar.bottom for bar in bars], [bar.top for bar in bars]


def _complex(columns: Floats, rows: Floats) -> Complexes:
    pairs = np.empty((len(columns), 2), np.float32)
    pairs[:, 0] = columns
    pairs[:, 1] = rows
    return pairs.view(np.complex64)[:, 0]


def _meet_sides(
    width: float, depth: float, start: tuple[float, float], east: Floats, north: Floats
) -> tuple[Floats, Floats]:
    """Where rays leave a rectangle centred on the origin: after how many steps (east, north) from `start`, and how far
    round its edge, counter-clockwise from the corner of smallest x and y."""
    x, y = (np.float32(at) for at in start)
    half_width, half_depth = np.float32(width / 2), np.float32(depth / 2)
    with np.errstate(divide="ignore"):
        to_x = (np.copysign(half_width, east) - x) / east
        to_y = (np.copysign(half_depth, north) - y) / north
    steps = np.minimum(to_x, to_y)
    hit_x, hit_y = x + steps * east, y + steps * north
    south_north = np.where(north < 0, half_width + hit_x, np.float32(1.5 * width + depth) - hit_x)
    east_west = np.where(east > 0, np.float32(width) + half_depth + hit_y, np.float32(2 * width + 1.5 * depth) - hit_y)
    return steps, np.where(to_y < to_x, south_north, east_west)
