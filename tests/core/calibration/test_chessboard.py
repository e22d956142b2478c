"""The board is found whatever its size and the lens, to a fraction of a pixel, and nothing else is taken for it."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from omnibotd.core.calibration.chessboard import (
    Board,
    BoardError,
    BoardView,
    agreed,
    find_board,
    find_grids,
    guess_board,
)
from tests.chessboards import Lens, Placed, drawn, placed

REAL = Path(__file__).parents[4] / "shared/data/fisheye_chessboard"
WIDE = Lens.fitting(640, 480, 190)
SCENES = (
    (WIDE, Board(6, 4, 0.03)),
    (Lens.fitting(640, 480, 220, "equisolid"), Board(7, 6, 0.025)),
    (Lens.fitting(640, 480, 130, "stereographic", fill=1.3), Board(11, 8, 0.02)),
)


def _scene(lens: Lens, board: Board, seed: int, **conditions: float) -> tuple[np.ndarray, np.ndarray]:
    """A picture, and the true corners (rows * columns, 2) px."""
    rng = np.random.default_rng(seed)
    pose = placed(lens, board, rng, 0.8 * min(lens.fov / 2.0, 1.9), least_span=0.7)
    return drawn(lens, board, pose, rng, **conditions), lens.project(pose.points(board))


def _in_true_order(view: BoardView, board: Board, truth: np.ndarray) -> np.ndarray:
    """The true corners in the view's order, counted from the end of the board that fits best."""
    columns, rows = np.rint(view.points.T / board.square).astype(int)
    grid = truth.reshape(board.rows, board.columns, 2)
    symmetric = [grid, grid[::-1, ::-1]]
    if board.rows == board.columns:
        symmetric += [np.swapaxes(other, 0, 1)[::-1] for other in symmetric]
    counted = [other[rows, columns] for other in symmetric]
    return min(counted, key=lambda corners: float(np.hypot(*(corners - view.corners).T).sum()))


@pytest.mark.parametrize(("lens", "board"), SCENES, ids=lambda part: getattr(part, "kind", str(part)))
def test_finds_every_corner_of_a_whole_board_in_order(lens: Lens, board: Board) -> None:
    image, truth = _scene(lens, board, 3)
    view = find_board(image, board, "one")
    assert view is not None
    assert view.name == "one"
    assert len(view.corners) == board.rows * board.columns == len(np.unique(view.points, axis=0))
    off = np.hypot(*(view.corners - _in_true_order(view, board, truth)).T)
    assert np.sqrt((off**2).mean()) < 0.2
    assert off.max() < 0.7


def test_a_square_board_a_large_picture_and_colours() -> None:
    lens, board = Lens.fitting(800, 700, 180, "webcam"), Board(5, 5)
    image, truth = _scene(lens, board, 1, blur=1.5)
    view = find_board(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), board)
    assert view is not None
    assert np.hypot(*(view.corners - _in_true_order(view, board, truth)).T).max() < 0.8


def test_finds_what_a_hand_leaves_of_a_board() -> None:
    board = Board(9, 6)
    image, truth = _scene(WIDE, board, 5)
    thumb = truth.reshape(6, 9, 2)[0, 0]
    cv2.circle(image, (round(thumb[0]), round(thumb[1])), 14, 120, -1)
    view = find_board(image, board)
    assert view is not None
    assert 40 <= len(view.corners) < 54
    # a part can be counted from anywhere on the board: neighbours there are neighbours here
    gaps = np.hypot(*np.moveaxis(view.corners[:, None] - truth, -1, 0))
    assert np.median(gaps.min(1)) < 0.2
    rows, columns = np.divmod(gaps.argmin(1), 9)
    true_steps = np.abs(np.subtract.outer(rows, rows)) + np.abs(np.subtract.outer(columns, columns))
    steps = np.abs(view.points[:, None] - view.points).sum(2)
    assert (steps[gaps.min(1) < 1][:, gaps.min(1) < 1] == true_steps[gaps.min(1) < 1][:, gaps.min(1) < 1]).all()


def test_another_board_is_not_taken_for_it() -> None:
    image, _ = _scene(WIDE, Board(7, 6), 2)
    assert find_board(image, Board(7, 6)) is not None
    for other in (Board(5, 4), Board(6, 6), Board(7, 5), Board(4, 3), Board(11, 8), Board(12, 6)):
        assert find_board(image, other) is None, other


@pytest.mark.parametrize("shape", [(480, 640), (40, 60), (3, 2000)])
def test_noise_has_no_board(shape: tuple[int, int]) -> None:
    noise = np.random.default_rng(0).integers(0, 255, shape).astype(np.uint8)
    assert find_board(noise, Board(4, 4)) is None
    assert find_board(cv2.GaussianBlur(noise, (0, 0), 4.0), Board(4, 4)) is None
    assert find_board(np.zeros(shape, np.uint8), Board(4, 4)) is None


def test_a_line_grid_is_no_chessboard() -> None:
    image = np.full((480, 640), 200, np.uint8)
    image[::40] = image[:, ::40] = 30
    assert find_grids(cv2.GaussianBlur(image, (0, 0), 1.0)) == []


def test_the_pictures_tell_the_size_of_their_board() -> None:
    images = [_scene(WIDE, Board(6, 7), seed)[0] for seed in (1, 2)] + [np.full((480, 640), 90, np.uint8)]
    assert guess_board(images, 0.03) == Board(7, 6, 0.03)
    assert guess_board(images[2:]) is None


def test_pictures_of_two_boards_agree_on_none() -> None:
    grids = [[np.zeros((4, 6, 2))], [np.zeros((5, 7, 2))], []]
    assert agreed(grids) is None
    assert agreed([*grids, [np.zeros((6, 4, 2))]]) == Board(6, 4)


def test_stray_crossings_beside_a_board_do_not_count() -> None:
    grid = np.full((5, 6, 2), np.nan)
    grid[:4] = np.random.default_rng(0).uniform(0, 100, (4, 6, 2))
    grid[4, 2:4] = 50.0
    assert agreed([[grid]]) == Board(6, 4)
    hidden = grid.copy()
    hidden[1, 1] = np.nan
    assert agreed([[hidden]]) is None


@pytest.mark.parametrize("text", ["9", "9x", "x6", "9x6x3", "2x9", "9x41", "-9x6", "nine x six", ""])
def test_a_malformed_board_is_refused(text: str) -> None:
    with pytest.raises(BoardError, match="inner corners"):
        Board.parse(text)


def test_parses_a_board() -> None:
    assert Board.parse("9x6", 0.02) == Board(9, 6, 0.02)
    assert str(Board.parse("11X8")) == "11x8"


def test_seen_from_ninety_degrees_off_axis() -> None:
    """Half of the board lies behind the camera's plane."""
    board, lens = Board(6, 4), Lens.fitting(640, 480, 230)
    facing, _ = cv2.Rodrigues(np.array([0.0, math.pi / 2, 0.0]))
    pose = Placed(facing, facing @ np.array([-2.5, -1.5, 8.0]))
    image = drawn(lens, board, pose, np.random.default_rng(0))
    view = find_board(image, board)
    assert view is not None
    truth = _in_true_order(view, board, lens.project(pose.points(board)))
    assert len(truth) == 24
    assert np.hypot(*(view.corners - truth).T).max() < 0.7


@pytest.mark.skipif(not REAL.is_dir(), reason=f"needs the real views in {REAL}")
def test_the_hardest_real_views() -> None:
    """Large and near, at the rim, with a shadow's edge across."""
    for name in ("5.jpg", "20.jpg", "21.jpg", "22.jpg", "26.jpg"):
        view = find_board(cv2.imread(str(REAL / name)), Board(4, 6), name)
        assert view is not None, name
        assert len(view.corners) == 24, name
