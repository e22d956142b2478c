"""The answer to `status`: everything a person wants to see at a glance."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

from omnibotd import __version__
from omnibotd.control import PERIOD, Feedback
from omnibotd.core.geometry import Pose2D
from omnibotd.io.camera_v4l2_modes import Stream
from omnibotd.io.control_server import Session
from omnibotd.requests.failures import Failures
from omnibotd.requests.params import Params, pose_values
from omnibotd.requests.robot import Method, Robot
from omnibotd.requests.teaching import Teaching


class Status:
    """Reads, never changes."""

    def __init__(self, robot: Robot, teaching: Teaching, failures: Failures) -> None:
        self._robot, self._teaching, self._failures = robot, teaching, failures
        self._started = robot.now()

    def methods(self) -> dict[str, Method]:
        return {
            "status": self._status,
        }

    async def _status(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        params.end()
        now = self._robot.now()
        control, place = self._robot.control, self._robot.control.place
        battery = self._robot.base.latest.battery if self._robot.base.latest else None
        return {
            "version": __version__,
            "uptime_s": round(now - self._started, 1),
            "state": control.state,
            "map": self._robot.perception.topo_map.name if self._robot.perception.topo_map else None,
            "pose": pose_values(control.map_from_base),
            "confidence": place.confidence if place else 0.0,
            "sigma": place.sigma if place else None,
            "place": self._named_place(control.map_from_base),
            "battery": battery,
            "charging": self._robot.base.latest.charging if self._robot.base.latest else None,
            "twist": {"vx": control.twist.vx, "wz": control.twist.wz},
            "job": self._job_status(now),
            "recording": self._teaching.status(now),
            "training": self._teaching.training,
            "last_failure": self._failures.last,
            "base": self._base_status(),
            "camera": self._camera_status(now),
            "calibrations": self._robot.calibrations.status() if self._robot.calibrations else [],
            "loop": self._loop_status(),
            "memory_mb": _resident_mb(),
        }

    def _job_status(self, now: float) -> dict[str, Any] | None:
        running = self._robot.control.running
        return None if running is None else {"name": running.name, **self._robot.control.progress(running, now)}

    def _base_status(self) -> dict[str, Any]:
        info = self._robot.base.info
        return {
            "connected": self._robot.base.connected,
            "driver": info.driver if info else self._robot.config.base.driver,
            "board": info.board if info else None,
            "firmware": info.firmware if info else None,
            "reason": self._robot.base.reason,
        }

    def _camera_status(self, now: float) -> dict[str, Any]:
        size = self._robot.camera.size or (None, None)
        return {
            "source": self._robot.config.camera.source,
            "ok": self._robot.camera.ok(now),
            "rate_hz": round(self._robot.camera.rate_hz, 1),
            "age_s": round(self._robot.camera.age(now), 2) if math.isfinite(self._robot.camera.age(now)) else None,
            "width": size[0],
            "height": size[1],
            "reason": self._robot.camera.reason or self._robot.perception.reason,
            "stream": _stream_values(self._robot.camera.stream),
        }

    def _loop_status(self) -> dict[str, Any]:
        late = sorted(self._robot.control.lateness) or [0.0]
        return {
            "period_ms": PERIOD * 1e3,
            "late_ms_p99": round(late[int(0.99 * (len(late) - 1))] * 1e3, 2),
            "late_ms_max": round(late[-1] * 1e3, 2),
            "ticks": self._robot.control.ticks,
            "late_ticks": self._robot.control.late_ticks,
        }

    def _named_place(self, here: Pose2D | None) -> str | None:
        """The named place or dock the robot stands at, within half a metre."""
        topo_map = self._robot.perception.topo_map
        if here is None or topo_map is None or not (topo_map.places or topo_map.docks):
            return None
        docks = {name: dock.map_from_dock for name, dock in topo_map.docks.items()}
        name, pose = min({**docks, **topo_map.places}.items(), key=lambda item: item[1].distance(here))
        return name if pose.distance(here) < 0.5 else None


def _stream_values(stream: Stream | None) -> dict[str, Any] | None:
    """What a V4L2 camera settled on; exposure and white balance are null where the camera chooses them."""
    if stream is None:
        return None
    return {
        "card": stream.card,
        "format": stream.mode.fourcc,
        "fps": round(stream.mode.fps, 2),
        "exposure_s": stream.exposure,
        "white_balance_k": stream.white_balance,
        "warnings": list(stream.warnings),
    }


def _resident_mb() -> float:
    """Memory of this process that is really in use (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return round(pages * os.sysconf("SC_PAGE_SIZE") / 2**20, 1)
