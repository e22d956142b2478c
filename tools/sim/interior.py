"""The walls of a simulated room: one strip of doors, windows, shelves, pictures and other things that stand there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from tools.sim.lighting import WARM, Lighting, Openings, strip_points, strip_shape
from tools.sim.paint import Light, blotches, box
from tools.sim.room import WALL_FOOT, WALL_SCALE, Room

USUAL = ("door", "window", "shelf", "picture")
_BAY = 1.4  # m that a piece of furniture needs


@dataclass
class Interior:
    """A strip under construction: what it reflects, which texels are panes or the way to the corridor, and where."""

    room: Room
    strip: Light
    panes: Light
    corridor: Light
    windows: list[float] = field(default_factory=list)  # m along the strip
    doors: list[float] = field(default_factory=list)

    @property
    def openings(self) -> Openings:
        """The standing lamp is in the south-east corner; where there is no door, light comes from the south-west."""
        points = [strip_points(self.room, np.array(at, np.float32)) for at in (self.windows, self.doors[:1] or [0.0])]
        windows, (door,) = (tuple((float(x), float(y)) for x, y in zip(*xy, strict=True)) for xy in points)
        return Openings(windows, door, (self.room.width / 2 - 0.4, 0.4 - self.room.depth / 2))

    def box(self, area: tuple[float, float, float, float], colour: Sequence[float] | float) -> None:
        """Fills (left, top, right, bottom), metres along the strip and below the ceiling."""
        box(self.strip, area, colour, WALL_SCALE)

    def lit(self, lighting: Lighting) -> Light:
        """The strip in that light, with shining windows and, by night, the lit corridor."""
        shining = (
            self.panes * (lighting.panes * np.array((1.0, 0.9, 0.8), np.float32)) + self.corridor * lighting.corridor
        )
        return np.asarray(self.strip * lighting.on_walls() + shining, np.float32)


def furnished(rng: np.random.Generator, room: Room, kinds: Sequence[str] = USUAL) -> Interior:
    """Walls of four tones; along each stand as many of `kinds`, in random order, as there is room for."""
    rows, columns = strip_shape(room)
    strip = np.empty((rows, columns, 3), np.float32)
    for start, length in room.walls:
        tone = rng.uniform(0.35, 0.8) * np.array(WARM) * rng.uniform(0.85, 1.1, 3)
        box(strip, (start, 0, start + length, room.height + WALL_FOOT), tone.tolist(), WALL_SCALE)
    strip *= blotches(rng, (rows, columns), 12.0, 0.03)
    none = np.zeros((rows, columns, 1), np.float32)
    interior = Interior(room, strip, none, none.copy())
    for start, length in room.walls:
        chosen = rng.permutation(list(kinds))[: round((length - 0.4) / _BAY)]
        for bay, kind in enumerate(chosen):
            left = start + 0.25 + bay * (length - 0.4) / len(chosen) + rng.uniform(0.0, 0.3)
            colour = (rng.uniform(0.05, 0.6) * rng.uniform(0.4, 1.3, 3)).tolist()
            _PIECES[kind](rng, interior, left, colour)
    interior.box((0, room.height - 0.08, room.perimeter, room.height), 0.2)
    interior.box((0, room.height, room.perimeter, room.height + WALL_FOOT), (0.12, 0.2, 0.28))
    return interior


def _door(rng: np.random.Generator, interior: Interior, left: float, colour: Sequence[float]) -> None:
    top, floor = interior.room.height - 2.02, interior.room.height
    interior.box((left - 0.06, top - 0.06, left + 0.96, floor), 0.75)
    interior.box((left, top, left + 0.9, floor), colour)
    if not interior.doors:
        box(interior.corridor, (left, top, left + 0.9, floor), 1.0, WALL_SCALE)
    interior.doors.append(left + 0.45)


def _window(rng: np.random.Generator, interior: Interior, left: float, colour: Sequence[float]) -> None:
    top = rng.uniform(0.4, 0.7)
    interior.box((left - 0.05, top - 0.05, left + 1.15, top + 1.25), 0.8)
    for pane in (left, left + 0.57):
        _pane(interior, (pane, top, pane + 0.53, top + 1.2))
    interior.windows.append(left + 0.55)


def _curtains(rng: np.random.Generator, interior: Interior, left: float, colour: Sequence[float]) -> None:
    """A window with folded curtains drawn to its sides."""
    top, foot = 0.35, interior.room.height - 0.5
    _pane(interior, (left + 0.3, top + 0.05, left + 1.0, foot - 0.4))
    for side in (left, left + 0.95):
        for fold in range(6):
            shade = rng.uniform(0.6, 1.3)
            edge = side + 0.06 * fold
            interior.box((edge, top, edge + 0.06, foot), [shade * c for c in colour])
            box(interior.panes, (edge, top, edge + 0.06, foot), 0.0, WALL_SCALE)
    interior.box((left - 0.05, top - 0.05, left + 1.36, top), 0.1)
    interior.windows.append(left + 0.65)


def _pane(interior: Interior, area: tuple[float, float, float, float]) -> None:
    interior.box(area, 0.0)
    box(interior.panes, area, 1.0, WALL_SCALE)


def _shelf(rng: np.random.Generator, interior: Interior, left: float, colour: Sequence[float]) -> None:
    top, floor = rng.uniform(0.5, 1.0), interior.room.height
    interior.box((left, top, left + 1.0, floor), 0.1)
    for board in np.arange(top + 0.05, floor - 0.35, 0.36):
        edge = left + 0.04
        while edge < left + 0.9:
            width, height = rng.uniform(0.03, 0.09), rng.uniform(0.18, 0.3)
            book = rng.uniform(0.05, 0.7, 3).tolist()
            interior.box((edge, board + 0.31 - height, edge + width, board + 0.31), book)
            edge += width + 0.012


def _picture(rng: np.random.Generator, interior: Interior, left: float, colour: Sequence[float]) -> None:
    top = rng.uniform(0.6, 1.0)
    interior.box((left - 0.03, top - 0.03, left + 0.73, top + 0.53), 0.08)
    interior.box((left, top, left + 0.7, top + 0.5), colour)
    interior.box((left + 0.1, top + 0.2, left + 0.4, top + 0.4), colour[::-1])


def _cupboard(rng: np.random.Generator, interior: Interior, left: float, colour: Sequence[float]) -> None:
    """Doors of one colour with handles, some boxes on top."""
    floor = interior.room.height
    top, doors = floor - rng.uniform(1.2, 2.0), int(rng.integers(2, 4))
    for i in range(doors):
        edge = left + 0.42 * i
        interior.box((edge, top, edge + 0.41, floor), colour)
        interior.box((edge + 0.35, top + 0.5, edge + 0.37, top + 0.65), 0.05)
    for i in range(int(rng.integers(0, 3))):
        edge, tall = left + 0.05 + 0.4 * i, rng.uniform(0.1, 0.3)
        interior.box((edge, top - tall, edge + 0.32, top), (rng.uniform(0.1, 0.6) * np.array((0.5, 0.8, 1.0))).tolist())


def _whiteboard(rng: np.random.Generator, interior: Interior, left: float, colour: Sequence[float]) -> None:
    top = interior.room.height - 2.0
    interior.box((left - 0.03, top - 0.03, left + 1.23, top + 0.93), 0.3)
    interior.box((left, top, left + 1.2, top + 0.9), 0.85)
    for _ in range(8):
        x, y = left + rng.uniform(0.05, 0.7), top + rng.uniform(0.05, 0.8)
        interior.box((x, y, x + rng.uniform(0.1, 0.4), y + 0.02), colour)


def _plant(rng: np.random.Generator, interior: Interior, left: float, colour: Sequence[float]) -> None:
    """Leaves over a pot."""
    floor, middle = interior.room.height, left + 0.4
    interior.box((middle - 0.18, floor - 0.4, middle + 0.18, floor), (0.2, 0.3, 0.55))
    for _ in range(140):
        x, y = middle + rng.normal(0.0, 0.17), floor - 0.95 + rng.normal(0.0, 0.2)
        green = rng.uniform(0.04, 0.2)
        interior.box((x, y, x + 0.09, y + 0.06), (0.4 * green, green, 0.6 * green))


def _radiator(rng: np.random.Generator, interior: Interior, left: float, colour: Sequence[float]) -> None:
    """Ribs, and a poster above."""
    floor = interior.room.height
    for edge in np.arange(left, left + 0.9, 0.08):
        interior.box((edge, floor - 0.75, edge + 0.05, floor - 0.15), 0.8)
    top = floor - rng.uniform(1.7, 2.0)
    interior.box((left + 0.1, top, left + 0.6, top + 0.7), colour)
    interior.box((left + 0.15, top + 0.08, left + 0.55, top + 0.2), 0.8)


def _lockers(rng: np.random.Generator, interior: Interior, left: float, colour: Sequence[float]) -> None:
    """A row of narrow metal doors, man-high, with vents."""
    top, floor = interior.room.height - 1.8, interior.room.height
    for edge in np.arange(left, left + 1.15, 0.3):
        interior.box((edge, top, edge + 0.285, floor), colour)
        for slit in (0.12, 0.16, 0.20):
            interior.box((edge + 0.06, top + slit, edge + 0.22, top + slit + 0.02), 0.04)


_PIECES: dict[str, Callable[[np.random.Generator, Interior, float, Sequence[float]], None]] = {
    "door": _door,
    "window": _window,
    "curtains": _curtains,
    "shelf": _shelf,
    "picture": _picture,
    "cupboard": _cupboard,
    "whiteboard": _whiteboard,
    "plant": _plant,
    "radiator": _radiator,
    "lockers": _lockers,
}
