"""Which pictures of a chessboard are kept, and what the person who holds it is told."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np

from omnibotd.core.calibration.board_collection import ENOUGH, BoardCollection
from omnibotd.core.calibration.chessboard import Board
from omnibotd.core.vision.frame import Frame, Image


def picture(u: float, v: float, square: float = 16.0, columns: int = 7, rows: int = 5) -> Image:
    """A flat board of so many inner corners with its middle at (u, v), in a grey picture of 640 x 480."""
    image = np.full((480, 640), 128, np.uint8)
    for row in range(rows + 1):
        for column in range(columns + 1):
            x, y = u + (column - (columns + 1) / 2) * square, v + (row - (rows + 1) / 2) * square
            corners = ((round(x), round(y)), (round(x + square) - 1, round(y + square) - 1))
            cv2.rectangle(image, *corners, 240 if (row + column) % 2 else 15, -1)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.8), np.uint8)


class Shown:
    """A collection that is shown pictures, three a second."""

    def __init__(self, board: Board | None = Board(7, 5), mount_yaw: float = 0.0) -> None:  # noqa: B008 - frozen
        self.collection = BoardCollection(board, mount_yaw)
        self._stamp = 0.0

    def see(self, image: Image) -> bool:
        self._stamp += 1.0 / 3.0
        return self.collection.take(Frame(self._stamp, image))

    def hold(self, u: float, v: float, **board: Any) -> bool:
        """Still, for two pictures."""
        self.see(image := picture(u, v, **board))
        return self.see(image)


def test_a_board_that_has_not_moved_is_kept_once() -> None:
    shown = Shown()
    assert [shown.hold(u, 240.0) for u in (320.0, 322.0, 400.0)] == [True, False, True]
    assert (shown.collection.seen, len(shown.collection.kept)) == (6, 2)
    assert shown.hold(320.0, 240.0, square=20.0)  # nearer


def test_a_moving_board_is_not_kept() -> None:
    shown = Shown()
    assert not any(shown.see(picture(200.0 + 25.0 * k, 240.0)) for k in range(6))
    assert shown.collection.hint == "hold it still"
    assert not any(shown.see(picture(320.0, 240.0, square=40.0 - 6.0 * k)) for k in range(5))  # away from the camera
    assert shown.collection.kept == []
    assert shown.see(picture(320.0, 240.0, square=15.0))
    assert shown.collection.hint == "now low at the robot's front"


def test_it_tells_on_which_sides_the_board_was_not_yet() -> None:
    shown = Shown()
    collection = shown.collection
    assert collection.missing[:3] == ["above", "front", "front left"]
    assert len(collection.missing) == 9
    shown.hold(320.0, 240.0)
    assert "above" not in collection.missing
    shown.hold(540.0, 240.0)
    # A picture of what is overhead, its top being the robot's front: right in it is the robot's left.
    assert {"above", "left"} == set(BoardCollection(None).missing) - set(collection.missing)
    for u, v in (
        (500.0, 400.0),
        (320.0, 420.0),
        (140.0, 400.0),
        (100.0, 240.0),
        (140.0, 80.0),
        (320.0, 60.0),
        (500.0, 80.0),
    ):
        shown.hold(u, v)
    assert collection.missing == []
    assert collection.hint == "now anywhere else, leant another way"
    assert not collection.enough
    for k in range(ENOUGH):
        shown.hold(120.0 + 22.0 * k, 200.0 + (k % 2) * 60.0)
    assert collection.enough
    collection.ask_for_more()
    assert not collection.enough
    assert len(collection.missing) == 9


def test_sides_are_the_robots_however_the_camera_is_mounted() -> None:
    shown = Shown(mount_yaw=math.pi / 2.0)  # the picture's top is the robot's left
    shown.hold(320.0, 60.0)
    assert set(BoardCollection(None).missing) - set(shown.collection.missing) == {"left"}


def test_the_boards_size_is_seen_where_it_was_not_told() -> None:
    shown = Shown(None)
    for k in range(3):
        shown.hold(200.0 + 60.0 * k, 240.0)
    board = shown.collection.board
    assert board is not None
    assert (board.columns, board.rows) == (7, 5)
    assert shown.collection.kept


def test_a_size_that_was_told_wrong_is_noticed() -> None:
    shown = Shown(Board(11, 8))
    for k in range(3):
        assert shown.collection.other is None
        shown.hold(200.0 + 60.0 * k, 240.0)
    assert str(shown.collection.other) == "7x5"
    assert shown.collection.kept == []
