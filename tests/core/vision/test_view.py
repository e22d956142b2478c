"""Views of synthetic frames: where things show up, and what doesn't change them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from omnibotd.core.errors import FrameError
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame, Image
from omnibotd.core.vision.view import RINGS, SECTORS, Viewer, cells_at, reduction_for

CAMERA = CameraModel.equidistant(640, 480, math.radians(190.0))


def picture(camera: CameraModel, lamps: list[tuple[float, float]], gain: float = 1.0) -> Image:
    """A grey sky with round lamps (zenith, bearing) in radians, drawn by asking every pixel for its ray."""
    v, u = np.mgrid[: camera.height, : camera.width]
    rays = camera.unproject(np.stack([u, v], -1))
    image = np.where(np.isnan(rays[..., 0]), 0.0, 60.0)
    for zenith, bearing in lamps:
        lamp = (math.sin(zenith) * math.cos(bearing), math.sin(zenith) * math.sin(bearing), math.cos(zenith))
        image[np.nan_to_num(rays @ np.array(lamp)) > math.cos(0.08)] = 200.0
    return np.clip(image * gain, 0, 255).astype(np.uint8)


def view_of(camera: CameraModel, image: Image) -> np.ndarray:
    viewer = Viewer(camera)
    return viewer.normalised(viewer.texture(Frame(0.0, image)))


def centre_of_mass(view: np.ndarray) -> tuple[float, float]:
    """(ring, bearing) about which the strong cells lie."""
    strong = np.where(view > 2.0, view, 0.0)
    angles = np.arange(SECTORS) * 2 * math.pi / SECTORS
    bearing = math.atan2((strong * np.sin(angles)).sum(), (strong * np.cos(angles)).sum())
    return float((strong.sum(1) * np.arange(RINGS)).sum() / strong.sum()), bearing


@pytest.mark.parametrize("bearing", [0.0, 0.7, math.pi / 2, -2.5])
def test_sector_is_bearing_and_ring_is_zenith_angle(bearing: float) -> None:
    ring, seen = centre_of_mass(view_of(CAMERA, picture(CAMERA, [(0.8, bearing)])))
    assert abs(math.remainder(seen - bearing, math.tau)) < 0.03
    # 16 rings between 2 and 50 px at 36.2 px/rad: 0.8 rad is 29 px.
    assert ring == pytest.approx((0.8 * 36.2 - 2.0) / 3.0 - 0.5, abs=0.5)


@pytest.mark.parametrize("bearing", [0.0, 0.7, math.pi / 2, -2.5, math.pi])
def test_the_cell_of_a_ray_is_where_its_lamp_shows(bearing: float) -> None:
    ray = np.array([math.sin(0.8) * math.cos(bearing), math.sin(0.8) * math.sin(bearing), math.cos(0.8)])
    ring, sector = divmod(int(cells_at(ray)), SECTORS)
    shown, seen = centre_of_mass(view_of(CAMERA, picture(CAMERA, [(0.8, bearing)])))
    assert abs(ring - shown) <= 1.0
    assert abs(math.remainder(seen - sector * math.tau / SECTORS, math.tau)) <= math.pi / SECTORS + 0.03


@pytest.mark.parametrize(
    "camera",
    [
        replace(CAMERA, tilt=(0.2, -0.1)),
        replace(CAMERA, mount_yaw=2.0),
        replace(CAMERA, cx=300.0, cy=250.0, fx=120.0, fy=120.0),
        replace(CAMERA, distortion=(-0.15, 0.03, 0.0, 0.0), fov=math.radians(180.0)),
    ],
    ids=["tilt", "mount_yaw", "centre", "distortion"],
)
def test_the_camera_model_is_undone(camera: CameraModel) -> None:
    lamps = [(0.5, 0.3), (0.9, 2.0), (1.0, -1.2)]
    straight, other = view_of(CAMERA, picture(CAMERA, lamps)), view_of(camera, picture(camera, lamps))
    assert (straight * other).mean() > 0.85
    wrong = view_of(CAMERA, picture(camera, lamps))
    assert (straight * wrong).mean() < 0.6


def test_light_hardly_matters() -> None:
    lamps = [(0.4, 0.3), (0.9, 2.0), (1.1, -1.2)]
    bright, dim = (view_of(CAMERA, picture(CAMERA, lamps, gain)) for gain in (1.2, 0.5))
    assert (bright * dim).mean() > 0.97


def test_normalised_over_what_is_seen() -> None:
    camera = replace(CAMERA, cx=180.0)
    viewer = Viewer(camera)
    view = viewer.normalised(viewer.texture(Frame(0.0, picture(camera, [(0.6, 1.0)]))))
    assert not viewer.seen.all()
    assert np.all(view[~viewer.seen] == 0.0)
    assert view[viewer.seen].mean() == pytest.approx(0.0, abs=1e-4)
    assert view[viewer.seen].std() == pytest.approx(1.0, abs=1e-3)


def test_a_frame_without_contrast_gives_zeros() -> None:
    viewer = Viewer(CAMERA)
    texture = viewer.texture(Frame(0.0, np.full((480, 640), 80, np.uint8)))
    assert viewer.contrast(texture) == 0.0
    assert not viewer.normalised(texture).any()


def test_a_frame_of_another_size_is_refused() -> None:
    with pytest.raises(FrameError, match="320x240"):
        Viewer(CAMERA).texture(Frame(0.0, np.zeros((240, 320), np.uint8)))


def test_a_camera_that_sees_no_sky_is_refused() -> None:
    with pytest.raises(FrameError, match="tilt"):
        Viewer(replace(CAMERA, tilt=(2.5, 0.0)))


@pytest.mark.parametrize(
    ("width", "height", "reduction"), [(160, 120, 1), (320, 240, 2), (640, 480, 4), (1280, 960, 8)]
)
def test_frames_are_decoded_at_the_size_the_view_needs(width: int, height: int, reduction: int) -> None:
    assert reduction_for(CameraModel.equidistant(width, height, math.radians(190.0))) == reduction
