"""Maps and places as the whole daemon answers: every change on disk, none lost, none under a running job."""

from __future__ import annotations

import asyncio
import base64
import shutil
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from omnibotd.control_protocol import RpcError
from omnibotd.core.decision import Decision, Observation
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.calibration import calibration_of
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.io.map_store import MapStore
from omnibotd.map_plot import ROUTE, TRAIL
from omnibotd.pruning_process import prune_and_save, prune_in_child
from tests.empty_hall import EmptyHall
from tests.made_maps import made_map
from tools.sim import virtual_time
from tools.sim.virtual_robot import VirtualRobot, virtual_robot

Story = Callable[[VirtualRobot], Awaitable[Any]]


def told(story: Story) -> Any:
    """What the story returns of a robot with maps `flat`, in use, and `attic`."""

    async def main() -> Any:
        async with virtual_robot(EmptyHall(), 1) as robot:
            robot.store.save(made_map())
            robot.store.save(made_map("attic", seed=2))
            await robot.call("map.use", map="flat")
            return await story(robot)

    return virtual_time.run(main())


async def refusal(work: Awaitable[Any]) -> RpcError:
    with pytest.raises(RpcError) as refused:
        await work
    return refused.value


def kept(result: dict[str, Any]) -> bytes:
    """The safety copy that an answer names."""
    return Path(result["kept"]).read_bytes()


class Endless:
    def step(self, seen: Observation) -> Decision:
        return Decision("FOLLOWING", waypoint=2, loop=1)


def prune_in_place(robot: VirtualRobot) -> None:
    """Child processes don't live in virtual time."""

    async def prune(name: str, nodes: int, store: MapStore) -> Any:
        return prune_and_save(name, nodes, store)

    robot.daemon.requests._methods["map.prune"].__self__._pruner = prune


def test_pruning_keeps_the_version_before_and_puts_the_smaller_map_to_use() -> None:
    async def story(robot: VirtualRobot) -> None:
        prune_in_place(robot)
        before = robot.store.file("flat").read_bytes()
        result = await robot.call("map.prune", nodes=40)
        assert (result["map"], result["nodes_before"], result["warnings"]) == ("flat", 60, [])
        assert result["nodes"] == len(robot.store.load("flat")) <= 40
        assert kept(result) == before
        assert robot.daemon.perception.topo_map is not None
        assert len(robot.daemon.perception.topo_map) == result["nodes"]
        assert robot.store.load("flat").places == made_map().places

    told(story)


def test_pruning_is_refused_while_the_map_is_needed_and_where_it_would_do_nothing() -> None:
    async def story(robot: VirtualRobot) -> None:
        prune_in_place(robot)
        error = await refusal(robot.call("map.prune", nodes=60))
        assert (error.code, "not more than 60" in error.message) == (-32602, True)
        assert (await refusal(robot.call("map.prune", nodes=0))).code == -32602
        robot.daemon.control.start("goto", Endless(), None)
        for method, params in (("map.prune", {"nodes": 40}), ("map.delete", {"map": "flat"})):
            assert (await refusal(robot.call(method, **params))).name is ErrorName.BUSY
        assert (await robot.call("map.prune", map="attic", nodes=40))["map"] == "attic"
        robot.daemon.requests.teaching.training = "attic"
        for method, params in (("map.prune", {"nodes": 30}), ("map.delete", {})):
            error = await refusal(robot.call(method, map="attic", **params))
            assert (error.name, "being trained" in error.message) == (ErrorName.BUSY, True)

    told(story)


def test_a_place_added_while_the_map_is_pruned_is_not_lost() -> None:
    async def story(robot: VirtualRobot) -> None:
        async def slow(name: str, nodes: int, store: MapStore) -> Any:
            pruned = replace(store.load(name))
            await asyncio.sleep(5.0)
            store.save(pruned)
            return pruned

        robot.daemon.requests._methods["map.prune"].__self__._pruner = slow
        pruning = asyncio.create_task(robot.call("map.prune", nodes=40))
        await asyncio.sleep(1.0)
        await robot.call("place.add", name="shelf", at=[1, 0, 0])
        await pruning
        assert "shelf" in robot.store.load("flat").places

    told(story)


def test_pruning_happens_in_a_child_and_its_refusals_come_through(tmp_path: Path) -> None:
    store = MapStore(tmp_path)
    store.save(made_map())

    async def main() -> None:
        assert len(await prune_in_child("flat", 40, store)) <= 40
        with pytest.raises(Exception, match="no map 'none'"):
            await prune_in_child("none", 40, store)

    asyncio.run(main())


def test_a_deleted_map_is_out_of_use_but_not_gone() -> None:
    async def story(robot: VirtualRobot) -> None:
        data = robot.store.file("flat").read_bytes()
        result = await robot.call("map.delete", map="flat")
        assert kept(result) == data
        assert (await robot.call("status"))["map"] is None
        assert [entry["name"] for entry in (await robot.call("map.list"))["maps"]] == ["attic"]
        assert "version before" in (await refusal(robot.call("map.use", map="flat"))).message
        await robot.call("map.delete", map="attic")

    told(story)


def test_a_map_that_is_only_recorded_says_so() -> None:
    async def story(robot: VirtualRobot) -> str:
        robot.store.new_recording_path("cellar").touch()
        return (await refusal(robot.call("map.delete", map="cellar"))).message

    assert "recorded, but not trained" in told(story)


def test_two_edits_at_once_both_hold() -> None:
    async def story(robot: VirtualRobot) -> None:
        names = [f"place{number}" for number in range(5)]
        await asyncio.gather(*(robot.call("place.add", name=name, at=[1, 0, 0]) for name in names))
        assert robot.store.load("flat").places.keys() == {"desk", "sofa", *names}

    told(story)


def test_an_edit_does_not_undo_a_training_that_is_not_in_use_yet() -> None:
    async def story(robot: VirtualRobot) -> None:
        robot.store.save(made_map("flat", nodes=90, seed=3))
        error = await refusal(robot.call("place.add", name="shelf", at=[1, 0, 0]))
        assert (error.name, "map use flat" in error.message) == (ErrorName.BUSY, True)
        assert len(robot.store.load("flat")) == 90
        await robot.call("map.use", map="flat")
        await robot.call("place.add", name="shelf", at=[1, 0, 0])

    told(story)


def test_a_place_is_renamed_where_it_stands() -> None:
    async def story(robot: VirtualRobot) -> None:
        result = await robot.call("place.rename", name="sofa", to="couch")
        assert (result["name"], result["pose"]["x"]) == ("couch", 5.9)
        assert robot.store.load("flat").places == {"desk": Pose2D(), "couch": made_map().places["sofa"]}
        taken = await refusal(robot.call("place.rename", name="couch", to="desk"))
        assert (taken.code, "already" in taken.message) == (-32602, True)
        for method, params in (("place.rename", {"to": "x"}), ("place.delete", {})):
            error = await refusal(robot.call(method, name="moon", **params))
            assert (error.name, "couch, desk" in error.message) == (ErrorName.NO_SUCH_PLACE, True)

    told(story)


def test_info_tells_the_drives_a_map_was_made_of() -> None:
    async def story(robot: VirtualRobot) -> Any:
        for size in (10, 20, 30):
            robot.store.new_recording_path("flat").write_bytes(bytes(size))
        return await robot.call("map.info")

    info = told(story)
    assert info["sessions"] == [
        {"session": 0, "recording": "flat.0001.mcap", "nodes": 20},
        {"session": 1, "recording": "flat.0002.mcap", "nodes": 40},
    ]
    assert [(entry["file"], entry["bytes"], entry["trained"]) for entry in info["recordings"]] == [
        ("flat.0001.mcap", 10, True),
        ("flat.0002.mcap", 20, True),
        ("flat.0003.mcap", 30, False),
    ]


def test_a_map_of_another_camera_is_refused_with_the_number_that_differs() -> None:
    async def story(robot: VirtualRobot) -> None:
        other = calibration_of(CameraModel.equidistant(160, 120, 3.3, 45.0))
        robot.store.save(replace(made_map("foreign"), camera=other))
        error = await refusal(robot.call("map.use", map="foreign"))
        assert "taught with another camera: f" in error.message
        assert (await robot.call("status"))["map"] == "flat"

    told(story)


def test_a_daemon_that_starts_with_such_a_map_goes_on_without_it() -> None:
    async def main() -> Any:
        async with virtual_robot(EmptyHall(), 1) as robot:
            other = calibration_of(CameraModel.equidistant(160, 120, 3.3, 45.0))
            robot.daemon.perception.model = None
            await robot.daemon.perception.use(replace(made_map("foreign"), camera=other))
            await asyncio.sleep(2.0)
            return await robot.call("status")

    assert virtual_time.run(main())["map"] is None


def test_a_plot_shows_the_way_driven_and_the_way_ahead() -> None:
    async def story(robot: VirtualRobot) -> tuple[bytes, bytes, bytes]:
        here = robot.daemon.control.goal_filter
        for x in (0.0, 1.0, 2.0, 3.0):
            for step in range(10):
                here.map_from_base = Pose2D(x + step * 0.1, 0.0)
                robot.daemon.requests.trail.note()
        robot.daemon.requests._methods["goto"].__self__._robot.goals = (Pose2D(), Pose2D(5.9, 0.0))
        robot.daemon.control.start("route", Endless(), None)
        await asyncio.sleep(0.2)
        png = base64.b64decode((await robot.call("map.plot"))["png"])
        svg = base64.b64decode((await robot.call("map.plot", format="svg"))["svg"])
        other = base64.b64decode((await robot.call("map.plot", map="attic"))["png"])
        assert (await refusal(robot.call("map.plot", format="pdf"))).code == -32602
        return png, svg, other

    png, svg, other = told(story)

    def width(picture: bytes, colour: tuple[int, int, int]) -> int:
        image = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
        columns = np.flatnonzero((image[60:, :930] == colour).all(axis=2).any(axis=0))
        return int(np.ptp(columns)) if len(columns) else 0

    scale = 900 / (5.9 + 4 * 0.3)  # px a metre: the nodes, and twice the floor beside them on either side
    assert width(png, TRAIL) > 3.5 * scale  # of the 3.9 m, less where route and robot lie over it
    # From 3.9 m to way-point 2, at 5.9 m; the robot's arrow (0.25 m) and the place's (0.3 m) lie over the ends.
    assert 1.4 * scale < width(png, ROUTE) <= 2.0 * scale + 2
    assert (width(other, TRAIL), width(other, ROUTE)) == (0, 0)
    assert svg.startswith(b"<svg")
    assert all(word in svg.decode() for word in ("last trajectory", "route", "desk", "sofa"))


def test_a_trail_breaks_where_the_robot_was_carried_and_begins_anew_in_another_map() -> None:
    async def story(robot: VirtualRobot) -> None:
        trail, here = robot.daemon.requests.trail, robot.daemon.control.goal_filter
        for x in (0.0, 0.1, 0.105, 0.2, 5.0, 5.1):
            here.map_from_base = Pose2D(x, 0.0)
            trail.note()
        assert trail.strokes() == [[(0.0, 0.0), (0.1, 0.0), (0.2, 0.0)], [(5.0, 0.0), (5.1, 0.0)]]
        await robot.call("place.add", name="here", at=[0, 0, 0])
        trail.note()
        assert len(trail.strokes()) == 2
        await robot.call("map.use", map="attic")
        trail.note()
        assert trail.strokes() == []

    told(story)


def test_a_job_waits_for_the_map_that_is_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    """As `goto` does right after a boot; and a stop ends the wait."""

    async def story(robot: VirtualRobot) -> tuple[RpcError, RpcError]:
        monkeypatch.setattr(robot.daemon.perception, "loading", "attic")
        stopped = asyncio.create_task(refusal(robot.call("goto", place="desk")))
        await asyncio.sleep(5.0)
        assert not stopped.done() and robot.daemon.control.running is None
        await robot.call("stop")
        told_off = await stopped
        waiting = asyncio.create_task(refusal(robot.call("goto", place="nowhere")))
        await asyncio.sleep(5.0)
        assert not waiting.done()
        robot.daemon.perception.loading = None
        return told_off, await waiting

    stopped, gone_on = told(story)
    assert (stopped.name, gone_on.name) == (ErrorName.CANCELLED, ErrorName.NO_SUCH_PLACE)


def test_driving_by_hand_is_refused_while_a_map_is_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    async def story(robot: VirtualRobot) -> RpcError:
        monkeypatch.setattr(robot.daemon.perception, "loading", "attic")
        return await refusal(robot.call("drive", vx=0.1, wz=0.0))

    error = told(story)
    assert (error.name, "'attic' is being loaded" in error.message) == (ErrorName.BUSY, True)


def test_a_map_put_back_by_hand_can_be_used() -> None:
    """What `map delete` and the messages about it tell people to do."""

    async def story(robot: VirtualRobot) -> int:
        result = await robot.call("map.delete", map="flat")
        shutil.move(result["kept"], robot.store.directory / "flat.omap")
        return int((await robot.call("map.use", map="flat"))["nodes"])

    assert told(story) == 60
