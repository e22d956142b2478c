"""Finding a chessboard's inner corners in a fisheye picture, whether or not its size is known.

    grid = find_grids(image)[0]                 # all that looks like a chessboard, the largest first
    view = find_board(image, Board(9, 6, 0.025), "left.jpg")

Part of a board is as good as a whole one: the corners of a part are on a plane, too. Which of its two (or four)
equal ends a board is counted from does not matter to a calibration.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from omnibotd.core.calibration.chessboard_corners import find_crossings
from omnibotd.core.calibration.chessboard_grid import join
from omnibotd.core.errors import CoreError
from omnibotd.core.vision.frame import FloatImage, Frame, Image

Floats = NDArray[np.float64]

# Sides of boards, in inner corners: a homography wants 3, and more than 40 no picture of a cheap camera resolves.
FEWEST, MOST = 3, 40
# Share of a board's corners that has to be found: a smaller part may as well belong to something else.
_LEAST_PART = 0.6
# A row beside the board that is filled less than this is stray crossings: the board's edge on a cluttered background.
_STRAY = 0.6
# A corner is refined in a window of this share of the way to its nearest neighbour: the more edge the less noise. Its
# half width (px) is at least 2, and at most 7 or this share of the picture: over more, a fisheye's edges are bent.
_WINDOW, _SMALLEST, _LARGEST, _BENT = 0.4, 2, 7, 1 / 150
# Noise pulls a refined corner back to where it started, so it is smoothed away (share of the longer side): what is
# lost in sharpness matters less. More than this moves corners of small squares.
_SMOOTH = 1 / 1000
_REFINED = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-3)


class BoardError(CoreError):
    """A board that can't be: malformed, or of a size nobody prints."""


@dataclass(frozen=True, slots=True)
class Board:
    """A chessboard by its inner corners: `columns` along a row, `rows`; `square` is a square's side in metres."""

    columns: int
    rows: int
    square: float = 1.0

    def __str__(self) -> str:
        return f"{self.columns}x{self.rows}"

    @classmethod
    def parse(cls, text: str, square: float = 1.0) -> Board:
        """From `9x6`; raises BoardError."""
        columns, _, rows = text.lower().partition("x")
        if not (columns.isdecimal() and rows.isdecimal()):
            raise BoardError(f"board {text!r}: expected COLUMNSxROWS of inner corners, such as 9x6")
        if not all(FEWEST <= int(side) <= MOST for side in (columns, rows)):
            raise BoardError(f"board {text}: {FEWEST} to {MOST} inner corners a side can be used")
        return cls(int(columns), int(rows), square)


@dataclass(frozen=True, slots=True)
class BoardView:
    """Corners found in one picture: `corners` (N, 2) px, `points` (N, 2) m on the board, same order.

    N may be less than all of the board's when a part is hidden.
    """

    name: str
    corners: Floats
    points: Floats


def find_board(image: Image, board: Board, name: str = "") -> BoardView | None:
    """The board in a picture (H, W) grey or (H, W, 3) BGR; None where it, or most of it, is not seen."""
    views = (view_of(grid, board, name) for grid in find_grids(image))
    return next((view for view in views if view is not None), None)


def guess_board(images: Iterable[Image], square: float = 1.0) -> Board | None:
    """The size most of the pictures agree on; None where they do not."""
    return agreed([find_grids(image) for image in images], square)


def agreed(found: Iterable[list[Floats]], square: float = 1.0) -> Board | None:
    """The size most of the pictures agree on, of what `find_grids` found in each; the longer side first."""
    sizes = Counter(size for grids in found if grids and (size := _size(grids[0])) is not None)
    if not sizes:
        return None
    (size, votes), *_ = sizes.most_common(1)
    return Board(*size, square) if votes > sizes.total() / 2 else None


def _size(grid: Floats) -> tuple[int, int] | None:
    """Longer and shorter side of a whole board, without stray crossings beside it; None where corners are hidden."""
    there = np.isfinite(grid[..., 0])
    while there.size and (stray := _sparse_side(there)) is not None:
        there = stray
    if min(there.shape) < FEWEST or not there.all():
        return None
    return max(there.shape), min(there.shape)


def _sparse_side(there: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """Without the emptiest of its four sides, if that holds stray crossings only."""
    sides = (there[0], there[-1], there[:, 0], there[:, -1])
    shares = [float(side.mean()) for side in sides]
    emptiest = int(np.argmin(shares))
    rest = (there[1:], there[:-1], there[:, 1:], there[:, :-1])[emptiest]
    return rest if shares[emptiest] < _STRAY else None


def find_grids(image: Image) -> list[Floats]:
    """All chessboards in a picture, the largest first: (rows, columns, 2) px, NaN where a corner is hidden."""
    grey = Frame(0.0, image).grey()
    smooth = cv2.GaussianBlur(grey, (0, 0), _SMOOTH * max(grey.shape)).astype(np.float32)
    return [_refined(smooth, grid) for grid in join(smooth, find_crossings(grey))]


def _refined(smooth: FloatImage, grid: Floats) -> Floats:
    """To sub-pixel accuracy, each in a window as large as its squares allow; what wanders out of it becomes NaN."""
    refined = grid.copy()
    largest = max(_LARGEST, round(_BENT * max(smooth.shape)))
    for cell in np.argwhere(np.isfinite(grid[..., 0])):
        place = grid[tuple(cell)]
        half = int(np.clip(_WINDOW * _nearest(grid, cell), _SMALLEST, largest))
        start = place.astype(np.float32).reshape(1, 1, 2)
        found = cv2.cornerSubPix(smooth, start, (half, half), (-1, -1), _REFINED).reshape(2)
        refined[tuple(cell)] = found if np.hypot(*(found - place)) <= half else np.nan
    return refined


def _nearest(grid: Floats, cell: NDArray[np.intp]) -> float:
    """px to the nearest of a corner's neighbours in the grid."""
    r, c = cell
    around = grid[max(r - 1, 0) : r + 2, max(c - 1, 0) : c + 2].reshape(-1, 2)
    gaps = np.hypot(*(around - grid[r, c]).T)
    return float(np.nanmin(gaps[gaps != 0.0]))


def view_of(grid: Floats, board: Board, name: str = "") -> BoardView | None:
    """The grid as a view of the board, or of most of it; None where it is another board's."""
    turned = np.swapaxes(grid, 0, 1)[::-1]  # a quarter turn: still right-handed
    windows = [window for whole in (grid, turned) if (window := _window(whole, board)) is not None]
    if not windows:
        return None
    best = max(windows, key=lambda window: int(np.isfinite(window[..., 0]).sum()))
    r, c = np.nonzero(np.isfinite(best[..., 0]))
    if len(r) < _LEAST_PART * board.rows * board.columns:
        return None
    points = np.column_stack([c, r]).astype(np.float64) * board.square
    return BoardView(name, best[r, c], points)


def _window(grid: Floats, board: Board) -> Floats | None:
    """The part of the grid, at most as large as the board, that holds most corners; None where the grid has more than
    stray crossings beside it, and so is of a larger board."""
    there = np.isfinite(grid[..., 0])
    rows, columns = min(board.rows, grid.shape[0]), min(board.columns, grid.shape[1])
    counts = sliding_window_view(there, (rows, columns)).sum((2, 3))
    r, c = (int(index) for index in np.unravel_index(counts.argmax(), counts.shape))
    window = grid[r : r + rows, c : c + columns]
    beside = [
        *(there[row, c : c + columns] for row in (r - 1, r + rows) if 0 <= row < len(there)),
        *(there[r : r + rows, column] for column in (c - 1, c + columns) if 0 <= column < there.shape[1]),
    ]
    return None if any(side.mean() >= _STRAY for side in beside) else window
