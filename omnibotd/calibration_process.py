"""Estimates of `calibrate spin` and `calibrate base` in a child process: they take many seconds and 150 MB.

`python -m omnibotd.calibration_process` reads a line of JSON, {"kind", "camera", "drive", "ceiling_height", "looks":
[[stamp, x, y, yaw, bytes], …]}, and behind it the JPEGs of all looks; it answers {"result": {…}} or {"error": text}.
Blocking: call it from a thread.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, BinaryIO

import cv2

from omnibotd.core.calibration import spin, wheels
from omnibotd.core.calibration.looks import Look
from omnibotd.core.errors import CoreError
from omnibotd.core.geometry import Pose2D
from omnibotd.core.kinematics import DifferentialDrive
from omnibotd.core.percept import Verdict
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame

NICENESS = 15  # the control loop goes on
LIMIT = 900.0  # s; an Atom takes two minutes


class EstimateError(CoreError):
    """No estimate was made; the sentence says why."""


def spin_in_child(looks: Sequence[Look], camera: CameraModel) -> spin.SpinResult:
    """Raises EstimateError."""
    values = _ask({"kind": "spin", "camera": asdict(camera)}, looks)
    pairs = {key: tuple(values[key]) for key in ("centre", "tilt")}
    return spin.SpinResult(**{**values, **pairs, "verdict": Verdict(values["verdict"])})


def wheels_in_child(
    looks: Sequence[Look], camera: CameraModel, drive: DifferentialDrive, ceiling_height: float | None
) -> wheels.WheelsResult:
    """Raises EstimateError."""
    task = {"kind": "base", "camera": asdict(camera), "drive": asdict(drive), "ceiling_height": ceiling_height}
    values = _ask(task, looks)
    scale = wheels.Scale(values["scale"])
    return wheels.WheelsResult(**{**values, "scale": scale, "verdict": Verdict(values["verdict"])})


def _ask(task: dict[str, Any], looks: Sequence[Look]) -> dict[str, Any]:
    jpegs = [look.frame.jpeg() for look in looks]
    rows = [
        [look.frame.stamp, look.odom_from_base.x, look.odom_from_base.y, look.odom_from_base.yaw, len(jpeg)]
        for look, jpeg in zip(looks, jpegs, strict=True)
    ]
    line = json.dumps({**task, "looks": rows}).encode() + b"\n"
    command = [sys.executable, "-m", "omnibotd.calibration_process"]
    try:
        done = subprocess.run(
            command, input=b"".join([line, *jpegs]), stdout=subprocess.PIPE, timeout=LIMIT, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise EstimateError(f"the estimate was not made within {LIMIT / 60:.0f} minutes") from error
    answer: dict[str, Any] = json.loads(done.stdout) if done.stdout else {}
    if "result" not in answer:
        raise EstimateError(answer.get("error", f"the estimate ended with status {done.returncode}, see the log"))
    result: dict[str, Any] = answer["result"]
    return result


def _looks(stream: BinaryIO, rows: Sequence[Sequence[float]]) -> list[Look]:
    return [Look(Frame(stamp, stream.read(int(size))), Pose2D(x, y, yaw)) for stamp, x, y, yaw, size in rows]


def _estimate(task: dict[str, Any], looks: Sequence[Look]) -> spin.SpinResult | wheels.WheelsResult:
    fields: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in task["camera"].items()}
    camera = CameraModel(**fields)
    if task["kind"] == "spin":
        return spin.estimate(looks, camera)
    return wheels.estimate(looks, camera, DifferentialDrive(**task["drive"]), task["ceiling_height"])


def main() -> int:
    """The child's side."""
    os.nice(NICENESS)
    cv2.setNumThreads(1)
    task = json.loads(sys.stdin.buffer.readline())
    try:
        result = _estimate(task, _looks(sys.stdin.buffer, task["looks"]))
    except CoreError as error:
        print(json.dumps({"error": str(error)}))
        return 1
    print(json.dumps({"result": asdict(result)}, default=float))
    return 0


if __name__ == "__main__":
    sys.exit(main())
