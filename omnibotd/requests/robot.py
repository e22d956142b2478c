"""What every request works on: the robot's parts, and the refusals that keep it safe."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any

from omnibotd.config import Config
from omnibotd.control import ControlLoop, Feedback
from omnibotd.control_protocol import RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation.navigator import SURE
from omnibotd.io.camera import Camera
from omnibotd.io.control_server import Session
from omnibotd.io.map_store import MapStore
from omnibotd.io.motor_base import MotorBase
from omnibotd.perception import OffLoop, Perception
from omnibotd.requests.params import Params

Method = Callable[[Params, Session | None, Feedback], Coroutine[Any, Any, dict[str, Any]]]


@dataclass
class Robot:
    """The parts of the daemon that requests read and command."""

    config: Config
    control: ControlLoop
    perception: Perception
    base: MotorBase
    camera: Camera
    store: MapStore
    off_loop: OffLoop

    @staticmethod
    def now() -> float:
        return asyncio.get_running_loop().time()

    def refuse_if_busy(self) -> None:
        if self.control.running is not None:
            raise RpcError.named(ErrorName.BUSY, f"busy with {self.control.running.name}; say stop first")

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
        place, pose = self.control.place, self.control.map_from_base
        if place is None or pose is None or place.confidence < SURE:
            confidence = place.confidence if place else 0.0
            raise RpcError.named(
                ErrorName.LOST, f"{what} not saved: the robot is not sure where it is ({confidence:.2f})"
            )
        return pose

    async def use(self, topo_map: TopoMap) -> None:
        self.refuse_if_busy()
        await self.perception.use(topo_map)
        self.store.set_active(topo_map.name)

    async def edit(self, topo_map: TopoMap) -> None:
        """Save first: an edit that is not on disk has not happened."""
        await self.off_loop(self.store.save, topo_map)
        self.perception.edited(topo_map)
