"""Chessboard crossings joined to grids: from neighbour to neighbour, so that any bending is tolerated."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.calibration.chessboard_corners import Crossings, sampled
from omnibotd.core.vision.frame import FloatImage

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Cells = dict[tuple[int, int], int]
"""Crossing by (row, column)."""
Links = dict[tuple[int, int], tuple[int, int]]
"""(crossing, direction 0-3) at one end of a square's side: the same at its other end."""

# The nearest crossings looked at for neighbours: four, and as many that texture puts in between.
_NEAREST = 24
# A side's chord and its direction at a crossing differ by less (rad): squares of 30 degrees on a bent side.
_BEND = math.radians(35.0)
# At mid-side, this share of the side's length to either side, grey values are compared ...
_BESIDE = 0.2
# ... and must differ by this share of the crossings' contrast: shadows and blur take some of it.
_SIDE_CONTRAST = 0.3
# Fewer rows or columns than this make no homography worth having.
_FEWEST = 3


def join(smooth: FloatImage, crossings: Crossings) -> list[Floats]:
    """Grids (rows, columns, 2) px of crossings on boards, the largest first; NaN where a crossing was not found.

    Rows and columns are in no special order but right-handed: columns x rows turns as u x v does.
    """
    if len(crossings) < _FEWEST * _FEWEST:
        return []
    links = _round_squares(_links(smooth, crossings))
    free = {i for i, _ in links}
    grids = []
    while free:
        cells, met = _component(links, min(free))
        free -= met
        grids.append(_array(cells, crossings.places))
    wide = [grid for grid in grids if min(grid.shape[:2]) >= _FEWEST]
    return sorted(wide, key=lambda grid: -int(np.isfinite(grid[..., 0]).sum()))


def _links(smooth: FloatImage, crossings: Crossings) -> Links:
    """Sides of squares on whose two ends both crossings agree."""
    near = _neighbours(crossings.places)
    chosen: Links = {}
    for i, a, j, b in _sides(smooth, crossings, near):
        chosen.setdefault((i, a), (j, b))  # they come by length: the shortest is the next corner
    return {end: other for end, other in chosen.items() if chosen.get(other) == end}


def _round_squares(links: Links) -> Links:
    """Only links round a whole square: chance makes chains, seldom squares."""
    kept: Links = {}
    for end in links:
        i, a = end
        face = []
        for _ in range(4):
            if (i, a) not in links:
                break
            face.append((i, a))
            j, b = links[i, a]
            i, a = j, (b + 3) % 4
        if len(face) == 4 and (i, a) == end:
            kept.update((side, links[side]) for side in face)
            kept.update((links[side], side) for side in face)
    return kept


def _neighbours(places: Floats) -> Indices:
    """(n, k) indices of the nearest other crossings."""
    squares = (places**2).sum(1)
    gaps = squares[:, None] + squares - 2.0 * places @ places.T
    np.fill_diagonal(gaps, np.inf)
    k = min(_NEAREST, len(places) - 1)
    return np.argpartition(gaps, k - 1, axis=1)[:, :k]


def _sides(smooth: FloatImage, crossings: Crossings, near: Indices) -> list[tuple[int, int, int, int]]:
    """(i, direction at i, j, direction at j) of all pairs that may be ends of one side, the shortest first."""
    i = np.repeat(np.arange(len(near)), near.shape[1])
    j = near.ravel()
    chord = crossings.places[j] - crossings.places[i]
    angle = np.arctan2(chord[:, 1], chord[:, 0])
    a, off_a = _nearest_direction(crossings.directions[i], angle)
    b, off_b = _nearest_direction(crossings.directions[j], angle + math.pi)
    # Seen from one end light is to the left of the side, from the other to the right.
    good = (off_a < _BEND) & (off_b < _BEND) & (a % 2 != b % 2)
    i, j, a, b, chord = i[good], j[good], a[good], b[good], chord[good]
    least = _SIDE_CONTRAST * np.minimum(crossings.contrast[i], crossings.contrast[j])
    good = _step_across(smooth, crossings.places[i], chord) * np.where(a % 2 == 0, 1.0, -1.0) > least
    order = np.argsort(np.hypot(*chord[good].T), kind="stable")
    return list(zip(*(column[good][order].tolist() for column in (i, a, j, b)), strict=True))


def _nearest_direction(directions: Floats, angle: Floats) -> tuple[Indices, Floats]:
    off = np.abs((directions - angle[:, None] + math.pi) % (2.0 * math.pi) - math.pi)
    return off.argmin(1), off.min(1)


def _step_across(smooth: FloatImage, start: Floats, chord: Floats) -> Floats:
    """Grey values by which it is lighter on the side towards a rising angle, beside the middle of each chord."""
    middle = start + 0.5 * chord
    across = _BESIDE * np.column_stack([-chord[:, 1], chord[:, 0]])
    beyond, before = middle + across, middle - across
    return sampled(smooth, beyond[:, :1], beyond[:, 1:])[:, 0] - sampled(smooth, before[:, :1], before[:, 1:])[:, 0]


def _component(links: Links, seed: int) -> tuple[Cells, set[int]]:
    """Crossings reached from `seed` with their rows and columns, and all that were met on the way."""
    cells: Cells = {(0, 0): seed}
    turned = {seed: 0}  # direction that leads to the next column
    places = {seed: (0, 0)}
    queue = deque([seed])
    while queue:
        i = queue.popleft()
        for a in range(4):
            j, b = links.get((i, a), (i, 0))
            if j in turned:
                continue
            step = ((0, 1), (1, 0), (0, -1), (-1, 0))[(a - turned[i]) % 4]
            cell = (places[i][0] + step[0], places[i][1] + step[1])
            turned[j] = (b + 2 - a + turned[i]) % 4
            places[j] = cell
            if cells.setdefault(cell, j) == j:
                queue.append(j)
    return cells, set(turned)


def _array(cells: Cells, places: Floats) -> Floats:
    rows, columns = (np.array(axis) for axis in zip(*cells, strict=True))
    rows, columns = rows - rows.min(), columns - columns.min()
    grid = np.full((rows.max() + 1, columns.max() + 1, 2), np.nan)
    grid[rows, columns] = places[list(cells.values())]
    return grid
