"""Painting of a room's surfaces in linear light: what reflects (albedo), what shines on it, what glows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from tools.sim.lens import Image
from tools.sim.world import CEILING, CEILING_SCALE, HEADROOM, SIDE, WALL_FOOT, WALL_SCALE

Light = NDArray[np.float32]  # (H, W, 3) BGR, linear; 1 is a white surface in normal light
Area = tuple[float, float, float, float]

LIGHTS = ("nominal", "lamps_off", "half_lamps", "sun")
_GAMMA = 1 / 2.2
WARM = (0.86, 0.95, 1.0)


@dataclass(frozen=True, slots=True)
class Lamp:
    """A lamp in the ceiling: centre and size in metres; round where it has no height."""

    x: float
    y: float
    width: float
    height: float = 0.0
    on: bool = True

    @property
    def strength(self) -> float:
        return 0.35 + self.width * (self.height or self.width)


def switched(lamps: Sequence[Lamp], light: str) -> list[Lamp]:
    """The lamps as that lighting has them: all on, all off, or every second one."""
    if light not in LIGHTS:
        raise ValueError(f"light is {light!r}, expected one of {', '.join(LIGHTS)}")
    off = {"lamps_off": 1, "half_lamps": 2}.get(light, len(lamps) + 1)
    return [Lamp(a.x, a.y, a.width, a.height, on=(i + 1) % off != 0) for i, a in enumerate(lamps)]


def ceiling_canvas(albedo: Sequence[float] = (0.72, 0.76, 0.78)) -> Light:
    n = round(SIDE * CEILING_SCALE)
    return np.full((n, n, 3), albedo, np.float32)


def blotches(rng: np.random.Generator, shape: tuple[int, int], size: float, contrast: float) -> Light:
    """Soft noise (H, W, 1) about 1: features of `size` texels, standard deviation `contrast`."""
    small = [max(2, round(n / size) + 2) for n in shape]
    coarse = rng.standard_normal(small).astype(np.float32)
    smooth = cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(1.0 + smooth * (contrast / float(smooth.std())), np.float32)[:, :, None]


def box(canvas: Light, area: Area, value: Sequence[float] | float, scale: float) -> None:
    """Fills the rectangle (x0, y0, x1, y1), in metres."""
    c0, r0, c1, r1 = (max(0, round(edge * scale)) for edge in area)
    canvas[r0:r1, c0:c1] = value


def disc(canvas: Light, centre: tuple[float, float], radius: float, value: float | Sequence[float]) -> None:
    """Fills a circle on the ceiling, in metres from its corner."""
    colour = [value] * 3 if isinstance(value, float) else list(value)
    texel = [round((metres * CEILING_SCALE - 0.5) * 16) for metres in centre]
    cv2.circle(canvas, texel, round(radius * CEILING_SCALE * 16), colour, -1, cv2.LINE_8, 4)


def illumination(lamps: Sequence[Lamp], light: str, n: int, scale: float) -> Light:
    """Light (n, n, 3) that reaches the ceiling: from the floor and the lamps; sun adds a patch."""
    at = (np.arange(n, dtype=np.float32) + 0.5) / scale - SIDE / 2
    lit = np.full((n, n), 0.42 if any(a.on for a in lamps) else 0.2, np.float32)
    for lamp in lamps:
        if lamp.on:
            away = (at[None, :] - lamp.x) ** 2 + (at[:, None] - lamp.y) ** 2
            lit += 0.30 * lamp.strength / (1.0 + away / 0.35)
    out = cv2.merge([lit * c for c in WARM])
    if light == "sun":
        patch = np.zeros((n, n), np.float32)
        corners = (np.array([[0.5, 0.4], [2.1, 0.9], [1.8, 2.6], [0.3, 1.9]]) * scale).astype(np.int32)
        cv2.fillPoly(patch, [corners], 1.6)
        daylight = 0.5 * np.exp(-at[None, :] / 3.0 - 1.0) + np.zeros_like(lit)
        out += (cv2.GaussianBlur(patch, (0, 0), 0.06 * scale) + daylight)[:, :, None]
    return np.asarray(out, np.float32)


def add_lamps(ceiling: Light, lamps: Sequence[Lamp]) -> None:
    """Draws the lamps' housings, and their glass: bright, or grey where off. In place."""
    for lamp in lamps:
        x, y = lamp.x + SIDE / 2, lamp.y + SIDE / 2
        glass = (6.0, 6.6, 6.9) if lamp.on else (0.20, 0.21, 0.21)
        w, h = lamp.width / 2, lamp.height / 2
        if lamp.height:
            box(ceiling, (x - w - 0.03, y - h - 0.03, x + w + 0.03, y + h + 0.03), 0.16, CEILING_SCALE)
            box(ceiling, (x - w, y - h, x + w, y + h), glass, CEILING_SCALE)
        else:
            disc(ceiling, (x, y), w + 0.03, 0.16)
            disc(ceiling, (x, y), w, glass)


def glare(light: Light, scale: float) -> Light:
    """Light scattered in the lens around very bright places."""
    excess = np.maximum(light - 1.0, 0.0)
    halo = cv2.GaussianBlur(excess, (0, 0), 0.10 * scale) * 0.05 + cv2.GaussianBlur(excess, (0, 0), 0.3 * scale) * 0.02
    return np.asarray(light + halo, np.float32)


def develop(light: Light, exposure: float = 1.0) -> Image:
    """The texture (uint8) of linear light, with the room above white that the sensor expects."""
    grey = np.maximum(light * exposure, 0.0) ** _GAMMA * (228.0 / HEADROOM)
    return np.asarray(np.clip(np.rint(grey), 0, 255), np.uint8)


def exposure_of(lamps: Sequence[Lamp], light: str) -> float:
    """What the camera's automatic exposure makes up for: part of the lamps' absence, or of the sun."""
    lit = sum(a.on for a in lamps) / max(1, len(lamps))
    return 0.75 if light == "sun" else 1.0 + 0.6 * (1.0 - lit)


def walls(rng: np.random.Generator, light: str, lamps: Sequence[Lamp]) -> Light:
    """The strip of four walls, from the ceiling down past the floor's edge, in linear light."""
    rows, columns = round((CEILING + WALL_FOOT) * WALL_SCALE), round(4 * SIDE * WALL_SCALE)
    strip = np.empty((rows, columns, 3), np.float32)
    for i in range(4):
        tone = rng.uniform(0.35, 0.8) * np.array(WARM) * rng.uniform(0.85, 1.1, 3)
        box(strip, (i * SIDE, 0, (i + 1) * SIDE, CEILING + WALL_FOOT), tone.tolist(), WALL_SCALE)
    strip *= blotches(rng, (rows, columns), 12.0, 0.03)
    glow = np.zeros_like(strip)
    for i in range(4):
        _furnish(rng, strip, glow, i * SIDE, light)
    box(strip, (0, CEILING - 0.08, 4 * SIDE, CEILING), 0.2, WALL_SCALE)
    box(strip, (0, CEILING, 4 * SIDE, CEILING + WALL_FOOT), (0.12, 0.2, 0.28), WALL_SCALE)
    height = np.linspace(1.0, 0.55, rows, dtype=np.float32)[:, None, None]
    lit = 0.62 if any(a.on for a in lamps) else 0.3
    corner = np.abs(np.arange(columns, dtype=np.float32) / WALL_SCALE % SIDE - SIDE / 2) / (SIDE / 2)
    shade = height * (1.0 - 0.25 * corner**6)[None, :, None]
    return np.asarray(strip * shade * (lit + (0.3 if light == "sun" else 0.0)) + glow, np.float32)


def _furnish(rng: np.random.Generator, strip: Light, glow: Light, start: float, light: str) -> None:
    """Doors, windows, shelves and pictures in four bays of one wall; window panes shine."""
    kinds = rng.permutation(["door", "window", "shelf", "picture"])
    for bay, kind in enumerate(kinds):
        left = start + 0.25 + bay * (SIDE - 0.4) / 4 + rng.uniform(0.0, 0.3)
        colour = (rng.uniform(0.05, 0.6) * rng.uniform(0.4, 1.3, 3)).tolist()
        if kind == "door":
            box(strip, (left - 0.06, 0.62, left + 0.96, CEILING), 0.75, WALL_SCALE)
            box(strip, (left, 0.68, left + 0.9, CEILING), colour, WALL_SCALE)
        elif kind == "window":
            _window(strip, glow, left, rng.uniform(0.4, 0.7), 3.0 if light == "sun" else 1.2)
        elif kind == "shelf":
            _shelf(rng, strip, left, rng.uniform(0.5, 1.0))
        else:
            top = rng.uniform(0.6, 1.0)
            box(strip, (left - 0.03, top - 0.03, left + 0.73, top + 0.53), 0.08, WALL_SCALE)
            box(strip, (left, top, left + 0.7, top + 0.5), colour, WALL_SCALE)
            box(strip, (left + 0.1, top + 0.2, left + 0.4, top + 0.4), colour[::-1], WALL_SCALE)


def _window(strip: Light, glow: Light, left: float, top: float, brightness: float) -> None:
    box(strip, (left - 0.05, top - 0.05, left + 1.15, top + 1.25), 0.8, WALL_SCALE)
    for pane in (0.0, 0.57):
        area = (left + pane, top, left + pane + 0.53, top + 1.2)
        box(strip, area, 0.0, WALL_SCALE)
        box(glow, area, (brightness, brightness * 0.9, brightness * 0.8), WALL_SCALE)


def _shelf(rng: np.random.Generator, strip: Light, left: float, top: float) -> None:
    box(strip, (left, top, left + 1.0, CEILING), 0.1, WALL_SCALE)
    for board in np.arange(top + 0.05, CEILING - 0.35, 0.36):
        edge = left + 0.04
        while edge < left + 0.9:
            width, height = rng.uniform(0.03, 0.09), rng.uniform(0.18, 0.3)
            colour = rng.uniform(0.05, 0.7, 3).tolist()
            box(strip, (edge, board + 0.31 - height, edge + width, board + 0.31), colour, WALL_SCALE)
            edge += width + 0.012
