"""Estimates in a child: what goes over comes back, and what goes wrong is said."""

from __future__ import annotations

import io
import json
import math
import sys
from typing import Any

import cv2
import numpy as np
import pytest

from omnibotd import calibration_process
from omnibotd.calibration_process import EstimateError, main, spin_in_child, wheels_in_child
from omnibotd.core.calibration.looks import Look
from omnibotd.core.calibration.spin import SpinResult
from omnibotd.core.errors import FrameError
from omnibotd.core.geometry import Pose2D
from omnibotd.core.kinematics import DifferentialDrive
from omnibotd.core.percept import Verdict
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame

CAMERA = CameraModel.equidistant(160, 120, math.radians(185.0))
RESULT = SpinResult((80.5, 60.25), (0.01, -0.02), 0.1, 0.0005, 0.3, 70, 6.9, Verdict.ACCEPTED, "good")


def jpeg(grey: int) -> bytes:
    return cv2.imencode(".jpg", np.full((120, 160), grey, np.uint8))[1].tobytes()


LOOKS = [Look(Frame(10.0 + k, jpeg(40 * k)), Pose2D(0.1 * k, -0.2, 0.5 * k)) for k in range(3)]


class _Stdin:
    def __init__(self, data: bytes) -> None:
        self.buffer = io.BytesIO(data)


def in_this_process(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The child's side runs here, so that its estimators can be replaced."""

    class Done:
        returncode = 0

    def run(command: list[str], *, input: bytes, **settings: Any) -> Done:
        assert command[1:] == ["-m", "omnibotd.calibration_process"]
        monkeypatch.setattr(sys, "stdin", _Stdin(input))
        done = Done()
        done.returncode = main()
        done.stdout = capsys.readouterr().out.encode()  # type: ignore[attr-defined]
        return done

    monkeypatch.setattr(calibration_process.os, "nice", lambda value: 0)
    monkeypatch.setattr(calibration_process.subprocess, "run", run)


def test_looks_and_camera_go_over_and_the_result_comes_back(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def estimate(looks: list[Look], camera: CameraModel) -> SpinResult:
        assert looks == LOOKS
        assert camera == CAMERA
        return RESULT

    in_this_process(monkeypatch, capsys)
    monkeypatch.setattr(calibration_process.spin, "estimate", estimate, raising=False)
    assert spin_in_child(LOOKS, CAMERA) == RESULT


def test_a_frame_that_is_none_is_said(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def estimate(*arguments: Any) -> Any:
        assert arguments[2:] == (DifferentialDrive(0.035, 0.23, 1.01), 2.2)
        raise FrameError("frame of 3 bytes is no picture")

    in_this_process(monkeypatch, capsys)
    monkeypatch.setattr(calibration_process.wheels, "estimate", estimate)
    with pytest.raises(EstimateError, match="frame of 3 bytes"):
        wheels_in_child(LOOKS, CAMERA, DifferentialDrive(0.035, 0.23, 1.01), 2.2)


def test_a_child_that_breaks_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibration_process.sys, "executable", "/bin/false")
    with pytest.raises(EstimateError, match="status 1"):
        spin_in_child(LOOKS, CAMERA)


def test_the_answer_is_one_line_of_json(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    in_this_process(monkeypatch, capsys)
    monkeypatch.setattr(calibration_process.spin, "estimate", lambda *arguments: RESULT, raising=False)
    monkeypatch.setattr(
        sys,
        "stdin",
        _Stdin(
            json.dumps(
                {
                    "kind": "spin",
                    "camera": {"width": 160, "height": 120, "fx": 40.0, "fy": 40.0, "cx": 80.0, "cy": 60.0},
                    "looks": [],
                }
            ).encode()
            + b"\n"
        ),
    )
    assert main() == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert json.loads(line)["result"]["verdict"] == "accepted"
