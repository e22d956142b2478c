"""Whole experiments with a robot taught for a minute: what is kept, what is measured, and that nothing is made up."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from tools.evaluation.__main__ import main
from tools.evaluation.carried import BEYOND

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

WORLD = "tools.sim.ceilings:tiles"


@pytest.fixture(scope="module")
def kept(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("kept")


def _evaluated(folder: Path, experiment: str, kept: Path, *options: str) -> dict[str, Any]:
    out = folder / "out.json"
    arguments = [experiment, "--world", WORLD, "--seed", "3", "--teach", "60", "--keep", str(kept), "--json", str(out)]
    assert main([*arguments, *options]) == 0
    return json.loads(out.read_text("utf-8"))


def test_what_was_taught_once_is_used_again_and_gives_the_same_runs(tmp_path, kept) -> None:
    first = _evaluated(tmp_path, "goto", kept, "--runs", "2", "--plot", str(tmp_path / "out.png"))
    again = _evaluated(tmp_path, "goto", kept, "--runs", "2")
    assert first["meta"]["reused"] == []
    assert again["meta"]["reused"] == ["drive", "map"]
    assert again["runs"] == first["runs"]
    assert again["summary"] == first["summary"]
    assert first["summary"]["calibration"]["n"] > 50
    assert (tmp_path / "out.png").stat().st_size > 10_000


def test_a_robot_carried_on_its_way_is_watched(tmp_path, kept) -> None:
    result = _evaluated(tmp_path, "kidnap", kept, "--runs", "3")
    for run in result["runs"]:
        assert math.dist(run["carried_to"][:2], run["goal"][:2]) < math.hypot(4.0, 4.0)
        assert run["carried_after_s"] <= run["seconds"]
        assert run["recovered_s"] is None or 0.0 <= run["recovered_s"] <= run["seconds"]
    assert result["summary"]["recovery"]["n"] == 3


def test_out_of_the_map_is_out_of_it(tmp_path, kept) -> None:
    result = _evaluated(tmp_path, "outside", kept, "--runs", "2")
    carried, driven = result["runs"]
    for run in (carried, driven):
        assert math.dist(run["start"][:2], run["goal"][:2]) > BEYOND - 0.1
    assert math.dist(carried["start"], driven["start"]) > 0.01


def test_a_route_counts_every_arrival(tmp_path, kept) -> None:
    result = _evaluated(tmp_path, "route", kept, "--runs", "2", "--condition", "people")
    assert result["summary"]["n"] == 10
    goals = [tuple(run["goal"]) for run in result["runs"]]
    assert goals[:5] == goals[5:]
    assert len(set(goals)) == 5
    assert {run["condition"] for run in result["runs"]} == {"people"}


def test_drift_is_in_the_map_and_out_of_the_measure(tmp_path, kept) -> None:
    """The map is a tenth too small; nobody is nearer to a goal for it."""
    result = _evaluated(tmp_path, "goto", kept, "--runs", "2", "--condition", "drift")
    assert result["summary"]["results"] == {"ARRIVED": 2}
    assert result["summary"]["max_m"] < 0.15


def test_docking_disturbed_by_a_robot_that_knows_its_camera(tmp_path, kept) -> None:
    result = _evaluated(tmp_path, "dock", kept, "--runs", "2", "--condition", "disturbed", "--calibration", "known")
    assert result["meta"]["axis"] == result["meta"]["true_axis"]
    assert [run["condition"] for run in result["runs"]] == ["disturbed,half_lamps", "disturbed,lamps_off"]
    docking = result["summary"]["docking"]
    assert (docking["docked"], docking["false_docked"]) == (2, 0)
    assert docking["max_m"] < 0.02
    assert len(docking["by_condition"]) == 2


def test_from_afar_is_from_elsewhere(tmp_path, kept) -> None:
    result = _evaluated(tmp_path, "afar", kept, "--runs", "2", "--open")
    for run in result["runs"]:
        assert math.dist(run["start"][:2], run["goal"][:2]) > 0.1
    assert result["summary"]["docking"]["docked"] == 2


def test_a_robot_that_has_rested_in_its_dock_docks_by_night(tmp_path, kept) -> None:
    result = _evaluated(tmp_path, "rested", kept, "--runs", "2", "--condition", "night")
    assert {run["condition"] for run in result["runs"]} == {"night"}
    docking = result["summary"]["docking"]
    assert (docking["docked"], docking["false_docked"]) == (2, 0)
    assert docking["max_m"] < 0.01


def test_the_thesis_docks_by_its_own_procedure(tmp_path, kept) -> None:
    result = _evaluated(tmp_path, "dock", kept, "--runs", "1", "--open", "--preset", "thesis")
    (run,) = result["runs"]
    assert run["report"]["steps"] >= 1.0
    assert run["result"] in ("DOCKED", "FAILED_TO_CONTROL", "FAILED_TO_DETECT_DOCK")
