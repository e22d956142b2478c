"""Trouble for any world: other light, people about, a sloping floor, a camera askew or dirty.

Some stands from before the robot comes, some comes and goes while it is there.

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
from tools.sim.mounting import Tilted, off_the_axle, tilted
from tools.sim.painted_light import LIGHTS, PaintedLight
from tools.sim.people import People
from tools.sim.slope import ANGLE, GENTLE, Slope
from tools.sim.smudges import Blur, Smudges
from tools.sim.world_plugin import World, WorldError

DRIFT = 0.10  # of the wheels' size, unknown to the robot, under the condition `drift`: odometry is that much too short
SLOPES = {"slope": ANGLE, "gentle_slope": GENTLE}
# A floor does not begin to slope after the teaching, nor do wheels grow, nor is the camera mounted anew.
STANDING = (*SLOPES, "drift", "tilt", "offset")
PASSING = (*LIGHTS, "people", "blur", "occluded")  # what may come and go
# All that is usual at once: camera askew and floor not level, so already while teaching; since then another light (each
# in turn), dirt on the lens, and the lens out of focus.
DISTURBED = "disturbed"
_DISTURBED = ("tilt", "offset", "gentle_slope", "blur", "occluded")
CONDITIONS = (*PASSING, *STANDING, DISTURBED)

Relit = Callable[[str], World | None]
"""The world under another light, None where its factory can't make that."""


def expanded(conditions: Collection[str], number: int = 0) -> tuple[str, ...]:
    """With what `disturbed` stands for in the run of this number."""
    if DISTURBED not in conditions:
        return tuple(conditions)
    light = list(LIGHTS)[number % len(LIGHTS)]
    return (light, *_DISTURBED, *(name for name in conditions if name != DISTURBED))


class Effect(Protocol):
    """Changes the picture taken from (x, y, yaw) at t seconds."""

    def __call__(self, image: Image, x: float, y: float, yaw: float, t: float) -> Image: ...


class Stage:
    """A world under conditions, itself a world; `enter` changes them."""

    def __init__(
        self,
        world: World,
        relit: Relit,
        seed: int,
        conditions: Collection[str] = (),
        dock: tuple[float, float, float] | None = None,
    ) -> None:
        """`conditions` are those that stand for good; `dock` is elsewhere than the world's own.

        Raises WorldError where the world's camera_info is no lens.
        """
        self._dock = dock
        self._nominal = self._shown = world
        self._relit, self._seed = relit, seed
        self._lit: dict[str, World | None] = {}
        self.lens = lens_of(world)
        self._off_axle = "offset" in conditions
        self._standing: list[Effect] = [Slope(self.lens, seed, SLOPES[name]) for name in SLOPES if name in conditions]
        self.camera = self.lens  # as it is mounted, which a calibration should find
        if "tilt" in conditions:
            self.camera = tilted(self.lens)
            self._standing.append(Tilted(self.lens))
        self._before: list[Effect] = []  # what the level camera would see
        self._on_lens: list[Effect] = []  # what its own lens adds

    def enter(self, conditions: Collection[str], number: int = 0) -> None:
        """From now on these hold of the passing ones, and no others; `number` says which of many smudged lenses.

        ValueError for more than one light.
        """
        lights = [name for name in conditions if name in LIGHTS]
        if len(lights) > 1:
            raise ValueError(f"{' and '.join(lights)}: there is one light at a time")
        self._shown, self._before, self._on_lens = self._nominal, [], []
        for light in lights:
            own = self._own(light)
            if own is None:
                self._before.append(PaintedLight(LIGHTS[light], self.lens, self.bounds, self._seed))
            else:
                self._shown = own
        if "people" in conditions:
            self._before.append(People(self.lens, self.bounds, self._seed))
        if "blur" in conditions:
            self._on_lens.append(Blur(self.lens, self._seed))
        if "occluded" in conditions:
            self._on_lens.append(Smudges(self.lens, (self._seed, number)))

    def _own(self, light: str) -> World | None:
        """Made once: a room takes a second or two."""
        if light not in self._lit:
            self._lit[light] = self._relit(light)
        return self._lit[light]

    @property
    def fov_deg(self) -> float:
        return self._nominal.fov_deg

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        return self._nominal.bounds

    @property
    def dock(self) -> tuple[float, float, float]:
        return self._nominal.dock if self._dock is None else self._dock

    @property
    def camera_info(self) -> Mapping[str, object] | None:
        return getattr(self._nominal, "camera_info", None)

    def free(self, x: float, y: float, radius: float) -> bool:
        return self._nominal.free(x, y, radius)

    def render(self, x: float, y: float, yaw: float, t: float) -> Image:
        if self._off_axle:
            x, y = off_the_axle(x, y, yaw)
        image = self._shown.render(x, y, yaw, t)
        for effect in (*self._before, *self._standing, *self._on_lens):
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
