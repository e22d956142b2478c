"""Teaching drives and training: `record` and `train`."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omnibotd.config import MappingConfig
from omnibotd.control import Feedback
from omnibotd.control_protocol import RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.core.errors import CoreError
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.io.control_server import Session
from omnibotd.io.map_store import MapStore, MapStoreError
from omnibotd.io.recorder import Recorder
from omnibotd.io.recording import RecordingError
from omnibotd.requests.params import Params
from omnibotd.requests.robot import Method, Robot
from omnibotd.requests.summary import summary

# (recording, name, store, lens, progress, preset, fresh, limits)
Trainer = Callable[
    [Path, str, MapStore, CameraModel, Callable[[str, float], None], str, bool, MappingConfig], Awaitable[TopoMap]
]
COVERAGE_CELL = 0.25  # m; a place seen once per such square is a place the map knows
LENS_LIMIT = 10.0  # s; a webcam takes 1-3 s to its first picture
SHORT_DRIVE = 5.0  # m; a shorter teaching drive rarely closes a loop
FAINT = 0.2  # contrast; sensor noise alone makes 0.1, the faintest of a dozen ceilings and lights tried 0.38


@dataclass
class Recording:
    """A teaching drive in progress."""

    name: str
    recorder: Recorder
    started: float
    distance: float
    cells: set[tuple[int, int]]


class Teaching:
    """One recording and one training at a time."""

    def __init__(self, robot: Robot, trainer: Trainer, open_recorder: Callable[[Path], Recorder]) -> None:
        self._robot, self._trainer, self._open_recorder = robot, trainer, open_recorder
        self._recording: Recording | None = None
        self.training: str | None = None
        self._trainer_task: asyncio.Future[TopoMap] | None = None

    def methods(self) -> dict[str, Method]:
        return {
            "record.start": self._record_start,
            "record.stop": self._record_stop,
            "train": self._train,
        }

    async def _record_start(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        name = params.name("map")
        params.end()
        if self._recording is not None:
            raise RpcError.named(ErrorName.BUSY, f"already recording {self._recording.name!r}; say record stop first")
        if not self._robot.camera.ok(self._robot.now()):
            raise RpcError.named(ErrorName.CAMERA_DOWN, f"no pictures to record: {self._robot.camera.reason}")
        if not self._robot.base.connected:
            raise RpcError.named(ErrorName.BASE_LINK_DOWN, f"no odometry to record: {self._robot.base.reason}")
        path = await asyncio.to_thread(_new_recording_path, self._robot.store, name)
        try:
            recorder = await self._robot.off_loop(self._open_recorder, path)
        except OSError as error:
            raise RpcError.named(ErrorName.STORAGE, f"{path}: {error.strerror}") from error
        self._recording = Recording(name, recorder, self._robot.now(), self._robot.control.odometry.distance, set())
        self._robot.control.recorder = recorder
        return {"map": name, "path": str(path)}

    async def _record_stop(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        params.end()
        if self._recording is None:
            raise RpcError.named(ErrorName.INVALID, "no recording is running")
        return await self._end(self._recording)

    async def close(self) -> None:
        """Ends a running recording whole and a training, as the daemon stops."""
        self.cancel_training()
        if self._recording is not None:
            await self._end(self._recording)

    async def _end(self, recording: Recording) -> dict[str, Any]:
        """Close the file; the summary warns of what will make a poor map."""
        status = self.status(self._robot.now()) or {}
        self._recording, self._robot.control.recorder = None, None
        await self._robot.off_loop(recording.recorder.close)
        status["warnings"] = _recording_warnings(status)
        return status

    def _note_coverage(self, recording: Recording) -> None:
        pose = self._robot.control.odometry.odom_from_base
        recording.cells.add((math.floor(pose.x / COVERAGE_CELL), math.floor(pose.y / COVERAGE_CELL)))

    async def watch_recording(self) -> None:
        """Notes which floor a running recording has covered, for ever."""
        while True:
            await asyncio.sleep(0.5)
            if self._recording is not None:
                self._note_coverage(self._recording)

    def status(self, now: float) -> dict[str, Any] | None:
        recording = self._recording
        if recording is None:
            return None
        self._note_coverage(recording)
        return {
            "map": recording.name,
            "seconds": round(now - recording.started, 1),
            "distance_m": round(self._robot.control.odometry.distance - recording.distance, 2),
            "frames": recording.recorder.frames,
            "dropped": recording.recorder.dropped,
            "bytes": recording.recorder.bytes_written,
            "coverage_m2": round(len(recording.cells) * COVERAGE_CELL**2, 2),
            "error": recording.recorder.error,
        }

    async def _train(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        name, fresh = params.name("map"), params.flag("fresh")
        params.end()
        if self.training is not None:
            raise RpcError.named(ErrorName.BUSY, f"map {self.training!r} is being trained")
        if self._recording is not None and self._recording.name == name:
            raise RpcError.named(ErrorName.BUSY, f"{name!r} is still being recorded; say record stop first")
        recording = self._robot.store.recording_path(name)
        began = self._robot.now()
        topo_map = await self._trained(name, recording, await self._lens(), fresh, feedback)
        warnings = _map_warnings(topo_map)
        active = self._robot.perception.topo_map
        if self._robot.control.running is not None:
            warnings.append(f"not in use yet, a job is running: say map use {name} when it has ended")
        elif active is None or active.name == name:
            await self._robot.use(topo_map)
        seconds = round(self._robot.now() - began, 1)
        return {**summary(self._robot.store, topo_map), "seconds": seconds, "warnings": warnings}

    async def _lens(self) -> CameraModel:
        """The camera's lens, which is known a few frames after the start."""
        perception = self._robot.perception
        with suppress(TimeoutError):
            await asyncio.wait_for(perception.lens_known.wait(), LENS_LIMIT)
        if perception.model is None:
            reason = self._robot.camera.reason or perception.reason
            raise RpcError.named(ErrorName.CAMERA_DOWN, f"the lens is not known before pictures come: {reason}")
        return perception.model

    async def _trained(
        self, name: str, recording: Path, model: CameraModel, fresh: bool, feedback: Feedback
    ) -> TopoMap:
        def progress(stage: str, share: float) -> None:
            feedback({"stage": stage, "progress": share})

        self.training = name
        config, store = self._robot.config, self._robot.store
        self._trainer_task = asyncio.ensure_future(
            self._trainer(recording, name, store, model, progress, config.navigation.preset, fresh, config.mapping)
        )
        try:
            return await self._trainer_task
        except asyncio.CancelledError:
            raise RpcError.named(
                ErrorName.CANCELLED, f"training of {name!r} was stopped; its recording is kept"
            ) from None
        except (CoreError, RecordingError) as error:
            raise RpcError.named(ErrorName.TRAINING_FAILED, str(error)) from error
        finally:
            self.training, self._trainer_task = None, None

    def cancel_training(self) -> None:
        """End a running training; what was recorded and trained before stays."""
        if self._trainer_task is not None:
            self._trainer_task.cancel()


def _new_recording_path(store: MapStore, name: str) -> Path:
    """The next on disk that the map was not made from: it may come from another computer, or its recordings be gone."""
    path = store.new_recording_path(name)
    known: tuple[str, ...] = ()
    with suppress(MapStoreError):  # no such map yet, or a damaged one
        known = store.load(name).recordings
    number = int(path.name.split(".")[1])
    while path.name in known:
        number += 1
        path = path.with_name(f"{name}.{number:04}.mcap")
    return path


def _recording_warnings(status: dict[str, Any]) -> list[str]:
    warnings = []
    if status["distance_m"] < SHORT_DRIVE:
        warnings.append(f"only {status['distance_m']:.1f} m driven; drive every part of the floor you want to use")
    if status["dropped"]:
        warnings.append(f"{status['dropped']} frames lost: the disk is too slow")
    if status["error"]:
        warnings.append(status["error"])
    return warnings


def _map_warnings(topo_map: TopoMap) -> list[str]:
    warnings = []
    if topo_map.statistics.get("ambiguity", 0.0) > 0.1:
        share = topo_map.statistics["ambiguity"]
        warnings.append(f"repetitive ceiling: {share:.0%} of the places look like another one more than 0.5 m away")
    if topo_map.statistics.get("contrast", math.inf) < FAINT:
        warnings.append("plain ceiling: little to see; expect less accuracy")
    return warnings
