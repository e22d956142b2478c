"""What every request works on: the robot's parts, and the refusals that keep it safe."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from omnibotd.calibrations import Calibrations
from omnibotd.config import Config
from omnibotd.control import PERIOD, ControlLoop, Feedback
from omnibotd.control_protocol import RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation.navigator import SURE
from omnibotd.core.vision.frame import Frame, mean_of
from omnibotd.io.camera import Camera
from omnibotd.io.control_server import Session
from omnibotd.io.map_store import MapStore, MapStoreError
from omnibotd.io.motor_base import MotorBase
from omnibotd.perception import OffLoop, Perception
from omnibotd.recognition import Recogniser
from omnibotd.requests.params import Params

STILL_FRAMES, STILL_TIME = 8, 5.0  # for one picture without noise, and the seconds they may take

Method = Callable[[Params, Session | None, Feedback], Coroutine[Any, Any, dict[str, Any]]]


@dataclass
class Robot:
    """The parts of the daemon that requests read and command.

    `editing` is held by whoever changes a stored map: two edits at once would lose one. `goals` are those of the last
    job. `stops` counts the requests to stop: a job that was asked for before one must not start after it.
    """

    config: Config
    control: ControlLoop
    perception: Perception
    recogniser: Recogniser
    base: MotorBase
    camera: Camera
    store: MapStore
    off_loop: OffLoop
    calibrations: Calibrations | None = None
    editing: asyncio.Lock = field(default_factory=asyncio.Lock)
    goals: tuple[Pose2D, ...] = ()
    stops: int = 0

    @staticmethod
    def now() -> float:
        return asyncio.get_running_loop().time()

    def refuse_if_busy(self) -> None:
        if self.control.running is not None:
            raise RpcError.named(ErrorName.BUSY, f"busy with {self.control.running.name}; say stop first")
        if self.perception.loading is not None:
            raise RpcError.named(ErrorName.BUSY, f"map {self.perception.loading!r} is being loaded; try again")

    async def until_loaded(self) -> None:
        """Wait for a map that is being made ready; a stop meanwhile ends the request."""
        stops = self.stops
        while self.perception.loading is not None:
            await asyncio.sleep(PERIOD)
            self.refuse_if_stopped(stops)

    def refuse_if_stopped(self, stops: int) -> None:
        """Where a stop came since `stops` was read."""
        if self.stops != stops:
            raise RpcError.named(ErrorName.CANCELLED, "stopped on request")

    def refuse_if_unsafe(self) -> None:
        if self.base.latest is not None and self.base.latest.emergency_stop:
            raise RpcError.named(ErrorName.EMERGENCY_STOP, "the emergency stop is pressed; release it first")
        if not self.base.connected:
            raise RpcError.named(ErrorName.BASE_LINK_DOWN, f"the base does not answer: {self.base.reason}")

    def active_map(self) -> TopoMap:
        if self.perception.topo_map is None:
            raise RpcError.named(ErrorName.NO_MAP, "no map in use; say map use NAME, or record and train one")
        return self.perception.topo_map

    def sure_pose(self, what: str) -> Pose2D:
        pose = self.known_pose()
        if pose is None:
            confidence = self.control.place.confidence if self.control.place else 0.0
            raise RpcError.named(
                ErrorName.LOST, f"{what} not saved: the robot is not sure where it is ({confidence:.2f})"
            )
        return pose

    def known_pose(self) -> Pose2D | None:
        """Where the robot is in the map, None while that is not sure."""
        place = self.control.place
        return self.control.map_from_base if place is not None and place.confidence >= SURE else None

    def stored(self) -> Calibrations:
        """Where results of calibrations are kept."""
        if self.calibrations is None:
            raise RpcError.named(ErrorName.STORAGE, "this daemon keeps no calibrations")
        return self.calibrations

    async def still(self) -> Frame:
        """What a robot at rest sees, the mean of a few frames: in the dark one is mostly noise. Raises RpcError."""
        frames: list[Frame] = []
        began = self.now()
        try:
            async with asyncio.timeout(STILL_TIME):
                while len(frames) < STILL_FRAMES:
                    frames.append(await self.camera.wait_newer(frames[-1].stamp if frames else began))
        except TimeoutError:
            reason = self.camera.reason or f"{len(frames)} pictures came in {STILL_TIME:.0f} s"
            raise RpcError.named(ErrorName.CAMERA_DOWN, f"no picture of the dock: {reason}") from None
        if self.control.moved_at >= began:
            raise RpcError.named(ErrorName.BUSY, "the robot was driven while it looked; let it rest")
        return await self.off_loop(mean_of, frames)  # type: ignore[no-any-return]

    def is_active(self, name: str) -> bool:
        return self.perception.topo_map is not None and self.perception.topo_map.name == name

    async def use(self, topo_map: TopoMap) -> None:
        self.refuse_if_busy()
        await self.perception.use(topo_map)
        await self.recogniser.chosen()
        await asyncio.to_thread(self.store.set_active, topo_map.name)

    async def edit(self, change: Callable[[TopoMap], TopoMap]) -> None:
        """Change places or docks of the active map. Save first: an edit that is not on disk has not happened."""
        async with self.editing:
            topo_map = change(self.active_map())
            await asyncio.to_thread(self._save_edited, topo_map)
            if self.is_active(topo_map.name):
                self.perception.edited(topo_map)

    def _save_edited(self, topo_map: TopoMap) -> None:
        """Unless the file has other nodes by now: it was trained while a job ran, and is not in use yet."""
        with suppress(MapStoreError):
            if not np.array_equal(self.store.load(topo_map.name).poses, topo_map.poses):
                message = (
                    f"map {topo_map.name!r} was made anew and is not in use yet: say map use {topo_map.name} first"
                )
                raise RpcError.named(ErrorName.BUSY, message)
        self.store.save(topo_map)
