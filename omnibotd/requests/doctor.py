"""The answer to `doctor`: what the running daemon knows of its parts, as findings."""

from __future__ import annotations

import asyncio
import os
import shutil
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from omnibotd import findings
from omnibotd.control import Feedback
from omnibotd.core.errors import CoreError
from omnibotd.core.vision.frame import Frame
from omnibotd.findings import Finding, ok, unknown, warning, wrong
from omnibotd.io.camera_v4l2_modes import Stream
from omnibotd.io.control_server import Session
from omnibotd.io.device_names import camera_by_id, serial_by_id
from omnibotd.requests.params import Params
from omnibotd.requests.robot import Method, Robot

WATCHED = 1.0  # s over which the processor is watched
_REDUCTION = 8  # brightness needs no detail


class Doctor:
    """Reads, never changes. Every check is one small method that yields findings."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    def methods(self) -> dict[str, Method]:
        return {"doctor": self._doctor}

    async def _doctor(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        params.end()
        share = await self._own_share()
        found = [*self._camera(), *await self._picture(), *self._base(), *self._calibration()]
        found += [await asyncio.to_thread(self._disk), self._loop(), self._map()]
        return {"findings": [finding.values() for finding in found], "processor_share": round(share, 3)}

    async def _own_share(self) -> float:
        """Of one core, over a second."""
        spent, began = time.process_time(), time.monotonic()
        await asyncio.sleep(WATCHED)
        return (time.process_time() - spent) / (time.monotonic() - began)

    def _camera(self) -> Iterator[Finding]:
        camera, settings = self._robot.camera, self._robot.config.camera
        if not camera.ok(self._robot.now()):
            yield wrong("camera", camera.reason or "no picture for a second", _camera_remedy(settings.source))
            return
        size = f" {camera.size[0]}x{camera.size[1]}" if camera.size else ""
        stream = camera.stream
        form = f"{stream.card}, {stream.mode.fourcc}" if stream else settings.source
        yield ok("camera", f"{form}{size}")
        yield findings.frame_rate(camera.rate_hz, min(settings.fps, stream.mode.fps) if stream else settings.fps)
        if stream is not None:
            yield ok("exposure", _held(stream))
        for told in stream.warnings if stream else ():
            yield warning("camera settings", told, "change the configuration to what the camera can do")
        if settings.source.startswith("/dev/video"):
            yield from _given(
                findings.stable_name("camera", "camera.source", settings.source, camera_by_id(settings.source))
            )

    async def _picture(self) -> list[Finding]:
        frame = self._robot.camera.latest
        if frame is None or not self._robot.camera.ok(self._robot.now()):
            return [unknown("picture", "there is none")]
        try:
            seen = findings.picture(*await self._robot.off_loop(brightness, frame))
        except CoreError as error:
            return [wrong("picture", str(error), "replug the camera; try another cable")]
        perception = self._robot.perception
        refused = [wrong("picture", perception.reason, "see camera in the configuration")] if perception.reason else []
        return [seen, *refused, *_given(findings.dirt(perception.dirt))]

    def _base(self) -> Iterator[Finding]:
        base, settings = self._robot.base, self._robot.config.base
        if not base.connected or base.info is None:
            yield wrong("base", f"{settings.driver} on {settings.port}: {base.reason}", _BASE_REMEDY)
            return
        info = base.info
        yield ok("base", f"{info.driver} {info.board} {info.firmware} on {settings.port}".replace("  ", " "))
        if base.latest is not None and base.latest.emergency_stop:
            yield warning("base", "the emergency stop is pressed", "release it when nobody is in danger")
        yield from _given(findings.stable_name("base", "base.port", settings.port, serial_by_id(settings.port)))

    def _calibration(self) -> Iterator[Finding]:
        stored = {entry["name"]: entry for entry in self._robot.stored().status()} if self._robot.calibrations else {}
        for name, what in (("camera", "the lens"), ("spin", "the camera's axis"), ("base", "the wheels")):
            yield _calibrated(f"calibration {name}", name, what, stored.get(name), self._configured(name))

    def _configured(self, name: str) -> str:
        """Where else than from a calibration the values come from; empty where they are defaults."""
        camera = self._robot.config.camera
        if name == "camera" and camera.calibration is not None:
            return f"from {camera.calibration}"
        return "from the configuration" if name == "spin" and camera.centre is not None else ""

    def _disk(self) -> Finding:
        folder = self._robot.config.storage.directory
        try:
            free = shutil.disk_usage(folder).free
        except OSError as error:
            return wrong("disk", f"{folder}: {error.strerror}", "see storage.directory in the configuration")
        if not os.access(folder, os.W_OK):
            return wrong(
                "disk", f"{folder} can't be written", f"chown omnibotd {folder}; is the disk mounted read-only?"
            )
        return findings.disk(free, str(folder))

    def _loop(self) -> Finding:
        late = sorted(self._robot.control.lateness) or [0.0]
        return findings.loop(late[int(0.99 * (len(late) - 1))], late[-1])

    def _map(self) -> Finding:
        topo_map = self._robot.perception.topo_map
        if topo_map is None:
            return warning("map", "none in use", "record a drive and train it, or say map use NAME")
        return ok("map", f"{topo_map.name}, {len(topo_map)} nodes")


_BASE_REMEDY = (
    "see cable and power, base.driver, base.port and base.baudrate; this user must be in the group `dialout`; "
    "ls -l /dev/serial/by-id shows what is plugged in"
)


def _held(stream: Stream) -> str:
    exposure = "chosen by the camera" if stream.exposure is None else f"held at {1e3 * stream.exposure:g} ms"
    white = "" if stream.white_balance is None else f", white balance at {stream.white_balance} K"
    return exposure + white


def _camera_remedy(source: str) -> str:
    if source.startswith("/dev/"):
        return "see cable and camera.source; ls -l /dev/v4l/by-id shows what is plugged in; the group must be `video`"
    return "see that the stream runs, and camera.source"


def _calibrated(name: str, verb: str, what: str, entry: Any, configured: str) -> Finding:
    say = f"say omnibotctl calibrate {verb}"
    if entry is not None and entry["in_use"]:
        return ok(name, f"of {entry['date']}, residual {entry['residual']}")
    if entry is not None:
        return warning(name, f"of {entry['date']}, not in use: {entry['reason']}", f"{say}, or restart omnibotd")
    return ok(name, configured) if configured else warning(name, f"none: {what} as the configuration has it", say)


def _given(finding: Finding | None) -> Iterator[Finding]:
    if finding is not None:
        yield finding


def brightness(frame: Frame) -> tuple[float, float, float]:
    """Mean, spread, and share of glare of what the lens shows; its black surround counts for nothing. FrameError."""
    grey = frame.grey(_REDUCTION)
    height, width = grey.shape
    middle = grey[height // 4 : -(height // 4) or None, width // 4 : -(width // 4) or None]
    return float(middle.mean()), float(middle.std()), float(np.mean(middle >= findings.BRIGHT))
