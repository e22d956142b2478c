"""A room's surfaces from an equirectangular HDR photograph, seen from the room's centre at camera height."""

from __future__ import annotations

import math
import os
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from tools.sim.lens import Image, Sensor
from tools.sim.lighting import strip_points, strip_shape
from tools.sim.room import CEILING_SCALE, WALL_SCALE, Room

PHOTOGRAPHS = ("lobby", "workshop", "hall", "apartment")
_KEY = 0.42  # the grey, gamma-coded, that the median of the upper hemisphere becomes

Floats = NDArray[np.float64]


class PanoramaError(RuntimeError):
    """A photograph that is not there or can't be read."""


def data_folder() -> Path:
    """The folder of shared data: OMNIBOT_DATA, else ../shared/data beside the checkout."""
    given = os.environ.get("OMNIBOT_DATA")
    return Path(given) if given else Path(__file__).resolve().parents[3] / "shared" / "data"


def load_panorama(seed: int, room: Room) -> tuple[Image, Image]:
    """(ceiling, walls) textures from photograph `seed` modulo their count, turned at random."""
    path = data_folder() / "ceilings_hdr" / f"{PHOTOGRAPHS[seed % len(PHOTOGRAPHS)]}.hdr"
    if not path.exists():
        raise PanoramaError(f"{path} is missing: set OMNIBOT_DATA to the folder that holds ceilings_hdr/")
    radiance = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if radiance is None or radiance.dtype != np.float32:
        raise PanoramaError(f"{path} is no HDR picture that OpenCV can read")
    picture = _tone_map(np.asarray(radiance, np.float32))
    turn = float(np.random.default_rng((seed, 4)).uniform(0.0, 2.0 * math.pi))
    return _sample(picture, *_ceiling_rays(room), turn), _sample(picture, *_wall_rays(room), turn)


def _tone_map(radiance: NDArray[np.float32]) -> Image:
    """8-bit picture: exposed for the upper hemisphere, highlights rolled off, with the sensor's headroom."""
    upper = radiance[: radiance.shape[0] // 2].mean(axis=2)
    scaled = radiance * (_KEY**2.2 / float(np.median(upper)))
    soft = np.where(scaled < 0.6, scaled, 0.6 + (scaled - 0.6) / (1.0 + 0.25 * (scaled - 0.6)))
    grey = soft ** (1 / 2.2) * (255.0 / Sensor.HEADROOM)
    return np.asarray(np.clip(np.rint(grey), 0, 255), np.uint8)


def _ceiling_rays(room: Room) -> tuple[Floats, Floats, Floats]:
    across, along = (
        (np.arange(round(size * CEILING_SCALE)) + 0.5) / CEILING_SCALE for size in (room.width, room.depth)
    )
    x, y = np.meshgrid(across - room.width / 2, along - room.depth / 2)
    return x, y, np.full_like(x, room.rise)


def _wall_rays(room: Room) -> tuple[Floats, Floats, Floats]:
    """To the strip round the room."""
    rows, columns = shape = strip_shape(room)
    x, y = strip_points(room, (np.arange(columns) + 0.5) / WALL_SCALE)
    up = room.rise - (np.arange(rows)[:, None] + 0.5) / WALL_SCALE
    return np.broadcast_to(x, shape), np.broadcast_to(y, shape), np.broadcast_to(up, shape)


def _sample(picture: Image, x: Floats, y: Floats, up: Floats, turn: float) -> Image:
    """The photograph along the rays (x, y, up) turned by `turn`; it wraps round at the back."""
    height, width = picture.shape[:2]
    azimuth = (np.arctan2(y, x) + turn) % (2.0 * math.pi)
    zenith = np.arctan2(np.hypot(x, y), up)
    columns = (width - azimuth * (width / (2.0 * math.pi)) - 0.5).astype(np.float32)
    rows = (zenith * (height / math.pi) - 0.5).astype(np.float32)
    return np.asarray(cv2.remap(picture, columns, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP), np.uint8)
