"""The drives of section 4.4, and what a mirror or the ceiling camera sees of a room on them."""

from __future__ import annotations

import gzip
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from omnibotd.core.compass.round_view import Ring, RoundView
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame, Image
from tools.real_frames import CALIBRATION, CEILING, FRAMES, TILT
from tools.sim.cone_mirror import ConeMirror, upright
from tools.sim.world import World

Floats = NDArray[np.float64]

RATE = 20.0  # frames a second
# The mirror's image is 230 px in radius; its middle shows little more than the camera, its edge is the mirror's own.
MIRROR = Ring(319.5, 239.5, inner=40.0, outer=228.0)
_REACH = 2.4  # m from the room's middle: its walls are at 3
_TRIES = 20_000  # most random drives of 6 m leave so small a room


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """True poses (n, 3): x, y, heading (not wrapped), a twentieth of a second apart."""

    poses: Floats

    @property
    def turns(self) -> Floats:
        """(n - 1,) rad from frame to frame."""
        return np.diff(self.poses[:, 2])


def drive(seed: int, speed: float, fastest: float, frames: int) -> Drive:
    """At `speed` m/s, with turn rates drawn twice a second within +-`fastest` rad/s and reached with a lag of 0.5 s.

    Of all the drives that the seed gives, the first that stays in the room.
    """
    for attempt in range(_TRIES):
        rng = np.random.default_rng((seed, attempt))
        wanted = rng.uniform(-fastest, fastest, math.ceil(frames / 10)).repeat(10)[:frames]
        rate = np.zeros(frames)
        for i in range(1, frames):
            rate[i] = rate[i - 1] + 0.1 * (wanted[i] - rate[i - 1])
        heading = rng.uniform(-math.pi, math.pi) + np.cumsum(rate) / RATE
        way = heading - rate / (2.0 * RATE)
        steps = speed / RATE * np.stack([np.cos(way), np.sin(way)], 1)
        places = rng.uniform(-_REACH, _REACH, 2) + np.cumsum(steps, axis=0)
        if np.abs(places).max() < _REACH:
            return Drive(np.column_stack([places, heading]))
    raise ValueError(f"no drive of seed {seed} stays within {_REACH} m of the room's middle")


def in_mirror(world: World, driven: Drive) -> list[RoundView]:
    """What a conical mirror half a metre above the floor shows."""
    mirror = ConeMirror(world, upright())
    return [RoundView(_grey(mirror.render(*pose, number / RATE)), MIRROR) for number, pose in enumerate(driven.poses)]


def overhead(world: World, driven: Drive) -> list[Frame]:
    """What the ceiling camera sees."""
    return [Frame(number / RATE, _grey(world.render(*pose, number / RATE))) for number, pose in enumerate(driven.poses)]


def bare(world: World) -> World:
    """The same room with walls that have no edges left: doors and shelves are soft shadows."""
    walls = cv2.GaussianBlur(world.surfaces.walls, (0, 0), 30.0)
    return World(replace(world.surfaces, walls=np.asarray(walls, np.uint8)), world.seed)


@dataclass(frozen=True, slots=True, eq=False)
class Filmed:
    """Real frames, their camera, how high the ceiling is above it (m), and the heading (n,) by the authors' tracker."""

    frames: Sequence[Frame]
    camera: CameraModel
    height: float
    heading: Floats


def filmed(folder: Path) -> Filmed | None:
    """The 200 frames of a car under a grid of lamps; None where they are not here."""
    if not (folder / "data.raw.gz").exists():
        return None
    with gzip.open(folder / "data.raw.gz") as raw:
        pixels = np.frombuffer(raw.read(), np.uint8).reshape(FRAMES, 480, 640)
    # The authors' heading grows clockwise.
    heading = -np.unwrap(np.loadtxt(folder / "golden.txt")[:FRAMES, 2])
    camera = replace(CameraModel.from_camera_info(yaml.safe_load(CALIBRATION), math.radians(190.0)), tilt=TILT)
    frames = [Frame(number / 30.0, picture) for number, picture in enumerate(pixels)]
    return Filmed(frames, camera, CEILING, heading - heading[0])


def _grey(picture: Image) -> Image:
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), np.uint8)
