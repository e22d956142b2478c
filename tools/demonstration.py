"""The main job, as a newcomer would do it (launcher: tools/demo).

A simulated robot is driven round a room once, and from then on goes where it is told and docks itself.

The daemon is the real one, started as a user starts it, against a real pty and a real MJPEG stream; every command is
given through omnibotctl. Only the person who drives is simulated: they see where the robot truly is.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from omnibotd import map_plot
from omnibotd.core.geometry import Pose2D, Twist2D, wrap
from omnibotd.io.map_store import MapStore
from tools.sim.emulators import BODIES, driver_of

GOTO_LIMIT = 0.25  # m
DOCK_LIMIT, DOCK_LIMIT_DEG = 0.03, 2.0  # m, degrees
SPEED = 0.4  # m/s, the base's top speed in this demonstration
# m: three lanes, then two across them, so that the drive meets its own way again and the map can be pulled straight.
LANES = ((-0.6, -1.2), (2.1, -1.2), (2.1, -0.5), (-0.6, -0.5), (-0.6, 0.2), (2.1, 0.2))
TOUR = (*LANES, (0.2, 0.2), (0.2, -1.2), (1.3, -1.2), (1.3, 0.2))
PLACES = {"desk": Pose2D(-0.4, 0.1, 2.2), "sofa": Pose2D(0.6, -1.0, -1.0), "shelf": Pose2D(1.8, 0.0, 0.6)}
RUN_UP = 0.6  # m straight ahead into the dock
STUCK_TICKS = 15  # of 0.1 s without getting ahead

WAYS = (  # BGR
    ("driven to teach", (150, 150, 150)),
    ("driven to name places", (215, 195, 120)),
    ("gone by itself", (20, 120, 240)),
)

CONFIG = """\
camera: {{source: "{camera}"}}
base:
  driver: {driver}
  port: "{port}"
  ticks_per_rev: {ticks_per_rev}
  max_linear_velocity: {speed}
  max_linear_acceleration: 0.8
  max_angular_velocity: 1.5
storage: {{directory: "{out}/state"}}
control: {{socket: "{socket}", group: }}
"""


class DemoError(Exception):
    """Something of the set-up failed; the message says what."""


@dataclass(frozen=True, slots=True)
class Result:
    """One command's end, measured against the truth of the simulator."""

    name: str
    metres: float
    degrees: float
    seconds: float
    passed: bool


class Simulator:
    """The person's eyes: where the robot truly is."""

    def __init__(self, url: str) -> None:
        self._url = url.rsplit("/", 1)[0] + "/truth"

    def pose(self) -> Pose2D:
        with urllib.request.urlopen(self._url, timeout=5) as answer:
            truth = json.load(answer)
        return Pose2D(truth["x"], truth["y"], truth["yaw"])


class Stick:
    """The person's hand: `drive` requests ten times a second over the daemon's own socket."""

    def __init__(self, path: Path, eyes: Simulator) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.connect(str(path))
        self._answers = self._socket.makefile("r", encoding="utf-8")
        self._eyes = eyes
        self._count = 0

    def drive(self, twist: Twist2D) -> None:
        self._count += 1
        params = {"vx": twist.vx, "wz": twist.wz}
        request = {"jsonrpc": "2.0", "id": self._count, "method": "drive", "params": params}
        self._socket.sendall(json.dumps(request).encode() + b"\n")
        answer = json.loads(self._answers.readline())
        if "error" in answer:
            raise DemoError(f"drive: {answer['error']['message']}")

    def to(self, point: tuple[float, float], near: float = 0.08, speed: float = SPEED) -> None:
        """Turn to the point and drive there."""
        target = Pose2D(*point)
        while (here := self._eyes.pose()).distance(target) > near:
            bearing = here.bearing(target)
            ahead = min(speed, 2.0 * here.distance(target)) if abs(bearing) < 0.4 else 0.0
            self.drive(Twist2D(ahead, max(-1.5, min(1.5, 2.5 * bearing))))
            time.sleep(0.1)

    def face(self, yaw: float) -> None:
        while abs(error := wrap(yaw - self._eyes.pose().yaw)) > 0.03:
            self.drive(Twist2D(0.0, max(-1.5, min(1.5, 1.5 * error))))
            time.sleep(0.1)
        self.stand()

    def stand(self) -> None:
        self.drive(Twist2D())
        time.sleep(0.6)

    def park(self, pose: Pose2D) -> None:
        """Straight ahead into the pose, correcting the heading on the way."""
        self.to(pose.transform(-RUN_UP, 0.0), near=0.02, speed=0.25)
        self.face(pose.yaw)
        way: deque[float] = deque(maxlen=STUCK_TICKS)
        while (ahead := -(pose.inverse() @ self._eyes.pose()).x) > 0.004:
            way.append(ahead)
            if len(way) == STUCK_TICKS and way[0] - ahead < 0.001:
                break  # a Roomba stops by itself when its contacts meet the dock's
            offset = pose.inverse() @ self._eyes.pose()
            self.drive(Twist2D(min(0.15, ahead + 0.02), -3.0 * offset.y - 1.5 * offset.yaw))
            time.sleep(0.1)
        self.stand()

    def close(self) -> None:
        self._socket.close()


class Demonstration:
    """The story, step by step."""

    def __init__(self, out: Path, camera: str, dock: Pose2D) -> None:
        self._out, self._dock = out, dock
        self._path = out / "control.sock"
        self._eyes = Simulator(camera)
        self._truth: dict[str, Pose2D] = {}  # true poses at which places were saved
        self._results: list[Result] = []
        self._chapters: list[float] = []  # monotonic seconds at which the next began

    def run(self) -> list[Result]:
        self._wait_until_ready()
        stick = Stick(self._path, self._eyes)
        self._chapters.append(time.monotonic())
        self._ctl("record", "start", "home")
        for point in TOUR:
            stick.to(point, near=0.15)
        stick.park(self._dock)
        self._ctl("record", "stop")
        say(f"driven round once, {time.monotonic() - self._chapters[0]:.0f} s")
        self._ctl("train", "home")
        self._ctl("map", "use", "home")
        self._save_places(stick)
        stick.close()
        self._chapters.append(time.monotonic())
        for name in ("sofa", "shelf", "desk"):  # the robot stands at the desk: each trip has another start
            self._go(name)
        self._go_home()
        self._ctl("status")
        return self._results

    def _save_places(self, stick: Stick) -> None:
        """The robot still stands in its dock: save that, then show it the places."""
        self._chapters.append(time.monotonic())
        self._wait_until_sure()
        self._ctl("dock", "save", "home")
        self._truth["home"] = self._eyes.pose()
        self._back_out(stick)
        for name, pose in reversed(PLACES.items()):
            stick.to((pose.x, pose.y))
            stick.face(pose.yaw)
            self._ctl("place", "add", name)
            self._truth[name] = self._eyes.pose()

    def _back_out(self, stick: Stick) -> None:
        while self._eyes.pose().distance(self._dock) < RUN_UP:
            stick.drive(Twist2D(-0.3, 0.0))
            time.sleep(0.1)

    def _go(self, name: str) -> None:
        began = time.monotonic()
        arrived = self._ctl("goto", name, check=False)
        metres, degrees = self._miss(name)
        passed = arrived and metres <= GOTO_LIMIT
        self._results.append(Result(f"goto {name}", metres, degrees, time.monotonic() - began, passed))

    def _go_home(self) -> None:
        began = time.monotonic()
        docked = self._ctl("dock", "home", check=False)
        metres, degrees = self._miss("home")
        passed = docked and metres <= DOCK_LIMIT and degrees <= DOCK_LIMIT_DEG
        self._results.append(Result("dock home", metres, degrees, time.monotonic() - began, passed))

    def _miss(self, name: str) -> tuple[float, float]:
        here, there = self._eyes.pose(), self._truth[name]
        return here.distance(there), math.degrees(abs(wrap(here.yaw - there.yaw)))

    def _wait_until_ready(self) -> None:
        status = self._poll(lambda s: s["camera"]["ok"] and s["base"]["connected"], 30.0)
        say(f"camera {status['camera']['width']}x{status['camera']['height']}, base {status['base']['board']}: ready")

    def _wait_until_sure(self) -> None:
        self._poll(lambda status: status["confidence"] > 0.8, 15.0)

    def _poll(self, good: Any, limit: float) -> dict[str, Any]:
        end = time.monotonic() + limit
        while time.monotonic() < end:
            answer = self._run("--json", "status")
            status: dict[str, Any] = json.loads(answer.stdout or "{}")
            if answer.returncode == 0 and good(status):
                return status
            time.sleep(0.3)
        raise DemoError(f"the daemon did not get ready in {limit:.0f} s: {answer.stdout or answer.stderr}")

    def _ctl(self, *words: str, check: bool = True) -> bool:
        """One command as typed, with its answer shown."""
        say(f"$ omnibotctl {' '.join(words)}")
        answer = self._run(*words)
        for line in answer.stdout.splitlines() + (answer.stderr.splitlines() if answer.returncode else []):
            say(f"    {line}")
        if check and answer.returncode != 0:
            raise DemoError(f"omnibotctl {' '.join(words)} ended with {answer.returncode}")
        return answer.returncode == 0

    def _run(self, *words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "omnibotd.cli", "--socket", str(self._path), *words]
        return subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)

    def picture(self, truth: Path) -> Path:
        """The map with the true ways driven, laid over it by the places whose true poses are known."""
        topo_map = MapStore(self._out / "state").load("home")
        poses = {**topo_map.places, **{name: dock.map_from_dock for name, dock in topo_map.docks.items()}}
        names = sorted(poses)
        to_map = fit([self._truth[name] for name in names], [poses[name] for name in names])
        lines = [json.loads(line) for line in truth.read_text().splitlines()]
        ways = []
        for (label, colour), begin, end in zip(WAYS, self._chapters, [*self._chapters[1:], math.inf], strict=True):
            points = [to_map.transform(line["x"], line["y"]) for line in lines if begin <= line["stamp"] < end]
            ways.append(map_plot.Path(points, colour, label))
        png = map_plot.plot_png(topo_map, to_map @ self._eyes.pose(), ways)
        path = self._out / "map.png"
        path.write_bytes(png)
        return path


def fit(source: list[Pose2D], target: list[Pose2D]) -> Pose2D:
    """The rigid motion that takes the source positions onto the target's best (least squares)."""
    a, b = (np.array([complex(pose.x, pose.y) for pose in poses]) for poses in (source, target))
    yaw = float(np.angle(np.sum((b - b.mean()) * np.conj(a - a.mean()))))
    shift = b.mean() - np.exp(1j * yaw) * a.mean()
    return Pose2D(float(shift.real), float(shift.imag), yaw)


def say(line: str) -> None:
    print(line, flush=True)


@contextlib.contextmanager
def process(log: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    """A child of ours, ended by SIGTERM when the story is over."""
    with log.open("w") as errors:
        child = subprocess.Popen(
            [sys.executable, "-m", *words], stdout=subprocess.PIPE, stderr=errors, text=True, encoding="utf-8"
        )
        try:
            yield child
        finally:
            child.terminate()
            try:
                child.wait(10)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()


def demonstrate(out: Path, ceiling: str, seed: int, base: str) -> bool:
    """Everything from an empty folder to the picture; True if every limit was kept."""
    truth = out / "truth.jsonl"
    world = f"tools.sim.ceilings:{ceiling}"
    start = f"--pose={TOUR[0][0]},{TOUR[0][1]},0"
    options = ("--world", world, "--base", base, "--seed", str(seed), start, "--truth", str(truth))
    with process(out / "simulator.log", "tools.sim.server", *options) as simulator:
        assert simulator.stdout is not None
        line = simulator.stdout.readline()
        if not line:
            raise DemoError(f"the simulator did not start: {(out / 'simulator.log').read_text().strip()}")
        where = json.loads(line)
        config = out / "omnibotd.yaml"
        wheels = {"driver": driver_of(base), "ticks_per_rev": BODIES[base].ticks_per_rev}
        config.write_text(CONFIG.format(**where, **wheels, out=out, socket=out / "control.sock", speed=SPEED))
        with process(out / "omnibotd.log", "omnibotd.daemon", "--config", str(config)):
            story = Demonstration(out, where["camera"], Pose2D(*where["dock"]))
            began = time.monotonic()
            results = story.run()
            say("")
            say(f"{'':14}  off by (truth)        limit            took")
            for result in results:
                limit = f"{GOTO_LIMIT * 100:.0f} cm" if result.name.startswith("goto") else "3 cm, 2 deg"
                verdict = "ok" if result.passed else "FAILED"
                off = f"{result.metres * 100:5.1f} cm {result.degrees:5.2f} deg"
                say(f"{result.name:14}  {off:20}  {limit:14}  {result.seconds:5.0f} s  {verdict}")
            say(f"\n{time.monotonic() - began:.0f} s in all; picture of the map: {story.picture(truth)}")
    return all(result.passed for result in results)


def main() -> int:
    """Exit status 0 only if every goto ended within 0.25 m and docking within 3 cm and 2 degrees."""
    parser = argparse.ArgumentParser(prog="tools/demo", description=__doc__)
    parser.add_argument("--ceiling", default="tiles", choices=("tiles", "plain", "beams", "photo"))
    parser.add_argument("--base", default="omnibot", choices=sorted(BODIES), help="omnibot-avr: its firmware in simavr")
    parser.add_argument("--seed", type=int, default=1, help="of the room's details and the robot's errors")
    parser.add_argument("--out", type=Path, default=Path("out/demo"), help="folder for map, logs and picture")
    options = parser.parse_args()
    out = options.out.resolve()
    shutil.rmtree(out / "state", ignore_errors=True)  # of an earlier demonstration; nothing else there is ours
    (out / "truth.jsonl").unlink(missing_ok=True)
    out.mkdir(parents=True, exist_ok=True)
    try:
        return 0 if demonstrate(out, options.ceiling, options.seed, options.base) else 1
    except DemoError as error:
        print(f"tools/demo: {error}; logs are in {out}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
