"""The daemon on a slow PC: navigation and docking in a processor quota, the simulator beside it at full speed.

What is told comes from the daemon's own `status` and from /proc: ticks late, memory, and which thread worked.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from omnibotd.control_client import Client, NoDaemon
from omnibotd.core.geometry import Pose2D
from omnibotd.io.map_store import MapStore
from tools.benchmark import cycle, docking
from tools.benchmark.quota import LOOP, N270, Group, group, loop_seconds, measured, slow_pc
from tools.demonstration import Simulator, Stick
from tools.footprint import CONFIG, SEED, WORLD, make_map

NODES = 4000
FRAMES = 60  # for the table of stages
ON_TIME = 0.999  # share of the ticks
MOST_MEMORY = 150.0  # MB
# True poses, which are the map's: the drive that taught it began at the origin.
CORNERS = {"a": (1.4, 1.4, 0.0), "b": (-1.4, 1.2, 1.6), "c": (-1.3, -1.4, 3.1), "d": (1.3, -1.2, -1.6)}
FPS = "10"  # all that perception looks at
START_LIMIT = 120.0  # s to the first answer
DOCKING_SHARE = 0.25  # of the time
EVENT_LOOP = "event loop"
SAMPLE = 5.0  # s between looks at the daemon


def measure(minutes: float, keep: Path | None) -> dict[str, Any]:
    """So many minutes in all: route, then docking. `keep` is a folder where the map is kept for the next time."""
    with TemporaryDirectory(prefix="omnibot-") as passing, slow_pc() as pc, group("sim") as fast:
        directory = Path(passing)
        _map_into(directory / "state", keep)
        loop = measured(pc)
        with _robot(directory, pc, fast) as (child, eyes, dock):
            began = time.monotonic()
            watch = Watch(child, directory / "control.sock")
            ready = time.monotonic() - began
            stretches = list(_stretches(watch, eyes, dock, 60.0 * minutes))
    return {
        "slow_pc": {"rounds": LOOP, "seconds": loop, "share": pc.share},
        "start_seconds": ready,
        "stretches": stretches,
        "stages": _stages(),
    }


def _stages() -> dict[str, dict[str, float]]:
    """Median ms of one cycle of navigation and one of docking, as long as they would take on the slow PC."""
    slower = N270 / loop_seconds()
    found = {"navigation": cycle.staged(NODES, FRAMES), "docking": docking.staged(FRAMES)}
    return {what: {stage: slower * spent for stage, spent in stages.items()} for what, stages in found.items()}


def _map_into(state: Path, keep: Path | None) -> None:
    if keep is not None and (keep / "large.omap").exists():
        shutil.copytree(keep, state)
        return
    state.mkdir()
    make_map(NODES, MapStore(state))
    if keep is not None:
        shutil.copytree(state, keep)


@contextmanager
def _robot(directory: Path, pc: Group, fast: Group) -> Iterator[tuple[int, Simulator, Pose2D]]:
    """The daemon's process id once it answers, the truth, and where the dock is."""
    simulate = ("-m", "tools.sim.server", "--world", WORLD, "--seed", str(SEED), "--fps", FPS)
    with _child(fast.command(sys.executable, *simulate), directory / "simulator.log") as simulator:
        assert simulator.stdout is not None
        where = json.loads(simulator.stdout.readline())
        config, path = directory / "omnibotd.yaml", directory / "control.sock"
        config.write_text(CONFIG.format(**where, state=directory / "state", socket=path))
        command = pc.command(sys.executable, "-m", "omnibotd.daemon", "--config", str(config))
        with _child(command, directory / "omnibotd.log") as daemon:
            yield daemon.pid, Simulator(where["camera"]), Pose2D(*where["dock"])


@contextmanager
def _child(command: list[str], log: Path) -> Iterator[subprocess.Popen[str]]:
    """Ended at the end."""
    with log.open("w") as errors:
        child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True)
        try:
            yield child
        finally:
            child.terminate()
            child.wait(30)


class Watch:
    """Looks at the daemon from outside, now and then."""

    def __init__(self, pid: int, path: Path) -> None:
        """Waits for its first answer."""
        self.pid, self.path = pid, path
        deadline = time.monotonic() + START_LIMIT
        while True:
            try:
                self._client = Client(str(path))
                self.status()
                return
            except NoDaemon:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.05)

    def status(self) -> dict[str, Any]:
        return self._client.call("status", {})

    def over(self, what: str, seconds: float, *words: str) -> dict[str, Any]:
        """Figures of so many seconds of a command, which is said again where it ends before; why it did is noted."""
        before, spent, began = self.status(), self.spent(), time.monotonic()
        held = self.held(before)
        memory, worst, ends = 0.0, 0.0, []
        job = self.start(*words)
        while time.monotonic() < began + seconds:
            time.sleep(SAMPLE)
            status = self.status()
            memory, worst = max(memory, status["memory_mb"]), max(worst, status["loop"]["late_ms_max"])
            if job.poll() is not None:
                ends.append(_outcome(job))
                job = self.start(*words)
        lasted, after = time.monotonic() - began, self.status()["loop"]
        holds = self.held(self.status())
        spent = {name: work - spent.get(name, 0.0) for name, work in self.spent().items()}
        job.terminate()  # as Ctrl-C, which a process in the background does not hear
        job.communicate()
        ticks = after["ticks"] - before["loop"]["ticks"]
        late = after["late_ticks"] - before["loop"]["late_ticks"]
        return {
            "what": what,
            "seconds": lasted,
            "ticks": ticks,
            "rate_hz": ticks / lasted,
            "late_ticks": late,
            "on_time": 1.0 - late / ticks,
            "late_ms_max": worst,
            "memory_mb": memory,
            "held": {name: [amount, holds[name]] for name, amount in held.items()},
            "threads": _by_work(spent, lasted),
            "ends": ends,
        }

    def held(self, status: dict[str, Any]) -> dict[str, float]:
        """What must not grow."""
        process = Path(f"/proc/{self.pid}")
        files, threads = (len(list((process / folder).iterdir())) for folder in ("fd", "task"))
        return {"MB": status["memory_mb"], "files": files, "threads": threads}

    def spent(self) -> dict[str, float]:
        """Processor seconds of each thread so far; the first is the event loop."""
        spent = {}
        for task in Path(f"/proc/{self.pid}/task").iterdir():
            fields = (task / "stat").read_text().rpartition(")")[2].split()
            name = EVENT_LOOP if int(task.name) == self.pid else task.name
            spent[name] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        return spent

    def start(self, *words: str) -> subprocess.Popen[str]:
        """One command as typed; it says nothing before it has ended."""
        command = [sys.executable, "-m", "omnibotd.cli", "--socket", str(self.path), "--json", *words]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    def say(self, *words: str) -> None:
        print(f"  {' '.join(words)}: {_outcome(self.start(*words))}", file=sys.stderr)


def _outcome(job: subprocess.Popen[str]) -> str:
    """In words, when it has ended."""
    error = json.loads(job.communicate()[0] or "{}").get("error")
    return f"{error['name']}, {error['message']}" if error else "done"


def _by_work(spent: dict[str, float], seconds: float) -> dict[str, float]:
    """Shares of a core: the event loop, the busiest of the others, which is perception, and the rest."""
    loop = spent.pop(EVENT_LOOP)
    others = sorted(spent.values(), reverse=True)
    shares = {EVENT_LOOP: loop, "perception": others[0] if others else 0.0, "camera and the rest": sum(others[1:])}
    return {name: work / seconds for name, work in shares.items()}


def _stretches(watch: Watch, eyes: Simulator, dock: Pose2D, seconds: float) -> Iterator[dict[str, Any]]:
    for name, pose in CORNERS.items():
        watch.say("place", "add", name, f"--at={','.join(map(str, pose))}")
    watch.say("goto", "a")
    yield watch.over("route", (1.0 - DOCKING_SHARE) * seconds, "route", *CORNERS, "--loops", "10000")
    before = dock @ Pose2D(-1.0, 0.0)
    watch.say("goto", f"--at={before.x},{before.y},{before.yaw}")
    stick = Stick(watch.path, eyes)
    stick.park(dock)
    stick.close()
    watch.say("dock", "save", "home")
    yield watch.over("docking", DOCKING_SHARE * seconds, "dock", "home", "--trials", "1000")
