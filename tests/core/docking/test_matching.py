"""Matching, walls and refinement on synthetic ceilings, whose pictures follow from geometry alone."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from omnibotd.core.docking.ceiling_view import FINE, MIDDLE, CeilingView, Layer
from omnibotd.core.docking.matching import Sample, align, residuals
from omnibotd.core.docking.refinement import Refinement
from omnibotd.core.docking.translation import ShiftSearch, ceiling_parts
from omnibotd.core.docking.walls import NO_WALLS, Walls, WallSearch
from omnibotd.core.vision.frame import FloatImage, Image

FOCAL = FINE / 2.0 / math.tan(math.radians(65.0))
VALID = np.full((FINE, FINE), 255, np.uint8)
PATTERN = cv2.GaussianBlur(np.random.default_rng(2).uniform(0, 255, (1600, 1600)).astype(np.float32), (0, 0), 5.0)
PATTERN = (PATTERN - PATTERN.mean()) * np.float32(9.0) + np.float32(128.0)


def rays() -> tuple[np.ndarray, np.ndarray]:
    axis = (np.arange(FINE) - (FINE - 1) / 2.0) / FOCAL
    return tuple(np.meshgrid(axis, axis))  # type: ignore[return-value]


def image(yaw: float, u: float, v: float, walls: tuple[tuple[float, float], ...] = ()) -> Image:
    """What a camera at (u, v), turned by yaw, sees of a patterned ceiling at height 1 that ends at `walls`.

    A wall's pattern goes on from the ceiling's, folded up: each ray meets the ceiling or, sooner, a wall.
    """
    c, s = math.cos(yaw), math.sin(yaw)
    ru, rv = rays()
    du, dv = c * ru - s * rv, s * ru + c * rv
    reach, (au, av) = np.ones_like(du), (np.zeros_like(du), np.zeros_like(du))
    for wu, wv in walls:
        left = 1.0 - wu * u - wv * v  # distance to the wall over that of the origin
        met = left / np.maximum(wu * du + wv * dv, 1e-9)
        nearer = met < reach
        length2 = wu * wu + wv * wv
        au, av = np.where(nearer, wu / math.sqrt(length2), au), np.where(nearer, wv / math.sqrt(length2), av)
        reach = np.minimum(reach, met)
    # Below the ceiling the pattern continues along the wall's normal.
    pu, pv = u + du * reach + au * (1.0 - reach), v + dv * reach + av * (1.0 - reach)
    scale, centre = 160.0, 800.0
    at = (np.float32(pu * scale + centre), np.float32(pv * scale + centre))
    return np.clip(cv2.remap(PATTERN, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT), 0, 255).astype(np.uint8)


def view(yaw: float, u: float, v: float, walls: tuple[tuple[float, float], ...] = ()) -> CeilingView:
    return CeilingView(image(yaw, u, v, walls), VALID, FOCAL, None)


TARGET = view(0.0, 0.0, 0.0)


@pytest.mark.parametrize("pose", [(0.06, 0.05, -0.03), (-0.05, -0.04, 0.06), (3.1, 0.03, 0.02), (0.0, 0.0, 0.0)])
def test_every_hypothesis_near_a_pose_ends_there(pose: tuple[float, float, float]) -> None:
    truth = np.array(pose)
    sample, layer = Sample.of(TARGET.layer(MIDDLE), 32), view(*pose).layer(MIDDLE)
    starts = truth + np.array([[0.03, 0.02, 0.0], [-0.04, 0.0, 0.03], [0.0, -0.03, -0.02]])
    near, all_ = NO_WALLS.nearness(sample.at), np.ones((1, 1), np.float32)
    found = align(sample, layer, starts, near, all_, 10)
    # A pixel of this layer is 1/28 of the ceiling's height.
    assert np.abs(found - truth).max() < 0.003
    assert residuals(sample, layer, found, near).misfit(sample.chance).max() < 0.2
    assert residuals(sample, layer, starts + 0.3, near).misfit(sample.chance).min() > 0.6


def test_gain_and_offset_change_nothing() -> None:
    pose = np.array([0.04, 0.02, -0.03])
    layer = view(*pose).layer(MIDDLE)
    dim = layer.picture * np.array([0.4, 0.4, 0.4, 1.0], np.float32) + np.array([0.7, 0.0, 0.0, 0.0], np.float32)
    sample = Sample.of(TARGET.layer(MIDDLE), 32)
    near, all_ = NO_WALLS.nearness(sample.at), np.ones((1, 1), np.float32)
    found = align(sample, Layer(dim, layer.focal), np.zeros((1, 3)), near, all_, 12)
    assert found[0] == pytest.approx(pose, abs=0.003)


def test_a_flat_view_takes_no_step_and_correlates_with_nothing() -> None:
    flat = CeilingView(np.full((FINE, FINE), 90, np.uint8), VALID, FOCAL, None)
    start = np.array([[0.2, 0.1, 0.0]])
    sample = Sample.of(flat.layer(MIDDLE), 32)
    near, all_ = NO_WALLS.nearness(sample.at), np.ones((1, 1), np.float32)
    assert align(sample, flat.layer(MIDDLE), start, near, all_, 3) == pytest.approx(start, abs=1e-9)
    refined = Refinement(flat).refine(TARGET, start[0], (0.02, 0.02))
    assert refined.pose == pytest.approx(start[0], abs=0.01)
    assert refined.correlation == pytest.approx(0.0, abs=1e-3)


def test_views_without_overlap_correlate_minus_one() -> None:
    sample = Sample.of(TARGET.layer(MIDDLE), 32)
    far = residuals(sample, TARGET.layer(MIDDLE), np.array([[0.0, 9.0, 0.0]]), NO_WALLS.nearness(sample.at))
    assert far.correlation()[0] == -1.0


def test_refinement_tells_pose_and_a_spread_that_holds() -> None:
    refinement = Refinement(TARGET)
    for k, pose in enumerate([(0.02, 0.03, -0.02), (2.0, -0.05, 0.04), (-1.0, 0.1, 0.05)]):
        truth = np.array(pose)
        noisy = np.clip(image(*pose) + np.random.default_rng(k).normal(0.0, 6.0, (FINE, FINE)), 0, 255)
        seen = CeilingView(noisy.astype(np.uint8), VALID, FOCAL, None)
        refined = refinement.refine(seen, truth + np.array([0.02, -0.02, 0.01]), None)
        error = refined.pose - truth
        assert np.abs(error).max() < 0.002
        assert error @ np.linalg.solve(refined.covariance, error) < 16.3  # 99.9 % of three degrees of freedom


def test_what_is_expected_holds_where_the_picture_says_little() -> None:
    """Parallel stripes: nothing tells where along them the camera stands."""
    stripes = np.broadcast_to(128.0 + 60.0 * np.sin(np.arange(FINE) / 3.0), (FINE, FINE))
    striped = CeilingView(stripes.astype(np.uint8), VALID, FOCAL, None)
    # Without noise nothing would be left to expect but the processor's own rounding.
    noisy = stripes + np.random.default_rng(1).normal(0.0, 2.0, (FINE, FINE))
    seen = CeilingView(noisy.astype(np.uint8), VALID, FOCAL, None)
    refined = Refinement(striped).refine(seen, np.array([0.0, 0.0, 0.01]), (0.02, 0.02))
    assert refined.pose[2] == pytest.approx(0.01, abs=0.004)  # a fifth of the spread
    across, along = np.sqrt(np.diag(refined.covariance)[1:])
    assert along > 5.0 * across


def test_light_that_falls_off_moves_no_groove() -> None:
    """A grid of dark grooves, and a lamp beside the view whose light falls off faster than the grooves are deep."""
    column, row = np.meshgrid(np.arange(FINE), np.arange(FINE))
    grooves = cv2.GaussianBlur(np.where((column % 30 < 3) | (row % 30 < 3), -6.0, 0.0), (0, 0), 1.0)
    lit = 118.0 + grooves, 118.0 + grooves - 0.9 * (column - FINE / 2.0)
    target, seen = (CeilingView(np.rint(picture).astype(np.uint8), VALID, FOCAL, None) for picture in lit)
    refined = Refinement(target).refine(seen, np.zeros(3), (0.02, 0.02))
    assert np.abs(refined.pose[1:]).max() * FOCAL < 0.2
    assert refined.correlation > 0.9


def test_what_is_hidden_has_nothing_alike() -> None:
    hidden = image(0.0, 0.0, 0.0)
    hidden[:, :80] = 90
    sample = Sample.of(TARGET.layer(MIDDLE), 32)
    seen = CeilingView(hidden, VALID, FOCAL, None).layer(MIDDLE)
    alike = residuals(sample, seen, np.zeros((1, 3)), NO_WALLS.nearness(sample.at)).alikeness()[0]
    column = sample.at[0] * FOCAL + (FINE - 1) / 2.0
    # The feature is evened over a box of 9 pixels of the fine layer and smeared by the reduction.
    assert alike[column < 65].max() < 0.1
    assert alike[column > 95].min() > 0.5  # less than 1: the hidden part changes the spread of the whole


WALLS = ((0.0, -4.0), (2.5, 0.0))  # ahead at 1/4, to the left at 2/5 of the height


def test_finds_the_walls_of_a_corner_and_the_pose_with_them() -> None:
    """The pose always; of the walls many, for three frames do not show each."""
    found = 0
    for drive in range(12):
        rng, refinement = np.random.default_rng(drive), Refinement(view(0.0, 0.0, 0.0, WALLS))
        for place in [(0.0, -0.06, 0.08), (0.2, -0.05, 0.05), (-0.1, 0.03, 0.05)]:
            pose = np.array(place) + rng.normal(0.0, 0.01, 3)
            start = pose + rng.normal(0.0, 0.01, 3)
            refined = refinement.refine(view(*pose, WALLS), start, (0.02, 0.02))
        assert refined.pose == pytest.approx(pose, abs=0.004)
        towards = refinement.walls.towards
        found += sum(np.hypot(*(towards - wall).T).min(initial=9.0) < 0.1 * math.hypot(*wall) for wall in WALLS)
    assert found >= 8  # of 24


def test_the_search_leaves_a_ceiling_without_walls_alone() -> None:
    pose = (0.1, 0.08, -0.1)
    search = WallSearch(Sample.of(TARGET.layer(MIDDLE), 32))
    assert len(search.more(view(*pose).layer(MIDDLE), np.array(pose), NO_WALLS)) == 0


def test_nearness_is_that_of_the_first_surface_met() -> None:
    walls = Walls(np.array(WALLS), np.zeros((4, 4)))
    met = np.array([[0.0, 0.0, 0.8, 0.8, -1.0], [0.0, -0.5, 0.0, -0.4, 1.0]], np.float32)
    assert walls.nearness(met) == pytest.approx([1.0, 2.0, 2.0, 2.0, 1.0])
    assert list(walls.met(met)[:3]) == [0, 1, 2]


def plane() -> FloatImage:
    rng = np.random.default_rng(4)
    return np.asarray(cv2.GaussianBlur(rng.normal(size=(200, 200)).astype(np.float32), (0, 0), 2.0), np.float32)


@pytest.mark.parametrize(("u", "v"), [(7, -4), (-8, 6), (0, 0)])
def test_the_shift_search_finds_the_shift(u: int, v: int) -> None:
    whole = plane()
    best = ShiftSearch(whole[70:130, 70:130].copy(), 14.0, 10.0).find(whole[70 + v : 130 + v, 70 + u : 130 + u], 3)[0]
    assert (best.u, best.v) == pytest.approx((u, v), abs=1.0)


def test_the_shift_search_finds_the_quarter_that_is_ceiling() -> None:
    """Only a quarter of the target is in the current view, at another shift; the rest of it is something else."""
    whole, other = plane(), np.roll(plane()[::-1], 31, 0)
    target = whole[70:130, 70:130].copy()
    current = other[70:130, 70:130].copy()
    current[28 - 5 :, : 32 - 3] = whole[70 + 28 : 130 + 5, 70 + 3 : 70 + 32][: 60 - 23]
    found = ShiftSearch(target, 14.0, 10.0).find(current, 3)
    assert any((shift.u, shift.v) == pytest.approx((3, 5), abs=1.0) for shift in found)


def test_parts_of_a_corner_leave_the_walls_out() -> None:
    parts = ceiling_parts(np.array([1.0, -1.0]), np.array([-1.0, 1.0]))
    corner = [k for k in range(9) if parts[k, 0] == 0.0 and parts[k, 1] == 1.0]
    assert len(corner) == 3  # left of it, behind it, and both
