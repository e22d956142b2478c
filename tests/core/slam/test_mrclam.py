"""Real recordings: set 7 of MRCLAM, landmark identity known, positions not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from omnibotd.core.slam.sighting import Bearing
from tools.reproduction.mrclam import DATA, Harm, Recording, RecordingError, aligned_error, load
from tools.reproduction.slam import recording

real = pytest.mark.skipif(not DATA.exists(), reason="../shared/data/mrclam7 is absent")


def test_alignment_takes_out_turn_and_shift_and_nothing_else() -> None:
    path = np.random.default_rng(0).standard_normal((50, 2))
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    assert aligned_error(path, path @ turn.T + [3.0, -1.0]) == pytest.approx(0.0, abs=1e-12)
    assert aligned_error(path, 2.0 * path) == pytest.approx(np.sqrt(((path - path.mean(0)) ** 2).sum(1).mean()))


def test_a_folder_without_recordings_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"Robot1_Odometry\.dat.*--data"):
        load(tmp_path, 1)


def made() -> Recording:
    views = [[Bearing(i, 0.1 * i) for i in some] for some in ((0, 1, 2), (), (3, 4), (5, 6))]
    return Recording(np.arange(4.0), views, [], np.zeros((4, 3)), np.arange(4))


def named(recording: Recording) -> list[list[object]]:
    return [[one.name for one in view] for view in recording.views]


def test_thin_keeps_every_so_manieth_bearing_whatever_view_it_is_in() -> None:
    assert named(Harm(thin=3).done(made())) == [[0], [], [3], [6]]
    assert Harm().done(made()).views == made().views


def test_absent_landmarks_are_never_seen() -> None:
    assert sum(map(len, named(Harm(absent=3).done(made())))) == 4


def test_misnamed_bearings_keep_their_direction_and_noise_their_name() -> None:
    wrong, noisy = Harm(misnamed=1.0).done(made()), Harm(noise=0.1).done(made())
    assert [[one.angle for one in view] for view in wrong.views] == [[one.angle for one in v] for v in made().views]
    assert named(wrong) != named(made()) == named(noisy)
    pairs = [(a, b) for views in zip(noisy.views, made().views, strict=True) for a, b in zip(*views, strict=True)]
    apart = [a.angle - b.angle for a, b in pairs]
    assert 0.03 < np.std(apart) < 0.2


@real
@pytest.mark.slow
@pytest.mark.parametrize("robot", [1, 2, 3])
def test_errors_are_within_the_limits(robot: int) -> None:
    rows = recording(DATA, robot)
    assert {row["method"] for row in rows if row["limit"]} == {"undelayed inverse depth", "growing batch"}
    assert all(row["met"] for row in rows)


@real
@pytest.mark.slow
@pytest.mark.parametrize("thin", [4, 8])
def test_filters_that_went_wrong_say_so(thin: int) -> None:
    """Robot 1 with few bearings: every filter here is more than 0.35 m off. Thinnings that nothing was tuned on."""
    rows = [row for row in recording(DATA, 1, Harm(thin=thin)) if "says_wrong" in row]
    assert all(row["says_wrong"] for row in rows if row["rmse"] > 0.35)
    assert any(row["rmse"] > 0.35 for row in rows)
