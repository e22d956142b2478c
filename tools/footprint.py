"""What the daemon costs in memory, processor and lateness, at rest and on a trip (launcher: tools/footprint).

The map is made from pictures rendered along a random drive. The daemon is the real one, against the simulated robot in
real time; its figures are read from /proc and from its own `status`.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.mapping.training import TeachingSample, train
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from omnibotd.io.map_store import MapStore
from tools.demonstration import process
from tools.sim import ceilings
from tools.sim.world import World

WORLD, SEED = "tools.sim.ceilings:tiles", 1
AREA = 2.0  # m from the middle to the edge of the taught square
SPACING = 0.1  # m between pictures
BEFORE_DOCK = 0.1  # share of its goals
SLIP = 0.01  # relative, of each odometry step
CORNERS = ((1.5, 1.5, 0.0), (-1.5, -1.5, 0.0))  # true poses between which it travels
SETTLE = 5.0  # s

CONFIG = """\
camera: {{source: "{camera}"}}
base: {{driver: omnibot, port: "{port}"}}
storage: {{directory: "{state}"}}
control: {{socket: "{socket}", group: }}
"""


@dataclass(frozen=True, slots=True)
class Cost:
    """Of one stretch of time: resident MB, share of one core, lateness of the loop in ms."""

    what: str
    memory_mb: float
    cpu: float
    late_p99_ms: float
    late_max_ms: float
    status_ms: float


def drive(world: World, nodes: int) -> Iterator[TeachingSample]:
    """Pictures every 10 cm of a drive to random points of the square, one in ten before the dock; odometry slips."""
    rng, noise = random.Random(SEED), np.random.default_rng(SEED)
    true, odom, target = Pose2D(), Pose2D(), Pose2D()
    for k in range(nodes):
        image = world.render(true.x, true.y, true.yaw, 0.2 * k)
        yield TeachingSample(0.2 * k, odom, Frame(0.2 * k, image))
        while true.distance(target) < SPACING:
            target = Pose2D(rng.uniform(-AREA, AREA), rng.uniform(-AREA, AREA))
            if rng.random() < BEFORE_DOCK:
                target = Pose2D(*world.dock) @ Pose2D(-rng.uniform(0.05, 1.2), rng.uniform(-0.3, 0.3))
        turn = true.bearing(target)
        step = Pose2D(SPACING * math.cos(turn), SPACING * math.sin(turn), turn)
        slipped = 1.0 + SLIP * noise.standard_normal(2)
        true, odom = true @ step, odom @ Pose2D(step.x * slipped[0], step.y * slipped[0], step.yaw * slipped[1])


def make_map(nodes: int, store: MapStore) -> TopoMap:
    """A map of about `nodes` nodes, saved and made the active one."""
    world = ceilings.tiles(SEED)
    height, width = world.render(0.0, 0.0, 0.0, 0.0).shape[:2]
    camera = CameraModel.equidistant(width, height, math.radians(world.fov_deg))
    topo_map = train("large", drive(world, nodes), camera, seed=SEED, progress=lambda stage, share: None)
    store.save(topo_map)
    store.set_active(topo_map.name)
    return topo_map


class Daemon:
    """A running daemon, looked at from outside."""

    def __init__(self, pid: int, path: Path) -> None:
        self._pid, self._path = pid, path

    def ctl(self, *words: str) -> dict[str, Any]:
        command = [sys.executable, "-m", "omnibotd.cli", "--socket", str(self._path), "--json", *words]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        answer: dict[str, Any] = json.loads(done.stdout or "{}")
        return answer

    def processor_seconds(self) -> float:
        fields = Path(f"/proc/{self._pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def watch(self, what: str, seconds: float, travel: bool) -> Cost:
        """Measure a stretch; on a trip it is sent to and fro for as long."""
        began, before = time.monotonic(), self.processor_seconds()
        goals = [f"{x},{y},{yaw}" for x, y, yaw in CORNERS]
        while time.monotonic() < began + seconds:
            if travel:
                goals = [*goals[1:], goals[0]]
                answer = self.ctl("goto", f"--at={goals[0]}")
                print(f"  goto {goals[0]}: {answer.get('error') or 'arrived'}", file=sys.stderr)
            else:
                time.sleep(1.0)
        share = (self.processor_seconds() - before) / (time.monotonic() - began)
        status = self.ctl("status")
        loop = status["loop"]
        return Cost(what, status["memory_mb"], share, loop["late_ms_p99"], loop["late_ms_max"], self.answer_ms())

    def answer_ms(self) -> float:
        """From typing `omnibotctl status` to its answer, start of the client included: the median of ten."""
        times = []
        for _ in range(10):
            asked = time.monotonic()
            self.ctl("status")
            times.append((time.monotonic() - asked) * 1e3)
        return float(np.median(times))


def measure(directory: Path, nodes: int, seconds: float) -> tuple[TopoMap, list[Cost]]:
    state, path = directory / "state", directory / "control.sock"
    topo_map = make_map(nodes, MapStore(state))
    with process(directory / "simulator.log", "tools.sim.server", "--world", WORLD, "--seed", str(SEED)) as simulator:
        assert simulator.stdout is not None
        where = json.loads(simulator.stdout.readline())
        config = directory / "omnibotd.yaml"
        config.write_text(CONFIG.format(**where, state=state, socket=path))
        with process(directory / "omnibotd.log", "omnibotd.daemon", "--config", str(config)) as child:
            daemon = Daemon(child.pid, path)
            time.sleep(SETTLE)
            costs = [daemon.watch("at rest", seconds, travel=False), daemon.watch("goto", seconds, travel=True)]
    return topo_map, costs


def main() -> int:
    """Prints a table."""
    parser = argparse.ArgumentParser(prog="tools/footprint", description=__doc__)
    parser.add_argument("--nodes", type=int, default=4000)
    parser.add_argument("--seconds", type=float, default=60.0, help="of each stretch")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    with TemporaryDirectory(prefix="omnibot-") as directory:
        topo_map, costs = measure(Path(directory), options.nodes, options.seconds)
    print(f"{len(topo_map)} nodes, {len(topo_map.edges)} links")
    print(f"{'':10}{'memory':>10}{'of a core':>12}{'late p99':>12}{'late max':>12}{'status':>12}")
    for cost in costs:
        print(
            f"{cost.what:10}{cost.memory_mb:7.0f} MB{cost.cpu:11.0%} {cost.late_p99_ms:9.1f} ms"
            f"{cost.late_max_ms:9.1f} ms{cost.status_ms:9.0f} ms"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
