"""Topics of a recording and their JSON: Foxglove's schemas where it has one, with our own members beside.

Every message carries `stamp`, the monotonic seconds all estimates work with, next to the wall clock's `timestamp`.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping
from typing import Any

from omnibotd.core.geometry import Pose2D, Twist2D

CAMERA, ODOM, POSE, CMD_VEL, DECISION = "/camera", "/odom", "/pose", "/cmd_vel", "/decision"
_INFO = 2  # foxglove.Log's level


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


_NUMBER, _TEXT, _WHOLE = {"type": "number"}, {"type": "string"}, {"type": "integer"}
_TIMES = {"timestamp": {"title": "time", **_object(sec=_WHOLE, nsec=_WHOLE)}, "stamp": _NUMBER}
_VECTOR = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
_POSE = _object(position=_VECTOR, orientation=_object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER))
_IMAGE = {"frame_id": _TEXT, "data": {"type": "string", "contentEncoding": "base64"}, "format": _TEXT}
_LOG = {"level": _WHOLE, "message": _TEXT, "name": _TEXT, "file": _TEXT, "line": _WHOLE}

_POSE_IN_FRAME = ("foxglove.PoseInFrame", _object(**_TIMES, frame_id=_TEXT, pose=_POSE))
_SCHEMAS: dict[str, tuple[str, dict[str, Any]]] = {
    CAMERA: (
        "foxglove.CompressedImage",
        _object(**_TIMES, **_IMAGE, odom_from_base=_object(x=_NUMBER, y=_NUMBER, yaw=_NUMBER)),
    ),
    ODOM: _POSE_IN_FRAME,
    POSE: _POSE_IN_FRAME,
    CMD_VEL: ("omnibotd.Twist2D", _object(**_TIMES, vx=_NUMBER, wz=_NUMBER)),
    DECISION: ("foxglove.Log", _object(**_TIMES, **_LOG)),
}


def schemas() -> Mapping[str, tuple[str, bytes]]:
    """By topic, the schema's name and its text."""
    return {topic: (name, json.dumps({"title": name, **schema}).encode()) for topic, (name, schema) in _SCHEMAS.items()}


def image(odom_from_base: Pose2D, jpeg: bytes) -> dict[str, Any]:
    """A frame with the odometry at its stamp, so that a pair never has to be guessed from two topics."""
    pose = {"x": odom_from_base.x, "y": odom_from_base.y, "yaw": odom_from_base.yaw}
    data = base64.b64encode(jpeg).decode("ascii")
    return {"frame_id": "camera", "format": "jpeg", "data": data, "odom_from_base": pose}


def pose_in_frame(frame: str, pose: Pose2D) -> dict[str, Any]:
    half = pose.yaw / 2.0
    position = {"x": pose.x, "y": pose.y, "z": 0.0}
    orientation = {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)}
    return {"frame_id": frame, "pose": {"position": position, "orientation": orientation}}


def twist(value: Twist2D) -> dict[str, Any]:
    return {"vx": value.vx, "wz": value.wz}


def log_line(state: str, text: str) -> dict[str, Any]:
    return {"level": _INFO, "message": text, "name": state, "file": "", "line": 0}


def message(stamp: float, wall_ns: int, content: Mapping[str, Any]) -> bytes:
    """The JSON of a message: its content between the two times."""
    seconds, nanoseconds = divmod(wall_ns, 1_000_000_000)
    times = {"timestamp": {"sec": seconds, "nsec": nanoseconds}, "stamp": stamp}
    return json.dumps(times | dict(content), separators=(",", ":")).encode()


def teaching_frame(data: bytes) -> tuple[float, Pose2D, bytes]:
    """Stamp, odometry and JPEG of a camera message. Raises ValueError, KeyError or TypeError for anything else."""
    content = json.loads(data)
    pose = content["odom_from_base"]
    odom_from_base = Pose2D(float(pose["x"]), float(pose["y"]), float(pose["yaw"]))
    return float(content["stamp"]), odom_from_base, base64.b64decode(content["data"], validate=True)
