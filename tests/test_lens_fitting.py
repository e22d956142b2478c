"""The lens fitted in a real child: here it only has to refuse, and to say why."""

from __future__ import annotations

import asyncio

import cv2
import numpy as np
import pytest

from omnibotd.core.calibration.chessboard import Board
from omnibotd.lens_fitting import FittingError, fit_in_child


def test_pictures_without_a_board_are_refused_with_the_childs_sentence() -> None:
    blank = cv2.imencode(".jpg", np.full((240, 320), 128, np.uint8))[1].tobytes()
    with pytest.raises(FittingError, match=r"[Nn]o chessboard"):
        asyncio.run(fit_in_child([blank, blank], Board(9, 6)))
