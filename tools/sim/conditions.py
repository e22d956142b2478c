"""Trouble for any world: other light, people about, a sloping floor; set before the robot comes or while it is there.

A light is the world's own where its factory makes it; else the picture is changed as that light would change it. No
condition moves what the robot can bump into.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from typing import Protocol

from omnibotd.core.errors import CoreError
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame, Image
from omnibotd.perception import CIRCLE_FRAMES, find_lens
from tools.sim.painted_light import LIGHTS, PaintedLight
from tools.sim.people import People
from tools.sim.slope import Slope
from tools.sim.world_plugin import World, WorldError

DRIFT = 0.10  # of the wheels' size, unknown to the robot, under the condition `drift`: odometry is that much too short
STANDING = ("slope", "drift")  # a floor does not begin to slope after the teaching, nor do wheels grow
PASSING = (*LIGHTS, "people")  # what may come and go
CONDITIONS = (*PASSING, *STANDING)

Relit = Callable[[str], World | None]
"""The world under another light, None where its factory can't make that."""


class Effect(Protocol):
    """Changes the picture taken from (x, y, yaw) at t seconds."""

    def __call__(self, image: Image, x: float, y: float, yaw: float, t: float) -> Image: ...


class Stage:
    """A world under conditions, itself a world; `enter` changes them."""

    def __init__(self, world: World, relit: Relit, seed: int, conditions: Collection[str] = ()) -> None:
        """`conditions` are those that stand for good. Raises WorldError where the world's camera_info is no lens."""
        self._nominal = self._shown = world
        self._relit, self._seed = relit, seed
        self._lens = lens_of(world)
        self._slope = [Slope(self._lens, seed)] if "slope" in conditions else []
        self._passing: list[Effect] = []

    def enter(self, conditions: Collection[str]) -> None:
        """From now on these hold of the passing ones, and no others. ValueError for more than one light."""
        lights = [name for name in conditions if name in LIGHTS]
        if len(lights) > 1:
            raise ValueError(f"{' and '.join(lights)}: there is one light at a time")
        self._shown, self._passing = self._nominal, []
        for light in lights:
            own = self._relit(light)
            if own is None:
                self._passing.append(PaintedLight(LIGHTS[light], self._lens, self.bounds, self._seed))
            else:
                self._shown = own
        if "people" in conditions:
            self._passing.append(People(self._lens, self.bounds, self._seed))

    @property
    def fov_deg(self) -> float:
        return self._nominal.fov_deg

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        return self._nominal.bounds

    @property
    def dock(self) -> tuple[float, float, float]:
        return self._nominal.dock

    @property
    def camera_info(self) -> Mapping[str, object] | None:
        return getattr(self._nominal, "camera_info", None)

    def free(self, x: float, y: float, radius: float) -> bool:
        return self._nominal.free(x, y, radius)

    def render(self, x: float, y: float, yaw: float, t: float) -> Image:
        image = self._shown.render(x, y, yaw, t)
        for effect in (*self._passing, *self._slope):
            image = effect(image, x, y, yaw, t)
        return image


def lens_of(world: World) -> CameraModel:
    """The world's lens: from its camera_info, else the image circle of its pictures, as the daemon finds it."""
    fov = math.radians(world.fov_deg)
    info = getattr(world, "camera_info", None)
    if not isinstance(info, Mapping):
        x, y, yaw = world.dock
        return find_lens([Frame(0.0, world.render(x, y, yaw + k, float(k))) for k in range(CIRCLE_FRAMES)], fov)
    try:
        return CameraModel.from_camera_info(info, fov)
    except CoreError as error:
        raise WorldError(f"the world's {error}") from error
