"""The slow PC: its control group, in a stand-in for the kernel's folder, and what is told of the daemon in it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tools.benchmark import quota
from tools.benchmark.slow_pc import _by_work
from tools.benchmark.slow_pc_report import slow_pc_lines

ROW = {
    "what": "route",
    "seconds": 120.0,
    "ticks": 1200,
    "rate_hz": 10.0,
    "late_ticks": 1,
    "late_ms_max": 61.0,
    "on_time": 1.0 - 1 / 1200,
    "memory_mb": 98.0,
    "held": {"MB": [97.1, 98.0], "files": [14, 14]},
    "threads": {"event loop": 0.041, "perception": 0.033, "camera and the rest": 0.004},
    "ends": ["LOST, looked everywhere"],
}


def told(**changed: object) -> str:
    row = {**ROW, **changed}
    result = {
        "slow_pc": {"rounds": 1, "seconds": 0.0601, "share": 0.15},
        "start_seconds": 4.2,
        "stretches": [row],
        "stages": {"navigation": {"decode": 4.8}},
    }
    return "\n".join(slow_pc_lines(result))


@pytest.fixture
def version_1(tmp_path: Path) -> Path:
    (tmp_path / "cpu").mkdir()
    return tmp_path


@pytest.fixture
def version_2(tmp_path: Path) -> Path:
    (tmp_path / "cgroup.controllers").write_text("cpu memory")
    (tmp_path / "cgroup.subtree_control").write_text("memory")
    return tmp_path


def test_a_group_of_version_1_gets_its_share_in_short_periods(version_1: Path) -> None:
    with quota.group("test", version_1) as group:
        group.limit(0.15)
        (folder,) = (version_1 / "cpu").iterdir()
        assert (folder / "cpu.cfs_period_us").read_text() == "10000"
        assert (folder / "cpu.cfs_quota_us").read_text() == "1500"
        assert group.share == 0.15


def test_a_group_of_version_2_too_for_which_the_controller_is_turned_on(version_2: Path) -> None:
    with quota.group("test", version_2) as group:
        group.limit(0.15)
        (folder,) = (entry for entry in version_2.iterdir() if entry.is_dir())
        assert (folder / "cpu.max").read_text() == "1500 10000"
    assert (version_2 / "cgroup.subtree_control").read_text() == "+cpu"


def test_a_share_below_what_the_kernel_takes_is_told_as_it_is(version_1: Path) -> None:
    with quota.group("test", version_1) as group:
        group.limit(0.01)
        assert group.share == 0.1


def test_without_the_right_it_says_what_it_needs(tmp_path: Path) -> None:
    with pytest.raises(quota.QuotaError, match="needs root"), quota.group("test", tmp_path / "none"):
        pass


def test_a_command_enters_the_group_before_it_runs(version_1: Path) -> None:
    with quota.group("test", version_1) as group:
        done = subprocess.run(group.command("echo", "a b"), capture_output=True, text=True, check=True)
        (folder,) = (version_1 / "cpu").iterdir()
        assert done.stdout == "a b\n"
        assert int((folder / "cgroup.procs").read_text()) > 1


@pytest.mark.slow
@pytest.mark.skipif(os.getuid() != 0 or not quota.CGROUPS.exists(), reason="a processor quota needs root and cgroups")
def test_the_loop_takes_there_what_it_is_meant_to() -> None:
    with quota.slow_pc() as pc:
        assert quota.measured(pc) == pytest.approx(quota.N270, rel=0.3)  # others on the machine disturb it
        spin = pc.command(sys.executable, "-c", "import time; t = time.time()\nwhile time.time() < t + 1: pass")
        before = os.times().children_user
        subprocess.run(spin, check=True)
        assert os.times().children_user - before < 2.0 * pc.share + 0.1


def test_work_is_told_by_thread() -> None:
    shares = _by_work({"event loop": 4.0, "17": 0.2, "18": 3.0, "19": 0.1}, 100.0)
    assert shares == {"event loop": 0.04, "perception": 0.03, "camera and the rest": pytest.approx(0.003)}


def test_it_is_judged_by_ticks_and_memory() -> None:
    assert told().count(": yes") == 2
    assert "ticks on time, at least 99.9%: NO (99.833%)" in told(late_ticks=2)
    assert "memory, at most 150 MB with 4000 nodes: NO (151)" in told(memory_mb=151.0)
    assert "97.1 to 98 MB, 14 to 14 files" in told()
    assert "begun anew after: LOST, looked everywhere" in told()
