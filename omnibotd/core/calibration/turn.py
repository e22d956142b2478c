"""A turn on the spot as a camera sees it: where everything seen round the robot appears in each picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from omnibotd.core.calibration.panorama import Floats, Grid
from omnibotd.core.vision.camera_model import CameraModel

# Steps of the numeric derivatives (rad): small against what bends, large against rounding.
_STEP = 1e-3
# Wide enough that no ray of the grid is lost beyond it.
_WIDE = 0.5
# Walls stand a little nearer than the ceiling is high: what is assumed of the depth before it is measured.
_WALL_NEARNESS = 0.6


@dataclass(frozen=True, slots=True)
class Turn:
    """The camera, and how it went round; lengths in ceiling heights.

    `heading` (n,) rad, the first 0, not wrapped; `rate` (n,) rad/s. The camera stands at `offset` (2,) in the base's
    axes from the turning point, which itself wanders by `drift` (n, 2). `nearness` of each block is 1 / its distance.
    `shutter` is the time from one row of the picture being taken to the next: the robot turns meanwhile.
    """

    camera: CameraModel
    heading: Floats
    rate: Floats
    offset: Floats
    drift: Floats
    nearness: Floats
    shutter: float = 0.0

    @classmethod
    def start(cls, camera: CameraModel, grid: Grid, heading: Floats, rate: Floats) -> Turn:
        """With nothing known but the headings."""
        nearness = expected_nearness(grid)
        return cls(camera, heading, rate, np.zeros(2), np.zeros((len(heading), 2)), nearness)

    def pixels(self, k: int, zenith: Floats, bearing: Floats, nearness: Floats) -> Floats:
        """Where (..., 2) the k-th picture shows what lies in these directions of the world."""
        camera = replace(self.camera, fov=self.camera.fov + _WIDE)
        early = camera.project(self._rays(k, zenith, bearing, nearness))
        if self.shutter == 0.0:
            return early
        turned = self.shutter * self.rate[k] * (early[..., 1] - camera.cy)
        return camera.project(self._rays(k, zenith, bearing - turned, nearness))

    def standpoint(self, k: int) -> Floats:
        """(2,) the camera's place in the base's axes, the mean turning point being the origin."""
        c, s = math.cos(self.heading[k]), math.sin(self.heading[k])
        return np.asarray(self.offset + np.array([[c, s], [-s, c]]) @ self.drift[k])

    def _rays(self, k: int, zenith: Floats, bearing: Floats, nearness: Floats) -> Floats:
        """In the base frame, from the camera; of any length."""
        relative, at = bearing - self.heading[k], self.standpoint(k)
        x = np.sin(zenith) * np.cos(relative) - nearness * at[0]
        y = np.sin(zenith) * np.sin(relative) - nearness * at[1]
        return np.stack([x, y, np.broadcast_to(np.cos(zenith), x.shape)], -1)


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """How the direction of what a block shows changes with what is assumed: radians along (bearing, zenith angle).

    `mount` (n, blocks, 2, 7): with centre (px), tilt, offset and shutter; `look` (n, blocks, 2, 3): with the look's
    heading and drift; `nearness` (n, blocks, 2): with the block's.
    """

    mount: Floats
    look: Floats
    nearness: Floats

    @classmethod
    def of(cls, turn: Turn, grid: Grid) -> Sensitivity:
        each = [_of_look(turn, grid, k) for k in range(len(turn.heading))]
        mount, look, nearness = (np.stack(part) for part in zip(*each, strict=True))
        return cls(mount, look, nearness)

    def relative_to_mean(self) -> Sensitivity:
        """Where pictures are compared with the mean of all: what moves all alike shows nowhere."""
        return Sensitivity(self.mount - self.mount.mean(0), self.look, self.nearness - self.nearness.mean(0))

    def relative_to(self, references: Sequence[Sequence[int]]) -> Sensitivity:
        """Where each picture is compared with the mean of some others."""
        mount = np.stack([self.mount[k] - self.mount[list(r)].mean(0) for k, r in enumerate(references)])
        return Sensitivity(mount, self.look, self.nearness)


def expected_nearness(grid: Grid) -> Floats:
    """(blocks,) of a flat ceiling, and walls beyond it."""
    zenith, _ = grid.blocks()
    return np.maximum(np.cos(zenith), _WALL_NEARNESS)


def _of_look(turn: Turn, grid: Grid, k: int) -> tuple[Floats, Floats, Floats]:
    zenith, bearing = grid.blocks()
    pixels = turn.pixels(k, zenith, bearing, turn.nearness)
    per_radian = _pixels_per_radian(turn, k, zenith, bearing)
    tilts = np.stack([_moved_by_tilt(turn, k, zenith, bearing, axis) for axis in (0, 1)], -1)
    centres = np.broadcast_to(np.eye(2), tilts.shape)
    # The pixel stays: what is assumed of the camera moves the direction that it stands for the other way.
    camera = -np.linalg.solve(per_radian, np.concatenate([centres, tilts], -1))
    relative = bearing - turn.heading[k]
    turned = np.stack([np.sin(zenith), np.zeros_like(zenith)], -1)
    parallax = turn.nearness[:, None, None] * _tangents(zenith, relative)
    c, s = math.cos(turn.heading[k]), math.sin(turn.heading[k])
    drift = parallax @ np.array([[c, s], [-s, c]])
    shutter = turned * (turn.rate[k] * (pixels[:, 1] - turn.camera.cy))[:, None]
    mount = np.concatenate([camera, parallax, shutter[..., None]], -1)
    look = np.concatenate([turned[..., None], drift], -1)
    return mount, look, _tangents(zenith, relative) @ turn.standpoint(k)


def _tangents(zenith: Floats, bearing: Floats) -> Floats:
    """(blocks, 2, 2): along bearing and zenith angle, the horizontal parts of unit steps over the sphere."""
    s, c = np.sin(bearing), np.cos(bearing)
    return np.stack([np.stack([-s, c], -1), np.cos(zenith)[:, None] * np.stack([c, s], -1)], -2)


def _pixels_per_radian(turn: Turn, k: int, zenith: Floats, bearing: Floats) -> Floats:
    """(blocks, 2, 2) columns and rows of the picture for each radian along bearing and zenith angle."""
    across = _STEP / np.sin(zenith)
    along = turn.pixels(k, zenith, bearing + across, turn.nearness)
    along = along - turn.pixels(k, zenith, bearing - across, turn.nearness)
    down = turn.pixels(k, zenith + _STEP, bearing, turn.nearness)
    down = down - turn.pixels(k, zenith - _STEP, bearing, turn.nearness)
    return np.stack([along, down], -1) / (2.0 * _STEP)


def _moved_by_tilt(turn: Turn, k: int, zenith: Floats, bearing: Floats, axis: int) -> Floats:
    """(blocks, 2) pixels for each radian of tilt about one axis."""
    step = np.eye(2)[axis] * _STEP
    more, less = (
        replace(turn, camera=replace(turn.camera, tilt=tuple(turn.camera.tilt + sign * step))) for sign in (1.0, -1.0)
    )
    moved = more.pixels(k, zenith, bearing, turn.nearness) - less.pixels(k, zenith, bearing, turn.nearness)
    return np.asarray(moved / (2.0 * _STEP))
