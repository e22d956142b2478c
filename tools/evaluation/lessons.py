"""Teaching drives and the maps made of them, kept in a folder: what was taught once need not be taught again.

KEPT/LESSON/ holds recording.mcap, track.npz (the truth) and lesson.json; in it MAKE/ holds the map that this state of
the code makes of them, and nodes.npy. A lesson's name changes with the simulator's code, MAKE with the core's.
"""

from __future__ import annotations

import fcntl
import hashlib
import inspect
import json
import shutil
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import omnibotd
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.io.map_store import MapStore
from tools.evaluation.axis import Axis, robot_with
from tools.evaluation.map_truth import MapTruth, true_poses
from tools.sim import track, virtual_time
from tools.sim.conditions import DRIFT
from tools.sim.teacher import Area, Teacher, record
from tools.sim.virtual_robot import STORAGE, VirtualRobot
from tools.sim.world_plugin import World, find_factory

MAP = "evaluated"
_RECORDING, _TRACK, _LESSON, _NODES = "recording.mcap", "track.npz", "lesson.json", "nodes.npy"


@dataclass(frozen=True)
class Lesson:
    """What is taught: the world by name, for how many seconds at which speed (m/s), where, and under which standing
    conditions. `park` is where the drive ends, None: anywhere; `axis` the calibration of the camera, None: none."""

    world: str
    seed: int
    preset: str
    seconds: float
    speed: float
    area: Area
    start: Pose2D
    park: Pose2D | None = None
    standing: tuple[str, ...] = ()
    axis: Axis | None = None

    @property
    def key(self) -> str:
        """Changes with the lesson, with the simulator and with the module of the world."""
        code = _digest([*Path(track.__file__).parent.glob("*.py"), Path(inspect.getfile(find_factory(self.world)))])
        return hashlib.sha256((json.dumps(asdict(self)) + code).encode()).hexdigest()[:16]

    @property
    def wheel_error(self) -> float:
        return DRIFT if "drift" in self.standing else 0.0


@dataclass(frozen=True)
class Taught:
    """A robot with a map in use, and what the map's poses are in the world; `reused` says what was kept from before."""

    robot: VirtualRobot
    topo_map: TopoMap
    truth: MapTruth
    reused: tuple[str, ...]


@asynccontextmanager
async def taught_robot(lesson: Lesson, world: World, folder: Path, reused: tuple[str, ...]) -> AsyncIterator[Taught]:
    """A robot that wakes where the drive of `driven` ended, with the map made of it. Raises RpcError."""
    end = Pose2D(*json.loads((folder / _LESSON).read_text("utf-8"))["end"])
    kept = folder / _digest((Path(omnibotd.__file__).parent / "core").rglob("*.py"))
    with TemporaryDirectory(prefix="omnibot-") as place:
        store = MapStore(Path(place) / STORAGE)
        store.new_recording_path(MAP).symlink_to((folder / _RECORDING).resolve())
        options = {"preset": lesson.preset, "wheel_error": lesson.wheel_error}
        async with robot_with(lesson.axis, world, lesson.seed, end, Path(place), **options) as robot:
            with _alone(kept):
                if (kept / _NODES).exists():
                    store.save(MapStore(kept).load(MAP))
                    reused += ("map",)
                else:
                    await _train(robot, folder, kept)
            await robot.call("map.use", map=MAP)
            topo_map = store.load(MAP)
            poses = topo_map.poses.astype(float)
            truth = MapTruth(poses, np.load(kept / _NODES), metric=topo_map.method != "thesis")
            yield Taught(robot, topo_map, truth, reused)


def driven(lesson: Lesson, world: World, keep: Path) -> tuple[Path, tuple[str, ...]]:
    """The lesson's folder in `keep`, and ("drive",) if the drive was there already. Raises RpcError, NoWay."""
    folder = keep / lesson.key
    with _alone(folder):
        folder.mkdir(exist_ok=True)
        if (folder / _LESSON).exists():
            return folder, ("drive",)
        virtual_time.run(_drive(lesson, world, folder))
    return folder, ()


async def _drive(lesson: Lesson, world: World, folder: Path) -> None:
    options = {"preset": lesson.preset, "wheel_error": lesson.wheel_error}
    with TemporaryDirectory(prefix="omnibot-") as place:
        async with robot_with(lesson.axis, world, lesson.seed, lesson.start, Path(place), **options) as robot:
            teacher = Teacher(robot, lesson.area, lesson.seed, lesson.speed)
            recording = await record(robot, teacher, MAP, lesson.seconds, lesson.park)
            shutil.move(recording, folder / _RECORDING)
            robot.track().save(folder / _TRACK)
            end = [robot.pose.x, robot.pose.y, robot.pose.yaw]
    # Last: it says that the rest is whole.
    (folder / _LESSON).write_text(json.dumps({"lesson": asdict(lesson), "end": end}, indent=1) + "\n", "utf-8")


async def _train(robot: VirtualRobot, folder: Path, kept: Path) -> None:
    await robot.call("train", map=MAP)
    topo_map, model = robot.store.load(MAP), robot.daemon.perception.model
    assert model is not None
    poses = true_poses(topo_map, folder / _RECORDING, model, track.Track.load(folder / _TRACK))
    MapStore(kept).save(topo_map)
    np.save(kept / _NODES, poses)


def _digest(files: Iterator[Path] | list[Path]) -> str:
    """Of the contents of files, in the order of their names."""
    total = hashlib.sha256()
    for path in sorted(files):
        total.update(path.read_bytes())
    return total.hexdigest()[:16]


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Another process that wants to fill the same folder waits until this one has."""
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
