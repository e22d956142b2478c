"""The daemon cut off in the middle of a drive, as processes over a pty: how long do the wheels turn?"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from firmware_bridge.bases import DRIVERS
from tools.runaway import keep, kept, missing, summary, table
from tools.runaway_bench import CUTS, LIMIT, Bench, Run, bench

# Seconds that the motors may be on after a cut: the base's own watchdog (omnibot: 0.25 s), or the guard's patience of
# 0.3 s after the last set-point; and as long again for a machine that has other things to do.
STOPPED = {"omnibot": 0.5, "create2": 0.7, "arduino_bridge": 0.7}
# With nobody left to say anything: the board's own time-out, after which this base stops, or none at all.
ALONE = {"omnibot": 0.5, "create2": None, "arduino_bridge": 2.4}
ROLL_OUT = 0.6  # s: seven times the lag of the simulated motors

pytestmark = pytest.mark.timeout(180)


def check(run: Run) -> None:
    limit = ALONE[run.base] if run.cut in ("kill-all", "unplug") else STOPPED[run.base]
    if limit is None:
        assert run.seconds >= LIMIT  # the day this fails, the documents that warn of it are wrong
    else:
        assert run.motors <= limit and run.seconds <= limit + ROLL_OUT
        assert run.metres > 0.0
    assert not run.moved_again


def cut(made: Bench, *cuts: str) -> None:
    for one in cuts:
        check(made.run(one))


def test_the_base_with_a_watchdog_stands_when_the_daemon_is_killed() -> None:
    with bench("omnibot", "drive", seed=1, wait=0.5) as made:
        cut(made, "kill")


@pytest.mark.slow
@pytest.mark.parametrize("base", DRIVERS)
def test_each_cut_of_each_base(base: str) -> None:
    with bench(base, "drive", seed=2) as made:
        cut(made, *CUTS, *CUTS)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("base", DRIVERS)
def test_on_a_trip(base: str) -> None:
    with bench(base, "goto", seed=3) as made:
        cut(made, "suspend", "hang", "kill")


KILL = Run("create2", "kill", "goto", 0.1, 0.2, 0.05, False, 0.01)
RUNS = (
    KILL,
    replace(KILL, motors=0.15, seconds=0.4, metres=0.02),
    replace(KILL, cut="unplug", motors=LIMIT, seconds=LIMIT, metres=1.5),
    replace(KILL, base="omnibot", cut="suspend", motors=0.2, seconds=0.25, metres=0.1, moved_again=True),
)


def test_the_table_tells_the_worst() -> None:
    rows = summary(RUNS)
    assert [(row["base"], row["cut"], row["runs"]) for row in rows] == [
        ("create2", "kill", 2),
        ("create2", "unplug", 1),
        ("omnibot", "suspend", 1),
    ]
    assert rows[0]["median_s"] == pytest.approx(0.3)
    assert (rows[0]["worst_motors_s"], rows[0]["worst_s"], rows[0]["worst_m"]) == (0.15, 0.4, 0.05)
    assert [row["moved_again"] for row in rows] == [0, 0, 1]
    lines = table(rows).splitlines()
    assert "0.40 s" in lines[1] and "5.0cm" in lines[1]
    assert "for ever" in lines[2] and "150.0cm+" in lines[2]


def test_what_an_interrupted_measurement_has_found_counts(tmp_path: Path) -> None:
    path = tmp_path / "rows"
    assert kept(path) == kept(None) == []
    for run in RUNS:
        keep(path, run)
    assert kept(path) == list(RUNS)
    assert missing("create2", "goto", ("kill", "unplug"), 6, kept(path)) == ["unplug", "kill", "unplug"]
    assert missing("create2", "goto", ("kill", "unplug"), 3, kept(path)) == []
    assert missing("create2", "drive", ("kill", "unplug"), 3, kept(path)) == ["kill", "unplug", "kill"]
