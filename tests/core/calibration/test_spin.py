"""Optical centre and tilt from a turn on the spot: its geometry, and turns in simulated rooms."""

import math
from dataclasses import replace

import numpy as np
import pytest

from omnibotd.core.calibration import spin
from omnibotd.core.calibration.looks import Look
from omnibotd.core.calibration.panorama import Grid
from omnibotd.core.calibration.turn import Sensitivity, Turn
from omnibotd.core.errors import FrameError
from omnibotd.core.geometry import Pose2D
from omnibotd.core.percept import Verdict
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from tools.calibration_trials import Mounting, TiltedCamera, Trial, bare
from tools.sim import ceilings
from tools.sim.world import World

NOMINAL = CameraModel.equidistant(640, 480, math.radians(190.0))
TRUE = replace(NOMINAL, cx=NOMINAL.cx + 5.0, cy=NOMINAL.cy - 4.0, tilt=(math.radians(1.2), math.radians(-0.9)))
OFFSET = Pose2D(0.02, -0.01)


def looks_round(world: World, count: int, mounting: Mounting, turn: float = 2.0 * math.pi) -> list[Look]:
    """Taken while turning about a point, with wheels that believe it is 7 % less."""
    camera = TiltedCamera(world, NOMINAL, mounting, 0.0)
    looks = []
    for k in range(count):
        yaw, stamp = turn * k / (count - 1), 0.2 * k
        pose = Pose2D(0.3, -0.2, yaw)
        jpeg = camera.picture(stamp, [(stamp, pose), (stamp + 0.02, pose)])
        looks.append(Look(Frame(stamp, jpeg), Pose2D(0.0, 0.0, math.remainder(0.93 * yaw, 2.0 * math.pi))))
    return looks


def far_from(result: spin.SpinResult, true: CameraModel) -> tuple[float, float]:
    """Errors of the centre (px) and the tilt (degrees)."""
    tilt = [a - b for a, b in zip(result.tilt, true.tilt, strict=True)]
    return math.hypot(result.centre[0] - true.cx, result.centre[1] - true.cy), math.degrees(math.hypot(*tilt))


def some_turn() -> tuple[Turn, Grid]:
    grid = Grid.of(NOMINAL)
    heading = np.array([0.0, 0.9, 2.1])
    turn = Turn.start(TRUE, grid, heading, np.full(3, 0.5))
    return replace(turn, offset=np.array([0.02, 0.01]), drift=np.array([[0.0, 0.0], [1e-3, 2e-3], [0.0, -1e-3]])), grid


def test_turn_sees_the_ceiling_where_geometry_has_it():
    turn, _ = some_turn()
    x, y, heading = 0.7, -0.4, 0.9  # a point of the ceiling, in heights; the second look
    c, s = math.cos(heading), math.sin(heading)
    eye = (turn.drift[1, 0] + c * 0.02 - s * 0.01, turn.drift[1, 1] + s * 0.02 + c * 0.01)
    ray = (c * (x - eye[0]) + s * (y - eye[1]), -s * (x - eye[0]) + c * (y - eye[1]), 1.0)
    zenith, bearing = math.atan(math.hypot(x, y)), math.atan2(y, x)
    seen = turn.pixels(1, *(np.array([value]) for value in (zenith, bearing, math.cos(zenith))))
    assert seen[0] == pytest.approx(TRUE.project(ray), abs=1e-9)


@pytest.mark.parametrize("column", range(7))
def test_sensitivity_is_how_the_seen_direction_moves(column):
    turn, grid = some_turn()
    zenith, bearing = grid.blocks()
    step = np.array([0.1, 0.1, 1e-4, 1e-4, 1e-4, 1e-4, 1e-6])[column] * np.eye(7)[column]
    camera = replace(
        turn.camera,
        cx=turn.camera.cx + step[0],
        cy=turn.camera.cy + step[1],
        tilt=(turn.camera.tilt[0] + step[2], turn.camera.tilt[1] + step[3]),
    )
    changed = replace(turn, camera=camera, offset=turn.offset + step[4:6], shutter=turn.shutter + step[6])
    moved = Sensitivity.of(turn, grid).mount[1] @ step
    # What is seen at the same pixel afterwards lies in the direction moved by the sensitivity.
    there = changed.pixels(1, zenith + moved[:, 1], bearing + moved[:, 0] / np.sin(zenith), turn.nearness)
    before = turn.pixels(1, zenith, bearing, turn.nearness)
    unmoved = np.abs(changed.pixels(1, zenith, bearing, turn.nearness) - before).max()
    assert np.abs(there - before).max() < 0.02 * unmoved


def test_a_turn_gives_centre_and_tilt():
    looks = looks_round(ceilings.tiles(1), 36, Mounting(TRUE, OFFSET))
    result = spin.estimate(looks, NOMINAL)
    centre, tilt = far_from(result, TRUE)
    assert result.verdict is Verdict.ACCEPTED, result.sentence
    assert centre < 0.2
    assert tilt < 0.08  # 0.072 with OpenCV 4.6
    assert result.turned == pytest.approx(2.0 * math.pi, abs=0.002)


def test_nothing_to_see_is_refused():
    result = spin.estimate(looks_round(bare(1), 24, Mounting(TRUE, OFFSET)), NOMINAL)
    assert result.verdict is Verdict.REJECTED
    assert "too little to see" in result.sentence


@pytest.mark.slow
def test_half_a_turn_is_refused():
    looks = looks_round(ceilings.tiles(1), 24, Mounting(NOMINAL, Pose2D()), math.pi)
    result = spin.estimate(looks, NOMINAL)
    assert result.verdict is Verdict.REJECTED
    assert result.turned < 1.01 * math.pi


def test_few_pictures_are_refused():
    look = Look(Frame(0.0, np.zeros((480, 640), np.uint8)), Pose2D())
    result = spin.estimate([look] * 5, NOMINAL)
    assert result.verdict is Verdict.REJECTED
    assert result.sentence.startswith("5 pictures")


def test_pictures_of_another_size_are_an_error():
    look = Look(Frame(0.0, np.zeros((240, 320), np.uint8)), Pose2D())
    with pytest.raises(FrameError, match="320x240"):
        spin.estimate([look] * 30, NOMINAL)


@pytest.mark.slow
@pytest.mark.parametrize("world", ["tiles", "beams", "photo", "plain"])
def test_a_robot_that_slips_finds_its_camera(world):
    told = Trial(f"tools.sim.ceilings:{world}", 5, 0.0).spin()
    assert told["verdict"] == Verdict.ACCEPTED, told["sentence"]
    assert told["centre_px"] < 0.5
    assert told["tilt_deg"] < 0.15


@pytest.mark.slow
def test_a_rolling_shutter_is_no_tilt():
    told = Trial("tools.sim.ceilings:tiles", 5, 0.03).spin()
    assert told["centre_px"] < 0.5
    assert told["tilt_deg"] < 0.15
