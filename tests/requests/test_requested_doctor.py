"""`doctor` as the daemon answers: a well robot, and one thing after the other made ill."""

from __future__ import annotations

import asyncio
import shutil
from collections import deque
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from omnibotd.config import BaseConfig, CameraConfig, Config, StorageConfig
from omnibotd.core.vision.frame import Frame
from omnibotd.findings import Finding, Grade, from_values
from omnibotd.io.camera_v4l2_modes import Mode, Stream
from omnibotd.requests import doctor
from omnibotd.requests.doctor import Doctor
from omnibotd.requests.params import Params
from tests.empty_hall import EmptyHall
from tests.made_maps import made_map
from tools.sim import virtual_time
from tools.sim.virtual_robot import virtual_robot

HALF_LIT = np.tile(np.repeat(np.array([90, 150], np.uint8), 32), (480, 10))


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The processor is watched for no time."""
    monkeypatch.setattr(doctor, "WATCHED", 0.0)


@pytest.fixture
def robot(tmp_path: Path) -> Any:
    """The parts that the doctor looks at, all well."""

    async def off_loop(function: Any, *arguments: Any) -> Any:
        return function(*arguments)

    told = {"date": "2026-01-01", "residual": "0.1", "in_use": True, "reason": ""}
    stored = SimpleNamespace(status=lambda: [{"name": name, **told} for name in ("camera", "spin", "base")])
    return SimpleNamespace(
        config=Config(
            camera=CameraConfig(source="http://127.0.0.1:8090/"),
            base=BaseConfig(driver="omnibot", port="/dev/pts/7"),
            storage=StorageConfig(directory=tmp_path),
        ),
        now=lambda: 5.0,
        off_loop=off_loop,
        camera=SimpleNamespace(
            ok=lambda now: True, reason="", size=(640, 480), stream=None, rate_hz=15.0, latest=Frame(4.9, HALF_LIT)
        ),
        base=SimpleNamespace(
            connected=True,
            reason="",
            info=SimpleNamespace(driver="omnibot", board="Uno", firmware="1.0"),
            latest=SimpleNamespace(emergency_stop=False),
        ),
        control=SimpleNamespace(lateness=deque([0.001] * 100)),
        perception=SimpleNamespace(reason="", topo_map=made_map(), dirt=0.0),
        calibrations=stored,
        stored=lambda: stored,
    )


def found(robot: Any) -> dict[str, Finding]:
    """What the doctor finds, by name: the worst of each."""
    order = [Grade.OK, Grade.UNKNOWN, Grade.WARNING, Grade.WRONG]
    answer = asyncio.run(Doctor(robot)._doctor(Params({}), None, lambda values: None))
    told = from_values(answer["findings"])
    return {finding.name: finding for finding in sorted(told, key=lambda finding: order.index(finding.grade))}


def test_a_well_robot(robot: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=5e9))
    told = found(robot)
    assert {"camera", "frame rate", "picture", "base", "disk", "control loop", "map"} <= set(told)
    assert {finding.grade for finding in told.values()} == {Grade.OK}


def test_the_whole_daemon_answers() -> None:
    async def main() -> dict[str, Any]:
        async with virtual_robot(EmptyHall(), 1) as robot:
            await asyncio.sleep(0.2)
            return await robot.call("doctor")

    answer = virtual_time.run(main())
    told = {finding.name: finding.grade for finding in from_values(answer["findings"])}
    assert told["camera"] is told["base"] is Grade.OK
    assert told["map"] is Grade.WARNING
    assert answer["processor_share"] >= 0.0


def test_a_camera_that_is_gone(robot: Any) -> None:
    robot.camera.ok = lambda now: False
    robot.camera.reason = "/dev/video0: the camera was unplugged"
    told = found(robot)
    assert told["camera"].grade is Grade.WRONG
    assert "unplugged" in told["camera"].found
    assert told["picture"].grade is Grade.UNKNOWN


def test_a_slow_camera(robot: Any) -> None:
    robot.camera.rate_hz = 3.0
    assert found(robot)["frame rate"].grade is Grade.WRONG


def test_a_camera_that_does_not_do_as_it_is_told(robot: Any) -> None:
    mode = Mode("MJPG", 640, 480, Fraction(1, 10))
    robot.camera.rate_hz = 10.0  # what it has agreed to
    robot.camera.stream = Stream("Test Cam", mode, warnings=("camera.exposure is not kept: this camera can't",))
    told = found(robot)
    assert told["camera"].found == "Test Cam, MJPG 640x480"
    assert told["exposure"].found == "chosen by the camera"
    assert told["camera settings"].grade is Grade.WARNING
    assert told["frame rate"].grade is Grade.OK


def test_exposure_and_white_balance_that_are_held_are_told(robot: Any) -> None:
    robot.camera.stream = Stream("Test Cam", Mode("MJPG", 640, 480, Fraction(1, 15)), 0.012, 4600)
    assert found(robot)["exposure"].found == "held at 12 ms, white balance at 4600 K"


@pytest.mark.parametrize(
    ("pixels", "grade"),
    [
        (np.full((480, 640), 3, np.uint8), Grade.WRONG),
        (np.tile(np.repeat(np.array([0, 30], np.uint8), 32), (480, 10)), Grade.WARNING),
        (np.tile(np.repeat(np.array([90, 255], np.uint8), 32), (480, 10)), Grade.WARNING),
        (HALF_LIT, Grade.OK),
    ],
)
def test_pictures_that_show_nothing_too_little_and_too_much(robot: Any, pixels: np.ndarray, grade: Grade) -> None:
    robot.camera.latest = Frame(4.9, pixels)
    assert found(robot)["picture"].grade is grade


def test_a_lens_that_is_to_be_wiped(robot: Any) -> None:
    robot.perception.dirt = 0.08
    assert found(robot)["lens"].grade is Grade.WARNING


def test_a_picture_that_is_none_and_one_that_perception_refuses(robot: Any) -> None:
    robot.perception.reason = "frame is about 320x240 px, the camera model is for 640x480"
    told = found(robot)["picture"]
    assert told.grade is Grade.WRONG
    assert "320x240" in told.found
    robot.camera.latest = Frame(4.9, b"no picture at all")
    assert "no picture that OpenCV can decode" in found(robot)["picture"].found


def test_a_base_that_fell_silent_and_one_that_is_stopped(robot: Any) -> None:
    robot.base.latest.emergency_stop = True
    assert found(robot)["base"].grade is Grade.WARNING
    robot.base.connected, robot.base.reason = False, "no answer in 10 s"
    told = found(robot)["base"]
    assert (told.grade, told.found) == (Grade.WRONG, "omnibot on /dev/pts/7: no answer in 10 s")
    assert "base.port" in told.remedy


def test_a_full_disk_and_a_folder_that_is_read_only_or_gone(robot: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=5e6))
    assert found(robot)["disk"].grade is Grade.WRONG
    monkeypatch.setattr(doctor.os, "access", lambda *_: False)
    assert "can't be written" in found(robot)["disk"].found
    monkeypatch.undo()
    robot.config.storage.directory.rmdir()
    assert found(robot)["disk"].grade is Grade.WRONG


def test_a_late_loop(robot: Any) -> None:
    robot.control.lateness.extend([0.2] * 10)
    assert found(robot)["control loop"].grade is Grade.WRONG


def test_no_map(robot: Any) -> None:
    robot.perception.topo_map = None
    assert found(robot)["map"].grade is Grade.WARNING


def test_a_calibration_that_is_ignored_and_those_there_are_none_of(robot: Any) -> None:
    entry = {"name": "base", "date": "2026-01-01", "residual": "1 %", "in_use": False, "reason": "changed since"}
    robot.calibrations.status = lambda: [entry]
    told = found(robot)
    assert "changed since" in told["calibration base"].found
    assert told["calibration base"].grade is told["calibration camera"].grade is Grade.WARNING
    assert "omnibotctl calibrate camera" in told["calibration camera"].remedy
