"""Full fixes and tracking under rendered ceilings; the truth is where the renderer stood."""

from __future__ import annotations

import math
from functools import cache

import cv2
import numpy as np
import pytest

from omnibotd.core.docking.ceiling_height import visual_height
from omnibotd.core.docking.ceiling_view import ceiling_optics
from omnibotd.core.docking.features import edge_strength, unoccluded
from omnibotd.core.docking.registration import DockRegistration
from omnibotd.core.errors import FrameError
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.percept import HomingEstimate, Verdict
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from omnibotd.core.vision.view import RINGS, SECTORS, cells_at
from tools.sim import ceilings
from tools.sim.panorama import PanoramaError
from tools.sim.world import World

CAMERA = CameraModel.equidistant(640, 480, math.radians(190.0), 240.0)
HEIGHT = 2.2  # m, of the rendered ceilings above the camera
MIDDLE = Pose2D(0.15, -0.1, 0.4)
STYLES = ["tiles", "plain", "beams", "photo"]


@cache
def world(style: str, seed: int = 5) -> World:
    try:
        return getattr(ceilings, style)(seed)
    except PanoramaError as error:
        pytest.skip(str(error))


def see(style: str, pose: Pose2D, stamp: float = 1.0) -> Frame:
    return Frame(stamp, world(style).render(pose.x, pose.y, pose.yaw, stamp))


@cache
def registration(style: str, dock: Pose2D) -> DockRegistration:
    return DockRegistration(CAMERA, see(style, dock, 0.0), HEIGHT)


def error(estimate: HomingEstimate, truth: Pose2D) -> tuple[float, float]:
    found = estimate.dock_from_base
    return found.distance(truth), abs(math.degrees(wrap(found.yaw - truth.yaw)))


def test_a_smudge_that_is_known_is_not_looked_at() -> None:
    rows, columns = np.mgrid[:480, :640]
    smudge = np.hypot(columns - 380, rows - 200) < 60
    fibres = np.where((rows // 8 + columns // 8) % 2, 30, 120)
    frame = see("tiles", MIDDLE @ Pose2D(-0.2, 0.1, 0.3))
    picture = np.where(smudge, fibres, frame.grey()).astype(np.uint8)
    y, x = np.meshgrid(*2 * [np.linspace(-3.0, 3.0, 400)])
    rays = np.stack([x, y, np.ones_like(x)], -1)
    u, v = np.moveaxis(CAMERA.project(rays), -1, 0)
    dirty = np.zeros((RINGS, SECTORS), np.bool_)
    dirty.flat[cells_at(rays)[np.hypot(u - 380, v - 200) < 60]] = True
    unknown, known = (
        registration("tiles", MIDDLE).fix(Frame(1.0, picture, cells), Pose2D()) for cells in (None, dirty)
    )
    assert known.score > unknown.score + 0.05
    assert error(known, Pose2D(-0.2, 0.1, 0.3))[0] < 0.02


def test_a_frame_is_looked_at_once_whoever_asks() -> None:
    one, other = see("tiles", MIDDLE), see("tiles", MIDDLE)
    seen = ceiling_optics(CAMERA).view(one)
    assert ceiling_optics(CAMERA).view(one) is seen
    assert ceiling_optics(CAMERA).view(other) is not seen


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("away", [Pose2D(0.0, 0.0, 0.0), Pose2D(-0.5, 0.2, 2.0), Pose2D(0.3, -0.8, -3.0)])
def test_a_full_fix_in_the_open_is_right_within_two_centimetres(style: str, away: Pose2D) -> None:
    odom = Pose2D(5.0, 6.0, 1.0)
    estimate = registration(style, MIDDLE).fix(see(style, MIDDLE @ away, 7.0), odom)
    assert estimate.verdict is Verdict.ACCEPTED
    assert (estimate.stamp, estimate.odom_from_base) == (7.0, odom)
    metres, degrees = error(estimate, away)
    assert metres < 0.02
    assert degrees < 0.5


@pytest.mark.parametrize("style", STYLES)
def test_tracking_from_odometry_is_right_within_two_centimetres(style: str) -> None:
    away, drift = Pose2D(-0.4, 0.1, 0.3), Pose2D(0.04, -0.03, 0.05)
    estimate = registration(style, MIDDLE).track(see(style, MIDDLE @ away), Pose2D(), away @ drift)
    assert estimate.verdict is Verdict.ACCEPTED
    metres, degrees = error(estimate, away)
    assert metres < 0.02
    assert degrees < 0.5


AWAY = [Pose2D(0.0, 0.0, 0.0), Pose2D(-0.1, 0.05, 0.2), Pose2D(-0.5, 0.2, 2.0), Pose2D(0.3, -0.8, -3.0)]


@pytest.mark.parametrize("style", ["tiles", "plain", "beams"])
def test_the_covariance_holds_the_errors_and_is_not_huge(style: str) -> None:
    nees = []
    for away in AWAY:
        estimate = registration(style, MIDDLE).fix(see(style, MIDDLE @ away), Pose2D())
        found, covariance = estimate.dock_from_base, estimate.covariance
        assert covariance is not None
        off = np.array([found.x - away.x, found.y - away.y, wrap(found.yaw - away.yaw)])
        nees.append(float(off @ np.linalg.solve(covariance, off)))
        assert math.sqrt(covariance[0, 0] + covariance[1, 1]) < 0.04
        assert math.sqrt(covariance[2, 2]) < math.radians(0.5)
    # The mean of four chi-squares of three degrees of freedom is below this 99.9 times in 100.
    assert np.mean(nees) < 32.9 / len(nees)


def bars(pose: Pose2D, spacing: list[float]) -> Frame:
    """A ceiling of nothing but bars along y, at irregular distances; levelled and seen from `pose`."""
    v, u = np.mgrid[:480, :640].astype(float)
    ray = CAMERA.unproject(np.stack([u, v], -1))
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = (HEIGHT * ray[..., k] / np.where(ray[..., 2] > 0.05, ray[..., 2], np.nan) for k in range(2))
    along = pose.x + math.cos(pose.yaw) * x - math.sin(pose.yaw) * y
    dark = np.searchsorted(np.cumsum([-8.0, *spacing]), along) % 2
    noise = np.random.default_rng(int(1e3 * abs(pose.x + pose.y))).normal(0.0, 2.0, dark.shape)
    return Frame(1.0, np.clip(np.where(np.isfinite(along), 90 + 90 * dark, 30) + noise, 0, 255).astype(np.uint8))


def test_parallel_bars_alone_leave_it_unsure() -> None:
    spacing = list(np.random.default_rng(8).uniform(0.1, 0.7, 40))
    estimate = DockRegistration(CAMERA, bars(Pose2D(), spacing), HEIGHT).fix(bars(Pose2D(0.2, 0.5), spacing), Pose2D())
    assert estimate.verdict is not Verdict.ACCEPTED


def test_a_dock_at_the_wall_is_found_by_learning_the_wall() -> None:
    """Half of the dock's view is a wall 22 cm ahead: as one plane, the views of a plain ceiling agree 7 cm off."""
    room = world("plain", 3)
    dock, staged, later = Pose2D(*room.dock), Pose2D(-0.32, 0.17, 0.2), Pose2D(-0.25, -0.05, 0.1)

    def seen(away: Pose2D) -> Frame:
        pose = dock @ away
        return Frame(1.0, room.render(pose.x, pose.y, pose.yaw, 1.0))

    fresh = DockRegistration(CAMERA, seen(Pose2D()), HEIGHT)
    fresh.fix(seen(staged), Pose2D())
    metres, degrees = error(fresh.track(seen(later), Pose2D(), later), later)
    assert metres < 0.01
    assert degrees < 0.5


def test_another_light_changes_little() -> None:
    dim = ceilings.tiles(5, light="half_lamps")
    away = Pose2D(-0.4, 0.3, -1.2)
    pose = MIDDLE @ away
    frame = Frame(1.0, dim.render(pose.x, pose.y, pose.yaw, 1.0))
    metres, degrees = error(registration("tiles", MIDDLE).fix(frame, Pose2D()), away)
    assert metres < 0.02
    assert degrees < 0.5


def test_a_wrong_prior_far_from_the_truth_is_rejected_or_lands_on_it() -> None:
    away = Pose2D(-0.2, 0.0, 0.0)
    wrong = Pose2D(0.6, 0.5, 2.0)
    estimate = registration("tiles", MIDDLE).track(see("tiles", MIDDLE @ away), Pose2D(), wrong)
    assert estimate.verdict is Verdict.REJECTED or error(estimate, away)[0] < 0.02


@pytest.mark.parametrize("level", [0, 130, 255])
@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_a_flat_ceiling_is_rejected_not_a_crash(level: int, noise: float) -> None:
    rng = np.random.default_rng(3)

    def flat() -> Frame:
        return Frame(0.0, np.clip(rng.normal(level, noise, (480, 640)), 0, 255).astype(np.uint8))

    empty = DockRegistration(CAMERA, flat(), HEIGHT)
    assert empty.fix(flat(), Pose2D()).verdict is Verdict.REJECTED
    assert empty.track(flat(), Pose2D(), Pose2D(0.1, 0.0, 0.0)).verdict is Verdict.REJECTED


def test_another_rooms_ceiling_is_never_accepted() -> None:
    for k in range(-2, 3):
        elsewhere = see("beams", Pose2D(0.3 * k, -0.2 * k, 0.5 * k))
        assert registration("tiles", MIDDLE).fix(elsewhere, Pose2D()).verdict is not Verdict.ACCEPTED


def test_a_snapshot_of_another_size_names_both_sizes() -> None:
    with pytest.raises(FrameError, match=r"\d+x\d+.*\d+x\d+"):
        DockRegistration(CAMERA, Frame(0.0, np.zeros((240, 320), np.uint8)), HEIGHT)


@pytest.mark.parametrize("style", ["tiles", "plain"])
def test_ceiling_height_from_a_known_displacement(style: str) -> None:
    heights = []
    for k in range(5):
        first, moved = Pose2D(-0.8 + 0.4 * k, 0.3, 0.7 * k), Pose2D(0.35, 0.05, 0.3)
        second = first @ moved
        heights.append(visual_height(CAMERA, see(style, first), see(style, second), moved.inverse()))
    found = [height for height in heights if height is not None]
    assert len(found) >= 3
    assert float(np.median(found)) == pytest.approx(HEIGHT, rel=0.02)


@pytest.mark.parametrize("moved", [Pose2D(0.1, 0.0, 0.0), Pose2D(0.9, 0.0, 0.0)])
def test_no_height_from_too_short_or_too_long_a_way(moved: Pose2D) -> None:
    frames = see("tiles", MIDDLE), see("tiles", MIDDLE @ moved)
    assert visual_height(CAMERA, *frames, moved.inverse()) is None


def test_no_height_where_sight_and_odometry_contradict_each_other() -> None:
    moved, claimed = Pose2D(0.4, 0.0, 0.0), Pose2D(0.0, 0.4, 0.0)
    frames = see("tiles", MIDDLE), see("tiles", MIDDLE @ moved)
    assert visual_height(CAMERA, *frames, claimed.inverse()) is None


def test_edge_strength_ignores_gain() -> None:
    grey = see("tiles", MIDDLE).grey()
    bright, dark = edge_strength(grey), edge_strength((grey // 2).astype(np.uint8))
    inside = np.s_[150:330, 230:410]
    assert np.corrcoef(bright[inside].ravel(), dark[inside].ravel())[0, 1] > 0.95


def test_a_person_at_the_border_is_masked_and_a_dark_tile_inside_is_not() -> None:
    view = np.full((160, 160), 180, np.uint8)
    cv2.rectangle(view, (60, 60), (90, 90), 20, -1)
    assert unoccluded(view) is None
    cv2.ellipse(view, (0, 80), (40, 25), 0, 0, 360, 20, -1)
    free = unoccluded(view)
    assert free is not None
    assert free[80, 10] == 0
    assert free[75, 75] == 255
    assert free[20, 140] == 255
