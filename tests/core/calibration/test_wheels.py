"""Wheels from what sight says of turns and drives: the fit, the ceiling's plane, whole runs in simulated rooms."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from omnibotd.core.calibration import wheels
from omnibotd.core.calibration.looks import Look
from omnibotd.core.calibration.phases import Phase
from omnibotd.core.calibration.sightline import Way, ceiling_of
from omnibotd.core.calibration.there_and_back import tied
from omnibotd.core.calibration.wheel_fit import Seen, fitted
from omnibotd.core.calibration.wheels import Scale, WheelsResult
from omnibotd.core.geometry import Pose2D
from omnibotd.core.kinematics import DifferentialDrive
from omnibotd.core.percept import Verdict
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from tools.calibration_trials import Trial
from tools.sim import ceilings

HEIGHT = 2.0
LEFT, RIGHT, SEPARATION = 0.0352, 0.0347, 0.24  # metres
CAMERA = CameraModel.equidistant(640, 480, math.radians(190.0))
RESULT = WheelsResult(
    0.035, 0.036, 0.23, 0.001, 0.001, 0.001, 1.0, Scale.NOMINAL, 20.0, 8.0, 1.2, Verdict.ACCEPTED, "measured"
)


def seen_by(left: float, right: float, *, turns: bool, rng: np.random.Generator | None = None) -> Seen:
    """What sight sees when the true wheels turn so far (rad), slipping 4 mm a root metre where there is chance."""
    rolled_left, rolled_right = LEFT * left, RIGHT * right
    if rng is not None:
        rolled_left += 4e-3 * math.sqrt(abs(rolled_left)) * rng.standard_normal()
        rolled_right += 4e-3 * math.sqrt(abs(rolled_right)) * rng.standard_normal()
    driven = 0.0 if turns else (rolled_left + rolled_right) / 2.0 / HEIGHT
    return Seen(Phase(turns, 0, 1, left, right), (rolled_right - rolled_left) / SEPARATION, driven)


def run_of(rng: np.random.Generator | None = None) -> list[Seen]:
    turns = [seen_by(-60.0 * s, 60.0 * s, turns=True, rng=rng) for s in (1.0, -1.0)]
    return turns + [seen_by(34.0 * s, 34.0 * s, turns=False, rng=rng) for s in (1.0, -1.0) * 3]


def test_fit_finds_the_wheels_exactly_where_nothing_slips():
    fit = fitted(run_of(), 0.033)
    assert (fit.left * HEIGHT, fit.right * HEIGHT, fit.separation * HEIGHT) == pytest.approx((LEFT, RIGHT, SEPARATION))
    assert fit.residual == pytest.approx(0.0, abs=1e-6)


def test_sigmas_are_what_errors_are():
    rng = np.random.default_rng(5)
    fits = [fitted(run_of(rng), 0.035) for _ in range(300)]
    radius = [(f.radius * HEIGHT / ((LEFT + RIGHT) / 2.0) - 1.0) / f.radius_sigma for f in fits]
    ratio = [(f.left / f.right * RIGHT / LEFT - 1.0) / f.ratio_sigma for f in fits]
    separation = [(f.separation * HEIGHT / SEPARATION - 1.0) / f.separation_sigma for f in fits]
    for errors in (radius, ratio, separation):
        assert np.std(errors) == pytest.approx(1.0, abs=0.2)


def test_a_push_shows_in_the_residual():
    pushed = run_of()
    pushed[-1] = replace(pushed[-1], turned=pushed[-1].turned + 0.3)
    assert fitted(pushed, 0.035).residual > 3.0


def test_ceiling_is_the_plane_that_most_of_it_lies_in():
    rng = np.random.default_rng(1)
    plaster, beams = -0.012 + 0.004 * rng.standard_normal(300), 0.1 + 0.01 * rng.standard_normal(100)
    plane, other = ceiling_of(np.stack([np.concatenate([plaster, beams]), np.ones(400)], -1))
    assert plane == pytest.approx(-0.012, abs=0.001)
    assert 0.2 < other < 0.35


def test_no_patches_leave_the_ceiling_as_it_is():
    assert ceiling_of(np.zeros((0, 2))) == (0.0, 0.0)


def test_way_of_the_base_forgets_where_the_camera_stands():
    base = Pose2D(0.5, 0.02, 0.1)
    mount = Pose2D(0.05, -0.03)
    way = Way(mount.inverse() @ base @ mount, np.zeros((0, 2))).of_base(np.array([0.05, -0.03]))
    assert (way.end.x, way.end.y, way.end.yaw) == pytest.approx((base.x, base.y, base.yaw))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_way_is_as_long_as_its_arc(sign):
    arc = DifferentialDrive(1.0, 1.0).displacement(sign * 0.9, sign * 1.1)
    assert Way(arc, np.zeros((0, 2))).length == pytest.approx(sign)


def test_ways_out_and_back_agree_on_their_length():
    world, true = ceilings.tiles(1), Pose2D(1.2 / 2.2, 0.0, 0.03)
    stands = [Pose2D(), true, Pose2D(0.01, -0.004, 0.02), true @ Pose2D(-0.008, 0.002, -0.01)]  # in heights
    frames = [Frame(0.0, world.render(2.2 * p.x - 0.6, 2.2 * p.y, p.yaw, 0.0)) for p in stands]
    legs = [a.inverse() @ b for a, b in pairwise(stands)]
    seen = [replace(leg, x=leg.x * share) for leg, share in zip(legs, (1.012, 0.99, 1.004), strict=True)]
    agreed = tied([Way(leg, np.zeros((0, 2))) for leg in seen], frames, CAMERA)
    assert agreed is not None
    shares = [way.length / Way(leg, np.zeros((0, 2))).length for way, leg in zip(agreed, legs, strict=True)]
    assert shares == pytest.approx([1.002] * 3, abs=5e-4)  # the mean of 1.012, 0.99 and 1.004
    assert [way.turned for way in agreed] == pytest.approx([leg.yaw for leg in legs], abs=5e-4)


def test_a_robot_that_ends_elsewhere_is_not_tied():
    world = ceilings.tiles(1)
    frames = [Frame(0.0, world.render(x, 0.0, 0.0, 0.0)) for x in (0.0, 0.6, 1.2)]
    ways = [Way(Pose2D(0.6 / 2.2), np.zeros((0, 2)))] * 2
    assert tied(ways, frames, CAMERA) is None


def test_tape_scales_all_lengths_and_says_so():
    scaled = RESULT.with_distance(1.26)
    assert (scaled.radius_left, scaled.radius_right, scaled.separation) == pytest.approx((0.03675, 0.0378, 0.2415))
    assert scaled.scale is Scale.DISTANCE
    assert scaled.verdict is Verdict.ACCEPTED
    assert scaled.radius_sigma > RESULT.radius_sigma
    assert "36.75" in scaled.sentence


def test_tape_read_from_the_wrong_place_is_refused():
    refused = RESULT.with_distance(2.4)
    assert refused.verdict is Verdict.REJECTED
    assert "2.40" in refused.sentence


def test_tape_does_not_mend_a_bad_run():
    bad = replace(RESULT, straight=0.0, verdict=Verdict.REJECTED, sentence="slipped")
    assert bad.with_distance(1.2) == bad


def test_too_little_motion_is_refused():
    frame = Frame(0.0, np.zeros((480, 640), np.uint8))
    looks = [Look(frame, Pose2D(0.1 * k, 0.0, 0.0)) for k in range(5)]
    result = wheels.estimate(looks, CAMERA, DifferentialDrive(0.035, 0.23), 2.2)
    assert result.verdict is Verdict.REJECTED
    assert "0.4 m" in result.sentence


@pytest.mark.slow
@pytest.mark.parametrize("world", ["tiles", "hall"])
def test_wheels_five_percent_wrong_come_within_half_a_percent(world):
    for told in Trial(f"tools.sim.ceilings:{world}", 3, 0.0).base():
        assert told["verdict"] == Verdict.ACCEPTED, told["sentence"]
        assert told["wheels_percent"] < 0.5


@pytest.mark.slow
def test_a_tape_stands_in_for_the_height_of_a_ceiling_with_beams():
    by_height, by_tape = Trial("tools.sim.ceilings:beams", 3, 0.0).base()
    assert by_height["scale"] == Scale.NOMINAL
    assert "does not show clearly that it is level" in by_height["sentence"]
    assert by_height["shape_percent"] < 0.5
    assert by_tape["verdict"] == Verdict.ACCEPTED, by_tape["sentence"]
    assert by_tape["wheels_percent"] < 0.5
