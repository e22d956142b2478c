"""The light in a simulated room: which lamps burn, what reaches ceiling and walls, what the camera makes of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tools.sim.lens import Floats, Sensor
from tools.sim.paint import Light, box, ceiling_shape, disc
from tools.sim.room import CEILING_SCALE, WALL_FOOT, WALL_SCALE, Room

LIGHTS = ("nominal", "lamps_off", "half_lamps", "sun", "night")
WARM = (0.86, 0.95, 1.0)
_SUN_PATCH = ((0.08, 0.07), (0.35, 0.15), (0.30, 0.43), (0.05, 0.32))  # corners, shares of width and depth


@dataclass(frozen=True, slots=True)
class Lamp:
    """A lamp in the ceiling: centre and size in metres, from the room's centre; round where it has no height."""

    x: float
    y: float
    width: float
    height: float = 0.0
    on: bool = True

    @property
    def strength(self) -> float:
        return 0.35 + self.width * (self.height or self.width)


@dataclass(frozen=True, slots=True)
class Openings:
    """Where light enters: points (x, y) at the foot of windows, of the door to a lit corridor, of a standing lamp."""

    windows: tuple[tuple[float, float], ...]
    door: tuple[float, float]
    standing_lamp: tuple[float, float]


class Lighting:
    """One of LIGHTS in a room: linear light on surfaces, and the camera's exposure and noise in it.

    `burning` is the share of the lamps that are on. Raises ValueError for a name that is none of them.
    """

    def __init__(self, name: str, lamps: Sequence[Lamp], room: Room, openings: Openings) -> None:
        if name not in LIGHTS:
            raise ValueError(f"light is {name!r}, expected one of {', '.join(LIGHTS)}")
        self.name, self.room, self.openings = name, room, openings
        every = {"lamps_off": 1, "night": 1, "half_lamps": 2}.get(name, len(lamps) + 1)
        self.lamps = [replace(lamp, on=(i + 1) % every != 0) for i, lamp in enumerate(lamps)]
        self.burning = sum(lamp.on for lamp in self.lamps) / max(1, len(lamps))

    @property
    def exposure(self) -> float:
        """What automatic exposure makes up for: part of the lamps' absence or of the sun; by night, all it can."""
        if self.name == "night":
            return 4.0
        return 0.75 if self.name == "sun" else 1.0 + 0.6 * (1.0 - self.burning)

    @property
    def noise(self) -> float:
        """Of the sensor, grey values: by night the gain is at its limit."""
        return Sensor.NOISE * (2.5 if self.name == "night" else 1.0)

    @property
    def panes(self) -> float:
        """How bright windows are, seen from inside."""
        return {"sun": 3.0, "night": 0.004}.get(self.name, 1.2)

    @property
    def corridor(self) -> float:
        """How bright the open door to the corridor is; by day that is not worth showing."""
        return 0.12 if self.name == "night" else 0.0

    def on_ceiling(self) -> Light:
        """Light (H, W, 3) that reaches the ceiling from the floor, lamps, windows, the sun's reflection."""
        x, y = _texel_centres(self.room)
        lit = np.full((len(y), len(x)), 0.42 if self.burning == 1.0 else 0.1 + 0.25 * self.burning, np.float32)
        if self.name == "night":
            lit[:] = 0.010
            lit += _fall(x[None, :], y[:, None], self.openings.door, 0.06, 0.8) + _fall(
                x[None, :], y[:, None], self.openings.standing_lamp, 0.45, 0.3
            )
        for lamp in self.lamps:
            if lamp.on:
                lit += _fall(x[None, :], y[:, None], (lamp.x, lamp.y), 0.30 * lamp.strength, 0.35)
        if self.name == "lamps_off":
            lit += sum(_fall(x[None, :], y[:, None], window, 0.30, 1.2) for window in self.openings.windows)
        if self.name == "sun":
            lit += self._sunshine(x)
        return np.asarray(cv2.merge([lit * c for c in WARM]), np.float32)

    def on_walls(self) -> Light:
        """Light (H, W, 1) that reaches the strip of walls, darker towards the floor and the corners."""
        rows, columns = strip_shape(self.room)
        level = np.full(columns, 0.3 + 0.32 * (self.burning > 0), np.float32)
        if self.name == "night":
            x, y = strip_points(self.room, (np.arange(columns) + 0.5) / WALL_SCALE)
            level = (
                0.02 + _fall(x, y, self.openings.standing_lamp, 0.5, 0.3) + _fall(x, y, self.openings.door, 0.03, 1.0)
            )
        if self.name == "sun":
            level += 0.3
        shade = np.ones(columns, np.float32)
        for start, length in self.room.walls:
            part = slice(round(start * WALL_SCALE), round((start + length) * WALL_SCALE))
            off_middle = np.abs(np.arange(part.stop - part.start) / (WALL_SCALE * length / 2) - 1.0)
            shade[part] -= 0.25 * off_middle**6
        height = np.linspace(1.0, 0.55, rows, dtype=np.float32)
        return np.asarray((height[:, None] * (shade * level)[None, :])[:, :, None], np.float32)

    def _sunshine(self, x: Floats) -> Floats:
        """The sun thrown onto the ceiling by something that shines, and more daylight on that side."""
        height, width = round(self.room.depth * CEILING_SCALE), len(x)
        patch = np.zeros((height, width), np.float32)
        corners = (np.array(_SUN_PATCH) * (width, height)).astype(np.int32)
        cv2.fillPoly(patch, [corners], 1.6)
        return cv2.GaussianBlur(patch, (0, 0), 0.06 * CEILING_SCALE) + np.float32(0.5) * np.exp(-x / 3.0 - 1.0)


def lit_ceiling(albedo: Light, lit: Light, lighting: Lighting) -> Light:
    """What the ceiling sends down under the light `lit`, with the lamps, bright or dark."""
    room, off = lighting.room, albedo.copy()
    for lamp in lighting.lamps:
        if not lamp.on:
            _draw(off, lamp, room, (0.50, 0.52, 0.52), 0.35)
    ceiling = off * lit
    for lamp in lighting.lamps:
        if lamp.on:
            _draw(ceiling, lamp, room, (6.0, 6.6, 6.9), 0.16)
    return ceiling


def _draw(ceiling: Light, lamp: Lamp, room: Room, glass: tuple[float, ...], housing: float) -> None:
    """A lamp's housing, and its glass inside that. In place."""
    x, y = lamp.x + room.width / 2, lamp.y + room.depth / 2
    w, h = lamp.width / 2, lamp.height / 2
    if lamp.height:
        box(ceiling, (x - w - 0.03, y - h - 0.03, x + w + 0.03, y + h + 0.03), housing)
        box(ceiling, (x - w, y - h, x + w, y + h), glass)
    else:
        disc(ceiling, (x, y), w + 0.03, housing)
        disc(ceiling, (x, y), w, glass)


def strip_shape(room: Room) -> tuple[int, int]:
    """(rows, columns) of the walls' texture."""
    return round((room.height + WALL_FOOT) * WALL_SCALE), round(room.perimeter * WALL_SCALE)


def strip_points(room: Room, along: Floats) -> tuple[Floats, Floats]:
    """(x, y) of the points `along` m from the start of the strip of walls."""
    corners = [0.0, *(start + length for start, length in room.walls)]
    x = np.interp(along, corners, np.array([-1, 1, 1, -1, -1]) * room.width / 2)
    y = np.interp(along, corners, np.array([-1, -1, 1, 1, -1]) * room.depth / 2)
    return x.astype(np.float32), y.astype(np.float32)


def _texel_centres(room: Room) -> tuple[Floats, Floats]:
    """x of the ceiling's columns and y of its rows."""
    rows, columns = ceiling_shape(room)
    x, y = ((np.arange(n, dtype=np.float32) + 0.5) / CEILING_SCALE for n in (columns, rows))
    return x - np.float32(room.width / 2), y - np.float32(room.depth / 2)


def _fall(x: Floats, y: Floats, source: tuple[float, float], strength: float, core: float) -> Floats:
    """Light of a source at the points (x, y): `strength` beside it, half of that sqrt(core) m away."""
    away = (x - np.float32(source[0])) ** 2 + (y - np.float32(source[1])) ** 2
    return np.asarray(strength / (1.0 + away / core), np.float32)
