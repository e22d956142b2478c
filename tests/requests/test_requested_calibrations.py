"""Calibrations as the whole daemon answers for them: real motions of the simulated base, scripted estimates."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from omnibotd.control_protocol import RpcError
from omnibotd.core.calibration.looks import Look
from omnibotd.core.calibration.motions import CalibrationMotion, Move, State
from omnibotd.core.calibration.spin import SpinResult
from omnibotd.core.calibration.wheels import Scale
from omnibotd.core.error_name import ErrorName
from omnibotd.core.errors import FrameError
from omnibotd.core.geometry import Pose2D
from omnibotd.core.percept import Verdict
from omnibotd.requests import calibrating
from tests.requested import refusal, told
from tools.sim.virtual_robot import VirtualRobot


class Estimate:
    """Stands in for an estimator: remembers what it was given, answers as told."""

    def __init__(self, answer: Any) -> None:
        self.answer = answer
        self.looks: Sequence[Look] = ()
        self.rest: tuple[Any, ...] = ()

    def __call__(self, looks: Sequence[Look], *rest: Any, **named: Any) -> Any:
        self.looks, self.rest = looks, (*rest, *named.values())
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


def spin_result(verdict: Verdict = Verdict.ACCEPTED) -> SpinResult:
    return SpinResult((80.4, 59.1), (0.01, -0.02), 0.12, 0.0004, 0.31, 70, 6.9, verdict, "the tilt is 1.28 degrees")


@dataclass(frozen=True)
class Wheels:
    """What a WheelsResult offers."""

    radius_left: float = 0.0362
    radius_right: float = 0.0358
    separation: float = 0.229
    radius_sigma: float = 0.001
    ratio_sigma: float = 0.0002
    separation_sigma: float = 0.001
    residual: float = 1.25
    scale: Scale = Scale.NOMINAL
    turned: float = 25.0
    driven: float = 7.2
    verdict: Verdict = Verdict.ACCEPTED
    sentence: str = "measure the drive"

    def with_distance(self, metres: float) -> Wheels:
        """As if 1.2 m had been driven by the result's own scale."""
        return replace(self, radius_left=self.radius_left * metres / 1.2, scale=Scale.DISTANCE)


@pytest.fixture
def spun(monkeypatch: pytest.MonkeyPatch) -> Estimate:
    estimate = Estimate(spin_result())
    monkeypatch.setattr(calibrating, "spin_in_child", estimate)
    return estimate


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Motions of a few seconds: how well they are made is the motions' own affair."""
    out_and_back = (Move(State.DRIVING, 0.4), Move(State.DRIVING, -0.4))
    for name in ("SpinMotion", "BaseMotion"):
        monkeypatch.setattr(calibrating, name, lambda limits: CalibrationMotion(limits, out_and_back))


@pytest.fixture
def rolled(monkeypatch: pytest.MonkeyPatch) -> Estimate:
    estimate = Estimate(Wheels())
    monkeypatch.setattr(calibrating, "wheels_in_child", estimate)
    return estimate


def test_a_spin_turns_once_and_keeps_what_it_learnt(tmp_path: Path, spun: Estimate) -> None:
    heard: list[dict[str, Any]] = []

    async def story(robot: VirtualRobot) -> Any:
        result = await robot.daemon.call("calibrate.spin", {}, heard.append)
        status = await robot.call("status")
        return result, status, robot.store.directory

    result, status, store = told(story, tmp_path)
    yaws = np.unwrap([look.odom_from_base.yaw for look in spun.looks])
    assert 2.0 * math.pi < yaws.max() - yaws.min() < 3.0 * math.pi
    assert len(spun.looks) > 50
    assert spun.rest[0].width == 160
    content = yaml.safe_load((store / "calibration" / "spin.yaml").read_text())
    assert (content["centre"], content["tilt"]) == ([80.4, 59.1], [0.01, -0.02])
    assert content["configured"]["camera.tilt"] == [0.0, 0.0]
    assert result["file"] == str(store / "calibration" / "spin.yaml")
    assert result["tilt_deg"] == pytest.approx(math.degrees(math.hypot(0.01, 0.02)), abs=1e-3)
    assert (result["message"], result["residual"]) == ("the tilt is 1.28 degrees", "0.31 px")
    assert "next start" in result["effect"]
    assert [entry["name"] for entry in status["calibrations"]] == ["spin"]
    shares = [values["progress"] for values in heard]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert [state for state in dict.fromkeys(v["state"] for v in heard) if state != "RESTING"] == [
        "TURNING",
        "ESTIMATING",
    ]


@pytest.mark.usefixtures("short")
def test_at_the_next_start_what_was_learnt_is_in_use(tmp_path: Path, spun: Estimate, rolled: Estimate) -> None:
    async def learn(robot: VirtualRobot) -> None:
        before = robot.daemon.perception.model
        await robot.call("calibrate.spin")
        await robot.call("calibrate.base")
        assert robot.daemon.perception.model is before  # not in mid-flight

    async def look(robot: VirtualRobot) -> Any:
        status = await robot.call("status")
        return robot.daemon.perception.model, robot.daemon.control.drive, status["calibrations"]

    told(learn, tmp_path)
    model, drive, status = told(look, tmp_path)
    assert ((model.cx, model.cy), model.tilt) == ((80.4, 59.1), (0.01, -0.02))
    assert drive.wheel_radius == pytest.approx(0.036)
    assert drive.wheel_ratio == pytest.approx(0.0362 / 0.0358, abs=1e-6)
    assert [(entry["name"], entry["in_use"]) for entry in status] == [("spin", True), ("base", True)]


@pytest.mark.usefixtures("short")
def test_a_spin_that_shows_nothing_keeps_the_result_before(tmp_path: Path, spun: Estimate) -> None:
    async def story(robot: VirtualRobot) -> RpcError:
        await robot.call("calibrate.spin")
        spun.answer = spin_result(Verdict.REJECTED)
        return await refusal(robot.call("calibrate.spin"))

    error = told(story, tmp_path)
    assert (error.name, error.code) == (ErrorName.CALIBRATION_FAILED, 1)
    assert error.message == "the tilt is 1.28 degrees"
    folder = tmp_path / "storage" / "calibration"
    assert [path.name for path in folder.iterdir()] == ["spin.yaml"]


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("fault", [FrameError("a frame is damaged"), ZeroDivisionError("a bug")])
def test_an_estimate_that_breaks_ends_the_job(tmp_path: Path, spun: Estimate, fault: Exception) -> None:
    spun.answer = fault

    async def story(robot: VirtualRobot) -> None:
        assert (await refusal(robot.call("calibrate.spin"))).name is ErrorName.CALIBRATION_FAILED
        assert (await robot.call("status"))["job"] is None

    told(story, tmp_path)
    assert not (tmp_path / "storage" / "calibration").exists()


@pytest.mark.usefixtures("short")
def test_base_measures_wheels(tmp_path: Path, rolled: Estimate) -> None:
    async def story(robot: VirtualRobot) -> Any:
        return await robot.call("calibrate.base")

    result = told(story, tmp_path)
    camera, drive, height = rolled.rest
    assert (camera.width, drive.wheel_separation, height) == (160, 0.23, None)
    assert result["wheel_radius"] == pytest.approx(0.036)
    assert result["wheel_ratio"] == pytest.approx(0.0362 / 0.0358, abs=1e-6)
    content = yaml.safe_load((tmp_path / "storage" / "calibration" / "base.yaml").read_text())
    assert (content["wheel_radius"], content["wheel_separation"], content["scale"]) == (0.036, 0.229, "nominal")
    assert "radius_sigma" not in content  # the radius is still the one configured
    assert content["residual"] == "1.2 times the usual errors"


@pytest.mark.usefixtures("short")
def test_a_tape_tells_the_length_of_the_last_drive(tmp_path: Path, rolled: Estimate) -> None:
    async def story(robot: VirtualRobot) -> tuple[RpcError, float, dict[str, Any]]:
        early = await refusal(robot.call("calibrate.base", distance=1.2))
        await robot.call("calibrate.base")
        began = robot.seconds
        taped = await robot.call("calibrate.base", distance=1.26)
        return early, robot.seconds - began, taped

    early, seconds, taped = told(story, tmp_path)
    assert early.name is ErrorName.INVALID
    assert "mark" in early.message
    assert seconds < 1.0
    assert taped["wheel_radius"] == pytest.approx((0.0362 * 1.05 + 0.0358) / 2.0)
    assert taped["scale"] == "distance"
    assert taped["radius_sigma"] == 0.001


@pytest.mark.usefixtures("short")
def test_a_tape_does_not_measure_a_drive_before_one_that_failed(tmp_path: Path, rolled: Estimate) -> None:
    async def story(robot: VirtualRobot) -> RpcError:
        await robot.call("calibrate.base")
        rolled.answer = Wheels(verdict=Verdict.REJECTED)
        await refusal(robot.call("calibrate.base"))
        return await refusal(robot.call("calibrate.base", distance=1.2))

    assert "no drive to measure" in told(story, tmp_path).message


@pytest.mark.parametrize(
    ("method", "params"),
    [
        ("calibrate.spin", {"turns": 2}),
        ("calibrate.base", {"distance": 0}),
        ("calibrate.base", {"distance": "far"}),
        ("calibrate.camera", {"board": "huge"}),
        ("calibrate.camera", {"board": "1x1"}),
        ("calibrate.camera", {"square": 0}),
        ("calibrate.camera", {"images": "folder"}),
    ],
)
def test_what_makes_no_sense_moves_nothing(tmp_path: Path, method: str, params: dict[str, Any]) -> None:
    async def story(robot: VirtualRobot) -> RpcError:
        error = await refusal(robot.call(method, **params))
        assert (await robot.call("status"))["job"] is None
        return error

    assert told(story, tmp_path).name is ErrorName.INVALID


def test_a_stop_ends_it_and_nothing_is_kept(tmp_path: Path, spun: Estimate) -> None:
    async def story(robot: VirtualRobot) -> RpcError:
        work = asyncio.create_task(robot.call("calibrate.spin"))
        await asyncio.sleep(4.0)
        assert (await refusal(robot.call("calibrate.base"))).name is ErrorName.BUSY
        await robot.call("stop")
        error = await refusal(work)
        await asyncio.sleep(0.5)
        stood = robot.pose
        await asyncio.sleep(1.0)
        assert abs(robot.pose.yaw - stood.yaw) < 1e-3
        assert robot.daemon.perception.witness is None
        return error

    assert told(story, tmp_path).name is ErrorName.CANCELLED
    assert spun.looks == ()
    assert not (tmp_path / "storage" / "calibration").exists()


@pytest.mark.usefixtures("short")
def test_what_is_in_the_way_ends_a_drive(tmp_path: Path, rolled: Estimate) -> None:
    async def story(robot: VirtualRobot) -> RpcError:
        return await refusal(robot.call("calibrate.base"))

    error = told(story, tmp_path, Pose2D(9.5, 0.0, 0.0))  # half a metre from a wall
    assert error.name is ErrorName.BLOCKED
    assert rolled.looks == ()
