"""tools/endurance: a patrol of many hours in virtual time, and whether anything of the daemon grows meanwhile.

The whole daemon goes round four places without an end. Once an hour the robot is carried off, and once the base falls
silent for a while, so that searches, failures with their reports, and reconnections take part; a client asks for the
status every second. The camera has a sixteenth of the pixels, for rendering takes most of the time.
"""

from __future__ import annotations

import argparse
import asyncio
import gc
import json
import logging
import os
import random
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest import mock

import cv2
import numpy as np

from omnibotd.control_protocol import RpcError
from omnibotd.core.geometry import Pose2D
from tools.benchmark.rooms import SMALL
from tools.sim import ceilings, virtual_time
from tools.sim.teacher import Area, Teacher, free_point, teach
from tools.sim.virtual_robot import VirtualRobot, virtual_robot

SEED = 1
TEACHING = 240.0  # s
SAMPLE = 600.0  # s
ACCIDENTS = 3600.0  # s from one to the next of a kind
SILENCE = 3.0  # s for which the base says nothing
CORNERS = ((0.8, 0.8), (-0.8, 0.7), (-0.7, -0.8), (0.7, -0.7))  # m from the middle of the taught floor
PAUSE = 5.0  # s after a trip that failed
# What may still grow, by the hour, in the second half: caches of the interpreter's memory, not one object a tick.
FLAT_MB = 0.5
FLAT_DISK = 2e6  # bytes in all of the second half: a failure's report replaces another


@dataclass(frozen=True, slots=True)
class Sample:
    """How the process stood at one moment; `log` counts the bytes that went to the log so far."""

    hours: float
    memory_mb: float
    objects: int
    descriptors: int
    threads: int
    disk: int
    log: int
    rounds: int


@dataclass
class Diary:
    """What happened so far; trips by the name of their error."""

    samples: list[Sample] = field(default_factory=list)
    ends: Counter[str] = field(default_factory=Counter)
    rounds: int = 0


class LogCounter(logging.Handler):
    """Takes the place of the journal."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.bytes = 0

    def emit(self, record: logging.LogRecord) -> None:
        self.bytes += len(self.format(record)) + 1


class Patrol:
    """The robot's day, its accidents, and the watch over it."""

    def __init__(self, robot: VirtualRobot, directory: Path, area: Area, diary: Diary) -> None:
        self._robot, self._directory, self._area, self._diary = robot, directory, area, diary
        self._rng = random.Random(SEED)
        self._log = LogCounter()

    async def run(self, hours: float) -> None:
        logging.getLogger("omnibotd").addHandler(self._log)
        logging.getLogger("omnibotd").setLevel(logging.INFO)
        try:
            async with asyncio.TaskGroup() as group:
                works = (self._go_round(), self._be_carried(), self._fall_silent(), self._ask(), self._watch())
                tasks = [group.create_task(work) for work in works]
                await asyncio.sleep(3600.0 * hours)
                for task in tasks:
                    task.cancel()
        finally:
            logging.getLogger("omnibotd").removeHandler(self._log)

    async def _go_round(self) -> None:
        places = [f"p{k}" for k in range(len(CORNERS))]
        while True:
            try:
                await self._robot.call("route", places=places, loops=1)
                self._diary.rounds += 1
                self._diary.ends["DONE"] += 1
            except RpcError as error:
                self._diary.ends[error.name.value] += 1
                await asyncio.sleep(PAUSE)

    async def _be_carried(self) -> None:
        while True:
            await asyncio.sleep(ACCIDENTS)
            x, y = free_point(self._robot.world, self._area, self._rng)
            self._robot.teleport(Pose2D(x, y, self._rng.uniform(-3.0, 3.0)))

    async def _fall_silent(self) -> None:
        await asyncio.sleep(ACCIDENTS / 2.0)
        while True:
            self._robot.link.cut = True
            await asyncio.sleep(SILENCE)
            self._robot.link.cut = False
            await asyncio.sleep(ACCIDENTS)

    async def _ask(self) -> None:
        while True:
            await self._robot.call("status")
            await asyncio.sleep(1.0)

    async def _watch(self) -> None:
        began = asyncio.get_running_loop().time()
        while True:
            # The simulator's own memory of where it was is not the daemon's.
            self._robot._truth.clear()
            gc.collect()
            self._diary.samples.append(self._sample((asyncio.get_running_loop().time() - began) / 3600.0))
            _say(self._diary.samples[-1])
            await asyncio.sleep(SAMPLE)

    def _sample(self, hours: float) -> Sample:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return Sample(
            hours=round(hours, 4),
            memory_mb=pages * os.sysconf("SC_PAGE_SIZE") / 1e6,
            objects=len(gc.get_objects()),
            descriptors=len(os.listdir("/proc/self/fd")),
            threads=len(os.listdir("/proc/self/task")),
            disk=sum(file.stat().st_size for file in self._directory.rglob("*") if file.is_file()),
            log=self._log.bytes,
            rounds=self._diary.rounds,
        )


def _say(sample: Sample) -> None:
    print(
        f"{sample.hours:6.2f} h  {sample.memory_mb:6.1f} MB  {sample.objects} objects  {sample.descriptors} files  "
        f"{sample.threads} threads  {sample.disk / 1e6:.2f} MB on disk  {sample.log / 1e3:.0f} kB of log  "
        f"{sample.rounds} rounds",
        file=sys.stderr,
        flush=True,
    )


async def patrol(hours: float, directory: Path, diary: Diary) -> None:
    """Teach, name the places, and be off."""
    with mock.patch("tools.sim.world.Lens", lambda: SMALL):
        world = ceilings.tiles(SEED)
    area = Area.to_teach(world, side=3.0)
    middle = Pose2D((area.xmin + area.xmax) / 2.0, (area.ymin + area.ymax) / 2.0)
    async with virtual_robot(world, SEED, middle, directory=directory) as robot:
        await teach(robot, Teacher(robot, area, SEED), "room", TEACHING)
        for k, (x, y) in enumerate(CORNERS):
            await robot.call("place.add", name=f"p{k}", at=[x, y, 0.0])
        await Patrol(robot, directory, area, diary).run(hours)


def verdicts(samples: Sequence[Sample]) -> dict[str, tuple[bool, str]]:
    """What of it is flat: by the second half, when every cache is full."""
    late = samples[len(samples) // 2 :]
    first, last = late[0], late[-1]
    slope = float(np.polyfit([s.hours for s in late], [s.memory_mb for s in late], 1)[0]) if len(late) > 2 else 0.0
    hours = max(last.hours - first.hours, 1e-9)
    return {
        "memory": (abs(slope) < FLAT_MB, f"{first.memory_mb:.1f} to {last.memory_mb:.1f} MB, {slope:+.3f} MB an hour"),
        "descriptors": (last.descriptors <= first.descriptors, f"{first.descriptors} to {last.descriptors}"),
        "threads": (last.threads <= first.threads, f"{first.threads} to {last.threads}"),
        "disk": (last.disk - first.disk < FLAT_DISK, f"{first.disk / 1e6:.2f} to {last.disk / 1e6:.2f} MB"),
        "log": (True, f"{(last.log - first.log) / 1e3 / hours:.0f} kB an hour, which the journal caps"),
    }


def draw(samples: Sequence[Sample], path: Path) -> None:
    """One curve each, from zero."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - it takes a second to load

    curves: Mapping[str, list[float]] = {
        "memory, MB": [s.memory_mb for s in samples],
        "objects, thousands": [s.objects / 1e3 for s in samples],
        "descriptors and threads": [s.descriptors + s.threads for s in samples],
        "on disk, MB": [s.disk / 1e6 for s in samples],
        "log, MB": [s.log / 1e6 for s in samples],
    }
    figure = Figure(figsize=(3.2 * len(curves), 2.8), layout="constrained")
    for axes, (name, values) in zip(figure.subplots(1, len(curves)), curves.items(), strict=True):
        axes.plot([s.hours for s in samples], values, color="#20507a")
        axes.set(title=name, xlabel="hours", ylim=(0.0, 1.15 * max([*values, 1e-9])))
    figure.savefig(path, dpi=110)


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit status 1 where something grows; Ctrl-C ends the patrol before its time, and what was seen is told."""
    parser = argparse.ArgumentParser(
        prog="tools/endurance", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hours", type=float, default=24.0, help="of the robot's time")
    parser.add_argument("--json", type=Path, metavar="FILE", help="all samples")
    parser.add_argument("--plot", type=Path, metavar="PNG")
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    began, diary = time.perf_counter(), Diary()
    with TemporaryDirectory(prefix="omnibot-") as directory, suppress(KeyboardInterrupt):
        virtual_time.run(patrol(options.hours, Path(directory), diary))
    if not diary.samples:
        return 1
    found = verdicts(diary.samples)
    wall = (time.perf_counter() - began) / 60.0
    print(f"{diary.samples[-1].hours:.1f} h in {wall:.0f} minutes; {diary.rounds} rounds; trips: {dict(diary.ends)}")
    for name, (flat, what) in found.items():
        print(f"{name:12} {'flat' if flat else 'GROWS'}: {what}")
    if options.json:
        _write(options.json, diary, found)
    if options.plot:
        draw(diary.samples, options.plot)
    return 0 if all(flat for flat, _ in found.values()) else 1


def _write(path: Path, diary: Diary, found: Mapping[str, tuple[bool, str]]) -> None:
    result: dict[str, Any] = {
        "samples": [asdict(sample) for sample in diary.samples],
        "trips": diary.ends,
        "verdicts": {name: {"flat": flat, "told": told} for name, (flat, told) in found.items()},
    }
    path.write_text(json.dumps(result, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    sys.exit(main())
