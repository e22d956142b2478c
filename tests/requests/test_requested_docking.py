"""Docking as the whole daemon answers for it, with jobs that do as they are told."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from omnibotd.control_protocol import RpcError
from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import Dock, DockView, TopoMap
from omnibotd.core.percept import HomingEstimate, PlaceEstimate, Verdict
from omnibotd.core.vision.frame import Frame
from omnibotd.presets import DockingTask, preset_of
from omnibotd.requests import docking, running
from tests.empty_hall import EmptyHall
from tests.made_maps import made_map
from tools.sim import virtual_time
from tools.sim.virtual_robot import VirtualRobot, virtual_robot

Story = Callable[[VirtualRobot], Awaitable[Any]]


class Scripted:
    """Ends as scripted at its third step; remembers what it was made for."""

    tasks: list[DockingTask]
    goals: list[Pose2D]
    endings: list[Outcome]

    def __init__(self, topo_map: TopoMap | None = None, goal: Pose2D | None = None, *rest: object) -> None:
        self._steps = 0
        if goal is not None:
            self.goals.append(goal)

    @classmethod
    def docking(cls, trip: Callable[[Pose2D], Any], task: DockingTask) -> Scripted:
        cls.tasks.append(task)
        return cls()

    def step(self, seen: Observation) -> Decision:
        self._steps += 1
        outcome = None if self._steps < 3 else self.endings.pop(0) if self.endings else Outcome(None, "done")
        return Decision("SCRIPTED", outcome=outcome, recoveries=2)


class Blind:
    """A localizer that never knows where it is: the real one takes most of a test's time."""

    def __init__(self, *arguments: object) -> None: ...

    def update(self, frame: Frame, odom_from_base: Pose2D) -> PlaceEstimate:
        return PlaceEstimate(frame.stamp, odom_from_base, Pose2D(), 0.0, 1.0, 0.0, 0.0, 0)


@pytest.fixture(autouse=True)
def scripted(monkeypatch: pytest.MonkeyPatch) -> type[Scripted]:
    Scripted.tasks, Scripted.goals, Scripted.endings = [], [], []
    parts = {"navigator": Scripted, "docking": Scripted.docking}
    for module in (docking, running):
        monkeypatch.setattr(module, "preset_of", lambda topo_map: replace(preset_of(topo_map), **parts))
    blind = lambda topo_map: replace(preset_of(topo_map), localizer=Blind, homing=Eye)  # noqa: E731
    monkeypatch.setattr("omnibotd.perception.preset_of", blind)
    return Scripted


class AtDock(EmptyHall):
    """Its dock is where the robot starts, so that it charges."""

    dock = (0.0, 0.0, 0.0)


def told(story: Story, world: EmptyHall | None = None, docks: dict[str, Dock] | None = None) -> Any:
    """What the story returns of a robot with map `flat` in use, which has the dock `home` unless told otherwise."""

    async def main() -> Any:
        async with virtual_robot(world or EmptyHall(), 1, Pose2D()) as robot:
            topo_map = made_map()
            robot.store.save(topo_map if docks is None else replace(topo_map, docks=docks))
            await robot.call("map.use", map="flat")
            return await story(robot)

    return virtual_time.run(main())


def believe(robot: VirtualRobot, pose: Pose2D, confidence: float = 0.95) -> None:
    """The map is sure that the robot stands there."""
    control = robot.daemon.control
    control.goal_filter.map_from_base = pose
    control.place = PlaceEstimate(0.0, Pose2D(), pose, confidence, 0.02, 0.8, 0.2, 1)
    control.note_place = lambda place: None  # type: ignore[method-assign]


async def refusal(work: Awaitable[Any]) -> RpcError:
    with pytest.raises(RpcError) as refused:
        await work
    return refused.value


AT = {"dock_x": 0.003, "dock_y": -0.001, "dock_yaw": 0.002}


def test_dock_tells_where_it_stands_and_how_it_went(scripted: type[Scripted]) -> None:
    scripted.endings = [Outcome(None, "docked", {**AT, "score": 0.9})]

    async def story(robot: VirtualRobot) -> Any:
        return await robot.call("dock", name="home")

    result = told(story)
    assert (result["dock"], result["retries"]) == ("home", 2)
    assert result["offset"] == {"x": 0.003, "y": -0.001, "yaw": 0.002}
    assert result["report"]["score"] == 0.9
    (task,) = scripted.tasks
    assert (task.dock, task.map_from_dock) == ("home", Pose2D(1.0, 0.0))
    assert task.parameters.max_retries == 3


@pytest.mark.parametrize(
    ("params", "docks", "name", "told_of"),
    [
        ({"name": "moon"}, None, ErrorName.DOCK_NOT_IN_DB, "docks of this map: home"),
        ({}, {}, ErrorName.DOCK_NOT_IN_DB, "dock save NAME"),
        ({}, {"a": None, "b": None}, ErrorName.DOCK_NOT_IN_DB, "say which dock; docks of this map: a, b"),
        ({"name": "../x"}, None, ErrorName.INVALID, "name"),
        ({"trials": 0}, None, ErrorName.INVALID, "trials"),
        ({"trials": 1.5}, None, ErrorName.INVALID, "trials"),
        ({"trials": 2000}, None, ErrorName.INVALID, "1000"),
        ({"speed": 1}, None, ErrorName.INVALID, "speed"),
    ],
)
def test_a_dock_that_makes_no_sense_starts_nothing(
    params: dict[str, Any], docks: dict[str, Dock] | None, name: ErrorName, told_of: str
) -> None:
    made = None if docks is None else {key: Dock(Pose2D(), (DockView(b"x"),)) for key in docks}

    async def story(robot: VirtualRobot) -> RpcError:
        error = await refusal(robot.call("dock", **params))
        assert (await robot.call("status"))["job"] is None
        return error

    error = told(story, docks=made)
    assert error.name is name
    assert told_of in error.message


@pytest.mark.parametrize(
    ("place", "charges", "looks"),
    [
        (Pose2D(1.1, 0.1), False, True),  # the map puts it into the dock
        (Pose2D(3.0, 0.0), False, False),
        (Pose2D(3.0, 0.0), True, True),
        (None, False, True),  # it may be anywhere
    ],
)
def test_only_a_robot_that_may_stand_in_the_dock_looks_before_it_goes(
    scripted: type[Scripted], place: Pose2D | None, charges: bool, looks: bool
) -> None:
    async def story(robot: VirtualRobot) -> None:
        if place is not None:
            believe(robot, place)
        await robot.call("dock")

    told(story, AtDock() if charges else EmptyHall())
    assert (scripted.tasks[0].glance is not None) is looks


def test_trials_are_listed_and_summed_up(scripted: type[Scripted]) -> None:
    heard: list[dict[str, Any]] = []
    in_dock = Outcome(None, "in dock", dict.fromkeys(AT, 0.0))
    scripted.endings = [in_dock, Outcome(None, "docked", AT), Outcome(ErrorName.FAILED_TO_CHARGE, "no contact")]

    async def story(robot: VirtualRobot) -> Any:
        return await robot.daemon.call("dock", {"trials": 2}, heard.append)

    result = told(story)
    assert [trial["result"] for trial in result["trials"]] == ["DOCKED", "FAILED_TO_CHARGE"]
    assert [trial["offset"] for trial in result["trials"]] == [{"x": 0.003, "y": -0.001, "yaw": 0.002}, None]
    assert (result["docked"], result["mean"]["x"], result["sd"]["x"]) == (1, 0.003, 0.0)
    assert result["mean"]["distance"] == pytest.approx(0.00316, abs=1e-5)
    assert {values["trial"] for values in heard} == {1, 2}
    assert heard[-1]["trials"] == 2
    assert scripted.tasks[0].goal_filter is not None
    assert [task.goal_filter for task in scripted.tasks[1:]] == [None, None]


def test_undock_needs_no_map_where_it_charges() -> None:
    async def main() -> Any:
        async with virtual_robot(AtDock(), 1, Pose2D()) as robot:
            result = await robot.call("undock")
            return result, robot.pose

    result, pose = virtual_time.run(main())
    assert result["dock"] is None
    assert result["distance_m"] == pytest.approx(0.5, abs=0.03)
    assert pose.x == pytest.approx(-0.5, abs=0.04)


@pytest.mark.parametrize("where", [Pose2D(3.0, 0.0), None])
def test_undock_far_from_any_dock_is_refused(where: Pose2D | None) -> None:
    async def story(robot: VirtualRobot) -> RpcError:
        if where is not None:
            believe(robot, where)
        before = robot.pose
        error = await refusal(robot.call("undock"))
        assert robot.pose.distance(before) < 1e-6
        return error

    docks = {name: Dock(Pose2D(x, 0.0), (DockView(b"x"),)) for name, x in (("a", 0.0), ("b", 9.0))}
    error = told(story, docks=docks)
    assert (error.name, error.code) == (ErrorName.NOT_DOCKED, 4)
    assert error.message.startswith("not docked")


def test_undock_while_busy_is_refused(scripted: type[Scripted]) -> None:
    async def story(robot: VirtualRobot) -> RpcError:
        robot.daemon.control.start("goto", Scripted(), None)
        return await refusal(robot.call("undock"))

    assert told(story, AtDock()).name is ErrorName.BUSY


def test_goto_a_dock_goes_to_where_docking_starts(scripted: type[Scripted]) -> None:
    async def story(robot: VirtualRobot) -> Any:
        await robot.call("goto", place="home")
        await robot.call("route", places=["desk", "home"])
        return await refusal(robot.call("goto", place="moon"))

    error = told(story)
    assert scripted.goals == [Pose2D(0.5, 0.0), Pose2D(), Pose2D(0.5, 0.0)]
    assert "desk, home, sofa" in error.message


def test_docks_are_renamed_and_deleted_as_places_are() -> None:
    async def story(robot: VirtualRobot) -> Any:
        renamed = await robot.call("place.rename", name="home", to="garage")
        assert renamed == {"name": "garage", "pose": {"x": 1.0, "y": 0.0, "yaw": 0.0}}
        assert (await robot.call("place.list"))["docks"].keys() == {"garage"}
        await robot.call("place.delete", name="garage")
        assert (await robot.call("place.list"))["docks"] == {}
        return await refusal(robot.call("place.delete", name="garage"))

    assert told(story).name is ErrorName.NO_SUCH_PLACE


# ---- dock save


class Eye:
    """Registers every frame with every view as scripted."""

    answers: list[tuple[Verdict, float, Pose2D]]

    def __init__(self, *arguments: object) -> None:
        self._answer = self.answers.pop(0)

    def fix(self, frame: object, odom_from_base: Pose2D) -> HomingEstimate:
        verdict, score, pose = self._answer
        return HomingEstimate(0.0, odom_from_base, pose, score, 0.2, verdict)


@pytest.fixture
def eye() -> type[Eye]:
    Eye.answers = []
    return Eye


def save(
    eye: type[Eye],
    answers: list[tuple[Verdict, float, Pose2D]],
    *,
    at: Pose2D | None = Pose2D(1.02, 0.0),  # noqa: B008 - a value
    world: EmptyHall | None = None,
    views: int = 1,
    **params: Any,
) -> tuple[dict[str, Any], Dock]:
    """The reply to `dock save home` and the dock it left, where the robot believes to stand `at`."""
    jpeg = cv2.imencode(".jpg", np.zeros((8, 8), np.uint8))[1].tobytes()
    docks = {"home": Dock(Pose2D(1.0, 0.0), tuple(DockView(jpeg + bytes([k])) for k in range(views)))}

    async def story(robot: VirtualRobot) -> tuple[dict[str, Any], Dock]:
        if at is not None:
            believe(robot, at)
        eye.answers = list(answers)
        result = await robot.call("dock.save", name="home", **params)
        return result, robot.store.load("flat").docks["home"]

    reply: tuple[dict[str, Any], Dock] = told(story, world, docks)
    return reply


def test_the_dock_in_another_light_gets_another_view(eye: type[Eye]) -> None:
    result, dock = save(eye, [(Verdict.ACCEPTED, 0.6, Pose2D(0.004, 0.001, 0.01))])
    assert (result["added"], result["views"]) == (True, 2)
    assert result["offset"] == {"x": 0.004, "y": 0.001, "yaw": 0.01}
    assert dock.map_from_dock == Pose2D(1.0, 0.0)
    assert [view.dock_from_base for view in dock.views] == [Pose2D(), Pose2D(0.004, 0.001, 0.01)]


def test_in_the_same_light_the_view_is_replaced(eye: type[Eye]) -> None:
    result, dock = save(eye, [(Verdict.ACCEPTED, 0.97, Pose2D(0.004, 0.0, 0.0))])
    assert (result["added"], result["views"], len(dock.views)) == (True, 1, 1)
    assert dock.views[0].dock_from_base == Pose2D(0.004, 0.0, 0.0)


def test_there_are_never_more_than_four_views(eye: type[Eye]) -> None:
    answers = [(Verdict.AMBIGUOUS, score, Pose2D()) for score in (0.3, 0.5, 0.4)]
    result, dock = save(eye, [*answers, (Verdict.ACCEPTED, 0.45, Pose2D(0.001, 0.0, 0.0))], views=4)
    assert (result["views"], len(dock.views)) == (4, 4)
    assert dock.views[0].jpeg.endswith(b"\x00")  # the second, most like the new one, went


@pytest.mark.parametrize("pose", [Pose2D(0.2, 0.0, 0.0), Pose2D(0.0, 0.0, 0.2)])
def test_a_dock_that_was_moved_is_another_dock(eye: type[Eye], pose: Pose2D) -> None:
    result, dock = save(eye, [(Verdict.ACCEPTED, 0.8, pose)], at=Pose2D(1.2, 0.0, 0.1))
    assert (result["added"], result["views"]) == (False, 1)
    moved = dock.map_from_dock
    assert (moved.x, moved.y, moved.yaw) == pytest.approx((1.2, 0.0, 0.1))


def test_fresh_forgets_the_views_before(eye: type[Eye]) -> None:
    result, dock = save(eye, [], views=3, fresh=True)
    assert (result["added"], result["views"], len(dock.views)) == (False, 1, 1)


UNSEEN = (Verdict.REJECTED, 0.1, Pose2D(0.7, 0.0, 0.0))


def test_in_a_light_that_shows_nothing_alike_the_contact_tells(eye: type[Eye]) -> None:
    result, dock = save(eye, [UNSEEN], world=AtDock(), at=None)
    assert (result["added"], result["views"]) == (True, 2)
    assert dock.views[1].dock_from_base == Pose2D()
    assert "contact" in result["warnings"][0]


def test_charging_somewhere_else_is_another_dock(eye: type[Eye]) -> None:
    result, dock = save(eye, [UNSEEN], world=AtDock(), at=Pose2D(4.0, 0.0))
    assert (result["added"], dock.map_from_dock) == (False, Pose2D(4.0, 0.0))


def test_having_docked_there_and_not_moved_tells_as_well(eye: type[Eye], scripted: type[Scripted]) -> None:
    scripted.endings = [Outcome(None, "docked", AT)]

    async def story(robot: VirtualRobot) -> tuple[dict[str, Any], dict[str, Any]]:
        await robot.call("dock")
        eye.answers = [UNSEEN]
        added = await robot.call("dock.save", name="home")
        believe(robot, Pose2D(1.0, 0.0))
        await robot.call("drive", vx=0.2, wz=0.0, **{"for": 1.0})
        eye.answers = [UNSEEN, UNSEEN]
        return added, await robot.call("dock.save", name="home")

    added, moved = told(story)
    assert (added["added"], added["offset"]["x"]) == (True, 0.003)
    assert moved["added"] is False


def test_a_robot_that_is_not_sure_saves_no_new_dock(eye: type[Eye]) -> None:
    async def story(robot: VirtualRobot) -> RpcError:
        eye.answers = [UNSEEN]
        error = await refusal(robot.call("dock.save", name="home"))
        assert len(robot.store.load("flat").docks["home"].views) == 1
        return error

    assert told(story).name is ErrorName.LOST
