"""Routes, relocalisation and failures as the whole daemon answers them, with navigators that do as they are told."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import pytest

from omnibotd.control_protocol import RpcError
from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D, Twist2D
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.presets import preset_of
from omnibotd.requests import jobs, running
from tests.empty_hall import EmptyHall
from tests.made_maps import made_map
from tools.sim import virtual_time
from tools.sim.virtual_robot import VirtualRobot, virtual_robot

TICKS = 5  # each made navigator takes this many to its end
REPORT = {"confidence": 0.12, "expected_confidence": 0.6}
Story = Callable[[VirtualRobot], Awaitable[Any]]


class Walker:
    """Walks for a few ticks and ends as scripted."""

    endings: list[Outcome]

    def __init__(self, topo_map: TopoMap, goal: Pose2D, *rest: object) -> None:
        self._ticks = 0

    def step(self, seen: Observation) -> Decision:
        self._ticks += 1
        ended = self._ticks == TICKS
        outcome = (self.endings.pop(0) if self.endings else Outcome(None, "arrived")) if ended else None
        return Decision("FOLLOWING", Twist2D(), outcome, distance_remaining=0.1 * (TICKS - self._ticks))


@pytest.fixture(autouse=True)
def walkers(monkeypatch: pytest.MonkeyPatch) -> type[Walker]:
    Walker.endings = []
    monkeypatch.setattr(running, "preset_of", lambda topo_map: replace(preset_of(topo_map), navigator=Walker))
    return Walker


def told(story: Story) -> Any:
    """What the story returns of a robot with map `flat` in use: places desk and sofa, dock home."""

    async def main() -> Any:
        async with virtual_robot(EmptyHall(), 1) as robot:
            robot.store.save(made_map())
            await robot.call("map.use", map="flat")
            return await story(robot)

    return virtual_time.run(main())


async def refusal(work: Awaitable[Any]) -> RpcError:
    with pytest.raises(RpcError) as refused:
        await work
    return refused.value


def test_a_route_visits_its_places_in_order_loop_after_loop() -> None:
    heard: list[dict[str, Any]] = []

    async def story(robot: VirtualRobot) -> Any:
        return await robot.daemon.call("route", {"places": ["sofa", "desk"], "loops": 2}, heard.append)

    result = told(story)
    arrivals = [(entry["loop"], entry["place"]) for entry in result["arrivals"]]
    assert arrivals == [(1, "sofa"), (1, "desk"), (2, "sofa"), (2, "desk")]
    seconds = [entry["seconds"] for entry in result["arrivals"]]
    assert seconds == pytest.approx([0.1 * TICKS * number for number in (1, 2, 3, 4)], abs=0.25)
    assert (result["arrived"], result["loops"], result["places"]) == (4, 2, ["sofa", "desk"])
    tour = list(dict.fromkeys((values["loop"], values["waypoint"]) for values in heard))
    assert tour == [(1, 1), (1, 2), (2, 1), (2, 2)]
    names = {"state", "distance_remaining", "navigation_time", "number_of_recoveries", "confidence"}
    assert all(values.keys() >= names for values in heard)
    assert {(values["waypoints"], values["loops"]) for values in heard} == {(2, 2)}


def test_a_route_of_one_place_is_a_route() -> None:
    async def story(robot: VirtualRobot) -> Any:
        return await robot.call("route", places=["desk"])

    assert [entry["place"] for entry in told(story)["arrivals"]] == ["desk"]


@pytest.mark.parametrize(
    ("params", "code"),
    [
        ({"places": ["desk", "moon"]}, 1),
        ({"places": []}, -32602),
        ({"places": "desk"}, -32602),
        ({"places": ["desk"] * 101}, -32602),
        ({"places": ["../x"]}, -32602),
        ({"places": ["desk"], "loops": 0}, -32602),
        ({"places": ["desk"], "loops": 1.5}, -32602),
        ({"places": ["desk"], "speed": 1}, -32602),
    ],
)
def test_a_route_that_makes_no_sense_starts_nothing(params: dict[str, Any], code: int) -> None:
    async def story(robot: VirtualRobot) -> RpcError:
        error = await refusal(robot.call("route", **params))
        assert (await robot.call("status"))["job"] is None
        return error

    error = told(story)
    assert error.code == code
    assert error.name is (ErrorName.NO_SUCH_PLACE if code == 1 else ErrorName.INVALID)


def test_a_failure_is_explained_kept_and_named_by_status(walkers: type[Walker]) -> None:
    walkers.endings = [Outcome(None, "arrived"), Outcome(ErrorName.LOST, "no view fits", REPORT)]

    async def story(robot: VirtualRobot) -> None:
        assert (await robot.call("status"))["last_failure"] is None
        error = await refusal(robot.call("route", places=["desk", "sofa"]))
        assert (error.name, error.code) == (ErrorName.LOST, 1)
        assert error.report.items() >= REPORT.items()
        last = (await robot.call("status"))["last_failure"]
        assert (last["job"], last["error"]) == ("route", "LOST")
        path = robot.store.directory / "failures" / "0001.json"
        assert last["file"] == str(path)
        kept = json.loads(path.read_text("utf-8"))
        assert kept["report"] == error.report
        assert (kept["map"], len(kept["goals"])) == ("flat", 2)
        frame = robot.camera.latest
        assert frame is not None
        assert path.with_suffix(".jpg").read_bytes() == frame.jpeg()

    told(story)


@pytest.mark.parametrize("name", [ErrorName.CANCELLED, ErrorName.BASE_LINK_DOWN, ErrorName.EMERGENCY_STOP])
def test_what_the_view_is_not_to_blame_for_is_not_kept(walkers: type[Walker], name: ErrorName) -> None:
    walkers.endings = [Outcome(name, "ended")]

    async def story(robot: VirtualRobot) -> None:
        assert (await refusal(robot.call("goto", place="desk"))).name is name
        assert not (robot.store.directory / "failures").exists()

    told(story)


def test_a_disk_that_is_full_hides_no_failure(walkers: type[Walker]) -> None:
    walkers.endings = [Outcome(ErrorName.BLOCKED, "a chair")]

    async def story(robot: VirtualRobot) -> None:
        (robot.store.directory / "failures").write_text("in the way")
        assert (await refusal(robot.call("goto", place="desk"))).name is ErrorName.BLOCKED
        last = (await robot.call("status"))["last_failure"]
        assert (last["error"], last["file"]) == ("BLOCKED", None)

    told(story)


def test_a_stop_holds_for_what_was_asked_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The trip is still being planned when the stop comes: it must not set out afterwards."""

    async def story(robot: VirtualRobot) -> RpcError:
        real = robot.daemon.requests._methods["goto"].__self__._robot

        async def slow(function: Callable[..., Any], *arguments: Any) -> Any:
            await asyncio.sleep(0.5)
            return function(*arguments)

        monkeypatch.setattr(real, "off_loop", slow)
        trip = asyncio.create_task(robot.call("goto", place="desk"))
        await asyncio.sleep(0.2)
        await robot.call("stop")
        error = await refusal(trip)
        assert (await robot.call("status"))["job"] is None
        return error

    assert told(story).name is ErrorName.CANCELLED


def test_a_trip_planned_in_one_map_does_not_start_in_another(monkeypatch: pytest.MonkeyPatch) -> None:
    async def story(robot: VirtualRobot) -> RpcError:
        real = robot.daemon.requests._methods["goto"].__self__._robot

        async def slow(function: Callable[..., Any], *arguments: Any) -> Any:
            await robot.daemon.perception.use(made_map("attic"))
            return function(*arguments)

        monkeypatch.setattr(real, "off_loop", slow)
        return await refusal(robot.call("goto", place="desk"))

    assert told(story).name is ErrorName.BUSY


class Finder:
    """A search that is over at once."""

    def __init__(self, topo_map: TopoMap, goal_filter: Any, *rest: object) -> None:
        self._filter = goal_filter

    def step(self, seen: Observation) -> Decision:
        self._filter.map_from_base, self._filter.confidence = Pose2D(1.0, 2.0, 0.5), 0.93
        return Decision("LOCALISING", outcome=Outcome(None, "found"))


def test_relocalise_forgets_asks_the_maps_and_tells_where_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "Relocalisation", Finder)
    heard: list[str] = []

    async def story(robot: VirtualRobot) -> dict[str, Any]:
        robot.daemon.control.goal_filter.map_from_base = Pose2D(9.0, 9.0, 0.0)
        asked: list[Pose2D | None] = []

        async def wake_up() -> None:
            asked.append(robot.daemon.control.map_from_base)

        monkeypatch.setattr(robot.daemon.recogniser, "wake_up", wake_up)
        result = await robot.daemon.call("relocalise", {}, lambda values: heard.append(values["state"]))
        assert asked == [None]
        return result

    result = told(story)
    assert (result["map"], result["pose"]) == ("flat", {"x": 1.0, "y": 2.0, "yaw": 0.5})
    assert result["confidence"] == 0.93
    assert heard == ["RECOGNISING", "LOCALISING"]


def test_relocalise_without_any_map_says_how_to_get_one() -> None:
    async def main() -> RpcError:
        async with virtual_robot(EmptyHall(), 1) as robot:
            return await refusal(robot.call("relocalise"))

    error = virtual_time.run(main())
    assert error.name is ErrorName.NO_MAP
    assert "record and train" in error.message


def test_a_stop_while_the_maps_are_tried_ends_the_search_before_it_moves() -> None:
    async def story(robot: VirtualRobot) -> RpcError:
        robot.store.save(made_map("attic", seed=2))
        search = asyncio.create_task(robot.call("relocalise"))
        await asyncio.sleep(1.0)
        await robot.call("stop")
        return await refusal(search)

    assert told(story).name is ErrorName.CANCELLED
