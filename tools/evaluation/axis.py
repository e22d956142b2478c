"""The optical axis that a robot believes its camera to have, as `calibrate spin` measures it or as it truly is."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omnibotd import calibrations
from omnibotd.config import load
from omnibotd.core.geometry import Pose2D
from tools.sim.conditions import Stage
from tools.sim.virtual_robot import STORAGE, VirtualRobot, virtual_robot
from tools.sim.world_plugin import World

OWN, KNOWN, NONE = "own", "known", "none"
CALIBRATIONS = (OWN, KNOWN, NONE)


class NotCalibrated(Exception):
    """The daemon does not work with the calibration that it was given."""


@dataclass(frozen=True, slots=True)
class Axis:
    """Optical centre (px) and tilt (rad) as the configuration has them."""

    centre: tuple[float, float]
    tilt: tuple[float, float]

    def store(self, directory: Path) -> None:
        """As the result of `calibrate spin`, for the robot whose configuration is in the folder."""
        content = {"residual": "unknown", "centre": list(self.centre), "tilt": list(self.tilt)}
        calibrations.write(directory / STORAGE, "spin", content, load(directory / "omnibotd.yaml"))


def known(stage: Stage) -> Axis:
    """What is true of a stage's camera."""
    return Axis((stage.camera.cx, stage.camera.cy), stage.camera.tilt)


async def measured(world: World, seed: int, start: Pose2D) -> Axis:
    """What the robot's own `calibrate spin` makes of it. Raises RpcError where it refuses."""
    async with virtual_robot(world, seed, start) as robot:
        reply = await robot.call("calibrate.spin")
    (u, v), (x, y) = reply["centre"], reply["tilt"]
    return Axis((float(u), float(v)), (float(x), float(y)))


@asynccontextmanager
async def robot_with(
    axis: Axis | None, world: World, seed: int, start: Pose2D, directory: Path, **options: Any
) -> AsyncIterator[VirtualRobot]:
    """`virtual_robot` in a folder, with this axis stored before it starts. Raises NotCalibrated."""
    if axis is not None:
        VirtualRobot(world, seed, start, directory, **options)  # writes its configuration
        axis.store(directory)
    async with virtual_robot(world, seed, start, directory=directory, **options) as robot:
        model = robot.daemon.perception.model
        if axis is not None and (model is None or model.tilt != axis.tilt):
            raise NotCalibrated(f"the daemon's camera has tilt {model and model.tilt}, stored was {axis.tilt}")
        yield robot
