import math

import numpy as np
import pytest

from omnibotd.core.vision.camera_model import CameraModel, CameraModelError

FOV = math.radians(190)
IDEAL = CameraModel.equidistant(640, 480, FOV)
REAL = CameraModel(640, 480, 190.0, 188.0, 317.0, 236.0, (0.02, -0.01, 0.004, -0.0005), FOV, 0.4, (0.03, -0.02))


def rays(theta: np.ndarray, bearing: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(theta) * np.cos(bearing), np.sin(theta) * np.sin(bearing), np.cos(theta)], -1)


@pytest.mark.parametrize(
    ("bearing", "du", "dv"), [(0.0, 0, -1), (math.pi / 2, 1, 0), (math.pi, 0, 1), (-math.pi / 2, -1, 0)]
)
def test_ahead_is_up_in_the_image_and_the_robots_left_is_on_the_right(bearing: float, du: int, dv: int) -> None:
    theta = math.radians(40)
    pixel = IDEAL.project(rays(np.array(theta), np.array(bearing)))
    reach = 240 / math.radians(95) * theta
    assert pixel == pytest.approx([319.5 + du * reach, 239.5 + dv * reach], abs=1e-9)


@pytest.mark.parametrize("model", [IDEAL, REAL])
def test_unproject_undoes_project_over_the_whole_field(model: CameraModel) -> None:
    theta, bearing = np.meshgrid(np.linspace(0, math.radians(90), 40), np.linspace(-3.1, 3.1, 50))
    pixels = model.project(rays(theta, bearing))
    seen = np.isfinite(pixels[..., 0])
    back = model.project(model.unproject(pixels))
    assert seen.mean() > 0.9
    assert np.nanmax(np.abs(back[seen] - pixels[seen])) < 1e-6


def test_what_the_lens_cannot_see_is_not_a_number() -> None:
    assert np.isnan(IDEAL.project([0.0, 0.0, -1.0])).all()
    assert np.isnan(IDEAL.unproject([0.0, 0.0])).all()


def test_mount_yaw_is_the_direction_of_the_images_top() -> None:
    model = CameraModel(640, 480, 144.0, 144.0, 319.5, 239.5, mount_yaw=math.pi / 2)
    left = model.project(rays(np.array(0.5), np.array(math.pi / 2)))
    assert left == pytest.approx([319.5, 239.5 - 72.0])


def test_tilt_turns_the_vertical_into_the_optical_axis() -> None:
    tilt = 0.1
    model = CameraModel(640, 480, 144.0, 144.0, 319.5, 239.5, tilt=(0.0, tilt))
    axis = [math.sin(tilt), 0.0, math.cos(tilt)]  # rotating z about y (left) leans it forward
    assert model.project(axis) == pytest.approx([319.5, 239.5], abs=1e-6)


def test_a_reduced_model_sees_block_averages_where_they_are() -> None:
    small = IDEAL.reduced(4)
    ray = rays(np.array(0.7), np.array(1.1))
    u, v = IDEAL.project(ray)
    assert small.project(ray) == pytest.approx([(u + 0.5) / 4 - 0.5, (v + 0.5) / 4 - 0.5])
    assert (small.width, small.height) == (160, 120)


def test_camera_info_of_another_model_is_refused() -> None:
    info = {
        "image_width": 640,
        "image_height": 480,
        "distortion_model": "plumb_bob",
        "camera_matrix": {"data": [1.0] * 9},
        "distortion_coefficients": {"data": [0.0] * 4},
    }
    with pytest.raises(CameraModelError, match="plumb_bob"):
        CameraModel.from_camera_info(info, FOV)
    with pytest.raises(CameraModelError, match="missing"):
        CameraModel.from_camera_info({}, FOV)
