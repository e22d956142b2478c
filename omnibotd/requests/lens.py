"""`calibrate camera`, live: somebody moves a chessboard before the camera, and is told where to hold it next."""

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
from omnibotd.lens_fitting import FittingError, LensFitter
from omnibotd.requests.calibrating import INTERNAL_ERROR
from omnibotd.requests.params import Params, invalid
from omnibotd.requests.robot import Method, Robot
from omnibotd.requests.running import Runner

log = logging.getLogger(__name__)

LIMIT = 600.0  # s to show the board everywhere; a minute or two is usual
FEWEST = 5  # pictures without which there is nothing to fit
PAUSE = 0.2  # s between looks for the board: leaves the processor to the control loop
COLLECTING, FITTING = "COLLECTING", "FITTING"
USUAL_SQUARE = 0.025  # m; the lens does not depend on it


class Posing:
    """The robot stands still for a while; `state`, `ending` and `complaint`, of the last fit, are set from outside."""

    def __init__(self) -> None:
        self.state = COLLECTING
        self.complaint = ""
        self.ending: Outcome | None = None

    def step(self, seen: Observation) -> Decision:
        """One tick."""
        if self.ending is None and self.state == COLLECTING and not seen.camera_ok:
            self.ending = Outcome(ErrorName.CAMERA_DOWN, "no picture from the camera for a second; check its cable")
        return Decision(self.state, outcome=self.ending)


class LensCalibration:
    """Collects pictures that show something new, then has the lens fitted."""

    def __init__(self, robot: Robot, runner: Runner, fit: LensFitter) -> None:
        self._robot, self._runner, self._fit = robot, runner, fit

    def methods(self) -> dict[str, Method]:
        return {"calibrate.camera": self._camera}

    async def _camera(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        collection = BoardCollection(_board(params), self._robot.config.camera.mount_yaw)
        params.end()
        self._robot.refuse_if_busy()
        self._robot.stored()
        if not self._robot.camera.ok(self._robot.now()):
            raise RpcError.named(ErrorName.CAMERA_DOWN, f"no pictures to calibrate by: {self._robot.camera.reason}")
        job = Posing()

        def progress(values: dict[str, Any]) -> None:
            feedback({"state": job.state, "navigation_time": values["navigation_time"], **_told(collection, job)})

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
        end = self._robot.now() + LIMIT
        try:
            info = None
            while info is None:
                await self._collect(collection, end)
                job.state = FITTING
                info = await self._fitted(collection, job, last=collection.full or self._robot.now() >= end)
                job.state = COLLECTING
        except CoreError as error:
            job.ending = Outcome(ErrorName.CALIBRATION_FAILED, str(error))
            return {}
        except Exception:  # our own bug must not leave the robot waiting for its lens for ever
            log.exception("calibration of the camera failed")
            job.ending = INTERNAL_ERROR
            return {}
        job.ending = Outcome(None, "the lens is fitted")
        return info

    async def _fitted(self, collection: BoardCollection, job: Posing, *, last: bool) -> Mapping[str, Any] | None:
        """The camera_info; None where the pictures do not do yet and there may be more. Raises FittingError."""
        assert collection.board is not None, "there are views of it"
        try:
            return await self._fit([frame.jpeg() for frame in collection.kept], collection.board)
        except FittingError as error:
            if last:
                raise
            job.complaint = f"{error} (the picture is looked at from below: its left is the robot's right)"
            collection.ask_for_more()
            return None

    async def _collect(self, collection: BoardCollection, end: float) -> None:
        """Until the board was everywhere, or time is up. Raises CoreError where that is no use."""
        newest, perception = _Newest(), self._robot.perception
        if perception.witness is not None:
            raise CoreError("another calibration is looking at the frames: say stop first")
        perception.witness = newest.take
        try:
            while not collection.enough and self._robot.now() < end:
                await asyncio.sleep(PAUSE)
                frame, newest.frame = newest.frame, None
                if frame is not None:
                    await self._robot.off_loop(_look, collection, frame)
                if collection.other is not None:
                    raise CoreError(_wrong_board(collection.other))
        finally:
            perception.witness = None
        if len(collection.kept) < FEWEST:
            raise CoreError(_too_few(collection))

    def _kept(self, info: Mapping[str, Any], collection: BoardCollection) -> dict[str, Any]:
        residual, data = f"{info.get('rms_px', 0.0):.2f} px rms", f"{len(collection.kept)} views of a chessboard"
        board = str(collection.board)
        lens = {key: value for key, value in info.items() if key != "images"}  # the child's folder is gone
        file = self._robot.stored().keep("camera", {**lens, "residual": residual, "data": data, "board": board})
        told = {"calibration": "camera", "file": str(file), "residual": residual, "data": data, "board": board}
        facts = {key: info[key] for key in ("rms_px", "edge_sigma_px", "covered_deg", "coverage") if key in info}
        warnings = ["maps taught before with another idea of the lens may be refused: teach them anew"]
        return {**told, **facts, "message": info.get("sentence", ""), "effect": NEXT_START, "warnings": warnings}


def _told(collection: BoardCollection, job: Posing) -> dict[str, Any]:
    """What the person with the board should know."""
    told: dict[str, Any] = {
        "hint": collection.hint if job.state == COLLECTING else "",
        "found": collection.seen,
        "kept": len(collection.kept),
        "missing": collection.missing,
    }
    return {**told, "complaint": job.complaint} if job.complaint else told


def _wrong_board(shown: Board) -> str:
    return f"the board that is shown has {shown} inner corners: count where four squares meet, or say --board {shown}"


def _too_few(collection: BoardCollection) -> str:
    if collection.board is None:
        return "no chessboard was seen, or no two pictures agreed on its size: say --board COLUMNSxROWS"
    if not collection.seen:
        return f"no chessboard of {collection.board} inner corners was seen: show all of it, nearer, in better light"
    return (
        f"{collection.seen} pictures showed the board, and {len(collection.kept)} were worth keeping, {FEWEST} the "
        "least: hold it still for a second in each of many places"
    )


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
