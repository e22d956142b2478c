"""A slow PC on a fast one: a control group that gets only so much of one core, calibrated with a fixed Python loop.

The measure is a PC of the Atom N270 class, on which the loop is taken to need 60 ms; no real one was at hand. The group
gets its share in periods of 10 ms, so what is done in it is not slow but interrupted, and the share comes before what
other programs on the machine want.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

LOOP = 170_000  # rounds: 9 ms on a server core of 2023, so that its share is 15 %
N270 = 0.060  # s that the loop takes on the slow PC
PERIOD = 10_000  # us; the shortest that leaves a slice worth having, so that interruptions are short
CGROUPS = Path("/sys/fs/cgroup")
_ROUNDS = 15  # of the loop, of which the fastest counts: others on the machine only make it slower
_WEIGHT_V1, _WEIGHT_V2 = "262144", "10000"  # the most there is


class QuotaError(Exception):
    """No such group can be made here; the message says what would be needed."""


def reference_loop(rounds: int = LOOP) -> int:
    """Plain bytecode: no library, no memory to speak of."""
    total = 0
    for k in range(rounds):
        total += k * k % 7
    return total


def loop_seconds() -> float:
    """Processor time of the loop on this machine, undisturbed."""
    return min(_timed() for _ in range(_ROUNDS))


def _timed() -> float:
    began = time.thread_time()
    reference_loop()
    return time.thread_time() - began


class Group:
    """A control group that comes before all others; `share` of one core is what its processes get at most."""

    def __init__(self, directory: Path, *, unified: bool) -> None:
        self._directory, self._unified = directory, unified
        self.share = math.inf
        self._write(*(("cpu.weight", _WEIGHT_V2) if unified else ("cpu.shares", _WEIGHT_V1)))

    def limit(self, share: float) -> None:
        quota = max(1000, round(share * PERIOD))  # us; the kernel takes no less
        self.share = quota / PERIOD
        if self._unified:
            self._write("cpu.max", f"{quota} {PERIOD}")
        else:
            self._write("cpu.cfs_period_us", str(PERIOD))
            self._write("cpu.cfs_quota_us", str(quota))

    def command(self, *words: str) -> list[str]:
        """The command, to be started within the group."""
        return ["sh", "-c", 'echo $$ > "$0/cgroup.procs" && exec "$@"', str(self._directory), *words]

    def _write(self, name: str, value: str) -> None:
        (self._directory / name).write_text(value)


@contextmanager
def group(name: str, root: Path = CGROUPS) -> Iterator[Group]:
    """Removed at the end, when its processes must be gone. Raises QuotaError."""
    directory, unified = _made(root, name)
    try:
        yield Group(directory, unified=unified)
    finally:
        with suppress(OSError):
            directory.rmdir()


@contextmanager
def slow_pc(root: Path = CGROUPS) -> Iterator[Group]:
    """A group of the N270 class. Raises QuotaError."""
    with group("slow", root) as pc:
        pc.limit(loop_seconds() / N270)
        yield pc


def measured(pc: Group) -> float:
    """Seconds of wall clock that the loop takes in the group: the median, start and imports left out."""
    code = (
        "import time, statistics; from tools.benchmark.quota import reference_loop; times = []\n"
        f"for _ in range({_ROUNDS}):\n"
        "    began = time.perf_counter(); reference_loop(); times.append(time.perf_counter() - began)\n"
        "print(statistics.median(times))"
    )
    done = subprocess.run(pc.command(sys.executable, "-c", code), capture_output=True, text=True, check=True)
    return float(done.stdout)


def _made(root: Path, name: str) -> tuple[Path, bool]:
    """A group of our own, and whether it is of version 2."""
    unified = (root / "cgroup.controllers").exists()
    directory = (root if unified else root / "cpu") / f"omnibot-{name}-{os.getpid()}"
    try:
        if unified and "cpu" not in (root / "cgroup.subtree_control").read_text().split():
            (root / "cgroup.subtree_control").write_text("+cpu")
        directory.mkdir()
    except OSError as error:
        raise QuotaError(
            f"{directory}: {error.strerror}: a processor quota needs root and the kernel's cpu controller; without, "
            "tools/bench measures at full speed only"
        ) from error
    return directory, unified
