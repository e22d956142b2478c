"""tools/endurance: what counts as growing, and (slow) a patrol of a few minutes."""

from __future__ import annotations

import asyncio
import json
import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from tools import long_patrol
from tools.long_patrol import Diary, Sample, verdicts

START = Sample(0.0, 80.0, 60_000, 9, 4, 1_000_000, 0, 0)


def hours(count: int, **growth: float) -> list[Sample]:
    """Samples an hour apart; in each of them these fields have grown by so much."""
    return [
        replace(
            START,
            hours=float(k),
            **{name: type(getattr(START, name))(getattr(START, name) + k * step) for name, step in growth.items()},
        )
        for k in range(count)
    ]


def grows(samples: list[Sample]) -> set[str]:
    return {name for name, (flat, _) in verdicts(samples).items() if not flat}


@pytest.mark.parametrize(
    ("growth", "found"),
    [
        ({}, set()),
        ({"memory_mb": 0.1, "rounds": 20.0, "log": 20_000.0}, set()),
        ({"memory_mb": 2.0}, {"memory"}),
        ({"descriptors": 1.0}, {"descriptors"}),
        ({"threads": 1.0}, {"threads"}),
        ({"disk": 500_000.0}, {"disk"}),
        ({"memory_mb": 2.0, "disk": 500_000.0}, {"memory", "disk"}),
    ],
)
def test_what_grows_is_found(growth: dict[str, float], found: set[str]) -> None:
    assert grows(hours(12, **growth)) == found


def test_caches_may_fill_in_the_first_half() -> None:
    filling = [replace(sample, memory_mb=80.0 + 5.0 * min(k, 6)) for k, sample in enumerate(hours(14))]
    assert grows(filling) == set()


def test_ctrl_c_ends_it_and_what_was_seen_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    async def patrol(length: float, directory: Path, diary: Diary) -> None:
        diary.samples += hours(6, memory_mb=2.0)
        diary.rounds = 40
        os.kill(os.getpid(), signal.SIGINT)
        await asyncio.sleep(3600.0)
        diary.rounds = 1000

    monkeypatch.setattr(long_patrol, "patrol", patrol)
    assert long_patrol.main(["--hours", "24"]) == 1
    told = capsys.readouterr().out
    assert "5.0 h in 0 minutes; 40 rounds" in told
    assert "memory       GROWS" in told


@pytest.mark.slow  # for the loading of matplotlib
def test_a_picture_has_all_curves(tmp_path: Path) -> None:
    long_patrol.draw(hours(5, memory_mb=0.1), tmp_path / "curves.png")
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_patrol_with_accidents(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(long_patrol, "TEACHING", 120.0)
    monkeypatch.setattr(long_patrol, "ACCIDENTS", 150.0)
    monkeypatch.setattr(long_patrol, "SAMPLE", 60.0)
    long_patrol.main(["--hours", "0.1", "--json", str(tmp_path / "patrol.json")])
    told = json.loads((tmp_path / "patrol.json").read_text())
    assert len(told["samples"]) >= 6
    assert told["trips"]["DONE"] >= 1
    assert told["trips"]["BASE_LINK_DOWN"] >= 1
    assert told["verdicts"]["descriptors"]["flat"]
