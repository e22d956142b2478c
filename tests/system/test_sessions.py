"""Maps that grow, shrink and are told apart, through the whole daemon in virtual time and through the real children."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from omnibotd.control_protocol import RpcError
from omnibotd.core.errors import TrainingError
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation.navigator import SURE
from omnibotd.core.percept import PlaceEstimate
from omnibotd.io.map_store import MapStore
from omnibotd.pruning_process import prune_in_child
from omnibotd.training_process import train_and_save, train_in_child
from tests.teaching import CAMERA
from tools.sim import ceilings, virtual_robot, virtual_time
from tools.sim.teacher import Area, Teacher, record, teach
from tools.sim.virtual_robot import STORAGE, VirtualRobot
from tools.sim.world_plugin import World

TEACH = 60.0  # s, 2 m x 2 m
HOME, ELSEWHERE = 11, 14  # seeds of two rooms
PLACES = {"desk": Pose2D(0.6, 0.6, 1.0), "sofa": Pose2D(-0.6, -0.5, -2.0)}  # where they are in the room
RIGHT = 0.25  # m within which a sure estimate promises to be
SECOND = "room.0002.mcap"


def home(light: str = "nominal") -> World:
    return ceilings.tiles(HOME, light)


def elsewhere() -> World:
    return ceilings.tiles(ELSEWHERE)


@dataclass(frozen=True)
class Taught:
    """A robot's files after its first lesson, the true pose of the map's origin, and where the robot ended."""

    directory: Path
    origin: Pose2D
    end: Pose2D

    def copied(self, to: Path) -> Taught:
        shutil.copytree(self.directory, to, dirs_exist_ok=True)
        return Taught(to, self.origin, self.end)

    @property
    def store(self) -> MapStore:
        return MapStore(self.directory / STORAGE)


@asynccontextmanager
async def awake(taught: Taught, world: World, start: Pose2D | None = None) -> AsyncIterator[VirtualRobot]:
    """The robot another day, where it was left or at `start`, with the files it has."""
    async with virtual_robot.virtual_robot(world, 2, start or taught.end, directory=taught.directory) as robot:
        yield robot


def teacher_of(robot: VirtualRobot, seed: int) -> Teacher:
    return Teacher(robot, Area.to_teach(robot.world, side=2.0), seed)


def lesson(directory: Path, world: World, name: str) -> Taught:
    """The first lesson: taught a minute, with places where the room has them."""

    async def live() -> Taught:
        async with virtual_robot.virtual_robot(world, 1, directory=directory) as robot:
            origin = robot.pose
            await teach(robot, teacher_of(robot, 1), name, TEACH)
            for place, pose in PLACES.items():
                at = origin.inverse() @ pose
                await robot.call("place.add", name=place, at=[at.x, at.y, at.yaw])
            return Taught(directory, origin, robot.pose)

    return virtual_time.run(live())


@pytest.fixture(scope="module")
def first_room(tmp_path_factory: pytest.TempPathFactory) -> Taught:
    return lesson(tmp_path_factory.mktemp("home"), home(), "room")


@pytest.fixture(scope="module")
def second_room(tmp_path_factory: pytest.TempPathFactory) -> Taught:
    return lesson(tmp_path_factory.mktemp("elsewhere"), elsewhere(), "hut")


@pytest.fixture(scope="module")
def second_drive(first_room: Taught, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording made another day in the first room."""
    taught = first_room.copied(tmp_path_factory.mktemp("second"))

    async def live() -> Path:
        async with awake(taught, home()) as robot:
            return await record(robot, teacher_of(robot, 3), "room", 30.0)

    return virtual_time.run(live())


@pytest.fixture
def room(first_room: Taught, tmp_path: Path) -> Taught:
    return first_room.copied(tmp_path)


async def visit(robot: VirtualRobot) -> list[float]:
    """How far from each place the robot ends that is sent there."""
    errors = []
    for place, pose in PLACES.items():
        await robot.call("goto", place=place)
        await asyncio.sleep(1.0)
        errors.append(robot.pose.distance(pose))
    return errors


async def visit_with_recording(robot: VirtualRobot) -> None:
    await robot.call("record.start", map="room")
    await visit(robot)
    await robot.call("record.stop")


def assert_old_part_untouched(before: TopoMap, after: TopoMap) -> None:
    known = len(before)
    for name in ("poses", "snapshots", "sessions"):
        np.testing.assert_array_equal(getattr(after, name)[:known], getattr(before, name))
    assert (after.places, after.docks) == (before.places, before.docks)


def test_a_map_grows_by_a_session_recorded_on_the_way_to_places(room: Taught) -> None:
    before = room.store.load("room")

    async def live() -> tuple[dict[str, Any], dict[str, Any], list[float]]:
        async with awake(room, home()) as robot:
            await visit_with_recording(robot)
            trained = await robot.call("train", map="room")
            return trained, await robot.call("map.info"), await visit(robot)

    trained, info, errors = virtual_time.run(live())
    after = room.store.load("room")
    assert_old_part_untouched(before, after)
    assert trained["nodes"] == len(after) > len(before)
    assert trained["warnings"] == []
    assert [(part["session"], part["recording"]) for part in info["sessions"]] == [
        (0, "room.0001.mcap"),
        (1, SECOND),
    ]
    assert [part["nodes"] for part in info["sessions"]] == [len(before), len(after) - len(before)]
    assert max(errors) < 0.15


@dataclass(frozen=True)
class Heard:
    """Shares of the estimates along a drive that are sure, and that are sure and wrong."""

    sure: float
    wrong: float


def listen(room: Taught, world: World) -> Heard:
    async def live() -> list[tuple[bool, bool]]:
        heard: list[tuple[bool, bool]] = []

        def note(place: PlaceEstimate) -> None:
            error = (room.origin @ place.map_from_base).distance(robot.true_pose_at(place.stamp))
            heard.append((place.confidence >= SURE, place.confidence >= SURE and error > RIGHT))

        async with awake(room, world) as robot:
            robot.overhear(note)
            await teacher_of(robot, 7).wander(30.0)
        return heard

    heard = virtual_time.run(live())
    assert len(heard) > 200
    return Heard(*np.mean(heard, axis=0).tolist())


@pytest.mark.slow
@pytest.mark.parametrize("light", ["half_lamps", "night"])
def test_a_session_in_another_light_makes_the_map_know_that_light(room: Taught, light: str) -> None:
    known, before = room.store.load("room"), listen(room, home(light))

    async def learn() -> None:
        async with awake(room, home(light)) as robot:
            await record(robot, teacher_of(robot, 3), "room", TEACH)
            await robot.call("train", map="room")

    virtual_time.run(learn())
    assert_old_part_untouched(known, room.store.load("room"))
    after, as_taught_first = listen(room, home(light)), listen(room, home())
    assert after.sure >= max(before.sure, 0.95)
    # Where only the other light was seen, the first one is expected to fit better than it can.
    assert as_taught_first.sure > 0.85
    assert before.wrong == after.wrong == as_taught_first.wrong == 0.0


@pytest.mark.slow
def test_a_session_that_would_spoil_the_map_is_refused(tmp_path: Path) -> None:
    """Beams by night look alike along their length, so that the camera shortens the way along them."""
    room = lesson(tmp_path, ceilings.beams(21), "room")
    on_disk = room.store.file("room").read_bytes()

    async def learn() -> None:
        async with awake(room, ceilings.beams(21, "night")) as robot:
            await record(robot, teacher_of(robot, 3), "room", TEACH)
            with pytest.raises(RpcError, match=r"its way differs by .* from what odometry says") as refused:
                await robot.call("train", map="room")
            assert refused.value.name == "TRAINING_FAILED"

    virtual_time.run(learn())
    assert room.store.file("room").read_bytes() == on_disk


def test_another_room_under_the_map_s_name_is_refused_and_a_fresh_map_keeps_the_old(
    room: Taught, second_room: Taught
) -> None:
    file = room.store.file("room")
    shutil.copy(second_room.store.recording_path("hut"), room.store.new_recording_path("room"))
    before, on_disk, files = room.store.load("room"), file.read_bytes(), sorted(file.parent.iterdir())

    async def live() -> str:
        async with awake(room, elsewhere(), second_room.end) as robot:
            with pytest.raises(RpcError) as refused:
                await robot.call("train", map="room")
            assert refused.value.name == "TRAINING_FAILED"
            assert file.read_bytes() == on_disk
            assert sorted(file.parent.iterdir()) == files
            in_use = robot.daemon.perception.topo_map
            assert (await robot.call("status"))["map"] == in_use.name == "room"
            np.testing.assert_array_equal(in_use.poses, before.poses)
            await robot.call("train", map="room", fresh=True)
            assert (await robot.call("status"))["map"] == "room"
            back = await robot.call("goto", at=[0.0, 0.0, 0.0])
            assert back["error_estimate_m"] < 0.1
            assert robot.pose.distance(second_room.origin) < 0.15
            return str(refused.value.message)

    assert "start a new map with --fresh" in virtual_time.run(live())
    assert room.store.load("room").recordings == (SECOND,)
    kept = room.store.load("room-1")
    assert_old_part_untouched(before, kept)
    assert kept.recordings == before.recordings


def test_a_robot_arrives_with_a_pruned_map(room: Taught) -> None:
    before = room.store.load("room")
    limit = round(0.7 * len(before))

    async def live() -> tuple[dict[str, Any], list[float]]:
        async with awake(room, home()) as robot:
            pruned = await robot.call("map.prune", nodes=limit)
            in_use = robot.daemon.perception.topo_map
            assert in_use is not None
            assert len(in_use) == limit
            return pruned, await visit(robot)

    pruned, errors = virtual_time.run(live())
    after = room.store.load("room")
    assert (pruned["nodes_before"], pruned["nodes"], pruned["warnings"]) == (len(before), limit, [])
    assert len(after) == limit
    assert after.places == before.places
    assert {tuple(pose) for pose in after.poses.tolist()} <= {tuple(pose) for pose in before.poses.tolist()}
    assert max(errors) < 0.15


def test_pruning_in_its_child(room: Taught) -> None:
    before = room.store.load("room")
    pruned = asyncio.run(prune_in_child("room", len(before) - 20, room.store))
    assert len(pruned) == len(room.store.load("room")) == len(before) - 20
    file = room.store.file("room")
    on_disk = file.read_bytes()
    with pytest.raises(Exception, match="needed to cover the floor"):
        asyncio.run(prune_in_child("room", 3, room.store))
    assert file.read_bytes() == on_disk


def test_a_power_cut_while_a_session_is_added_leaves_the_map_whole(
    room: Taught, second_drive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(second_drive, room.store.new_recording_path("room"))
    file, children, stages = room.store.file("room"), [], []
    on_disk, begin = file.read_bytes(), asyncio.create_subprocess_exec

    async def begun(*command: Any, **options: Any) -> asyncio.subprocess.Process:
        children.append(await begin(*command, **options))
        return children[-1]

    def cut(stage: str, share: float) -> None:
        stages.append(stage)
        if stage == "joining":
            children[-1].kill()

    monkeypatch.setattr(asyncio, "create_subprocess_exec", begun)
    recording = room.store.recording_path("room")
    with pytest.raises(TrainingError, match="ended with status -9 before it was done"):
        asyncio.run(train_in_child(recording, "room", room.store, CAMERA, cut))
    assert "joining" in stages
    assert "done" not in stages
    assert file.read_bytes() == on_disk
    assert room.store.verify("room").ok
    # Nothing that the child left behind is in the way of the next one.
    grown = asyncio.run(train_in_child(recording, "room", room.store, CAMERA, lambda *_: None))
    assert grown.recordings == ("room.0001.mcap", SECOND)


def test_a_place_added_while_the_map_is_trained_is_kept(room: Taught, second_drive: Path) -> None:
    shutil.copy(second_drive, room.store.new_recording_path("room"))
    bed, moved = Pose2D(0.1, 0.2, 0.3), Pose2D(0.2, 0.2, 0.2)

    def furnish(stage: str, share: float) -> None:
        if stage == "joining":
            room.store.save(room.store.load("room").with_place("bed", bed).with_place("desk", moved))

    train_and_save(room.store.recording_path("room"), "room", room.store, CAMERA, furnish)
    grown = room.store.load("room")
    assert grown.recordings == ("room.0001.mcap", SECOND)
    assert grown.places.keys() == {"desk", "sofa", "bed"}
    assert grown.places["desk"].distance(moved) < 1e-9


def test_a_recording_never_takes_the_name_of_one_that_the_map_was_made_from(room: Taught) -> None:
    """A map may come from another computer, or its recordings may be gone to make room."""
    before = room.store.load("room")
    for path in room.store.recordings("room"):
        path.unlink()

    async def live() -> list[dict[str, Any]]:
        async with awake(room, home()) as robot:
            await visit_with_recording(robot)
            await robot.call("train", map="room")
            return (await robot.call("map.info"))["recordings"]

    recordings = virtual_time.run(live())
    assert [(entry["file"], entry["trained"]) for entry in recordings] == [(SECOND, True)]
    assert_old_part_untouched(before, room.store.load("room"))


@pytest.mark.parametrize("active", ["room", None])
def test_a_robot_that_wakes_in_another_room_takes_that_room_s_map(
    room: Taught, second_room: Taught, active: str | None
) -> None:
    room.store.save(second_room.store.load("hut"))
    room.store.set_active(active)

    async def live() -> float:
        async with awake(room, elsewhere(), second_room.end) as robot:
            assert (await robot.call("status"))["map"] == active
            await asyncio.sleep(15.0)
            assert (await robot.call("status"))["map"] == "hut"
            await robot.call("goto", place="desk")
            await asyncio.sleep(1.0)
            return robot.pose.distance(PLACES["desk"])

    assert virtual_time.run(live()) < 0.15
    assert room.store.active() == "hut"


class OtherLens:
    """A world seen through a lens that, says the configuration, covers less."""

    fov_deg = 150.0

    def __init__(self, world: World) -> None:
        self.bounds, self.dock, self.free, self.render = world.bounds, world.dock, world.free, world.render


def test_a_map_of_another_camera_is_not_used_and_not_added_to(room: Taught, second_drive: Path) -> None:
    shutil.copy(second_drive, room.store.new_recording_path("room"))
    on_disk = room.store.file("room").read_bytes()

    async def live() -> list[tuple[str, str]]:
        refusals = []
        async with awake(room, OtherLens(home())) as robot:
            await asyncio.sleep(3.0)
            assert (await robot.call("status"))["map"] is None
            for method in ("map.use", "train"):
                with pytest.raises(RpcError) as refused:
                    await robot.call(method, map="room")
                refusals.append((refused.value.name.value, refused.value.message))
            assert (await robot.call("status"))["map"] is None
        return refusals

    (use, why), (train, why_not) = virtual_time.run(live())
    assert (use, train) == ("NO_MAP", "TRAINING_FAILED")
    for sentence in (why, why_not):
        assert "map 'room' was taught with another camera: fx was" in sentence
        assert "teach a new map" in sentence
    assert room.store.file("room").read_bytes() == on_disk
