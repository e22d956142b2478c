"""The tile compass: lens, colours and angles, against geometry worked out here."""

import math

import cv2
import numpy as np
import pytest

from omnibotd.core.errors import FrameError
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.thesis.compass import (
    BLUE,
    FOCAL,
    GREEN,
    RED,
    Compass,
    Undistortion,
    decode_colour,
    heading,
    largest_blob,
    opposing,
)
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from tools.sim.compass_tiles import APART, HEIGHT, with_compass_tiles

CAMERA = CameraModel.equidistant(640, 480, math.radians(190.0))


class Grey:
    """A room with nothing in it: the same grey all round."""

    fov_deg = 190.0
    bounds = (-2.0, -4.0, 4.0, 2.0)  # its middle is (1, -1)
    dock = (0.0, 0.0, 0.0)

    def __init__(self, light: int = 110) -> None:
        self._light = light

    def render(self, x: float, y: float, yaw: float, t: float) -> np.ndarray:
        return np.full((480, 640, 3), self._light, np.uint8)


def squares(red: tuple[int, int], blue: tuple[int, int], size: int = 21) -> np.ndarray:
    """An undistorted image with squares about two pixels."""
    image = np.full((480, 640, 3), 128, np.uint8)
    for (u, v), colour in ((red, (0, 0, 255)), (blue, (255, 0, 0))):
        half = size // 2
        image[v - half : v + half + 1, u - half : u + half + 1] = colour
    return image


@pytest.mark.parametrize(
    ("colour", "values"),
    [((0, 0, 255), {RED: 255.0, GREEN: -127.5, BLUE: -127.5}), ((90, 90, 90), {RED: 0.0, GREEN: 0.0, BLUE: 0.0})],
)
def test_opposing_channels_are_signed(colour: tuple[int, int, int], values: dict[int, float]) -> None:
    image = np.full((2, 2, 3), colour, np.uint8)
    for channel, value in values.items():
        assert (opposing(image, channel) == 2 * value).all()


def test_the_largest_blob_is_found_at_its_middle() -> None:
    image = squares((100, 200), (400, 300))
    image[50:60, 500:510] = (0, 0, 255)  # a smaller red thing
    assert largest_blob(image, RED) == pytest.approx((100, 200), abs=0.01)
    assert largest_blob(image, BLUE) == pytest.approx((400, 300), abs=0.01)
    assert largest_blob(image, GREEN) is None


def test_specks_and_dim_colours_are_no_tiles() -> None:
    assert largest_blob(squares((100, 200), (400, 300), size=5), RED) is None
    assert largest_blob((squares((100, 200), (400, 300)) // 4), RED) is None


@pytest.mark.parametrize(
    ("red", "blue", "degrees"),
    [
        ((300, 300), (300, 200), 0.0),  # red straight below blue: what the thesis turns the image to
        ((400, 200), (300, 200), 90.0),
        ((300, 100), (300, 200), 180.0),
        ((200, 300), (300, 200), -45.0),
    ],
)
def test_heading_is_how_far_the_image_must_turn_to_bring_red_below_blue(
    red: tuple[int, int], blue: tuple[int, int], degrees: float
) -> None:
    found = heading(squares(red, blue))
    assert found is not None
    assert abs(wrap(found - math.radians(degrees))) < 1e-6


def test_straight_lines_of_the_ceiling_are_straight_and_to_scale() -> None:
    """Points on a line overhead, drawn where the equidistant lens sees them."""
    focal = 240.0 / math.radians(95.0)
    image = np.zeros((480, 640, 3), np.uint8)
    ahead, lefts = 0.9, (-1.2, -0.4, 0.5, 1.3)  # in heights of the ceiling
    for left in lefts:
        across = math.hypot(ahead, left)
        r = focal * math.atan(across)
        u, v = 319.5 + r * left / across, 239.5 - r * ahead / across
        cv2.circle(image, (round(u * 16), round(v * 16)), 3 * 16, (255, 255, 255), -1, cv2.LINE_AA, 4)
    flat = Undistortion(CAMERA)(Frame(0.0, image))[..., 0]
    _, _, _, centres = cv2.connectedComponentsWithStats((flat > 100).astype(np.uint8))
    found = sorted((float(u), float(v)) for u, v in centres[1:])
    assert [u for u, _ in found] == pytest.approx([319.5 + FOCAL * left for left in lefts], abs=1.0)
    assert [v for _, v in found] == pytest.approx([239.5 - FOCAL * ahead] * 4, abs=1.0)


@pytest.mark.parametrize("yaw", [-3.0, -1.6, -0.2, 0.0, 0.7, 1.5, 3.1])
@pytest.mark.parametrize("place", [(1.0, -1.0), (2.9, 0.8), (-0.9, -2.9)])
def test_heading_of_a_rendered_picture_is_the_robots(yaw: float, place: tuple[float, float]) -> None:
    picture = with_compass_tiles(Grey()).render(*place, yaw, 0.0)
    found = heading(Undistortion(CAMERA)(Frame(0.0, picture)))
    assert found is not None
    assert abs(wrap(found - yaw)) < math.radians(1.0)


def test_heading_allows_for_the_cameras_mounting() -> None:
    picture = with_compass_tiles(Grey()).render(1.5, -0.5, 0.4, 0.0)
    turned = CameraModel.equidistant(640, 480, math.radians(190.0))
    turned = CameraModel(**{**{k: getattr(turned, k) for k in turned.__dataclass_fields__}, "mount_yaw": 0.3})
    found = heading(Undistortion(turned)(Frame(0.0, picture)))
    assert found == pytest.approx(0.4 - 0.3, abs=math.radians(1.0))


def test_tiles_hang_where_they_are_said_to() -> None:
    """The robot under the red tile, facing the blue: red in the image's middle, blue straight ahead of it."""
    picture = with_compass_tiles(Grey()).render(1.0 - APART / 2, -1.0, 0.0, 0.0)
    flat = Undistortion(CAMERA)(Frame(0.0, picture))
    assert largest_blob(flat, RED) == pytest.approx((319.5, 239.5), abs=0.5)
    assert largest_blob(flat, BLUE) == pytest.approx((319.5, 239.5 - FOCAL * APART / HEIGHT), abs=0.5)


def test_in_the_dark_no_tile_is_seen() -> None:
    flat = Undistortion(CAMERA)(Frame(0.0, with_compass_tiles(Grey(8)).render(1.0, -1.0, 0.0, 0.0)))
    assert heading(flat) is None


def test_a_world_with_tiles_is_otherwise_the_world_itself() -> None:
    world = Grey()
    assert with_compass_tiles(world).dock == world.dock
    before = world.render(0.0, 0.0, 0.0, 0.0)
    changed = (with_compass_tiles(world).render(0.0, 0.0, 0.0, 0.0) != before).any(-1)
    assert 0 < changed.sum() < 0.02 * changed.size


def test_while_a_tile_is_hidden_odometry_carries_the_heading_on() -> None:
    compass = Compass()
    hidden = np.full((480, 640, 3), 128, np.uint8)
    assert compass.read(hidden, Pose2D()) is None
    seen = compass.read(squares((400, 200), (300, 200)), Pose2D(5.0, 5.0, -1.0))
    assert seen is not None
    assert (seen.yaw, seen.seen) == (pytest.approx(math.pi / 2), True)
    carried = compass.read(hidden, Pose2D(5.0, 6.0, 0.5))
    assert carried is not None
    assert (carried.yaw, carried.seen) == (pytest.approx(wrap(math.pi / 2 + 1.5)), False)


def test_frames_are_decoded_in_colour() -> None:
    image = squares((100, 200), (400, 300))
    jpeg = Frame(0.0, cv2.imencode(".jpg", image)[1].tobytes())
    assert np.abs(decode_colour(jpeg).astype(int) - image).mean() < 2.0
    grey = decode_colour(Frame(0.0, image[..., 0]))
    assert grey.shape == (480, 640, 3)
    with pytest.raises(FrameError, match="no picture"):
        decode_colour(Frame(0.0, b"not a picture"))
    with pytest.raises(FrameError, match="320x240"):
        Undistortion(CAMERA)(Frame(0.0, image[::2, ::2]))
