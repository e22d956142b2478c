"""tools/bench --only docking: every stage is met, every contestant has its row."""

from __future__ import annotations

from tools.benchmark import docking
from tools.benchmark.report import as_text


def test_every_contestant_has_times_and_every_stage_was_met() -> None:
    result = docking.measure(frames=3, rounds=1)
    rows = result["contestants"]
    assert {*docking.MOST, docking.LITERAL, docking.PEER, docking.APRILTAG} < set(rows)
    assert rows[docking.DECODING]["of_decoding"] == 1.0
    for stages in result["stages"].values():
        assert all(row["median_ms"] > 0.0 for row in stages.values()), stages
    text = as_text({"docking": result})
    for name in rows:
        assert name in text
