"""`calibrate camera`, live: somebody moves a chessboard before the camera, and is told where it is missing."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from typing import Any

from omnibotd.calibrations import NEXT_START
from omnibotd.control import Feedback
from omnibotd.control_protocol import RpcError
from omnibotd.core.calibration.board_collection import BoardCollection
from omnibotd.core.calibration.chessboard import Board, BoardError
from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.error_name import ErrorName
from omnibotd.core.errors import CoreError, FrameError
from omnibotd.core.geometry import Pose2D
from omnibotd.core.vision.frame import Frame
from omnibotd.io.control_server import Session
from omnibotd.lens_fitting import LensFitter
from omnibotd.requests.calibrating import INTERNAL_ERROR
from omnibotd.requests.params import Params, invalid
from omnibotd.requests.robot import Method, Robot
from omnibotd.requests.running import Runner

log = logging.getLogger(__name__)

LIMIT = 600.0  # s to show the board everywhere; a minute or two is usual
PAUSE = 0.2  # s between looks for the board: leaves the processor to the control loop
FITTING = "FITTING"
USUAL_SQUARE = 0.025  # m; the lens does not depend on it


class Posing:
    """The robot stands still for a while; `state` and `ending` are set from outside."""

    def __init__(self) -> None:
        self.state = "COLLECTING"
        self.ending: Outcome | None = None

    def step(self, seen: Observation) -> Decision:
        """One tick."""
        return Decision(self.state, outcome=self.ending)


class LensCalibration:
    """Collects pictures that show something new, then has the lens fitted."""

    def __init__(self, robot: Robot, runner: Runner, fit: LensFitter) -> None:
        self._robot, self._runner, self._fit = robot, runner, fit

    def methods(self) -> dict[str, Method]:
        return {"calibrate.camera": self._camera}

    async def _camera(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        collection = BoardCollection(_board(params))
        params.end()
        self._robot.refuse_if_busy()
        self._robot.stored()
        if not self._robot.camera.ok(self._robot.now()):
            raise RpcError.named(ErrorName.CAMERA_DOWN, f"no pictures to calibrate by: {self._robot.camera.reason}")
        job = Posing()

        def progress(values: dict[str, Any]) -> None:
            told = {"state": job.state, "navigation_time": values["navigation_time"]}
            feedback({**told, "found": collection.seen, "kept": len(collection.kept), "missing": collection.missing})

        running = asyncio.ensure_future(self._runner.run("calibrate camera", lambda: job, progress))
        working = asyncio.ensure_future(self._work(collection, job))
        await asyncio.wait({running, working}, return_when=asyncio.FIRST_COMPLETED)
        if not working.done():
            working.cancel()
            await asyncio.gather(working, return_exceptions=True)
        await running
        return self._kept(working.result(), collection)

    async def _work(self, collection: BoardCollection, job: Posing) -> Mapping[str, Any]:
        """The camera_info; sets how the job ends."""
        try:
            await self._collect(collection)
            if collection.board is None:
                raise CoreError(
                    "no chessboard was seen, or no two pictures agreed on its size: say --board COLUMNSxROWS"
                )
            job.state = FITTING
            info = await self._fit([frame.jpeg() for frame in collection.kept], collection.board)
        except CoreError as error:
            job.ending = Outcome(ErrorName.CALIBRATION_FAILED, str(error))
            return {}
        except Exception:  # our own bug must not leave the robot waiting for its lens for ever
            log.exception("calibration of the camera failed")
            job.ending = INTERNAL_ERROR
            return {}
        job.ending = Outcome(None, "the lens is fitted")
        return info

    async def _collect(self, collection: BoardCollection) -> None:
        """Until the board was everywhere, or time is up."""
        end, newest = self._robot.now() + LIMIT, _Newest()
        perception = self._robot.perception
        if perception.witness is not None:
            raise CoreError("another calibration is looking at the frames: say stop first")
        perception.witness = newest.take
        try:
            while not collection.enough and self._robot.now() < end:
                await asyncio.sleep(PAUSE)
                frame, newest.frame = newest.frame, None
                if frame is not None:
                    await self._robot.off_loop(_look, collection, frame)
        finally:
            perception.witness = None

    def _kept(self, info: Mapping[str, Any], collection: BoardCollection) -> dict[str, Any]:
        residual, data = f"{info.get('rms_px', 0.0):.2f} px rms", f"{len(collection.kept)} views of a chessboard"
        board = str(collection.board)
        lens = {key: value for key, value in info.items() if key != "images"}  # the child's folder is gone
        file = self._robot.stored().keep("camera", {**lens, "residual": residual, "data": data, "board": board})
        told = {"calibration": "camera", "file": str(file), "residual": residual, "data": data, "board": board}
        facts = {key: info[key] for key in ("rms_px", "edge_sigma_px", "covered_deg", "coverage") if key in info}
        warnings = ["maps taught before with another idea of the lens may be refused: teach them anew"]
        return {**told, **facts, "message": info.get("sentence", ""), "effect": NEXT_START, "warnings": warnings}


class _Newest:
    """Keeps the newest frame until somebody has time for it."""

    def __init__(self) -> None:
        self.frame: Frame | None = None

    def take(self, frame: Frame, odom_from_base: Pose2D) -> None:
        self.frame = frame


def _look(collection: BoardCollection, frame: Frame) -> None:
    """On the worker; a damaged frame is no board."""
    try:
        collection.take(frame)
    except FrameError:
        return


def _board(params: Params) -> Board | None:
    square = params.number("square", USUAL_SQUARE)
    if not 0.001 <= square <= 1.0:
        raise invalid(f"square: {square:g} given, expected the side of a square in metres, from 0.001 to 1")
    if "board" not in params:
        return None
    try:
        return Board.parse(params.text("board", 16), square)
    except BoardError as error:
        raise invalid(str(error)) from error
