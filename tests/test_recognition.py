"""Several maps: the right one is recognised by its ceiling, and only when that is clear and nothing else goes on."""

from __future__ import annotations

import asyncio
import gc
import logging
import weakref
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from omnibotd.core.errors import MapError
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.percept import PlaceEstimate
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from omnibotd.io.map_store import MapStore
from omnibotd.recognition import Recogniser
from tests.made_maps import made_map
from tools.sim import virtual_time

ROOMS = [np.random.default_rng(seed).integers(0, 256, (120, 160), dtype=np.uint8) for seed in range(3)]


def place(confidence: float) -> PlaceEstimate:
    return PlaceEstimate(0.0, Pose2D(), Pose2D(), confidence, 0.05, 0.7, 0.2, 0)


class Localizer:
    """As sure as told, after a few frames."""

    alive: ClassVar[weakref.WeakSet[Localizer]] = weakref.WeakSet()
    most_alive = 0

    def __init__(self, confidence: float) -> None:
        self._confidence, self._frames = confidence, 0
        Localizer.alive.add(self)
        gc.collect()
        Localizer.most_alive = max(Localizer.most_alive, len(Localizer.alive))

    def update(self, frame: Frame, odom_from_base: Pose2D) -> PlaceEstimate:
        self._frames += 1
        return place(self._confidence * min(1.0, self._frames / 4))


class Robot:
    """The parts a recogniser works with, standing in room 0; `known` is how well each map knows this view."""

    def __init__(self, directory: Path, known: dict[str, float], active: str | None = None) -> None:
        self.store = MapStore(directory)
        self.known, self.tried = known, list[str]()
        self.events_told: list[dict[str, Any]] = []
        for name in known:
            self.store.save(made_map(name))
        self.trying = asyncio.Event()
        self.room, self.odom_from_base = 0, Pose2D()
        # what the control loop offers
        self.place: PlaceEstimate | None = None
        self.moving, self.odometry = False, self
        self.recorder: object = None
        self.events = self.events_told.append
        # what perception offers
        self.model = CameraModel.equidistant(160, 120, 3.3)
        self.lens_known = asyncio.Event()
        self.lens_known.set()
        self.loading: str | None = None
        self.topo_map = self.store.load(active) if active else None
        self.recogniser = Recogniser(self, self, self, self.store, self.off_loop)  # type: ignore[arg-type]

    # control and odometry
    def absorb(self) -> None: ...

    def at(self, stamp: float) -> Pose2D:
        return self.odom_from_base

    # perception
    async def localizer_of(self, topo_map: TopoMap, model: CameraModel) -> Localizer:
        self.tried.append(topo_map.name)
        self.trying.set()
        await asyncio.sleep(0.1)
        if self.known[topo_map.name] < 0.0:
            raise MapError(f"map {topo_map.name!r} was taught with another camera")
        return Localizer(self.known[topo_map.name])

    async def use(self, topo_map: TopoMap) -> None:
        self.topo_map, self.place = topo_map, place(self.known[topo_map.name])

    # camera
    @property
    def latest(self) -> Frame:
        return Frame(asyncio.get_running_loop().time(), ROOMS[self.room])

    async def wait_newer(self, stamp: float) -> Frame:
        await asyncio.sleep(max(0.1, stamp - asyncio.get_running_loop().time()))
        return self.latest

    @staticmethod
    async def off_loop(function: Callable[..., Any], *arguments: Any) -> Any:
        return function(*arguments)


def living(
    directory: Path, known: dict[str, float], story: Callable[[Robot], Awaitable[None]], active: str | None = None
) -> Robot:
    """The robot after the story, its recogniser running all the while."""

    async def main() -> Robot:
        robot = Robot(directory, known, active)
        watching = asyncio.create_task(robot.recogniser.run())
        await story(robot)
        assert not watching.done()
        watching.cancel()
        return robot

    return virtual_time.run(main())


async def minute(robot: Robot) -> None:
    await asyncio.sleep(60.0)


def test_on_wake_up_the_right_map_is_taken_and_remembered(tmp_path: Path) -> None:
    robot = living(tmp_path, {"attic": 0.2, "cellar": 0.95, "flat": 0.1}, minute)
    assert robot.topo_map is not None
    assert (robot.topo_map.name, robot.store.active()) == ("cellar", "cellar")
    assert robot.events_told == [{"event": "map_recognised", "map": "cellar", "before": None}]
    assert robot.tried == ["attic", "cellar", "flat"]  # and then never again


def test_the_active_map_has_the_first_word(tmp_path: Path) -> None:
    async def sure(robot: Robot) -> None:
        robot.place = place(0.9)
        await asyncio.sleep(60.0)

    assert living(tmp_path, {"flat": 0.9, "attic": 1.0}, sure, active="flat").tried == []

    robot = living(tmp_path, {"flat": 0.1, "attic": 1.0}, minute, active="flat")
    assert robot.events_told == [{"event": "map_recognised", "map": "attic", "before": "flat"}]
    assert robot.tried == ["attic"]


@pytest.mark.parametrize("known", [{"a": 0.95, "b": 0.9}, {"a": 0.5, "b": 0.1}, {"a": 0.0}])
def test_without_a_clear_winner_nothing_is_switched(tmp_path: Path, known: dict[str, float]) -> None:
    robot = living(tmp_path, known, minute)
    assert (robot.topo_map, robot.events_told) == (None, [])
    assert robot.tried == sorted(known)


def test_a_map_little_better_than_the_active_one_does_not_replace_it(tmp_path: Path) -> None:
    async def nearly_sure(robot: Robot) -> None:
        robot.place = place(0.55)
        await asyncio.sleep(20.0)

    assert living(tmp_path, {"flat": 0.55, "attic": 0.7}, nearly_sure, active="flat").events_told == []


def test_it_is_tried_again_only_when_the_robot_was_moved(tmp_path: Path) -> None:
    tries = []

    async def story(robot: Robot) -> None:
        for change in ("nothing", "nothing", "driven", "nothing", "turned", "carried", "nothing", "was sure"):
            robot.odom_from_base = robot.odom_from_base @ Pose2D(0.5 * (change == "driven"), 0.0, change == "turned")
            robot.room += change == "carried"
            if change == "was sure":
                robot.place = place(0.9)
                await asyncio.sleep(2.0)
                robot.place = place(0.1)
            before = len(robot.tried)
            await asyncio.sleep(10.0)
            tries.append((change, len(robot.tried) - before))

    living(tmp_path, {"flat": 0.0, "attic": 0.3}, story, active="flat")
    assert tries[0] == ("nothing", 1)
    assert tries[1:] == [
        ("nothing", 0),
        ("driven", 1),
        ("nothing", 0),
        ("turned", 1),
        ("carried", 1),
        ("nothing", 0),
        ("was sure", 1),
    ]


@pytest.mark.parametrize("busy", ["moving", "recorder", "loading"])
def test_nothing_is_tried_while_something_goes_on(tmp_path: Path, busy: str) -> None:
    async def story(robot: Robot) -> None:
        setattr(robot, busy, "flat")
        await asyncio.sleep(30.0)
        assert robot.tried == []
        assert await robot.recogniser.recognise() is None

    assert living(tmp_path, {"flat": 0.9}, story).tried == []


def test_a_job_that_begins_meanwhile_keeps_its_map(tmp_path: Path) -> None:
    async def story(robot: Robot) -> None:
        attempt = asyncio.create_task(robot.recogniser.recognise())
        await robot.trying.wait()
        robot.moving = True
        assert await attempt is None

    robot = living(tmp_path, {"attic": 0.95, "cellar": 0.1}, story)
    assert (robot.topo_map, robot.tried) == (None, ["attic"])


def test_unusable_maps_are_passed_over_and_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "broken.omap").write_bytes(b"no map")

    async def story(robot: Robot) -> None:
        data = bytearray(robot.store.file("cut").read_bytes())
        data[-1] ^= 1
        robot.store.file("cut").write_bytes(data)
        await asyncio.sleep(30.0)

    with caplog.at_level(logging.WARNING):
        robot = living(tmp_path, {"cut": 0.99, "foreign": -1.0, "good": 0.9}, story)
    assert robot.topo_map is not None
    assert robot.topo_map.name == "good"
    assert "map cut not considered" in caplog.text
    assert "taught with another camera" in caplog.text


def test_one_map_more_than_the_active_one_is_in_memory(tmp_path: Path) -> None:
    Localizer.most_alive = 0
    living(tmp_path, {f"map{number}": 0.1 for number in range(5)}, minute)
    assert Localizer.most_alive == 1


def test_a_map_that_somebody_chose_stays_until_the_robot_is_moved(tmp_path: Path) -> None:
    async def story(robot: Robot) -> None:
        robot.place = place(0.0)
        await robot.recogniser.chosen()
        await asyncio.sleep(30.0)
        assert robot.tried == []
        robot.room = 1
        await asyncio.sleep(10.0)

    assert living(tmp_path, {"flat": 0.0, "attic": 0.95}, story, active="flat").tried == ["attic"]


def test_on_request_the_active_map_is_asked_before_the_others(tmp_path: Path) -> None:
    async def knows(robot: Robot) -> None:
        robot.place = place(0.9)
        await robot.recogniser.wake_up()

    async def knows_not(robot: Robot) -> None:
        began = asyncio.get_running_loop().time()
        await robot.recogniser.wake_up()
        assert asyncio.get_running_loop().time() - began < 10.0

    assert living(tmp_path / "a", {"flat": 0.9, "attic": 0.95}, knows, active="flat").tried == []
    robot = living(tmp_path / "b", {"flat": 0.2, "attic": 0.95}, knows_not, active="flat")
    assert robot.topo_map is not None
    assert robot.topo_map.name == "attic"
