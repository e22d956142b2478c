"""What `dock`, `undock`, `calibrate` and `status` show, and `calibrate camera` from a folder without a daemon."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from omnibotd import cli, cli_calibrate, cli_docking, cli_output

TRIALS = {
    "dock": "home",
    "docked": 2,
    "trials": [
        {
            "trial": 1,
            "seconds": 14.2,
            "retries": 0,
            "offset": {"x": 0.0012, "y": -0.0004, "yaw": 0.0017},
            "result": "DOCKED",
        },
        {"trial": 2, "seconds": 61.0, "retries": 3, "offset": None, "result": "FAILED_TO_CHARGE"},
        {"trial": 3, "seconds": 15.8, "retries": 1, "offset": {"x": 0.0, "y": 0.0, "yaw": 0.0}, "result": "DOCKED"},
    ],
    "mean": {"x": 0.0006, "y": -0.0002, "yaw": 0.00085, "distance": 0.00063, "seconds": 15.0, "retries": 0.5},
    "sd": {"x": 0.0006, "y": 0.0002, "yaw": 0.00085, "distance": 0.00063, "seconds": 0.8, "retries": 0.5},
}


def test_trials_are_a_table_with_mean_and_spread() -> None:
    lines = cli_docking.trials(TRIALS).splitlines()
    assert lines[0].split() == ["TRIAL", "RESULT", "AFTER", "RETRIES", "X", "mm", "Y", "mm", "YAW", "°"]
    assert lines[1].split() == ["1", "DOCKED", "14.2", "s", "0", "1.2", "-0.4", "0.10"]
    assert lines[2].split() == ["2", "FAILED_TO_CHARGE", "61.0", "s", "3", "-", "-", "-"]
    assert lines[4].split() == ["mean", "15.0", "s", "0.50", "0.6", "-0.2", "0.05"]
    assert lines[5].split() == ["sd", "0.8", "s", "0.50", "0.6", "0.2", "0.05"]
    assert lines[-1] == "docked at home in 2 of 3 trials"


def test_trials_that_all_failed_have_no_mean() -> None:
    none = dict.fromkeys(TRIALS["mean"])
    text = cli_docking.trials({**TRIALS, "docked": 0, "trials": TRIALS["trials"][1:2], "mean": none, "sd": none})
    assert "mean" not in text
    assert text.endswith("docked at home in 0 of 1 trials")


def test_feedback_of_trials_and_of_a_board_is_one_line() -> None:
    values = {"state": "CONTROLLING", "trial": 2, "trials": 10, "docked": 1, "retries": 1, "distance_remaining": 0.31}
    assert cli_output.feedback(values) == "CONTROLLING  trial 2 of 10, 1 docked  0.31 m to go  1 retry"
    board = {"state": "COLLECTING", "hint": "hold it still", "found": 12, "kept": 7, "missing": ["front", "left"]}
    told = "COLLECTING  hold it still  12 boards seen, 7 kept  still missing: front, left"
    assert cli_output.feedback(board) == told
    assert cli_output.feedback({**board, "missing": []}).endswith("seen everywhere")


def test_another_view_of_a_dock_is_told() -> None:
    first = {"name": "home", "pose": {"x": 1.0, "y": 2.0, "yaw": 0.0}, "views": 1, "added": False, "offset": None}
    assert cli_docking._saved(first) == "home saved at x 1.000 m  y 2.000 m  yaw 0.0°"
    more = {**first, "views": 3, "added": True, "offset": {"x": 0.003, "y": 0.004, "yaw": 0.0}}
    assert cli_docking._saved(more).endswith("another view, 3 in all, taken 5 mm from the first")


def test_status_tells_which_calibrations_hold() -> None:
    used = {"name": "spin", "date": "2026-01-02T03:04:05+01:00", "residual": "0.3 px", "in_use": True, "reason": ""}
    assert cli_output._calibration(used) == "of 2026-01-02T03:04:05+01:00, residual 0.3 px"
    ignored = {**used, "in_use": False, "reason": "it was measured with camera.width 640, now 320"}
    assert cli_output._calibration(ignored).startswith(
        "NOT IN USE: it was measured with camera.width 640, now 320 (of "
    )


# ---- calibrate camera --images

CHILD = """
import json, pathlib, sys
out = pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
print(json.dumps({"image": "1.jpg", "found": True, "message": "a chessboard"}))
print("noise from a library")
print(json.dumps({"image": "2.jpg", "found": False, "message": "no chessboard"}))
"""
GOOD = """
info = {"rms_px": 0.31, "sentence": "good to 0.4 px", "board": sys.argv[sys.argv.index("--board") + 1]}
out.write_text(json.dumps(info))
print(json.dumps({"done": info}))
"""
BAD = """
print(json.dumps({"error": "hold the board nearer the left edge"}))
sys.exit(1)
"""


@pytest.fixture
def pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "pictures"
    folder.mkdir()
    return folder


def child(monkeypatch: pytest.MonkeyPatch, ending: str) -> None:
    """The real command line, but another program."""
    real = cli_calibrate._command

    def command(*arguments: Any) -> list[str]:
        executable, dash, module, *rest = real(*arguments)
        assert (executable, dash, module) == (sys.executable, "-m", "omnibotd.lens_calibration")
        return [executable, "-c", CHILD + ending, *rest]

    monkeypatch.setattr(cli_calibrate, "_command", command)


def test_pictures_are_calibrated_without_a_daemon(
    pictures: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    child(monkeypatch, GOOD)
    (pictures.parent / "lens.yaml").write_text("the one before")
    words = [
        "--socket",
        "/nonexistent",
        "calibrate",
        "camera",
        "--images",
        "pictures",
        "--board",
        "8x5",
        "-o",
        "lens.yaml",
    ]
    assert cli.main(words) == 0
    printed = capsys.readouterr()
    assert printed.out.splitlines() == [
        "good to 0.4 px",
        "wrote lens.yaml: name it in the configuration under camera.calibration",
    ]
    assert "1.jpg: a chessboard  1 of 1 found" in printed.err
    assert json.loads((pictures.parent / "lens.yaml").read_text())["board"] == "8x5"
    assert (pictures.parent / "lens.yaml.old").read_text() == "the one before"


def test_bad_pictures_leave_the_file_before(
    pictures: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    child(monkeypatch, BAD)
    (pictures.parent / "camera.yaml").write_text("the one before")
    words = ["--json", "calibrate", "camera", "--images", "pictures"]
    assert cli.main(words) == 1
    error = json.loads(capsys.readouterr().out)["error"]
    assert (error["name"], error["message"]) == ("CALIBRATION_FAILED", "hold the board nearer the left edge")
    assert {path.name for path in pictures.parent.iterdir()} == {"pictures", "camera.yaml"}
    assert (pictures.parent / "camera.yaml").read_text() == "the one before"


@pytest.mark.parametrize("ending", ["", "sys.exit(3)"])
def test_a_child_that_says_nothing_is_a_failure(
    pictures: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], ending: str
) -> None:
    child(monkeypatch, ending)
    assert cli.main(["calibrate", "camera", "--images", "pictures"]) == 1
    assert "CALIBRATION_FAILED" in capsys.readouterr().err


def test_where_nothing_can_be_written_it_says_so(
    pictures: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    child(monkeypatch, GOOD)
    words = ["calibrate", "camera", "--images", "pictures", "--board", "8x5", "-o", "no/such/folder/lens.yaml"]
    assert cli.main(words) == 1
    assert "STORAGE: no/such/folder/lens.yaml" in capsys.readouterr().err
