"""Lenses come out as they went in, or are refused with what to do; how far they can be trusted is told honestly."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from omnibotd.core.calibration import lens_model
from omnibotd.core.calibration.chessboard import Board, BoardView
from omnibotd.core.calibration.lens import LensResult, calibrate_lens
from omnibotd.core.calibration.lens_verdict import Evidence, judge, too_few
from omnibotd.core.percept import Verdict
from omnibotd.core.vision.camera_model import CameraModel
from tests.chessboards import Lens, Placed, placed

BOARD = Board(6, 4, 0.03)
WIDE = Lens.fitting(640, 480, 190, "webcam")


def _views(
    lens: Lens,
    count: int = 12,
    noise: float = 0.15,
    farthest: float = 0.85,
    seed: int = 0,
    accept: Callable[[Placed], bool] = lambda pose: True,
) -> list[BoardView]:
    """Corners as a detector would find them, of boards whose middle is at most `farthest` of the way to the edge."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(BOARD.columns), np.arange(BOARD.rows))
    points = np.column_stack([x.ravel(), y.ravel()]) * BOARD.square
    views: list[BoardView] = []
    while len(views) < count:
        pose = placed(lens, BOARD, rng, farthest * min(lens.fov / 2.0, 1.9), whole=False)
        corners = lens.project(pose.points(BOARD))
        seen = np.isfinite(corners[:, 0])
        if accept(pose):
            corners = corners + rng.normal(0.0, noise, corners.shape)
            views.append(BoardView(f"{len(views)}.jpg", corners[seen], points[seen]))
    return views


def _calibrated(lens: Lens, views: list[BoardView]) -> LensResult:
    radius = float(lens.radius(np.array(lens.fov / 2.0)))
    shows = radius < min(lens.width, lens.height) / 2.0
    return calibrate_lens(views, (lens.width, lens.height), (lens.cx, lens.cy, radius) if shows else None)


def _rays(zenith: float) -> np.ndarray:
    headings = np.arange(0.0, 2.0 * math.pi, 0.2)
    across = math.sin(zenith)
    return np.column_stack(
        [across * np.cos(headings), across * np.sin(headings), np.full(len(headings), math.cos(zenith))]
    )


def _error(lens: Lens, result: LensResult, zenith: float) -> float:
    """Largest px between where lens and result image rays out to `zenith`."""
    fitted = np.array([*result.camera_matrix, *result.distortion])
    rings = [_rays(angle) for angle in np.arange(0.1, zenith, 0.1)] + [_rays(zenith)]
    gaps = [np.hypot(*(lens_model.project(fitted, ring) - lens.project(ring)).T) for ring in rings]
    return float(np.nanmax(np.concatenate(gaps)))


@pytest.mark.parametrize(
    ("lens", "rim"),
    [
        (WIDE, 80.0),
        (Lens.fitting(640, 480, 220, "equisolid"), 80.0),
        (Lens.fitting(960, 960, 180, "stereographic"), 80.0),
        (Lens.fitting(640, 480, 130, "equidistant", fill=1.3), 64.0),
        (replace(WIDE, cx=270.0, cy=251.0, f=WIDE.f * 1.1, aspect=1.01), 80.0),
    ],
    ids=["190", "220", "180 stereographic", "130 larger than the picture", "off centre, oblong pixels"],
)
def test_recovers_lenses_of_all_kinds(lens: Lens, rim: float) -> None:
    result = _calibrated(lens, _views(lens))
    assert result.verdict is Verdict.ACCEPTED, result.sentence
    error = _error(lens, result, math.radians(rim))
    assert error < 1.5
    assert error < 4.0 * result.edge_sigma
    assert len(result.view_rms) == 12
    assert result.covered > math.radians(0.8 * rim)


def test_rms_is_of_distances() -> None:
    """Noise of 0.4 px in each coordinate: sqrt(2) times that, less what the 8 + 6 x 20 unknowns explain away."""
    views = _views(WIDE, count=20, noise=0.4)
    corners = sum(len(view.corners) for view in views)
    expected = 0.4 * math.sqrt(2.0) * math.sqrt(1.0 - (8 + 6 * 20) / (2 * corners))
    assert _calibrated(WIDE, views).rms == pytest.approx(expected, rel=0.05)


def test_the_written_camera_info_projects_like_the_lens() -> None:
    result = _calibrated(WIDE, _views(WIDE))
    model = CameraModel.from_camera_info(result.camera_info(), math.radians(190))
    camera = _rays(1.2)
    camera_from_base = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # u is y, v is -x
    assert np.hypot(*(model.project(camera @ camera_from_base) - WIDE.project(camera)).T).max() < 1.5


def test_corners_and_views_that_contradict_are_left_out() -> None:
    rng = np.random.default_rng(3)
    views = _views(WIDE, count=14)
    for i in (2, 9):
        views[i] = replace(views[i], corners=rng.permutation(views[i].corners))
    stray = views[5].corners.copy()
    stray[3] += [9.0, -7.0]
    views[5] = replace(views[5], corners=stray)
    result = _calibrated(WIDE, views)
    assert result.verdict is Verdict.ACCEPTED, result.sentence
    assert {name for name, _ in result.dropped} == {"2.jpg", "9.jpg"}
    assert result.rms < 0.3
    assert _error(WIDE, result, math.radians(80)) < 1.5


def test_most_views_contradicting_is_no_lens() -> None:
    rng = np.random.default_rng(1)
    views = [replace(view, corners=rng.uniform(60, 420, view.corners.shape)) for view in _views(WIDE, count=6)]
    result = _calibrated(WIDE, views)
    assert result.verdict is Verdict.REJECTED
    assert "flat" in result.sentence


@pytest.mark.parametrize("count", [0, 1, 4])
def test_too_few_views(count: int) -> None:
    result = _calibrated(WIDE, _views(WIDE, count=count))
    assert result.verdict is Verdict.REJECTED
    assert result.sentence.startswith(f"Only {count} different views")
    assert "near each edge" in result.sentence


def test_the_same_view_again_counts_once() -> None:
    views = _views(WIDE, count=4)
    again = [replace(view, name=f"again {view.name}", corners=view.corners + 0.4) for view in views]
    result = _calibrated(WIDE, views + again)
    assert result.sentence.startswith("Only 4 different views")
    assert ("again 2.jpg", "the same view as 2.jpg") in result.dropped


def test_a_part_too_small_for_a_pose_is_left_out() -> None:
    views = _views(WIDE)
    views[0] = BoardView("bit.jpg", views[0].corners[:5], views[0].points[:5])
    assert ("bit.jpg", "only 5 corners") in _calibrated(WIDE, views).dropped


def test_a_board_only_in_the_middle() -> None:
    near = _views(WIDE, farthest=0.1, accept=lambda pose: pose.translation[2] > 0.25)
    result = _calibrated(WIDE, near)
    assert result.verdict is Verdict.REJECTED
    assert "the board was seen only as far as" in result.sentence.lower()
    assert "nearer the" in result.sentence


def test_a_board_only_on_the_right_sends_to_the_left() -> None:
    """The whole board right of the middle: where the lens is farthest off is where none was."""

    def right(pose: Placed) -> bool:
        return bool((pose.points(BOARD)[:, 0] > 0.1 * pose.points(BOARD)[:, 2]).all())

    result = _calibrated(WIDE, _views(WIDE, accept=right))
    assert result.verdict is Verdict.REJECTED
    assert "left" in result.sentence
    assert "right" not in result.sentence


def test_an_ordinary_lens_is_no_fisheye() -> None:
    lens = Lens.fitting(640, 480, 90, "pinhole", fill=1.67)
    result = _calibrated(lens, _views(lens))
    assert result.verdict is Verdict.REJECTED
    assert "no fisheye" in result.sentence


GOOD = Evidence(0.2, 640, np.full(8, 1.6), np.full(8, 1.5), 1.5, 0.9, 0.5, 3.2, False)


@pytest.mark.parametrize(
    ("change", "used", "contradicting", "says"),
    [
        ({}, 12, 9, "9 of 21 views contradict"),
        ({"rms": 2.0}, 12, 0, "2.0 px"),
        ({"rms": math.nan}, 12, 0, "off any lens"),
        ({"edges": np.full(8, 0.7), "reached": np.full(8, 0.7)}, 12, 0, "no farther than 40 degrees"),
        ({"covered": 0.9, "reached": np.full(8, 0.9)}, 12, 0, "only as far as 52 degrees"),
        ({"folded": True}, 12, 0, "only as far as 86 degrees"),
        ({"reached": np.array([1.5, 0.4, 0.4, 0.4, 0.4, 1.5, 1.5, 1.5])}, 12, 0, "nearer the bottom and left edge"),
        ({"edge_sigma": 3.0}, 12, 0, "known to 3.0 px only"),
        ({"edge_sigma": math.nan}, 12, 0, "only"),
    ],
)
def test_each_objection(change: dict[str, object], used: int, contradicting: int, says: str) -> None:
    verdict, sentence = judge(replace(GOOD, **change), used, contradicting)
    assert verdict is Verdict.REJECTED
    assert says in sentence


def test_good_evidence_is_accepted_with_what_would_make_it_better() -> None:
    assert judge(GOOD, 12, 0) == (
        Verdict.ACCEPTED,
        "Good to 0.5 px at 80 degrees off axis: 12 views out to 86 degrees, 0.20 px rms",
    )
    reached = np.array([1.5, 1.5, 1.5, 0.2, 0.3, 1.5, 1.5, 1.5])
    verdict, sentence = judge(replace(GOOD, reached=reached), 12, 2)
    assert verdict is Verdict.ACCEPTED
    assert sentence.endswith("views near the left edge would make it better")
    assert "3 others" in too_few(2, 3)


def test_derivatives_are_those_of_the_projection() -> None:
    lens = np.array([190.0, 188.0, 320.0, 240.0, -0.03, 0.02, -0.01, 0.001])
    points = np.array([[0.3, -0.2, 1.0], [2.0, 1.0, 0.1], [-1.0, 0.4, -0.3], [1e-7, 0.0, 1.0]])
    by_lens, by_point = lens_model.derivatives(lens, points)
    for k in range(8):
        step = np.eye(8)[k] * 1e-5
        slope = (lens_model.project(lens + step, points) - lens_model.project(lens - step, points)) / 2e-5
        np.testing.assert_allclose(by_lens[:, :, k], slope, atol=1e-4)
    for k in range(3):
        step = np.eye(3)[k] * 1e-9
        slope = (lens_model.project(lens, points + step) - lens_model.project(lens, points - step)) / 2e-9
        np.testing.assert_allclose(by_point[:, :, k], slope, rtol=1e-4, atol=1e-2)


def test_zenith_inverts_the_radius_as_far_as_the_lens_rises() -> None:
    folding = np.array([190.0, 190.0, 320.0, 240.0, -0.2, 0.0, 0.0, 0.0])  # r = t - 0.2 t^3, largest at t^2 = 1 / 0.6
    angles = np.linspace(0.0, 1.2, 50)
    np.testing.assert_allclose(lens_model.zenith(folding, angles - 0.2 * angles**3), angles, atol=1e-6)
    top = math.sqrt(1.0 / 0.6)
    assert np.isnan(lens_model.zenith(folding, np.array([top - 0.2 * top**3 + 0.01]))).all()
