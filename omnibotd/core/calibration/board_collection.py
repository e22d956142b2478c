"""Which pictures of a chessboard are worth keeping while somebody moves it about, and what to tell that person."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.calibration.chessboard import Board, agreed, find_grids, view_of
from omnibotd.core.vision.frame import Frame, Image

Floats = NDArray[np.float64]

# Pictures that make a good lens, if they cover it; so many more where they did not; and the most that are kept.
ENOUGH, MORE, MOST = 18, 6, 48
# A picture is new whose board has moved by so much (of the longer side) from every one kept, or changed so much in
# size or slant (of itself).
_MOVED, _CHANGED = 0.06, 0.2
# A board that moves by less than this share of the longer side in a second is blurred, and sheared where the camera
# reads row by row, by one pixel of 640 in 1/30 s.
_STILL = 0.05
# Corners beyond this share of the way from the middle to the rim are near the rim, within this one in the middle.
_NEAR_RIM, _MIDDLE = 0.65, 0.35
# Where the board is, seen from the robot; the picture, looking up, has left and right the other way round.
_SIDES = ("front", "front left", "left", "rear left", "rear", "rear right", "right", "front right")
ABOVE = "above"
# Sizes of boards found, to agree on one where none was told: the first few pictures may show half of it.
_REMEMBERED = 30
# So many whole boards of one size, and none of the size told, and that was told wrong.
_OTHERS = 5


@dataclass(frozen=True, slots=True)
class _Place:
    """Where the board was in a picture: its middle (2,) and spread (2, 2), px."""

    stamp: float
    middle: Floats
    spread: Floats

    @classmethod
    def of(cls, stamp: float, corners: Floats) -> _Place:
        return cls(stamp, corners.mean(0), np.cov(corners.T))

    def differs(self, other: _Place, longer: int) -> bool:
        changed = self._changed(other) / float(np.linalg.norm(other.spread))
        return self._moved(other) > _MOVED * longer or changed > _CHANGED

    def still(self, before: _Place, longer: int) -> bool:
        """Whether it was in about the same place in a picture shortly before."""
        outermost = self._moved(before) + self._changed(before) / math.sqrt(float(np.trace(self.spread)))
        return outermost < _STILL * longer * (self.stamp - before.stamp)

    def _moved(self, other: _Place) -> float:
        return float(np.hypot(*(self.middle - other.middle)))

    def _changed(self, other: _Place) -> float:
        return float(np.linalg.norm(self.spread - other.spread))


class BoardCollection:
    """Takes pictures one by one; `kept` are those to calibrate with, `hint` tells what to do with the board now."""

    def __init__(self, board: Board | None, mount_yaw: float = 0.0) -> None:
        """`board` is None where the pictures are to tell its size; `mount_yaw` as in CameraModel."""
        self.board = board
        self.kept: list[Frame] = []
        self.seen = 0  # pictures with a board
        self.hint = "show all of it"
        self._told, self._mount_yaw, self._wanted = board, mount_yaw, ENOUGH
        self._places: list[_Place] = []
        self._last: _Place | None = None
        self._zones: set[str] = set()
        self._found: list[list[Floats]] = []

    @property
    def missing(self) -> list[str]:
        """Sides of the robot, or above it, where no corner was yet."""
        return [zone for zone in (ABOVE, *_SIDES) if zone not in self._zones]

    @property
    def full(self) -> bool:
        return len(self.kept) >= MOST

    @property
    def enough(self) -> bool:
        return self.full or (len(self.kept) >= self._wanted and not self.missing)

    @property
    def other(self) -> Board | None:
        """The board that is shown, where it has another size than was told."""
        whole = [grids for grids in self._found if grids]
        return agreed(whole) if self._told is not None and not self.seen and len(whole) >= _OTHERS else None

    def ask_for_more(self) -> None:
        """What is kept was not enough: everywhere again."""
        self._wanted = len(self.kept) + MORE
        self._zones.clear()

    def take(self, frame: Frame) -> bool:
        """Look for the board; whether the picture is kept. FrameError where it is none."""
        grey = frame.grey()
        corners = self._corners(grey)
        before, self._last = self._last, None if corners is None else _Place.of(frame.stamp, corners)
        if corners is None or self._last is None:
            self.hint = "not seen: show more of it, nearer, in better light"
            return False
        self.seen += 1
        longer = max(grey.shape)
        if before is None or not self._last.still(before, longer):
            self.hint = "hold it still"
            return False
        new = not self.enough and all(self._last.differs(other, longer) for other in self._places)
        if new:
            self.kept.append(frame)
            self._places.append(self._last)
            self._zones |= self._zones_of(corners, grey)
        self.hint = self._onward()
        return new

    def _onward(self) -> str:
        """Where to go with a board that was seen well where it is."""
        if not self.missing:
            return "now anywhere else, leant another way"
        return "now straight above" if self.missing[0] == ABOVE else f"now low at the robot's {self.missing[0]}"

    def _corners(self, grey: Image) -> Floats | None:
        """(N, 2) of the board, None where it is not seen or its size not yet known."""
        grids = find_grids(grey)
        self._found = [*self._found, grids][-_REMEMBERED:]
        if self.board is None and sum(bool(found) for found in self._found) >= 3:
            self.board = agreed(self._found)
        if self.board is None:
            return None
        views = (view_of(grid, self.board) for grid in grids)
        return next((view.corners for view in views if view is not None), None)

    def _zones_of(self, corners: Floats, grey: Image) -> set[str]:
        """The zones with a corner; the rim is taken to be as far off as the nearer edges."""
        height, width = grey.shape
        away = corners - ((width - 1) / 2.0, (height - 1) / 2.0)
        share = np.hypot(*away.T) / (min(width, height) / 2.0)
        bearing = np.arctan2(away[:, 0], -away[:, 1]) + self._mount_yaw
        sides = np.round(bearing / (math.pi / 4.0)).astype(int) % 8
        zones = {_SIDES[k] for k in sides[share > _NEAR_RIM]}
        return zones | {ABOVE} if (share < _MIDDLE).any() else zones
