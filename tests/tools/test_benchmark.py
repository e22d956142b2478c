"""tools/bench: the shape of its results, and that its instruments measure what they say."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tools.benchmark import cycle, measuring, rooms
from tools.benchmark.__main__ import Sizes, main, run
from tools.benchmark.measuring import Tracer
from tools.benchmark.report import as_text

pytest.importorskip("minisom", reason="a peer that only tools/bench needs")

TINY = Sizes(nodes=120, frames=8, rounds=1, grown=(60, 120, 240), per_room=120, perceptions=60, samples=120, epochs=1)


@pytest.fixture(scope="module")
def result() -> dict:
    return run(TINY, ("cycle", "scale", "som", "decoding"))


def test_every_contestant_has_times(result: dict) -> None:
    contestants = result["cycle"]["contestants"]
    assert {cycle.DECODING, cycle.DEFAULT, cycle.THESIS, cycle.LITERAL, cycle.ORB} <= set(contestants)
    for row in contestants.values():
        assert 0.0 < row["minimum_ms"] <= row["median_ms"]
    assert contestants[cycle.DECODING]["of_decoding"] == 1.0
    assert contestants[cycle.DEFAULT]["of_default"] == 1.0


def test_every_stage_was_met(result: dict) -> None:
    for stages in result["cycle"]["stages"].values():
        assert all(row["median_ms"] > 0.0 for row in stages.values()), stages


def test_growth_is_that_of_the_sizes(result: dict) -> None:
    scale = result["scale"]
    assert list(scale["sizes"]) == ["60", "120", "240"]
    assert (scale["growth"]["from"], scale["growth"]["to"]) == (120, 240)
    held = [row["index_bytes"] for row in scale["sizes"].values()]
    assert held == sorted(held)


def test_trainers_are_compared_on_the_same_data(result: dict) -> None:
    trainers = result["som"]["trainers"]
    assert result["som"]["samples"] == 120
    assert trainers["ours"]["of_ours"] == 1.0
    assert len(trainers) >= 4
    assert all(0.0 <= row["topographic_error"] <= 1.0 for row in trainers.values())


def test_decoding_smaller_costs_places_nothing(result: dict) -> None:
    places = result["decoding"]["places"]
    assert places["reduced"]["median_mm"] < places["whole"]["median_mm"] + 5.0
    assert result["decoding"]["docking"]["whole"]["found"] == TINY.frames
    times = [row["minimum_ms"] for row in result["decoding"]["decoding"].values()]
    assert times == sorted(times, reverse=True)


def test_text_names_everything(result: dict) -> None:
    text = as_text(result)
    for name in (*result["cycle"]["contestants"], *result["som"]["trainers"], *cycle.STAGES):
        assert name in text


def test_writes_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("tools.benchmark.__main__.QUICK", TINY)
    path = tmp_path / "bench.json"
    assert main(["--quick", "--only", "som", "--json", str(path)]) == 0
    written = json.loads(path.read_text())
    assert set(written) == {"meta", "som"}
    assert "ours" in capsys.readouterr().out


def test_unknown_part_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--only", "cycles"])
    assert "cycles" in capsys.readouterr().err


class Work:
    def outer(self) -> None:
        tick(3)
        self.inner()

    @staticmethod
    def inner() -> None:
        tick(5)


now = 0


def tick(steps: int) -> None:
    global now
    now += steps


def test_a_stage_is_spared_what_stages_inside_it_took(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measuring, "clock", lambda: now)
    here = f"{__name__}:Work."
    with Tracer({"outside": [here + "outer"], "inside": [here + "inner"]}) as tracer:
        assert tracer.of(Work().outer) == {"outside": 3, "inside": 5}
    assert tracer.of(Work().outer) == {"outside": 0, "inside": 0}


def test_rooms_of_a_large_map_stand_apart() -> None:
    large = rooms.large_map(240, 120)
    first, second = large.poses[:120, :2], large.poses[120:, :2]
    assert second[:, 0].min() - first[:, 0].max() > 0.0
    driven = large.poses[large.edges.first, :2] - large.poses[large.edges.second, :2]
    assert abs(driven).max() < rooms.ROOM_SPACING / 2
