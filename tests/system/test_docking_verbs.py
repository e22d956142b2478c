"""Dock, undock and trials of the whole daemon with a simulated robot; the truth is the simulator's."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import pytest

from omnibotd.control_protocol import RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.mapping.topo_map import Dock, DockView
from omnibotd.core.vision.frame import Frame
from tests.made_maps import made_map
from tools.sim import ceilings, virtual_time
from tools.sim.virtual_robot import VirtualRobot, virtual_robot

WORLD = ceilings.tiles(3)
DOCK = Pose2D(*WORLD.dock)
Story = Callable[[VirtualRobot], Awaitable[Any]]


def told(story: Story, start: Pose2D = DOCK) -> Any:
    """What the story returns of a robot whose map knows nothing but how its dock looks."""

    async def main() -> Any:
        async with virtual_robot(WORLD, 3, start) as robot:
            jpeg = Frame(0.0, WORLD.render(DOCK.x, DOCK.y, DOCK.yaw, 0.0)).jpeg()
            docks = {"home": Dock(Pose2D(1.0, 0.0), (DockView(jpeg),))}
            robot.store.save(replace(made_map(), docks=docks, places={}))
            await robot.call("map.use", map="flat")
            return await story(robot)

    return virtual_time.run(main())


def off(robot: VirtualRobot) -> Pose2D:
    """Where the robot truly stands to its dock."""
    return DOCK.inverse() @ robot.pose


async def refusal(work: Awaitable[Any]) -> RpcError:
    with pytest.raises(RpcError) as refused:
        await work
    return refused.value


def test_a_robot_in_its_dock_is_docked_at_once_and_leaves_it_straight_back() -> None:
    async def story(robot: VirtualRobot) -> None:
        result = await robot.call("dock")
        assert (result["dock"], result["retries"]) == ("home", 0)
        assert result["seconds"] < 4.0
        assert math.hypot(result["offset"]["x"], result["offset"]["y"]) < 0.01
        assert off(robot).distance(Pose2D()) < 1e-3

        out = await robot.call("undock")
        assert out["dock"] == "home"
        assert out["distance_m"] == pytest.approx(0.5, abs=0.03)
        assert off(robot).x == pytest.approx(-0.5, abs=0.05)
        assert abs(off(robot).y) < 0.03
        assert abs(off(robot).yaw) < math.radians(4.0)

        error = await refusal(robot.call("undock"))
        assert (error.name, error.code) == (ErrorName.NOT_DOCKED, 4)
        assert "0.5" in error.message

    told(story)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_trials_measure_the_installation() -> None:
    heard: list[dict[str, Any]] = []

    async def story(robot: VirtualRobot) -> dict[str, Any]:
        result = await robot.daemon.call("dock", {"trials": 3}, heard.append)
        assert off(robot).distance(Pose2D()) < 0.01
        assert abs(wrap(off(robot).yaw)) < math.radians(0.5)
        return result

    result = told(story)
    assert [trial["result"] for trial in result["trials"]] == ["DOCKED"] * 3
    assert result["docked"] == 3
    assert result["mean"]["distance"] < 0.006
    assert result["sd"]["x"] < 0.006
    assert result["mean"]["seconds"] < 40.0
    assert {(values["trial"], values["docked"]) for values in heard} >= {(1, 0), (2, 1), (3, 2)}


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_stop_ends_the_trials_where_they_are() -> None:
    async def story(robot: VirtualRobot) -> None:
        trials = asyncio.create_task(robot.call("dock", trials=5))
        while off(robot).x > -0.3:  # noqa: ASYNC110 - nothing tells
            await asyncio.sleep(0.1)
        await robot.call("stop")
        assert (await refusal(trials)).name is ErrorName.CANCELLED
        stood = robot.pose
        await asyncio.sleep(2.0)
        assert stood.distance(robot.pose) < 0.02

    told(story)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_dead_contact_is_tried_again_from_the_staging_pose_and_then_told() -> None:
    async def story(robot: VirtualRobot) -> RpcError:
        robot.plant.at_dock = lambda: False  # type: ignore[method-assign]
        trip = asyncio.create_task(robot.call("dock"))
        before, starts = "", []
        while not trip.done():
            state = robot.daemon.control.state
            if (before, state) == ("RETRY", "INITIAL_PERCEPTION"):
                starts.append(off(robot))
            before = state
            await asyncio.sleep(0.05)
        assert len(starts) == 3
        for pose in starts:
            assert pose.distance(Pose2D(-0.5)) < 0.12
            assert abs(pose.yaw) < math.radians(12.0)
        return await refusal(trip)

    error = told(story)
    assert error.name is ErrorName.FAILED_TO_CHARGE
    assert abs(error.report["dock_x"]) < 0.006
