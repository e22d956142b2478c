"""`calibrate camera` of the whole daemon, live: somebody does with a chessboard what it says."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from omnibotd.core.calibration.chessboard import Board
from omnibotd.io.camera import load_calibration
from omnibotd.lens_calibration import LensCalibrationError, calibrate_folder
from omnibotd.lens_fitting import FittingError
from tests.chessboards import Lens
from tests.held_board import HeldBoard
from tools.sim import virtual_time
from tools.sim.virtual_robot import virtual_robot

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
LENS = Lens.fitting(480, 360, 185, "webcam")
BOARD = Board(7, 5, 0.03)
# The camera's axes (u right, v down, optical axis) from the base's (x image top, y image right, z up).
CAMERA_FROM_BASE = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def session(world: HeldBoard, directory: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The reply, and all that was told meanwhile."""
    heard: list[dict[str, Any]] = []

    def tell(values: dict[str, Any]) -> None:
        heard.append(values)
        world.wanted = values["missing"]

    async def fit(jpegs: Sequence[bytes], board: Board) -> dict[str, Any]:
        """As `fit_in_child`; there are no processes in virtual time."""
        folder = directory / "pictures"
        folder.mkdir(exist_ok=True)
        for number, jpeg in enumerate(jpegs, 1):
            (folder / f"{number:03}.jpg").write_bytes(jpeg)
        try:
            return calibrate_folder(folder, board, board.square, lambda message: None)
        except LensCalibrationError as error:
            raise FittingError(str(error)) from error

    async def main() -> dict[str, Any]:
        async with virtual_robot(world, 1, directory=directory) as robot:
            robot.daemon.requests._methods["calibrate.camera"].__self__._fit = fit
            return await robot.daemon.call("calibrate.camera", {}, tell)

    return virtual_time.run(main()), heard


def test_a_lens_from_a_board_in_somebodys_hands(tmp_path: Path) -> None:
    told, heard = session(HeldBoard(LENS, BOARD, 1), tmp_path)
    assert told["board"] == "7x5"
    assert heard[-1]["navigation_time"] < 180.0
    hints = {values["hint"] for values in heard}
    assert "hold it still" in hints
    assert any(hint.startswith("now low at the robot's") for hint in hints)
    model = load_calibration(Path(told["file"]))
    bearings = np.arange(0.0, 2.0 * math.pi, 0.1)
    for zenith in np.radians([30, 60, 75]):
        across = math.sin(zenith)
        rays = np.column_stack([across * np.cos(bearings), across * np.sin(bearings)])
        rays = np.column_stack([rays, np.full(len(bearings), math.cos(zenith))])
        off = model.project(rays @ CAMERA_FROM_BASE) - LENS.project(rays)
        assert np.hypot(*off.T).max() < 0.5
