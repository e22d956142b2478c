"""A robot that rests in its dock keeps how the ceiling looks there in other lights; all is registered for real."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from functools import partial

import pytest

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import Dock
from omnibotd.core.percept import PlaceEstimate
from omnibotd.core.vision.frame import Frame
from omnibotd.presets import preset_of
from omnibotd.requests import dock_watch
from tests.made_maps import made_map
from tools.sim import ceilings, virtual_time
from tools.sim.conditions import Stage
from tools.sim.virtual_robot import VirtualRobot, virtual_robot

Story = Callable[[VirtualRobot, Stage], Awaitable[None]]

SEED = 3
PERIOD = 10.0  # s between looks, here: six times as often as on a robot


class Blind:
    """A localizer that is sure to stand in the dock: the real one takes most of a test's time."""

    dirty = None

    def __init__(self, *arguments: object) -> None: ...

    def update(self, frame: Frame, odom_from_base: Pose2D) -> PlaceEstimate:
        return PlaceEstimate(frame.stamp, odom_from_base, Pose2D(), 0.97, 0.02, 0.9, 0.3, 1)

    def reset(self) -> None: ...


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dock_watch, "PERIOD", PERIOD)
    monkeypatch.setattr("omnibotd.perception.preset_of", lambda topo_map: replace(preset_of(topo_map), localizer=Blind))


def dock_after(story: Story) -> Dock:
    """The dock on disk after the story of a robot that has just saved the dock it stands in."""

    async def main() -> Dock:
        stage = Stage(ceilings.tiles(SEED), partial(ceilings.tiles, SEED), SEED)
        async with virtual_robot(stage, SEED, Pose2D(*stage.dock)) as robot:
            robot.store.save(replace(made_map(), docks={}))
            await robot.call("map.use", map="flat")
            await asyncio.sleep(1.0)
            await robot.call("dock.save", name="home")
            await story(robot, stage)
            return robot.store.load("flat").docks["home"]

    dock: Dock = virtual_time.run(main())
    return dock


async def looks(count: float) -> None:
    await asyncio.sleep(count * PERIOD)


async def night_falls(stage: Stage) -> None:
    stage.enter(["night"])
    await looks(3.5)


def test_a_light_that_no_view_shows_gets_a_view_and_only_one() -> None:
    async def story(robot: VirtualRobot, stage: Stage) -> None:
        await looks(1.5)
        await night_falls(stage)
        in_use = robot.daemon.perception.topo_map
        assert in_use is not None and in_use.docks == robot.store.load("flat").docks
        await looks(5.0)
        stage.enter([])
        await looks(3.0)

    by_hand, by_night = dock_after(story).views
    assert by_hand.dock_from_base == Pose2D()
    assert by_night.dock_from_base.distance(Pose2D()) < 0.002
    assert abs(by_night.dock_from_base.yaw) < 0.003


def test_of_a_light_that_does_not_stay_nothing_is_kept() -> None:
    async def story(robot: VirtualRobot, stage: Stage) -> None:
        await looks(1.5)
        for light in ([], ["night"], [], ["night"], []):
            stage.enter(light)
            await looks(1.0)

    assert len(dock_after(story).views) == 1


def test_who_came_by_night_knows_only_roughly_where_it_stands_and_keeps_nothing() -> None:
    async def story(robot: VirtualRobot, stage: Stage) -> None:
        await night_falls(stage)

    assert len(dock_after(story).views) == 1


def test_a_robot_that_was_driven_since_is_somewhere_else() -> None:
    async def story(robot: VirtualRobot, stage: Stage) -> None:
        await looks(1.5)
        await robot.call("drive", vx=-0.02, wz=0.0, **{"for": 0.5})
        await night_falls(stage)

    assert len(dock_after(story).views) == 1


def test_a_robot_that_was_carried_off_in_the_dark_keeps_nothing() -> None:
    async def story(robot: VirtualRobot, stage: Stage) -> None:
        await looks(1.5)
        stage.enter(["night"])
        robot.teleport(Pose2D(*stage.dock) @ Pose2D(-0.5, 0.2, 0.8))
        await looks(4.0)

    assert len(dock_after(story).views) == 1


def test_one_that_was_pushed_askew_says_so_in_the_view_it_keeps() -> None:
    async def story(robot: VirtualRobot, stage: Stage) -> None:
        robot.teleport(Pose2D(*stage.dock) @ Pose2D(-0.004, 0.006, 0.02))
        await looks(1.5)
        await night_falls(stage)

    pose = dock_after(story).views[1].dock_from_base
    assert (pose.x, pose.y, pose.yaw) == pytest.approx((-0.004, 0.006, 0.02), abs=0.004)


def test_a_dock_saved_afresh_is_where_the_robot_stands_then() -> None:
    async def story(robot: VirtualRobot, stage: Stage) -> None:
        robot.teleport(Pose2D(*stage.dock) @ Pose2D(0.0, 0.0, 0.03))
        await looks(1.5)
        topo_map = robot.store.load("flat")
        moved = Dock(Pose2D(0.0, 0.0, 0.03), topo_map.docks["home"].views)
        await robot.daemon.requests.dock_watch._robot.edit(lambda newest: newest.with_dock("home", moved))
        await night_falls(stage)

    assert len(dock_after(story).views) == 1


def test_it_never_replaces_a_view_and_stops_at_four() -> None:
    async def story(robot: VirtualRobot, stage: Stage) -> None:
        topo_map = robot.store.load("flat")
        view = topo_map.docks["home"].views[0]
        await robot.daemon.requests.dock_watch._robot.edit(
            lambda newest: newest.with_dock("home", Dock(Pose2D(), (view,) * 4))
        )
        await looks(1.5)
        await night_falls(stage)

    views = dock_after(story).views
    assert len({view.jpeg for view in views}) == 1
    assert len(views) == 4
