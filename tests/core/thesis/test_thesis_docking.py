"""Docking of the thesis: its parts on drawings, the chain under a painted ceiling, the procedure on a perfect base."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from omnibotd.core.decision import Observation, Outcome
from omnibotd.core.docking.docker import DockingParameters
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Pose2D, Twist2D, wrap
from omnibotd.core.percept import HomingEstimate, Verdict
from omnibotd.core.thesis.docking import (
    BINS,
    SIZE,
    START,
    ThesisHoming,
    edge_histogram,
    match_histograms,
    match_profiles,
    profiles,
    turned,
)
from omnibotd.core.thesis.docking_controller import MAX_STEPS, ThesisDocker, Vicinity
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame

CAMERA = CameraModel.equidistant(640, 480, math.radians(190.0))
ALL = np.full((SIZE, SIZE), 255, np.uint8)
HEIGHT = 2.5  # m from camera to ceiling: 240 px / 2.5 m = 96 px a metre
TEXELS = 100.0  # a metre


def step_edge(grey: int) -> np.ndarray:
    """0 left of the middle, `grey` right of it."""
    image = np.zeros((SIZE, SIZE), np.uint8)
    image[:, SIZE // 2 :] = grey
    return image


def test_an_edge_counts_from_a_sobel_of_150_on() -> None:
    """A step of g grey values has |dx| = 4 g in the two columns beside it: 148 for 37, 152 for 38."""
    assert edge_histogram(step_edge(37), ALL).sum() == 0
    histogram = edge_histogram(step_edge(38), ALL)
    assert histogram[0] == 2 * SIZE
    assert histogram.sum() == 2 * SIZE


def test_edges_point_from_dark_to_bright_and_v_is_down() -> None:
    down = edge_histogram(np.ascontiguousarray(step_edge(200).T), ALL)
    assert int(down.argmax()) == 90
    left = edge_histogram(np.ascontiguousarray(step_edge(200)[:, ::-1]), ALL)
    assert int(left.argmax()) == 180


def test_the_border_of_what_the_lens_sees_is_no_edge() -> None:
    valid = ALL.copy()
    valid[:, : SIZE // 2] = 0
    assert edge_histogram(step_edge(200), valid).sum() == 0


@pytest.mark.parametrize(("shift", "degrees"), [(0, 0), (93, 93), (180, 180), (350, -10)])
def test_the_turn_is_the_shift_of_the_histogram_the_short_way(shift: int, degrees: int) -> None:
    target = np.random.default_rng(1).integers(0, 400, BINS).astype(float)
    turn = match_histograms(target, np.roll(target, shift))
    assert turn is not None
    assert math.degrees(wrap(turn.angle - math.radians(degrees))) == pytest.approx(0.0, abs=1e-9)
    assert turn.margin == 1.0


def test_a_ceiling_that_looks_the_same_from_behind_leaves_no_margin() -> None:
    half = np.random.default_rng(2).integers(0, 400, BINS // 2).astype(float)
    turn = match_histograms(np.tile(half, 2), np.tile(half, 2))
    assert turn is not None
    assert turn.margin == 0.0


def test_without_edges_there_is_no_turn() -> None:
    some = np.ones(BINS)
    assert match_histograms(np.zeros(BINS), some) is None
    assert match_histograms(some, np.zeros(BINS)) is None


def test_content_turns_from_u_towards_v() -> None:
    image = np.zeros((SIZE, SIZE), np.uint8)
    image[235:245, 395:405] = 255  # right of the centre by 160 px
    rows, columns = np.nonzero(turned(image, math.radians(90.0)) > 128)
    assert (columns.mean(), rows.mean()) == pytest.approx((239.5, 239.5 + 160.0), abs=1.0)


def test_corners_are_filled_with_the_mean() -> None:
    assert turned(np.full((SIZE, SIZE), 77, np.uint8), 0.8).min() == 77


def test_profiles_are_differences_of_row_and_column_means() -> None:
    ramp = np.tile(np.arange(SIZE) % 200, (SIZE, 1)).astype(np.uint8)
    made = profiles(ramp)
    assert made.columns[:199] == pytest.approx(1.0)
    assert made.rows == pytest.approx(0.0)
    assert len(made.rows) == SIZE - 1


@pytest.mark.parametrize("shift", [0, 1, -37, 100])
def test_a_profile_is_found_whatever_its_gain(shift: int) -> None:
    rng = np.random.default_rng(3)
    long = rng.normal(size=SIZE + 400)
    target, current = long[200 : 200 + SIZE - 1], long[200 - shift : 200 - shift + SIZE - 1]
    found = match_profiles(target, 0.3 * current)
    assert (found.pixels, found.saturated) == (shift, False)
    assert found.ncc == pytest.approx(1.0)


def test_beyond_the_search_it_says_so() -> None:
    template = np.sin(np.arange(SIZE - 1) / 150.0)  # rises and falls once: the best place is off either end
    assert match_profiles(template, np.roll(template, 200)).saturated
    assert match_profiles(template, np.zeros(SIZE - 1)).ncc == -1.0
    assert START == 144


class Ceiling:
    """Bright triangles of all sizes that point the same way, HEIGHT above the camera; no walls."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self._texture = np.full((800, 800), 60, np.uint8)
        for _ in range(70):
            corners = rng.uniform(0, 800, 2) + rng.uniform(20, 70) * np.array([[0, 0], [1, 0], [0, 1.5]])
            cv2.fillConvexPoly(self._texture, corners.astype(np.int32), int(rng.integers(130, 255)), cv2.LINE_AA)
        # As soft as the lens is: hard edges would come out as staircases, whose steps point elsewhere.
        self._texture = cv2.GaussianBlur(self._texture, (0, 0), 1.5)
        # NaN is what lies outside the lens.
        rays = np.nan_to_num(CAMERA.unproject(np.stack(np.meshgrid(np.arange(640), np.arange(480)), -1)))
        self._x, self._y = (HEIGHT * rays[..., k] / np.maximum(rays[..., 2], 0.2) for k in (0, 1))

    def frame(self, pose: Pose2D, stamp: float = 0.0) -> Frame:
        x, y = pose.transform(self._x, self._y)
        maps = [(400.0 + TEXELS * axis).astype(np.float32) for axis in (x, y)]
        return Frame(stamp, cv2.remap(self._texture, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


DOCK = Pose2D(0.2, -0.1, 0.7)


@pytest.fixture(scope="module")
def ceiling() -> Ceiling:
    return Ceiling(1)


@pytest.fixture(scope="module")
def homing(ceiling: Ceiling) -> ThesisHoming:
    return ThesisHoming(CAMERA, ceiling.frame(DOCK), HEIGHT)


def test_at_the_dock_there_is_nothing_to_do(ceiling: Ceiling, homing: ThesisHoming) -> None:
    estimate = homing.fix(ceiling.frame(DOCK, 3.0), Pose2D(1.0, 2.0, 3.0))
    assert estimate.dock_from_base == Pose2D()
    assert (estimate.stamp, estimate.odom_from_base) == (3.0, Pose2D(1.0, 2.0, 3.0))
    assert estimate.verdict is Verdict.ACCEPTED


@pytest.mark.parametrize(("x", "y", "yaw"), [(-0.5, 0.0, 0.0), (0.0, 0.4, 0.0), (0.3, -0.3, 2.0), (-0.6, 0.2, -3.0)])
def test_homes_at_96_pixels_a_metre_in_the_robots_axes(
    ceiling: Ceiling, homing: ThesisHoming, x: float, y: float, yaw: float
) -> None:
    away = Pose2D(x, y, yaw)
    found = homing.fix(ceiling.frame(DOCK @ away), Pose2D()).dock_from_base
    # Whole pixels of 1.04 cm and whole degrees; 1 cm is what the method takes a pixel for.
    assert found.x == pytest.approx(0.96 * x, abs=0.02)
    assert found.y == pytest.approx(0.96 * y, abs=0.02)
    assert math.degrees(wrap(found.yaw - yaw)) == pytest.approx(0.0, abs=1.0)


def test_within_a_metre_nine_turns_of_ten_are_right_and_the_direction_is_good(
    ceiling: Ceiling, homing: ThesisHoming
) -> None:
    rng = np.random.default_rng(4)
    turns, directions = [], []
    for _ in range(30):
        r, bearing, yaw = 0.2 + 0.7 * rng.random(), *rng.uniform(-math.pi, math.pi, 2)
        truth = Pose2D(r * math.cos(bearing), r * math.sin(bearing), yaw)
        goal, found = truth.inverse(), homing.fix(ceiling.frame(DOCK @ truth), Pose2D()).dock_from_base.inverse()
        turns.append(abs(math.degrees(wrap(found.yaw - goal.yaw))))
        directions.append(abs(math.degrees(wrap(math.atan2(found.y, found.x) - math.atan2(goal.y, goal.x)))))
    assert np.mean(np.array(turns) <= 1.0) >= 0.9
    assert np.median(directions) <= 2.0


def test_a_flat_ceiling_is_rejected(homing: ThesisHoming) -> None:
    assert homing.fix(Frame(0.0, np.full((480, 640), 130, np.uint8)), Pose2D()).verdict is Verdict.REJECTED


class PerfectBase:
    """Goes exactly as told, ten ticks a second."""

    def __init__(self, start: Pose2D) -> None:
        self.pose, self.stamp = start, 50.0

    def drive(self, twist: Twist2D) -> None:
        turn, ahead = twist.wz * 0.1, twist.vx * 0.1
        self.pose = self.pose @ Pose2D(ahead * math.cos(turn / 2), ahead * math.sin(turn / 2), turn)
        self.stamp += 0.1


def dock(base: PerfectBase, docker: ThesisDocker, estimate, **seen) -> Outcome:
    """Steps until the outcome; `estimate(base)` answers each request of a base that stands."""
    homing, was_still = None, 0
    for _ in range(6000):
        decision = docker.step(Observation(base.stamp, base.pose, homing=homing, **seen))
        if decision.outcome is not None:
            return decision.outcome
        base.drive(decision.twist)
        was_still = was_still + 1 if decision.twist == STOP else 0
        homing = estimate(base) if decision.homing is not None and was_still > 4 else homing
    raise AssertionError("no outcome in ten minutes")


def test_docks_on_a_plane_to_a_pixel_and_a_degree_and_counts_steps(ceiling: Ceiling, homing: ThesisHoming) -> None:
    base = PerfectBase(DOCK @ Pose2D(-0.6, 0.3, 1.9))
    outcome = dock(
        base,
        ThesisDocker("home", DockingParameters()),
        lambda base: homing.fix(ceiling.frame(base.pose, base.stamp), base.pose),
    )
    assert outcome.error is None
    assert base.pose.distance(DOCK) < 0.02
    assert abs(math.degrees(wrap(base.pose.yaw - DOCK.yaw))) < 1.5
    assert 1.0 <= outcome.report["steps"] < 16.0


def seen_as(pose: Pose2D, verdict: Verdict = Verdict.ACCEPTED):
    """An eye that sees the dock so, wherever it looks from."""
    return lambda base: HomingEstimate(base.stamp, base.pose, pose, 0.9, 0.5, verdict)


def test_one_pixel_is_there_and_the_last_turn_is_the_short_way() -> None:
    base = PerfectBase(Pose2D())
    goal = Pose2D(0.0, 0.01, math.radians(-20.0))
    outcome = dock(base, ThesisDocker("home", DockingParameters()), seen_as(goal.inverse()))
    assert (outcome.error, outcome.report["steps"]) == (None, 0.0)
    assert math.degrees(base.pose.yaw) == pytest.approx(-20.0, abs=1.0)
    assert base.pose.distance(Pose2D()) < 1e-6


def test_a_pixel_more_is_driven() -> None:
    base = PerfectBase(Pose2D())
    docker = ThesisDocker("home", DockingParameters())

    def two_pixels_once(base: PerfectBase) -> HomingEstimate:
        return seen_as(Pose2D(-0.02 if docker.steps == 0 else 0.0))(base)

    outcome = dock(base, docker, two_pixels_once)
    assert outcome.report["steps"] == 1.0
    assert base.pose.x == pytest.approx(0.02, abs=0.003)


def test_gives_up_after_sixty_steps() -> None:
    outcome = dock(PerfectBase(Pose2D()), ThesisDocker("home", DockingParameters()), seen_as(Pose2D(0.03, 0.0)))
    assert outcome.error is ErrorName.FAILED_TO_CONTROL
    assert outcome.report["steps"] == MAX_STEPS


def test_a_bump_ends_the_drive_not_the_job() -> None:
    base = PerfectBase(Pose2D())
    outcome = dock(base, ThesisDocker("home", DockingParameters()), seen_as(Pose2D(-0.5, 0.0)), bumper_left=True)
    assert outcome.error is ErrorName.FAILED_TO_CONTROL
    assert base.pose.distance(Pose2D()) < 1e-6


def test_sees_nothing_says_so_and_a_dead_base_ends_it() -> None:
    unseen = seen_as(Pose2D(), Verdict.REJECTED)
    outcome = dock(PerfectBase(Pose2D()), ThesisDocker("home", DockingParameters()), unseen)
    assert outcome.error is ErrorName.FAILED_TO_DETECT_DOCK
    docker = ThesisDocker("home", DockingParameters())
    outcome = dock(PerfectBase(Pose2D()), docker, unseen, base_ok=False)
    assert outcome.error is ErrorName.BASE_LINK_DOWN


class Trip:
    def __init__(self, *left: float | None) -> None:
        self._left = list(left)

    def step(self, seen: Observation):
        from omnibotd.core.decision import Decision

        return Decision("NAVIGATING", Twist2D(0.2, 0.0), distance_remaining=self._left.pop(0))


def test_the_maps_part_ends_within_a_metre() -> None:
    trip = Vicinity(Trip(None, 1.4, 0.9))
    seen = Observation(0.0, Pose2D())
    assert [trip.step(seen).outcome for _ in range(2)] == [None, None]
    last = trip.step(seen)
    assert last.outcome is not None
    assert last.outcome.error is None
    assert last.twist == STOP
