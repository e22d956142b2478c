"""`calibrate camera` as the whole daemon answers for it: scripted boards and fits."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml

from omnibotd.control_protocol import RpcError
from omnibotd.core.calibration.board_collection import ENOUGH, MORE, BoardCollection
from omnibotd.core.calibration.chessboard import Board
from omnibotd.core.error_name import ErrorName
from omnibotd.core.vision.frame import Frame
from omnibotd.lens_fitting import FittingError
from omnibotd.requests import lens
from tests.requested import Story, refusal, told
from tools.sim.virtual_robot import VirtualRobot


class Boards(BoardCollection):
    """Sees a board in every frame, and has seen enough of them after five."""

    def __init__(self, board: Board | None, mount_yaw: float) -> None:
        super().__init__(board, mount_yaw)
        self.board = board or Board(9, 6)

    @property
    def missing(self) -> list[str]:
        return [] if len(self.kept) >= 5 else ["front", "left"]

    @property
    def enough(self) -> bool:
        return len(self.kept) >= (5 if self._wanted == ENOUGH else self._wanted)

    def take(self, frame: Frame) -> bool:
        self.seen += 1
        self.kept.append(frame)
        return True


INFO = {"image_width": 160, "image_height": 120, "rms_px": 0.314, "covered_deg": 84.0, "edge_sigma_px": 0.4}


class Fitter:
    """Gives these answers in turn, the last one ever after."""

    def __init__(self, *answers: Any) -> None:
        self.answers = answers
        self.asked: list[tuple[int, Board]] = []

    async def __call__(self, jpegs: Sequence[bytes], board: Board) -> dict[str, Any]:
        answer = self.answers[min(len(self.asked), len(self.answers) - 1)]
        self.asked.append((len(jpegs), board))
        await asyncio.sleep(2.0)
        if isinstance(answer, Exception):
            raise answer
        return dict(answer)


def calibrated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fitter: Fitter, story: Story) -> Any:
    monkeypatch.setattr(lens, "BoardCollection", Boards)

    async def with_fitter(robot: VirtualRobot) -> Any:
        robot.daemon.requests._methods["calibrate.camera"].__self__._fit = fitter
        return await story(robot)

    return told(with_fitter, tmp_path)


def test_the_camera_is_calibrated_with_the_boards_held_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[dict[str, Any]] = []
    fitter = Fitter(INFO)

    async def story(robot: VirtualRobot) -> Any:
        return await robot.daemon.call("calibrate.camera", {"board": "8x5", "square": 0.03}, heard.append)

    result = calibrated(tmp_path, monkeypatch, fitter, story)
    assert fitter.asked == [(5, Board(8, 5, 0.03))]
    assert (result["rms_px"], result["data"]) == (0.314, "5 views of a chessboard")
    content = yaml.safe_load((tmp_path / "storage" / "calibration" / "camera.yaml").read_text())
    assert (content["image_width"], content["board"]) == (160, "8x5")
    assert list(dict.fromkeys(values["state"] for values in heard)) == ["COLLECTING", "FITTING"]
    assert heard[0]["missing"] == ["front", "left"]
    assert heard[-1] == {**heard[-1], "found": 5, "kept": 5, "missing": []}


@pytest.mark.parametrize("fault", [FittingError("hold the board nearer the left edge"), ZeroDivisionError("a bug")])
def test_a_lens_that_can_not_be_fitted_is_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: Exception
) -> None:
    async def story(robot: VirtualRobot) -> RpcError:
        error = await refusal(robot.call("calibrate.camera"))
        assert (await robot.call("status"))["job"] is None
        return error

    error = calibrated(tmp_path, monkeypatch, Fitter(fault), story)
    assert error.name is ErrorName.CALIBRATION_FAILED
    assert not (tmp_path / "storage" / "calibration").exists()


def test_where_the_pictures_do_not_do_it_says_why_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[dict[str, Any]] = []
    fitter = Fitter(FittingError("hold it nearer the left edge"), INFO)

    async def story(robot: VirtualRobot) -> Any:
        return await robot.daemon.call("calibrate.camera", {}, heard.append)

    assert calibrated(tmp_path, monkeypatch, fitter, story)["rms_px"] == 0.314
    assert [count for count, _ in fitter.asked] == [5, 5 + MORE]
    complaints = dict.fromkeys(values.get("complaint", "") for values in heard)
    assert [complaint.partition(" (")[0] for complaint in complaints] == ["", "hold it nearer the left edge"]
    assert "its left is the robot's right" in list(complaints)[1]


def test_a_camera_that_stops_ends_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def story(robot: VirtualRobot) -> RpcError:
        monkeypatch.setattr(robot.camera, "ok", lambda now: robot.seconds < 4.0)
        return await refusal(robot.call("calibrate.camera"))

    monkeypatch.setattr(Boards, "enough", False)
    assert calibrated(tmp_path, monkeypatch, Fitter(INFO), story).name is ErrorName.CAMERA_DOWN


def test_a_board_that_is_never_held_still_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def pass_by(boards: Boards, frame: Frame) -> bool:
        boards.seen += 1
        return False

    async def story(robot: VirtualRobot) -> RpcError:
        return await refusal(robot.call("calibrate.camera"))

    monkeypatch.setattr(lens, "LIMIT", 3.0)
    monkeypatch.setattr(Boards, "take", pass_by)
    error = calibrated(tmp_path, monkeypatch, Fitter(INFO), story)
    assert error.name is ErrorName.CALIBRATION_FAILED
    assert "hold it still" in error.message


def test_a_board_of_another_size_than_told_is_said_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def story(robot: VirtualRobot) -> RpcError:
        return await refusal(robot.call("calibrate.camera", board="9x6"))

    monkeypatch.setattr(Boards, "enough", False)
    monkeypatch.setattr(Boards, "other", Board(8, 5), raising=False)
    error = calibrated(tmp_path, monkeypatch, Fitter(INFO), story)
    assert error.name is ErrorName.CALIBRATION_FAILED
    assert "8x5 inner corners" in error.message


def test_a_stop_while_it_is_fitted_keeps_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fitter = Fitter(INFO)

    async def story(robot: VirtualRobot) -> RpcError:
        work = asyncio.create_task(robot.call("calibrate.camera"))
        while not fitter.asked:  # noqa: ASYNC110 - nothing tells
            await asyncio.sleep(0.1)
        await robot.call("stop")
        error = await refusal(work)
        assert robot.daemon.perception.witness is None
        return error

    assert calibrated(tmp_path, monkeypatch, fitter, story).name is ErrorName.CANCELLED
    assert not (tmp_path / "storage" / "calibration").exists()


@pytest.mark.parametrize(
    ("params", "says"), [({}, "--board"), ({"board": "9x6"}, "no chessboard of 9x6 inner corners")]
)
def test_without_a_board_it_says_so_when_time_is_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, params: dict[str, Any], says: str
) -> None:
    monkeypatch.setattr(lens, "LIMIT", 3.0)

    async def story(robot: VirtualRobot) -> RpcError:
        return await refusal(robot.call("calibrate.camera", **params))

    error = told(story, tmp_path)
    assert error.name is ErrorName.CALIBRATION_FAILED
    assert says in error.message
