"""Conditions laid over a world: geometry against lens formulas written out here, and what never changes."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from omnibotd.core.vision.camera_model import CameraModel
from tools.sim.conditions import CONDITIONS, DISTURBED, STANDING, Stage, expanded, lens_of
from tools.sim.mounting import OFFSET, SHIFT, TILT, Tilted, tilted
from tools.sim.painted_light import LIGHTS, PaintedLight
from tools.sim.people import FROM_WALL, NEAREST, PACE, People
from tools.sim.slope import ANGLE, GENTLE, Slope
from tools.sim.smudges import BLUR, COVERED, NOISE, Blur, Smudges
from tools.sim.world_plugin import WorldError

WIDTH, HEIGHT, RADIUS = 320, 240, 119.0
FOCAL = RADIUS / math.radians(95.0)
CX, CY = (WIDTH - 1) / 2.0, (HEIGHT - 1) / 2.0
LENS = CameraModel.equidistant(WIDTH, HEIGHT, math.radians(190.0), RADIUS)
BOUNDS = (-3.0, -3.0, 3.0, 3.0)


def disc(value: int) -> np.ndarray:
    """Grey within the image circle, black outside."""
    rows, columns = np.indices((HEIGHT, WIDTH))
    inside = np.hypot(columns - CX, rows - CY) <= RADIUS
    return np.repeat(np.where(inside, value, 0).astype(np.uint8)[..., None], 3, axis=2)


def pixel(bearing: float, zenith: float) -> tuple[float, float]:
    return CX + FOCAL * zenith * math.sin(bearing), CY - FOCAL * zenith * math.cos(bearing)


class Room:
    """Evenly grey, whatever the light its factory made."""

    fov_deg = 190.0
    bounds = BOUNDS
    dock = (2.5, 0.0, 0.0)

    def __init__(self, value: int = 120) -> None:
        self._image = disc(value)

    def free(self, x: float, y: float, radius: float) -> bool:
        return max(abs(x), abs(y)) + radius <= 3.0

    def render(self, x: float, y: float, yaw: float, t: float) -> np.ndarray:
        return self._image


def staged(*conditions: str, own: object = None) -> Stage:
    stage = Stage(Room(), lambda light: own, 1, conditions)
    stage.enter(conditions)
    return stage


def test_without_conditions_the_world_is_itself() -> None:
    stage, room = staged(), Room()
    assert (stage.bounds, stage.dock, stage.fov_deg) == (room.bounds, room.dock, room.fov_deg)
    assert stage.camera_info is None
    assert stage.free(0.0, 0.0, 0.2)
    assert not stage.free(2.9, 0.0, 0.2)
    assert np.array_equal(stage.render(0.0, 0.0, 0.0, 0.0), room.render(0.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    "name", [name for name in CONDITIONS if name not in ("drift", "offset", "gentle_slope", DISTURBED)]
)
def test_each_condition_shows_and_ends(name: str) -> None:
    image = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8), (0, 0), 3.0)
    room = Room()
    room._image = cv2.bitwise_and(image, disc(255))
    stage = Stage(room, lambda light: None, 1, (name,))
    stage.enter((name,))
    seen = stage.render(0.5, 0.3, 0.2, 4.0)
    assert seen.dtype == np.uint8
    assert seen.shape == image.shape
    assert np.abs(seen.astype(int) - room._image).mean() > 0.5
    if name not in STANDING:
        stage.enter(())
        assert np.array_equal(stage.render(0.5, 0.3, 0.2, 4.0), room._image)


def test_a_light_that_the_factory_makes_is_the_factorys() -> None:
    assert staged("night", own=Room(7)).render(0.0, 0.0, 0.0, 0.0)[120, 160, 0] == 7


def test_there_is_one_light_at_a_time() -> None:
    with pytest.raises(ValueError, match="one light"):
        staged("night", "sun")


def test_the_lens_is_read_off_the_picture_or_taken_from_the_world() -> None:
    found = lens_of(Room())
    assert (found.cx, found.cy) == pytest.approx((CX, CY), abs=0.7)
    assert found.fx == pytest.approx(FOCAL, rel=0.01)
    room = Room()
    matrix = [50.0, 0, 161, 0, 51.0, 121, 0, 0, 1]
    room.camera_info = {
        "image_width": WIDTH,
        "image_height": HEIGHT,
        "camera_matrix": {"data": matrix},
        "distortion_coefficients": {"data": [0.0] * 4},
    }
    assert (lens_of(room).fx, lens_of(room).cy) == (50.0, 121.0)
    room.camera_info = {"image_width": WIDTH}
    with pytest.raises(WorldError, match="camera_info"):
        lens_of(room)


@pytest.mark.parametrize("yaw", [0.0, 1.1, -2.5])
def test_a_slope_moves_the_zenith_against_the_leaning_in_the_world(yaw: float) -> None:
    """A camera that leans by 1 degree one way sees the zenith 1 degree the other way; the way is the world's."""
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    cv2.circle(image, (round(CX), round(CY)), 9, (255, 255, 255), -1)
    slope = Slope(LENS, 4)
    moved = _middle(slope(image, 0.0, 0.0, yaw, 0.0)) - _middle(image)
    assert math.hypot(*moved) == pytest.approx(FOCAL * ANGLE, abs=0.15)
    bearing = math.atan2(moved[0], -moved[1])  # of the zenith, from the robot's front
    still = _middle(slope(image, 0.0, 0.0, 0.0, 0.0)) - _middle(image)
    assert math.remainder(bearing + yaw - math.atan2(still[0], -still[1]), math.tau) == pytest.approx(0.0, abs=0.1)


def test_a_gentle_slope_is_a_fifth_of_a_slope() -> None:
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    cv2.circle(image, (round(CX), round(CY)), 9, (255, 255, 255), -1)
    moved = _middle(Slope(LENS, 4, GENTLE)(image, 0.0, 0.0, 0.0, 0.0)) - _middle(image)
    assert math.hypot(*moved) == pytest.approx(FOCAL * ANGLE / 5.0, abs=0.05)


def test_a_slope_leaves_the_image_circle_where_it_is() -> None:
    rim = Slope(LENS, 4)(disc(200), 0.0, 0.0, 0.0, 0.0)
    assert _middle(rim) == pytest.approx(_middle(disc(200)), abs=0.1)  # of a shift of 1.25 px
    assert rim.sum() == pytest.approx(disc(200).sum(), rel=0.002)


def _middle(image: np.ndarray) -> np.ndarray:
    """Centre of brightness (u, v)."""
    weight = image[..., 0].astype(float)
    rows, columns = np.indices(weight.shape)
    return np.array([(columns * weight).sum(), (rows * weight).sum()]) / weight.sum()


def test_people_walk_slowly_inside_the_room() -> None:
    people = People(LENS, BOUNDS, 3)
    tracks = np.array([people.positions(0.1 * k) for k in range(3000)])
    assert tracks.shape[1:] == (4, 2)  # 36 m2, one for each 9
    assert np.abs(tracks).max() <= 3.0 - FROM_WALL
    speed = np.hypot(*np.moveaxis(np.diff(tracks, axis=0), -1, 0)) / 0.1
    assert PACE / 4.0 < speed.max() <= PACE * 1.001
    assert np.array_equal(people.positions(7.0), People(LENS, BOUNDS, 3).positions(7.0))


def test_a_person_stands_dark_where_they_are(monkeypatch) -> None:
    """1.7 m tall, 2 m ahead to the left by 40 degrees: the head ends 31 degrees above the camera's horizon."""
    people = People(LENS, BOUNDS, 3)
    bearing = math.radians(40.0)
    monkeypatch.setattr(people, "positions", lambda t: [(2.0 * math.cos(bearing), 2.0 * math.sin(bearing))] * 4)
    image = disc(200)
    seen = people(image, 0.0, 0.0, 0.0, 0.0)
    assert (image[image > 0] == 200).all()  # the world's own picture is not painted on
    top = math.atan2(2.0, 1.2)
    for zenith, dark in ((top - 0.05, False), (top + 0.03, True), (math.radians(80.0), True)):
        u, v = pixel(bearing, zenith)
        assert (int(seen[round(v), round(u), 0]) < 60) is dark
    u, v = pixel(-bearing, math.radians(80.0))
    assert seen[round(v), round(u), 0] == 200


def test_people_make_way(monkeypatch) -> None:
    people = People(LENS, BOUNDS, 3)
    drawn = []
    monkeypatch.setattr(people, "_draw", lambda image, distance, bearing, clothes: drawn.append(distance))
    monkeypatch.setattr(people, "positions", lambda t: np.array([[0.1, 0.0], [1.5, 0.0], [9.0, 0.0], [0.0, 0.0]]))
    people(disc(200), 0.0, 0.0, 0.0, 0.0)
    assert drawn == [NEAREST, 1.5, NEAREST]


def test_half_the_lamps_leave_the_other_half_as_it_is() -> None:
    light = PaintedLight(LIGHTS["half_lamps"], LENS, BOUNDS, 1)
    east_ahead = light(disc(180), 0.0, 0.0, 0.0, 0.0)
    west_ahead = light(disc(180), 0.0, 0.0, math.pi, 0.0)
    ahead, behind = (tuple(map(round, pixel(b, math.radians(50.0)))) for b in (0.0, math.pi))
    for image, bright, dim in ((east_ahead, behind, ahead), (west_ahead, ahead, behind)):
        assert image[bright[1], bright[0]].mean() == pytest.approx(180.0, abs=8.0)
        assert image[dim[1], dim[0]].mean() == pytest.approx(0.55 * 180.0, abs=12.0)


def test_lamps_go_out_and_the_sun_shines_on_one_spot() -> None:
    off, sun = (
        PaintedLight(LIGHTS[name], LENS, BOUNDS, 1)(disc(250), 0.0, 0.0, 0.0, 0.0) for name in ("lamps_off", "sun")
    )
    inside = disc(1)[..., 0] == 1
    assert off[inside].max() < 190 * 0.85 + 25
    assert off[inside].mean() < sun[inside].mean()
    share = (PaintedLight(LIGHTS["sun"], LENS, BOUNDS, 1)(disc(100), 0.0, 0.0, 0.0, 0.0)[inside] > 130).mean()
    assert 0.005 < share < 0.3


def test_night_is_dark_and_noisy() -> None:
    seen = PaintedLight(LIGHTS["night"], LENS, BOUNDS, 1)(disc(120), 0.0, 0.0, 0.0, 0.0)
    middle = seen[90:150, 130:190, 0].astype(float)
    assert 0.15 * 120 < middle.mean() < 0.35 * 120
    assert (middle - cv2.GaussianBlur(middle, (0, 0), 5.0)).std() == pytest.approx(5.0, rel=0.2)


def test_drift_is_no_matter_of_pictures() -> None:
    assert np.array_equal(staged("drift").render(0.0, 0.0, 0.0, 0.0), disc(120))


def test_a_tilted_camera_sees_the_zenith_where_its_calibration_says() -> None:
    """The axis of a tilt (a, b) about top and left is (b, -a, 1): the zenith is b to its back and a to its left."""
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    cv2.circle(image, (160, 120), 9, (255, 255, 255), -1)
    moved = _middle(Tilted(LENS)(image, 0.0, 0.0, 0.0, 0.0)) - _middle(image)
    assert moved == pytest.approx((SHIFT[0] + FOCAL * TILT[0], SHIFT[1] + FOCAL * TILT[1]), abs=0.1)
    assert tilted(LENS).project([0.0, 0.0, 1.0]) - (CX, CY) == pytest.approx(moved, abs=0.1)


def test_a_tilted_camera_sees_a_mark_far_off_the_axis_where_its_calibration_says() -> None:
    bearing, zenith = math.radians(130.0), math.radians(70.0)
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    u, v = pixel(bearing, zenith)
    cv2.circle(image, (round(u), round(v)), 5, (255, 255, 255), -1)
    ray = LENS.unproject([round(u), round(v)])
    assert _middle(Tilted(LENS)(image, 0.0, 0.0, 0.0, 0.0)) == pytest.approx(tilted(LENS).project(ray), abs=0.4)


def test_the_image_circle_of_a_tilted_camera_stays() -> None:
    assert _middle(Tilted(LENS)(disc(200), 0.0, 0.0, 0.0, 0.0)) == pytest.approx(_middle(disc(200)), abs=0.2)  # of 5 px


@pytest.mark.parametrize("yaw", [0.0, math.pi / 2])
def test_a_camera_off_the_axle_is_carried_round_by_the_base(yaw: float) -> None:
    seen = []
    room = Room()
    room.render = lambda x, y, yaw, t: seen.append((x, y)) or disc(9)
    Stage(room, lambda light: None, 1, ("offset",)).render(1.0, 2.0, yaw, 0.0)
    ahead, left = OFFSET
    assert seen[-1] == pytest.approx((1.0 + ahead, 2.0 + left) if yaw == 0.0 else (1.0 - left, 2.0 + ahead))
    assert math.hypot(*OFFSET) == pytest.approx(0.02)


def test_blur_widens_an_edge_and_keeps_the_noise() -> None:
    image = np.full((HEIGHT, WIDTH, 3), 100, np.uint8)
    image[:, WIDTH // 2 :] = 200
    seen = Blur(LENS, 1)(image, 0.0, 0.0, 0.0, 0.0).astype(float)
    # The steepest slope of a step of 100 through a Gaussian, per pixel.
    steepest = np.diff(seen[:, 140:180].mean((0, 2))).max()
    assert steepest == pytest.approx(100.0 * math.erf(0.5 / BLUR / math.sqrt(2.0)), rel=0.08)  # OpenCV cuts it at 4 px
    assert seen[:, :100].std() == pytest.approx(math.hypot(NOISE, 1 / math.sqrt(12)), rel=0.1)


@pytest.mark.parametrize("number", [0, 1, 2, 3])
def test_a_tenth_of_the_lens_is_covered(number: int) -> None:
    smudges = Smudges(LENS, (1, number))
    grey, black = (smudges(disc(value), 0.0, 0.0, 0.0, 0.0) for value in (255, 0))
    inside = disc(1)[..., 0] == 1
    # What a pixel still shows of the picture behind, which at a patch's soft edge is a part.
    assert (grey.astype(int) - black)[inside].mean() == pytest.approx(255.0 * (1.0 - COVERED), abs=255.0 * 0.01)
    assert np.array_equal(grey, smudges(disc(255), 1.0, 2.0, 3.0, 4.0))
    assert not np.array_equal(grey, Smudges(LENS, (1, number + 1))(disc(255), 0.0, 0.0, 0.0, 0.0))


def test_disturbed_is_one_light_after_the_other_and_what_always_holds() -> None:
    runs = [expanded((DISTURBED,), number) for number in range(5)]
    assert [names[0] for names in runs] == [*LIGHTS, next(iter(LIGHTS))]
    assert {names[1:] for names in runs} == {("tilt", "offset", "gentle_slope", "blur", "occluded")}
    assert expanded(("people", "sun")) == ("people", "sun")
