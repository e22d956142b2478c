"""One base, the daemon that drives it, and what befalls that daemon at a random moment of its drive."""

from __future__ import annotations

import contextlib
import json
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tools.runaway_daemon import HELD_UP, LET_GO, Daemon, DaemonError, descendants, send
from tools.runaway_map import FLOOR, SEED, taught_map
from tools.sim.emulators import BODIES, driver_of

# In an order in which one daemon lives through several.
CUTS = ("suspend", "unplug", "hang", "kill", "term", "kill-all")
SIGNALS = {"suspend": signal.SIGSTOP, "hang": HELD_UP, "term": signal.SIGTERM}  # SIGKILL where it isn't said
FATAL = ("kill", "kill-all", "term")
LIMIT = 3.5  # s after which wheels are said to turn for ever: any base that stops by itself has done so
STILL = 0.4  # s of standing after which nothing is to come: four ticks of the control loop
HANG = 1.5  # s at least; what is shorter than a second is a stall, after which a job goes on
NOTICE, QUIET = 0.3, 0.4  # s for the daemon to see what has happened; and then to keep still in
NOTHING = 0.002  # m; a wheel that is said to stand creeps on for its motor's lag of 0.08 s: half a tick to a millimetre
START_LIMIT = 15.0  # s of asking, until the robot moves; it may have to look round first
WAIT = 2.5  # s after setting out within which the cut comes
POLL = 0.03  # s
REPEAT = 0.3  # s until a refused request is made again
LATE = 0.1  # s; where the simulator was so late to hear what a host still said, nothing was measured
RETRIES = 12  # of a run in which that happened, or the robot did not move: it stood at a wall, or was lost


class RunawayError(Exception):
    """The set-up failed; the message says what."""


@dataclass(frozen=True, slots=True)
class Run:
    """One cut. Seconds after it that the motors were on and that the wheels turned, LIMIT or more: for ever.

    `metres`: rolled, to a standstill; `moved_again`: when the daemon went on or was started anew, or the cable was put
    back; `late`: seconds by which the simulator may have heard too late what a host still said, and times be too long.
    """

    base: str
    cut: str
    job: str
    motors: float
    seconds: float
    metres: float
    moved_again: bool
    late: float


class Robot:
    """The robot's process, over HTTP."""

    def __init__(self, camera: str) -> None:
        self.camera = camera

    def wheels(self) -> dict[str, Any]:
        return self.post("wheels")

    def post(self, path: str, body: object = None) -> dict[str, Any]:
        url = f"{self.camera.rsplit('/', 1)[0]}/{path}"
        with urllib.request.urlopen(url, json.dumps(body).encode(), timeout=5) as answer:
            told: dict[str, Any] = json.load(answer)
            return told


class Bench:
    """A base with its robot, and the daemon to be cut off."""

    def __init__(self, base: str, job: str, robot: Robot, daemon: Daemon, seed: int, wait: float) -> None:
        self._base, self._job, self._robot, self._daemon, self._wait = base, job, robot, daemon, wait
        self._random = random.Random(seed)

    def run(self, cut: str) -> Run:
        """One cut at a random moment. RunawayError where the robot won't move at all."""
        for _ in range(RETRIES):
            try:
                if not self._daemon.alive:
                    self._begin_anew()
                if self._sets_out():
                    time.sleep(self._random.uniform(0.0, self._wait))
                    if self._strike(cut) and (run := self._judged(cut)).late < LATE:
                        return run
            except (DaemonError, OSError) as error:
                print(f"tools/runaway: {error}", file=sys.stderr)
            self._daemon.end()
        raise RunawayError(f"no cut in {RETRIES} tries; the daemon said:\n{self._daemon.said()}")

    def _begin_anew(self) -> None:
        self._robot.post("renew", self._somewhere())
        self._daemon.start()
        self._daemon.await_ready()

    def _somewhere(self) -> tuple[float, float, float]:
        side = FLOOR / 2.0
        return self._random.uniform(-side, side), self._random.uniform(-side, side), self._random.uniform(-3.0, 3.0)

    def _sets_out(self) -> bool:
        """Ask until the wheels turn: a daemon that has just found its base refuses, a goal may be off the map."""
        self._ask()
        return self._until(lambda: bool(self._robot.wheels()["turning"]))

    def _ask(self) -> None:
        if self._job == "goto":
            self._daemon.ask("goto", at=self._somewhere())
        else:
            self._daemon.ask("drive", vx=0.3, wz=self._random.uniform(-1.0, 1.0), **{"for": 60.0})

    def _strike(self, cut: str) -> bool:
        """Once the wheels turn; the robot's own process strikes, and so knows when that was."""
        pids = [] if cut == "unplug" else [self._daemon.pid]
        if cut == "kill-all":  # the guard first, or it may still say stop
            pids = [*descendants(self._daemon.pid), *pids]
        blow = {"signal": SIGNALS.get(cut, signal.SIGKILL), "pids": pids}
        return self._until(lambda: bool(self._robot.post("strike", blow)["struck"]))

    def _until(self, true: Callable[[], bool]) -> bool:
        """Wait for it, and ask again whenever what was asked for has ended."""
        end = time.monotonic() + START_LIMIT
        while time.monotonic() < end:
            if true():
                return True
            time.sleep(POLL)
            if self._daemon.idle:
                time.sleep(REPEAT)
                self._ask()
        return False

    def _judged(self, cut: str) -> Run:
        wheels = self._standing()
        for_ever = wheels["turned"] >= LIMIT - STILL
        self._recover(cut, wheels["since"])
        now = self._robot.wheels()
        moved = now["turning"] if for_ever else now["rolled"] - wheels["rolled"] > NOTHING
        motors, turned = (LIMIT, LIMIT) if for_ever else (max(0.0, wheels["driven"]), wheels["turned"])
        if for_ever:
            self._daemon.end()  # the robot has left the floor it knows
        return Run(self._base, cut, self._job, motors, turned, wheels["rolled"], moved, wheels["late"])

    def _standing(self) -> dict[str, Any]:
        """The wheels when they stand or are said to turn for ever."""
        while True:
            wheels = self._robot.wheels()
            if wheels["since"] > LIMIT or wheels["since"] - max(wheels["turned"], wheels["driven"], 0.0) > STILL:
                return wheels
            time.sleep(POLL)

    def _recover(self, cut: str, since: float) -> None:
        """Let the daemon go on, start another or put the cable back, and wait until it had time to do wrong."""
        if cut in FATAL:
            self._daemon.end()
            self._daemon.start()
        else:
            time.sleep(max(0.0, HANG - since))
            self._robot.post("plug") if cut == "unplug" else send(
                signal.SIGCONT if cut == "suspend" else LET_GO, [self._daemon.pid]
            )
        time.sleep(NOTICE)
        self._daemon.await_ready()
        time.sleep(QUIET)


@contextlib.contextmanager
def bench(base: str, job: str, seed: int, wait: float = WAIT) -> Iterator[Bench]:
    """A robot with a daemon to be cut within `wait` seconds of setting out."""
    with tempfile.TemporaryDirectory(prefix="runaway-") as folder, _robot(base, Path(folder) / "base") as robot:
        directory = Path(folder)
        (directory / "state").mkdir()
        if job == "goto":
            shutil.copy(taught_map(), directory / "state/home.omap")
            (directory / "state/active").write_text("home\n")
        daemon = Daemon(_configuration(base, robot, directory), directory / "control.sock", with_map=job == "goto")
        try:
            yield Bench(base, job, robot, daemon, seed, wait)
        finally:
            daemon.end()


@contextlib.contextmanager
def _robot(base: str, link: Path) -> Iterator[Robot]:
    command = [sys.executable, "-m", "tools.runaway_robot", "--base", base, "--seed", str(SEED), "--link", str(link)]
    # In a session of its own: Linux shares processors out by sessions, and a robot needs no share of its daemon's.
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as process:
        assert process.stdout is not None
        try:
            camera = json.loads(process.stdout.readline() or "{}").get("camera")
            if camera is None:
                raise RunawayError("the robot did not start")
            yield Robot(camera)
        finally:
            process.kill()


def _configuration(base: str, robot: Robot, directory: Path) -> Path:
    path = directory / "omnibotd.yaml"
    ticks = f", ticks_per_rev: {BODIES[base].ticks_per_rev}" if base == "arduino_bridge" else ""
    path.write_text(
        f"camera: {{source: '{robot.camera}'}}\n"
        f"base: {{driver: {driver_of(base)}, port: '{directory / 'base'}'{ticks}}}\n"
        f"storage: {{directory: {directory / 'state'}}}\n"
        f"control: {{socket: {directory / 'control.sock'}, group: }}\n"
    )
    return path
