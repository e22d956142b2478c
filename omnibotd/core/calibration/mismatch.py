"""How far what each picture of a turn shows lies from where the others show it, block by block."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.calibration.panorama import COLUMN_STEP, Floats, Grid, Pictures, View, contrast, slopes
from omnibotd.core.calibration.turn import Sensitivity, Turn
from omnibotd.core.vision.frame import FloatImage

# What so many of the pictures show has a mean worth comparing with.
_SHARED = 0.6
# Contrast (squared) that two views of the same thing never agree better than.
_LEAST_VARIANCE = 1e-3
# Rounds of telling the world from what stays in the picture: each leaves a tenth of the error.
_CLEANINGS = 3


@dataclass(frozen=True, slots=True)
class Mismatch:
    """Displacements along bearing and zenith angle (rad) of each look and block, as far as they can be told.

    `information` (n, blocks, 2, 2) is the inverse of their covariance, `pull` (n, blocks, 2) that times what was seen;
    `sensitivity` is what they are to be explained by.
    """

    information: Floats
    pull: Floats
    sensitivity: Sensitivity


def from_mean(turn: Turn, grid: Grid, pictures: Pictures, blur: float) -> Mismatch:
    """Each picture against the mean of all: the best where they nearly fit already."""
    views = [contrast(each, blur) for each in _cleaned(list(_views(turn, grid, pictures)), turn)]
    reference = _Reference(grid, views, _SHARED)
    sensitivity = Sensitivity.of(turn, grid).relative_to_mean()
    return _mismatch([reference.compare(each) for each in views], sensitivity)


def from_neighbours(turn: Turn, grid: Grid, pictures: Pictures, blur: float, window: int) -> Mismatch:
    """Each picture against the `window` before it, which fit however wrong the camera; the first ones against none."""
    views: list[View] = []
    compared, references = [], []
    for k, shown in enumerate(_views(turn, grid, pictures)):
        each = contrast(shown, blur)
        nothing = np.zeros((len(turn.nearness), 3, 2))
        compared.append(nothing if k < window else _Reference(grid, views, 1.0).compare(each))
        references.append(range(max(0, k - window), k) if k else range(1))
        views = [*views, each][-window:]
    return _mismatch(compared, Sensitivity.of(turn, grid).relative_to(references))


class _Reference:
    """The mean of some views, and its slopes."""

    def __init__(self, grid: Grid, views: Sequence[View], share: float) -> None:
        """Cells count that at least this share of the views have."""
        count = np.zeros(views[0].seen.shape, np.float32)
        total = np.zeros_like(count)
        for each in views:
            count += each.seen
            total += each.cells
        self._grid = grid
        self._mean: FloatImage = np.asarray(total / np.maximum(count, 1.0), np.float32)
        self._known: NDArray[np.bool_] = count >= share * len(views)
        self._along, self._down = slopes(grid, self._mean)

    def compare(self, other: View) -> Floats:
        """(blocks, 3, 2): the information matrix, and the pull below it."""
        sums = self._grid.sums
        weight = self._grid.worth * (other.seen & self._known)
        difference = other.cells - self._mean
        along, down = weight * self._along, weight * self._down
        aa, ad, dd = sums(along * self._along), sums(along * self._down), sums(down * self._down)
        variance = sums(weight * difference * difference) / np.maximum(sums(weight), 1.0) + _LEAST_VARIANCE
        parts = [aa, ad, ad, dd, sums(along * difference), sums(down * difference)]
        return np.asarray((np.stack(parts, -1) / variance[:, None]).reshape(-1, 3, 2))


def _cleaned(views: list[View], turn: Turn) -> list[View]:
    """Without what stays in the picture as the robot turns, as far as that is not what the world shows there.

    Each picture is a sum of both; one after the other is the mean of what the other leaves.
    """
    shifts = [round(heading / COLUMN_STEP) for heading in turn.heading]
    staying = np.zeros_like(views[0].cells)
    for _ in range(_CLEANINGS):
        world = _mean(each.cells - np.roll(staying, shift, 1) for each, shift in zip(views, shifts, strict=True))
        staying = _mean(np.roll(each.cells - world, -shift, 1) for each, shift in zip(views, shifts, strict=True))
    return [View(each.cells - np.roll(staying, shift, 1), each.seen) for each, shift in zip(views, shifts, strict=True)]


def _mean(images: Iterator[FloatImage]) -> FloatImage:
    total, count = next(images).copy(), 1
    for image in images:
        total += image
        count += 1
    return np.asarray(total / count, np.float32)


def _views(turn: Turn, grid: Grid, pictures: Pictures) -> Iterator[View]:
    """Each picture as it would look had it been taken at heading 0, were all assumptions right."""
    zenith, bearing, nearness = grid.nodes(turn.nearness)
    for k in range(len(pictures.grey)):
        yield pictures.view(k, *grid.between_nodes(turn.pixels(k, zenith, bearing, nearness)))


def _mismatch(compared: Sequence[Floats], sensitivity: Sensitivity) -> Mismatch:
    parts = np.stack(compared)
    return Mismatch(parts[:, :, :2], parts[:, :, 2], sensitivity)
