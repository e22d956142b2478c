"""Docking's figures against numbers worked out by hand, single estimates against lines and vectors that are known."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from omnibotd.calibrations import file_of
from omnibotd.config import load
from omnibotd.core.geometry import Pose2D
from omnibotd.core.percept import HomingEstimate, Verdict
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from tests.core.thesis.rooms import PaintedCeiling
from tools.evaluation.axis import Axis
from tools.evaluation.campaign import trials
from tools.evaluation.docking import DockingSummary, docking_summary, figures
from tools.evaluation.homing import FARTHEST, Answer, Errors, drive, robust_line, summary
from tools.evaluation.options import parse
from tools.evaluation.orb_homing import OrbHoming
from tools.evaluation.plots import draw_runs
from tools.evaluation.summary import Run, Summary
from tools.evaluation.tables import DOCKING_HEADINGS, markdown
from tools.homing import main as homing
from tools.sim.virtual_robot import STORAGE

GOAL = Pose2D(1.0, 2.0, 0.5)


def _run(metres: float, degrees: float, result: str = "DOCKED", **more: object) -> Run:
    final = GOAL @ Pose2D(-metres, 0.0, math.radians(degrees))
    return Run(Pose2D(), GOAL, final, 20.0, result, **more)


RUNS = [
    _run(0.001, 0.2, report={"steps": 12.0}),
    _run(0.003, -0.4, report={"steps": 20.0}),
    _run(0.021, 0.1),
    _run(0.4, 90.0, "FAILED_TO_CONTROL", message="not there", report={"steps": 60.0}),
]


def test_docking_by_hand() -> None:
    found = DockingSummary.of(RUNS)
    assert (found.n, found.docked, found.good, found.false_docked) == (4, 3, 0.5, 1)
    assert found.mean_m == pytest.approx((0.001 + 0.003 + 0.021) / 3)
    assert found.max_m == pytest.approx(0.021)
    assert found.mean_deg == pytest.approx(0.7 / 3)
    assert found.max_deg == pytest.approx(0.4)
    assert found.mean_steps == 16.0
    assert figures(docking_summary(RUNS))["mean"] == "8.3 mm"


def test_turned_too_far_is_not_docked_either() -> None:
    assert DockingSummary.of([_run(0.0, 1.1)]).false_docked == 1


def test_where_nobody_docked_there_are_no_errors() -> None:
    shown = figures(docking_summary([_run(0.4, 90.0, "TIMEOUT")]))
    assert (shown["docked"], shown["mean"], shown["within 2 cm, 1°"]) == ("0 of 1", "", "0%")


def _result(runs: list[Run], **meta: object) -> dict:
    from dataclasses import asdict

    described = {
        "experiment": "dock",
        "world": "w:w",
        "seed": 1,
        "preset": "default",
        "homing": None,
        "open": False,
        "calibration": "none",
        "teach_s": 60.0,
        "conditions": [],
        "bounds": [-3, -3, 3, 3],
    } | meta
    calibration = {"n": 0, "error": 0.0, "bins": []}
    figures = asdict(Summary.of(runs)) | {"docking": docking_summary(runs), "calibration": calibration}
    return {"meta": described, "runs": [run.as_json() for run in runs], "summary": figures}


def test_the_table_tells_what_always_holds_from_what_came_later() -> None:
    runs = [_run(0.002, 0.1, condition="disturbed,sun"), _run(0.004, 0.1, condition="disturbed,night")]
    result = _result(runs, conditions=["disturbed"], calibration="own", homing="orb")
    rows = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in markdown([result]).splitlines()]
    assert rows[0] == list(DOCKING_HEADINGS)
    assert rows[2][4:10] == [
        "orb",
        "tilt, offset, gentle_slope",
        "blur, occluded, another light",
        "by its own spin",
        "2 of 2",
        "3.0 mm",
    ]
    assert [row[6] for row in rows[3:]] == ["disturbed,sun", "disturbed,night"]


def test_pictures_of_docking_and_its_json(tmp_path: Path) -> None:
    result = _result(RUNS)
    assert json.loads(json.dumps(result))["runs"][0]["report"] == {"steps": 12.0}
    draw_runs(result, tmp_path / "docking.png")
    assert (tmp_path / "docking.png").stat().st_size > 5000


def _parsed(tmp_path: Path, experiment: str, *options: str):
    arguments = [experiment, "--world", "w:w", "--json", str(tmp_path / "out.json"), *options]
    return parse(arguments, ["dock", "afar", "goto"])


def test_a_tilted_camera_is_calibrated_unless_said_otherwise(tmp_path: Path) -> None:
    assert _parsed(tmp_path, "dock").calibration == "none"
    assert _parsed(tmp_path, "dock", "--condition", "disturbed").calibration == "own"
    assert _parsed(tmp_path, "goto", "--condition", "tilt,people").calibration == "own"
    assert _parsed(tmp_path, "dock", "--condition", "tilt", "--calibration", "none").calibration == "none"


def test_disturbed_is_for_docking_and_brings_its_own_light(tmp_path: Path, capsys) -> None:
    for experiment, condition in (("goto", "disturbed"), ("dock", "disturbed,sun")):
        with pytest.raises(SystemExit):
            _parsed(tmp_path, experiment, "--condition", condition)
    assert "more than one light" in capsys.readouterr().err


def test_a_plan_may_name_the_peer() -> None:
    entry = {"experiment": "dock", "world": "w:w", "runs": 5, "homing": ["", "orb"]}
    ours, peer = trials([entry])
    (away_from_walls,) = trials([entry | {"homing": "", "open": True}])
    assert "--open" in away_from_walls.arguments
    assert away_from_walls.name != ours.name
    assert "--homing" not in ours.arguments
    assert peer.arguments[-2:] == ["--homing", "orb"]
    assert ours.name != peer.name


def test_an_axis_is_stored_as_the_daemon_reads_it(tmp_path: Path) -> None:
    from omnibotd import calibrations

    (tmp_path / "omnibotd.yaml").write_text(
        f"camera: {{source: 'http://x/'}}\nbase: {{driver: omnibot, port: /dev/x}}\nstorage: {{directory: {STORAGE}}}\n"
    )
    Axis((322.5, 237.5), (0.02, -0.01)).store(tmp_path)
    assert file_of(tmp_path / STORAGE, "spin").exists()
    config, _ = calibrations.apply(load(tmp_path / "omnibotd.yaml"), tmp_path / STORAGE)
    assert (config.camera.centre, config.camera.tilt) == ((322.5, 237.5), (0.02, -0.01))


CAMERA = CameraModel.equidistant(640, 480, math.radians(190.0))


@pytest.mark.parametrize("away", [Pose2D(-0.4, 0.2, 0.3), Pose2D(0.3, -0.3, -2.5)])
def test_the_peer_finds_the_pose_under_a_painted_ceiling(away: Pose2D) -> None:
    world, dock = PaintedCeiling(2), Pose2D(0.1, 0.2, 1.0)
    frames = [Frame(0.0, world.render(pose.x, pose.y, pose.yaw, 0.0)) for pose in (dock, dock @ away)]
    peer = OrbHoming(CAMERA, frames[0], 2.2)
    found = peer.fix(frames[1], Pose2D())
    assert found.verdict is Verdict.ACCEPTED
    assert found.dock_from_base.distance(away) < 0.03
    assert abs(math.remainder(found.dock_from_base.yaw - away.yaw, math.tau)) < 0.01
    assert peer.fix(Frame(0.0, np.full((480, 640), 90, np.uint8)), Pose2D()).verdict is Verdict.REJECTED


def test_the_robust_line_does_not_see_outliers() -> None:
    x = np.linspace(0.0, 1.0, 60)
    y = 96.0 * x + 3.0 + 0.5 * np.sin(97.0 * x)
    y[::7] += 80.0
    slope, intercept = robust_line(x, y)
    assert slope == pytest.approx(96.0, abs=0.5)
    assert intercept == pytest.approx(3.0, abs=0.3)


def _answer(truth: Pose2D, said: Pose2D, verdict: Verdict = Verdict.ACCEPTED) -> Answer:
    return Answer(truth, HomingEstimate(0.0, Pose2D(), said, 0.9, 1.0, verdict))


def test_errors_by_hand() -> None:
    behind = Pose2D(-0.5, 0.0, 0.0)
    answers = [
        _answer(behind, behind),
        _answer(behind, Pose2D(-0.5, 0.0, math.radians(4.0))),
        _answer(behind, Pose2D(0.0, -0.5, 0.0)),  # says the dock is to the left, where it is ahead
        _answer(behind, Pose2D()),  # says it is there
        _answer(behind, behind, Verdict.REJECTED),
        _answer(Pose2D(-1.5, 0.0, 0.0), behind, Verdict.REJECTED),
    ]
    errors = Errors.of(answers, metric=True)
    assert errors.distance == pytest.approx([0.5] * 4)
    assert errors.length == pytest.approx([0.5, 0.5, 0.5, 0.0])
    # The turn that the robot must make, against what it should: it says 4 degrees less.
    assert errors.turn == pytest.approx([0.0, -4.0, 0.0, 0.0], abs=1e-9)
    assert errors.component[[0, 2]] == pytest.approx([1.0, 0.0], abs=1e-9)
    # Turned by 4 degrees, the dock is seen 4 degrees off ahead.
    assert errors.component[1] == pytest.approx(math.cos(math.radians(4.0)))
    assert math.isnan(errors.component[3])
    assert (errors.refused, errors.refused_near) == (2, 1)
    assert errors.wrong.tolist() == [False, False, True, True]


def test_an_honest_covariance_is_told_from_a_boastful_one() -> None:
    rng, truth = np.random.default_rng(3), Pose2D(-0.5, 0.1, 0.2)
    sigma = np.array([0.002, 0.003, 0.001])

    def nees(claimed: float) -> dict[str, float]:
        answers = []
        for x, y, yaw in rng.normal(0.0, sigma, (200, 3)):
            said = Pose2D(truth.x + x, truth.y + y, truth.yaw + yaw)
            answer = _answer(truth, said)
            answers.append(replace(answer, said=replace(answer.said, covariance=np.diag((claimed * sigma) ** 2))))
        return summary(Errors.of(answers, metric=True))["estimate_within_1_m"]["nees"]

    assert nees(1.0)["within_95"] == pytest.approx(0.95, abs=0.04)
    assert nees(1.0)["median"] == pytest.approx(2.37, abs=0.5)  # of a chi-squared of three degrees of freedom
    assert nees(0.5)["within_95"] < 0.6


def test_what_is_in_pixels_is_worth_what_it_is_on_average() -> None:
    """A centimetre a pixel is said where a metre has 109 pixels: 9 % too long, and no error."""
    truth = [Pose2D(-r, 0.3 * r, 0.2) for r in np.linspace(0.2, 0.9, 12)]
    answers = [_answer(pose, Pose2D(1.09 * pose.x, 1.09 * pose.y, pose.yaw)) for pose in truth]
    errors = Errors.of(answers, metric=False)
    assert errors.offset == pytest.approx(0.0, abs=1e-9)
    found = summary(errors)
    assert found["distance"]["slope"] == pytest.approx(109.0)
    assert found["component"]["median"] == pytest.approx(1.0)
    assert found["estimate_within_1_m"]["failed"] == 0.0
    assert found["turn"]["gross"] == 0


def test_the_drive_is_free_and_within_reach_of_the_target() -> None:
    world, target = PaintedCeiling(), Pose2D(0.3, 0.2, 0.5)
    poses = drive(world, target, 100, 1)
    assert len(poses) == 100
    for pose in poses:
        assert math.hypot(pose.x, pose.y) <= FARTHEST
        at = target @ pose
        assert world.free(at.x, at.y, 0.17)
    assert len({(round(p.x, 6), round(p.y, 6), round(p.yaw, 6)) for p in poses}) == 100


@pytest.mark.slow
def test_the_tool_compares_three_methods_on_the_same_frames(tmp_path: Path, capsys) -> None:
    out, picture = tmp_path / "out.json", tmp_path / "out.png"
    arguments = ["--world", "tools.sim.ceilings:tiles", "--frames", "24", "--json", str(out), "--plot", str(picture)]
    assert homing([*arguments, "--condition", "tilt,blur"]) == 0
    result = json.loads(out.read_text("utf-8"))
    assert list(result["methods"]) == ["thesis", "default", "ORB"]
    assert result["methods"]["default"]["estimate_within_1_m"]["median_m"] < 0.02
    assert result["methods"]["default"]["component"]["median"] > 0.999
    assert picture.stat().st_size > 20_000
    assert "thesis, its robot" in capsys.readouterr().out
