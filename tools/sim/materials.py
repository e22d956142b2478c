"""What ceilings are made of: mineral tiles, plaster, boards, metal panels, concrete; albedos to light later."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tools.sim import paint
from tools.sim.paint import Light
from tools.sim.room import CEILING_SCALE, Room

TILE = 0.6  # m, the grid of suspended ceilings
T_BAR = 0.024


def tiled(rng: np.random.Generator, room: Room) -> Light:
    """Speckled mineral tiles of slightly different tone, a few with water stains, between metal bars."""
    albedo = paint.ceiling_canvas(room)
    shape, step = albedo.shape[:2], round(TILE * CEILING_SCALE)
    speckle = (rng.random((*shape, 1)) < 0.03).astype(np.float32)
    albedo *= 1.0 - 0.35 * speckle
    albedo *= paint.blotches(rng, shape, 4.0, 0.015)
    for row in range(0, shape[0], step):
        for column in range(0, shape[1], step):
            albedo[row : row + step, column : column + step] *= rng.normal(1.0, 0.025)
    for _ in range(5):
        stain(rng, albedo)
    bar = round(T_BAR * CEILING_SCALE / 2)
    for axis in (0, 1):
        for edge in range(0, shape[axis] + 1, step):
            np.moveaxis(albedo, axis, 0)[max(0, edge - bar) : edge + bar] = 0.42
    return albedo


def stain(rng: np.random.Generator, albedo: Light) -> None:
    """A brownish ring with a frayed edge, where water dried. In place."""
    shape = albedo.shape[:2]
    depth, width = (n / CEILING_SCALE for n in shape)
    x, y = rng.uniform(0.5, width - 0.5), rng.uniform(0.5, depth - 0.5)
    across, along = ((np.arange(n, dtype=np.float32) + 0.5) / CEILING_SCALE for n in shape[::-1])
    away = np.hypot(across[None, :] - x, (along[:, None] - y) * rng.uniform(0.7, 1.4))
    frayed = away * paint.blotches(rng, shape, 8.0, 0.06)[:, :, 0] / rng.uniform(0.12, 0.28)
    wet = np.exp(-(((frayed - 0.85) / 0.18) ** 2)) + 0.4 * (frayed < 0.85)
    albedo *= 1.0 - 0.45 * wet[:, :, None] * np.array([1.0, 0.75, 0.5], np.float32)


def vent(albedo: Light, left: float, top: float, size: float = TILE) -> None:
    """An air outlet: concentric slots in a square, metres from the ceiling's corner. In place."""
    for i, margin in enumerate(np.arange(0.05, 0.47 * size, 0.028)):
        slot = (left + margin, top + margin, left + size - margin, top + size - margin)
        paint.box(albedo, slot, 0.12 if i % 2 else 0.6)


def plaster(rng: np.random.Generator, room: Room) -> Light:
    """White plaster with faint marks of the trowel."""
    albedo = paint.ceiling_canvas(room, (0.76, 0.79, 0.80))
    for size, contrast in ((90.0, 0.02), (14.0, 0.012), (3.0, 0.015)):
        albedo *= paint.blotches(rng, paint.ceiling_shape(room), size, contrast)
    return albedo


def detector(albedo: Light, x: float, y: float) -> None:
    """A smoke detector, metres from the ceiling's corner. In place."""
    paint.disc(albedo, (x, y), 0.07, 0.35)
    paint.disc(albedo, (x, y), 0.055, 0.85)


def boards(rng: np.random.Generator, room: Room, width: float) -> Light:
    """Wooden boards along y of different tone and length, with dark joints."""
    albedo = paint.wood(rng, paint.ceiling_shape(room), (0.22, 0.36, 0.52))
    for x in np.arange(0.0, room.width, width):
        for low, high in _lengths(rng, room.depth):
            board = np.s_[round(low * 100) : round(high * 100), round(x * 100) : round((x + width) * 100)]
            albedo[board] *= rng.normal(1.0, 0.12)
            paint.box(albedo, (x, high - 0.006, x + width, high + 0.006), 0.05)
            if rng.random() < 0.5:
                _knot(rng, albedo, x + width * rng.uniform(0.3, 0.7), rng.uniform(low, high))
        paint.box(albedo, (x - 0.008, 0.0, x + 0.008, room.depth), 0.04)
    return albedo


def _lengths(rng: np.random.Generator, total: float) -> Iterator[tuple[float, float]]:
    """Where boards of 1 to 2.4 m begin and end until `total` is covered."""
    start = -rng.uniform(0.0, 0.9)
    while start < total:
        stop = start + rng.uniform(1.0, 2.4)
        yield max(0.0, start), stop
        start = stop


def _knot(rng: np.random.Generator, albedo: Light, x: float, y: float) -> None:
    paint.disc(albedo, (x, y), rng.uniform(0.008, 0.02), (0.07, 0.13, 0.22))


def panels(rng: np.random.Generator, room: Room, size: tuple[float, float]) -> Light:
    """Perforated metal panels (width, depth), with narrow joints and hardly any difference of tone."""
    albedo = paint.ceiling_canvas(room, (0.70, 0.71, 0.71))
    shape = paint.ceiling_shape(room)
    albedo[::4, ::4] *= 0.75
    albedo *= paint.blotches(rng, shape, 60.0, 0.012)
    for x in np.arange(0.0, room.width, size[0]):
        for y in np.arange(0.0, room.depth, size[1]):
            area = np.s_[round(y * 100) : round((y + size[1]) * 100), round(x * 100) : round((x + size[0]) * 100)]
            albedo[area] *= rng.normal(1.0, 0.02)
            paint.box(albedo, (x, y - 0.006, x + size[0], y + 0.006), 0.3)
        paint.box(albedo, (x - 0.008, 0.0, x + 0.008, room.depth), 0.25)
    return albedo


def concrete(rng: np.random.Generator, room: Room) -> Light:
    """Grey concrete: cloudy, with the joints of the formwork, pores and a few stains."""
    albedo = paint.ceiling_canvas(room, (0.36, 0.38, 0.39))
    shape = paint.ceiling_shape(room)
    for size, contrast in ((120.0, 0.08), (25.0, 0.05), (4.0, 0.04)):
        albedo *= paint.blotches(rng, shape, size, contrast)
    for x in np.arange(rng.uniform(0.2, 1.0), room.width, 1.25):
        paint.box(albedo, (x, 0.0, x + 0.012, room.depth), 0.24)
    for y in np.arange(rng.uniform(0.2, 2.0), room.depth, 2.5):
        paint.box(albedo, (0.0, y, room.width, y + 0.012), 0.24)
    for _ in range(150):
        pore = (rng.uniform(0.0, room.width), rng.uniform(0.0, room.depth))
        paint.disc(albedo, pore, rng.uniform(0.005, 0.015), 0.2)
    for _ in range(3):
        stain(rng, albedo)
    return albedo


def repeated(rng: np.random.Generator, room: Room, pitch: float, start: tuple[float, float]) -> Light:
    """Three by three tiles, all alike, again and again every `pitch` m (whole centimetres) from `start`."""
    n = round(pitch * CEILING_SCALE)
    third = n // 3
    cell = np.full((n, n, 3), (0.72, 0.76, 0.78), np.float32)
    speckle = np.ones((n, n, 1), np.float32) - 0.35 * (rng.random((n, n, 1)) < 0.03)
    cell *= speckle
    for edge in (0, third, 2 * third):
        cell[edge : edge + 2] = 0.42
        cell[:, edge : edge + 2] = 0.42
    rows, columns = paint.ceiling_shape(room)
    first = [
        round((at + half) * CEILING_SCALE) % n for at, half in zip(start, (room.width / 2, room.depth / 2), strict=True)
    ]
    tiled_cells = np.tile(cell, (rows // n + 2, columns // n + 2, 1))
    return tiled_cells[n - first[1] : n - first[1] + rows, n - first[0] : n - first[0] + columns].astype(np.float32)
