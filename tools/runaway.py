"""How long do the wheels turn when the daemon is gone? (launcher: tools/runaway)

The real daemon drives a simulated robot over a real pty. In the middle of it the daemon is killed, alone or with all
its processes, stopped, hung, told to end, or the cable is pulled; the robot, a process of its own, tells how long its
motors were on afterwards and how far it rolled. Then the daemon goes on or the cable is put back: does anything move
again?
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tools.runaway_map import FLOOR, SEED, taught_map
from tools.sim.emulators import BODIES, driver_of

CUTS = ("kill", "kill-all", "stop", "hang", "term", "unplug")
LIMIT = 5.0  # s after which wheels are said to turn for ever: any base that stops by itself has done so
STILL = 0.7  # s without motors that count as standing: the control loop ticks seven times
HANG = LIMIT + 1.0  # s
AFTERWARDS = 2.0  # s in which nothing may move again
READY_LIMIT = 30.0  # s until base and camera answer
START_PERIOD, START_TRIES = 3.0, 10  # s after which a job that doesn't have the robot moving is asked for again
WAIT = 3.0  # s after setting out within which the cut comes
POLL = 0.02  # s
RETRIES = 3  # of a run in which the robot did not move: it stood at a wall, or was lost

# The daemon as it is, with a way to hang it: the signal's handler holds up the whole event loop.
PROGRAM = f"""
import signal, sys, time
signal.signal(signal.SIGUSR1, lambda *_: time.sleep({HANG}))
from omnibotd.daemon import main
sys.exit(main(sys.argv[1:]))
"""


class RunawayError(Exception):
    """The set-up failed; the message says what."""


@dataclass(frozen=True, slots=True)
class Run:
    """One cut. `seconds` the motors were on after it, LIMIT or more: for ever; `metres` rolled, to a standstill."""

    base: str
    cut: str
    job: str
    seconds: float
    metres: float
    moved_again: bool | None  # None where there was nothing to go on


class Robot:
    """The robot's process, over HTTP."""

    def __init__(self, url: str) -> None:
        self._url = url.rsplit("/", 1)[0]

    def wheels(self) -> dict[str, Any]:
        with urllib.request.urlopen(f"{self._url}/wheels", timeout=5) as answer:
            told: dict[str, Any] = json.load(answer)
            return told

    def post(self, path: str, body: object = None) -> dict[str, Any]:
        with urllib.request.urlopen(f"{self._url}/{path}", json.dumps(body).encode(), timeout=5) as answer:
            told: dict[str, Any] = json.load(answer)
            return told

    def driven_within(self, seconds: float) -> bool:
        """Wait until its motors are on."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if self.wheels()["driven"]:
                return True
            time.sleep(POLL)
        return False


class Hand:
    """A client of the daemon that asks and goes on."""

    def __init__(self, path: Path) -> None:
        """OSError where nobody listens yet."""
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(5.0)
        try:
            self._socket.connect(str(path))
        except OSError:
            self._socket.close()
            raise
        self._answers = self._socket.makefile("r", encoding="utf-8")

    def ask(self, method: str, **params: Any) -> None:
        self._socket.sendall(
            json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": params}).encode() + b"\n"
        )

    def ready(self, *, with_map: bool) -> bool:
        """Whether the daemon has base, camera and map; False, too, where it hangs up."""
        try:
            self.ask("status")
            status = json.loads(self._answers.readline())["result"]
        except (OSError, ValueError):
            return False
        return bool(status["base"]["connected"] and status["camera"]["ok"] and (status["map"] or not with_map))

    def close(self) -> None:
        self._answers.close()
        self._socket.close()


class Bench:
    """One base: its robot, its daemon's configuration, and what happens to both."""

    def __init__(
        self, base: str, job: str, robot: Robot, camera: str, directory: Path, seed: int, wait: float = WAIT
    ) -> None:
        self._base, self._job, self._robot, self._wait = base, job, robot, wait
        self._random = random.Random(seed)
        self._socket = directory / "control.sock"
        self._config = directory / "omnibotd.yaml"
        ticks = f", ticks_per_rev: {BODIES[base].ticks_per_rev}" if base == "arduino_bridge" else ""
        self._config.write_text(
            f"camera: {{source: '{camera}'}}\n"
            f"base: {{driver: {driver_of(base)}, port: '{directory / 'base'}'{ticks}}}\n"
            f"storage: {{directory: {directory / 'state'}}}\n"
            f"control: {{socket: {self._socket}, group: }}\n"
        )
        self._log = directory / "omnibotd.log"

    def run(self, cut: str) -> Run:
        """One cut at a random moment. Raises RunawayError where the robot won't move at all."""
        for _ in range(RETRIES):
            self._robot.post("renew", self._somewhere())
            with self._daemon() as daemon, contextlib.closing(self._ready(daemon)) as hand:
                if not self._sets_out(hand):
                    continue
                time.sleep(self._random.uniform(0.0, self._wait))
                if self._robot.driven_within(STILL):
                    return self._cut(daemon, cut)
        raise RunawayError(f"the robot did not move in {RETRIES} tries; the daemon said:\n{self._said()}")

    def _somewhere(self) -> tuple[float, float, float]:
        side = FLOOR / 2.0
        return self._random.uniform(-side, side), self._random.uniform(-side, side), self._random.uniform(-3.0, 3.0)

    def _sets_out(self, hand: Hand) -> bool:
        """Ask until the wheels turn: a daemon that loads its map refuses, one on its way refuses a second trip."""
        goal, turn = self._somewhere(), self._random.uniform(-1.0, 1.0)
        for _ in range(START_TRIES):
            if self._job == "goto":
                hand.ask("goto", at=goal)
            else:
                hand.ask("drive", vx=0.3, wz=turn, **{"for": 60.0})
            if self._robot.driven_within(START_PERIOD):
                return True
        return False

    def _cut(self, daemon: subprocess.Popen[bytes], cut: str) -> Run:
        rolled = self._robot.wheels()["rolled"]
        began = time.monotonic()
        if cut == "unplug":
            began = self._robot.post("pull")["now"]
        else:
            strike(daemon.pid, cut)
        wheels = self._robot.wheels()
        while wheels["now"] - max(began, wheels["driven_until"]) < STILL and wheels["now"] - began < LIMIT:
            time.sleep(POLL)
            wheels = self._robot.wheels()
        seconds = max(0.0, min(wheels["driven_until"], wheels["now"]) - began)
        metres = self._robot.wheels()["rolled"] - rolled
        for_ever = wheels["now"] - began >= LIMIT
        again = None if for_ever else self._goes_on(daemon, cut, began)
        return Run(self._base, cut, self._job, max(seconds, LIMIT) if for_ever else seconds, metres, again)

    def _goes_on(self, daemon: subprocess.Popen[bytes], cut: str, began: float) -> bool | None:
        """Let the daemon go on or put the cable back, and see whether anything moves."""
        match cut:
            case "stop":
                daemon.send_signal(signal.SIGCONT)
            case "hang":
                time.sleep(max(0.0, began + HANG - time.monotonic()))
            case "unplug":
                self._robot.post("plug")
                time.sleep(AFTERWARDS)  # a board that boots
            case _:
                return None
        return self._robot.driven_within(AFTERWARDS)

    def _said(self) -> str:
        return "\n".join(self._log.read_text(errors="replace").splitlines()[-20:])

    @contextlib.contextmanager
    def _daemon(self) -> Iterator[subprocess.Popen[bytes]]:
        self._socket.unlink(missing_ok=True)
        command = [sys.executable, "-c", PROGRAM, "--config", str(self._config)]
        with self._log.open("a") as log:
            child = subprocess.Popen(command, stderr=log, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"})
        try:
            yield child
        finally:
            strike(child.pid, "kill-all")
            child.wait()

    def _ready(self, daemon: subprocess.Popen[bytes]) -> Hand:
        end = time.monotonic() + READY_LIMIT
        while time.monotonic() < end and daemon.poll() is None:
            with contextlib.suppress(OSError):
                hand = Hand(self._socket)
                if hand.ready(with_map=self._job == "goto"):
                    return hand
                hand.close()
            time.sleep(0.1)
        raise RunawayError(f"the daemon was not ready in {READY_LIMIT:.0f} s; it said:\n{self._said()}")


def strike(pid: int, cut: str) -> None:
    """What befalls the daemon; it may have ended already."""
    number = {"stop": signal.SIGSTOP, "hang": signal.SIGUSR1, "term": signal.SIGTERM}.get(cut, signal.SIGKILL)
    victims = [pid, *descendants(pid)] if cut == "kill-all" else [pid]
    for victim in victims:
        with contextlib.suppress(ProcessLookupError):
            os.kill(victim, number)


def descendants(pid: int) -> list[int]:
    """Children and theirs, as a service's whole control group is killed."""
    found: list[int] = []
    for tasks in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            for child in map(int, tasks.read_text().split()):
                found += [child, *descendants(child)]
    return found


@contextlib.contextmanager
def bench(base: str, job: str, seed: int, wait: float = WAIT) -> Iterator[Bench]:
    """A robot with a daemon to be cut within `wait` seconds of setting out."""
    with tempfile.TemporaryDirectory(prefix="runaway-") as folder:
        directory = Path(folder)
        (directory / "state").mkdir()
        if job == "goto":
            shutil.copy(taught_map(), directory / "state/home.omap")
            (directory / "state/active").write_text("home\n")
        command = [sys.executable, "-m", "tools.runaway_robot", "--base", base, "--seed", str(SEED)]
        command += ["--link", str(directory / "base")]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            try:
                camera = json.loads(process.stdout.readline() or "{}").get("camera")
                if camera is None:
                    raise RunawayError("the robot did not start")
                yield Bench(base, job, Robot(camera), camera, directory, seed, wait)
            finally:
                process.kill()


def measure(base: str, job: str, runs: int, seed: int, cuts: Sequence[str] = CUTS) -> list[Run]:
    """So many cuts of a base, the kinds in turn."""
    found = []
    with bench(base, job, seed) as made:
        for number in range(runs):
            run = made.run(cuts[number % len(cuts)])
            print(f"{number + 1:4} {base} {run.cut}: {spoken(run.seconds)}, {run.metres * 100:.1f} cm", file=sys.stderr)
            found.append(run)
    return found


def spoken(seconds: float) -> str:
    return "for ever" if seconds >= LIMIT else f"{seconds:.2f} s"


def summary(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """One row a base and cut."""
    rows = []
    for base, cut in dict.fromkeys((run.base, run.cut) for run in runs):
        these = [run for run in runs if (run.base, run.cut) == (base, cut)]
        seconds = [run.seconds for run in these]
        row = {"base": base, "cut": cut, "runs": len(these), "median_s": statistics.median(seconds)}
        worst = {"worst_s": max(seconds), "worst_m": max(run.metres for run in these)}
        rows.append({**row, **worst, "moved_again": sum(run.moved_again is True for run in these)})
    return rows


def table(rows: Sequence[dict[str, Any]]) -> str:
    lines = [f"{'base':15} {'cut':9} {'runs':>4}  {'median':>8}  {'worst':>8}  {'rolled':>8}  moved again"]
    for row in rows:
        times = f"{spoken(row['median_s']):>8}  {spoken(row['worst_s']):>8}"
        rolled = f"{row['worst_m'] * 100:6.1f}cm" + ("+" if row["worst_s"] >= LIMIT else " ")
        lines.append(f"{row['base']:15} {row['cut']:9} {row['runs']:4}  {times}  {rolled}  {row['moved_again']:6}")
    return "\n".join(lines)


def main() -> int:
    """Exit status 1 where the set-up failed; what the wheels did is for the reader to judge."""
    parser = argparse.ArgumentParser(prog="tools/runaway", description=__doc__)
    parser.add_argument("--base", action="append", choices=tuple(BODIES), help="again for another; default: all")
    parser.add_argument("--runs", type=int, default=len(CUTS), help="cuts of each base, the kinds in turn")
    parser.add_argument("--job", choices=("goto", "drive"), default="goto")
    parser.add_argument("--cut", action="append", choices=CUTS, help="again for another; default: all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    try:
        runs = [
            run
            for base in options.base or BODIES
            for run in measure(base, options.job, options.runs, options.seed, options.cut or CUTS)
        ]
    except RunawayError as error:
        print(f"tools/runaway: {error}", file=sys.stderr)
        return 1
    rows = summary(runs)
    print(table(rows))
    if options.json:
        meta = {"job": options.job, "runs": options.runs, "seed": options.seed, "limit_s": LIMIT}
        told = {"meta": meta, "runs": [asdict(run) for run in runs], "summary": rows}
        options.json.write_text(json.dumps(told, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
