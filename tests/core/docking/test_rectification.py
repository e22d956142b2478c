"""Rectified views: points of a ceiling land where plane geometry says, also under a tilted and turned camera."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from omnibotd.core.docking.rectification import Lookup, Rectification, rim_rays
from omnibotd.core.errors import FrameError
from omnibotd.core.vision.camera_model import CameraModel

LEVEL = CameraModel.equidistant(640, 480, math.radians(190.0), 240.0)
TILTED = replace(LEVEL, tilt=(0.03, -0.05), cx=322.0, cy=236.0, mount_yaw=0.4)


def _spot(camera: CameraModel, x: float, y: float) -> np.ndarray:
    """A fisheye picture with a bright spot where the ceiling's point (x, y) times its height is seen."""
    u, v = camera.project(np.array([x, y, 1.0]))
    rows, columns = np.mgrid[: camera.height, : camera.width]
    return (255 * np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / (2 * 2.0**2))).astype(np.uint8)


@pytest.mark.parametrize("camera", [LEVEL, TILTED])
@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (-0.4, 0.7)])
def test_a_ceiling_point_stands_left_for_y_and_up_for_x(camera: CameraModel, x: float, y: float) -> None:
    rectify = Rectification(camera, 240, math.radians(100.0))
    view = rectify(_spot(camera, x, y)).astype(float)
    rows, columns = np.mgrid[:240, :240]
    focal = 120.0 / math.tan(math.radians(50.0))
    assert (columns * view).sum() / view.sum() == pytest.approx(119.5 + focal * y, abs=0.5)
    assert (rows * view).sum() / view.sum() == pytest.approx(119.5 - focal * x, abs=0.5)


def test_a_narrow_lens_leaves_the_corners_invalid_and_black() -> None:
    narrow = CameraModel.equidistant(640, 480, math.radians(110.0), 240.0)
    rectify = Rectification(narrow, 160, math.radians(130.0))
    assert rectify.valid[0, 0] == 0
    assert rectify.valid[80, 80] == 255
    assert rectify(np.full((480, 640), 200, np.uint8))[0, 0] == 0


def test_a_frame_of_another_size_is_refused_with_both_sizes() -> None:
    rectify = Rectification(LEVEL, 60, math.radians(90.0))
    with pytest.raises(FrameError, match=r"320x240.*640x480"):
        rectify(np.zeros((240, 320), np.uint8))


def test_the_rim_turns_with_the_view() -> None:
    """What stands at bearing b on the rim stands at the same angle in the rectified view."""
    rays = rim_rays(np.array([math.radians(40.0)]), 360)
    bearing = 70
    x, y, z = rays[0, bearing]
    picture = _spot(LEVEL, x / z, y / z)
    assert int(np.argmax(Lookup(LEVEL, rays)(picture)[0])) == bearing
    view = Rectification(LEVEL, 240, math.radians(100.0))(picture)
    row, column = np.unravel_index(int(np.argmax(view)), view.shape)
    assert math.degrees(math.atan2(row - 119.5, column - 119.5)) == pytest.approx(bearing, abs=1.0)
