"""Which pictures of a chessboard are worth keeping while somebody moves it about, and where it is still to be held."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.calibration.chessboard import Board, agreed, find_grids, view_of
from omnibotd.core.vision.frame import Frame, Image

Floats = NDArray[np.float64]

# Pictures that make a good lens, if they cover it; and the most that are kept: more tell nothing new.
ENOUGH, MOST = 18, 40
# A picture is new whose board has moved by so much (of the longer side) from every one kept, or changed so much in
# size or slant (of itself).
_MOVED, _CHANGED = 0.06, 0.2
# Corners beyond this share of the way from the middle to the rim are near the rim, within this one in the middle.
_NEAR_RIM, _MIDDLE = 0.6, 0.35
_SECTORS = ("right", "bottom right", "bottom", "bottom left", "left", "top left", "top", "top right")
MIDDLE = "middle"
# Sizes of boards found, to agree on one where none was told: the first few pictures may show half of it.
_REMEMBERED = 30


@dataclass(frozen=True, slots=True)
class _Place:
    """Where the board was in a picture: its middle (2,) and spread (2, 2), px."""

    middle: Floats
    spread: Floats

    def differs(self, other: _Place, longer: int) -> bool:
        moved = float(np.hypot(*(self.middle - other.middle))) > _MOVED * longer
        changed = float(np.linalg.norm(self.spread - other.spread)) > _CHANGED * float(np.linalg.norm(other.spread))
        return moved or changed


class BoardCollection:
    """Takes pictures one by one; `kept` are those to calibrate with."""

    def __init__(self, board: Board | None) -> None:
        """`board` is None where the pictures are to tell its size."""
        self.board = board
        self.kept: list[Frame] = []
        self.seen = 0  # pictures with a board
        self._places: list[_Place] = []
        self._zones: set[str] = set()
        self._found: list[list[Floats]] = []

    @property
    def missing(self) -> list[str]:
        """Parts of the picture in which no corner was yet, as the picture shows them; its top is the robot's front."""
        return [zone for zone in (MIDDLE, *_SECTORS) if zone not in self._zones]

    @property
    def enough(self) -> bool:
        return len(self.kept) >= MOST or (len(self.kept) >= ENOUGH and not self.missing)

    def take(self, frame: Frame) -> bool:
        """Look for the board; whether the picture is kept. FrameError where it is none."""
        grey = frame.grey()
        corners = self._corners(grey)
        if corners is None:
            return False
        self.seen += 1
        place = _Place(corners.mean(0), np.cov(corners.T))
        if self.enough or not all(place.differs(other, max(grey.shape)) for other in self._places):
            return False
        self.kept.append(frame)
        self._places.append(place)
        self._zones |= _zones(corners, grey)
        return True

    def _corners(self, grey: Image) -> Floats | None:
        """(N, 2) of the board, None where it is not seen or its size not yet known."""
        grids = find_grids(grey)
        if self.board is None:
            self._found = [*self._found, grids][-_REMEMBERED:]
            if sum(bool(found) for found in self._found) >= 3:
                self.board = agreed(self._found)
        if self.board is None:
            return None
        views = (view_of(grid, self.board) for grid in grids)
        return next((view.corners for view in views if view is not None), None)


def _zones(corners: Floats, grey: Image) -> set[str]:
    """The parts of the picture with a corner; the rim is taken to be as far off as the nearer edges."""
    height, width = grey.shape
    away = corners - ((width - 1) / 2.0, (height - 1) / 2.0)
    share = np.hypot(*away.T) / (min(width, height) / 2.0)
    sectors = np.round(np.arctan2(away[:, 1], away[:, 0]) / (math.pi / 4.0)).astype(int) % 8
    zones = {_SECTORS[k] for k in sectors[share > _NEAR_RIM]}
    return zones | {MIDDLE} if (share < _MIDDLE).any() else zones
