"""What the whole daemon does when parts of it fail in the middle of a trip: the wheels stop, and the job says why."""

import asyncio
import shutil
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from omnibotd.control_protocol import RpcError
from omnibotd.core.decision import Decision, Observation
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D, Twist2D
from tools.sim import ceilings, virtual_time
from tools.sim.teacher import Area, Teacher, teach
from tools.sim.virtual_robot import VirtualRobot, virtual_robot

SEED = 5
FAR = [1.3, 1.3, 0.0]
STOPPING = 0.12  # m: 0.3 m/s for the base's 250 ms watchdog and its motors' 80 ms, and a little

pytestmark = pytest.mark.timeout(120)


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map of 3 m x 3 m, taught once for all of these tests."""
    kept = tmp_path_factory.mktemp("maps") / "home.omap"

    async def main() -> None:
        world = ceilings.tiles(SEED)
        async with virtual_robot(world, SEED) as robot:
            await teach(robot, Teacher(robot, Area.to_teach(world, side=3.0), SEED), "home", 100.0)
            shutil.copy(robot.store.directory / "home.omap", kept)

    virtual_time.run(main())
    return kept


def on_a_trip(home: Path, trouble: Callable[[VirtualRobot], Awaitable[None]]) -> RpcError:
    """Sets out, has the trouble once it drives, and checks that the robot stands; returns how the trip ended."""

    async def main() -> RpcError:
        async with virtual_robot(ceilings.tiles(SEED), SEED) as robot:
            shutil.copy(home, robot.store.directory / "home.omap")
            await robot.call("map.use", map="home")
            trip = asyncio.create_task(robot.call("goto", at=FAR))
            for _ in range(200):
                if (await robot.call("status"))["twist"]["vx"] >= 0.2:
                    break
                await asyncio.sleep(0.1)
            else:
                raise AssertionError("it never set out")
            await trouble(robot)
            with pytest.raises(RpcError) as ended:
                await asyncio.wait_for(trip, 5.0)
            await asyncio.sleep(0.5)
            stood = robot.pose
            await asyncio.sleep(2.0)
            assert stood.distance(robot.pose) < 1e-3
            return ended.value

    return virtual_time.run(main())


def test_a_silent_base_ends_the_trip(home: Path) -> None:
    async def cut(robot: VirtualRobot) -> None:
        robot.link.cut = True
        at = robot.pose
        await asyncio.sleep(1.0)
        assert at.distance(robot.pose) < STOPPING
        assert "silent" in (await robot.call("status"))["base"]["reason"]

    error = on_a_trip(home, cut)
    assert (error.name, error.code) == (ErrorName.BASE_LINK_DOWN, 1)


def test_a_base_that_restarts_ends_the_trip_and_is_not_driven_on(home: Path) -> None:
    async def restart(robot: VirtualRobot) -> None:
        robot.device.reset(99)

    assert on_a_trip(home, restart).name == ErrorName.BASE_LINK_DOWN


def test_a_camera_that_stalls_ends_the_trip_within_a_second(home: Path) -> None:
    async def freeze(robot: VirtualRobot) -> None:
        robot.camera.ok = lambda now: False  # type: ignore[method-assign]
        at = robot.pose
        await asyncio.sleep(1.0)
        assert at.distance(robot.pose) < STOPPING

    assert on_a_trip(home, freeze).name == ErrorName.CAMERA_DOWN


def test_the_emergency_stop_ends_the_trip_and_refuses_the_next(home: Path) -> None:
    async def press(robot: VirtualRobot) -> None:
        robot.daemon.control._base.emergency_stop()
        at = robot.pose
        await asyncio.sleep(1.0)
        assert at.distance(robot.pose) < STOPPING
        with pytest.raises(RpcError) as refused:
            await robot.call("drive", vx=0.1, wz=0.0)
        assert (refused.value.name, refused.value.code) == (ErrorName.EMERGENCY_STOP, 4)

    assert on_a_trip(home, press).name == ErrorName.EMERGENCY_STOP


def test_stop_cancels_and_a_second_job_is_refused_meanwhile(home: Path) -> None:
    async def stop(robot: VirtualRobot) -> None:
        for method, params in (("goto", {"at": FAR}), ("drive", {"vx": 0.1, "wz": 0.0}), ("dock.save", {"name": "x"})):
            with pytest.raises(RpcError) as refused:
                await robot.call(method, **params)
            assert (refused.value.name, refused.value.code) == (ErrorName.BUSY, 4)
        await robot.call("stop")
        for _ in range(20):
            await asyncio.sleep(0.05)
            assert robot.device.target == (0, 0)

    error = on_a_trip(home, stop)
    assert (error.name, error.code) == (ErrorName.CANCELLED, 130)


def test_our_own_bug_in_a_tick_stops_the_wheels_and_leaves_the_daemon_answering(home: Path) -> None:
    class Broken:
        def step(self, seen: Observation) -> Decision:
            raise ZeroDivisionError("a bug")

    async def bug(robot: VirtualRobot) -> None:
        assert robot.daemon.control.running is not None
        robot.daemon.control.running.job = Broken()
        await asyncio.sleep(0.5)
        assert (await robot.call("status"))["state"] == "IDLE"

    assert on_a_trip(home, bug).message.startswith("internal error")


def test_a_place_is_only_saved_when_the_robot_is_sure_and_survives_a_new_training(home: Path) -> None:
    async def main() -> None:
        async with virtual_robot(ceilings.tiles(SEED), SEED) as robot:
            with pytest.raises(RpcError, match="no map in use"):
                await robot.call("place.add", name="here")
            shutil.copy(home, robot.store.directory / "home.omap")
            await robot.call("map.use", map="home")
            await asyncio.sleep(3.0)
            await robot.call("place.add", name="here")
            assert robot.store.load("home").places.keys() == {"here"}
            for bad in ({"name": "../x"}, {"name": "a", "at": [1, 2]}, {"name": "a", "colour": "red"}, {}):
                with pytest.raises(RpcError) as refused:
                    await robot.call("place.add", **bad)
                assert refused.value.code == -32602
            with pytest.raises(RpcError, match="places and docks of this map: here"):
                await robot.call("goto", place="nowhere")

    virtual_time.run(main())


def test_a_drive_whose_base_goes_silent_fails_with_that_name() -> None:
    async def main() -> None:
        async with virtual_robot(ceilings.tiles(SEED), SEED) as robot:
            drive = asyncio.create_task(robot.call("drive", **{"vx": 0.1, "wz": 0.0, "for": 20.0}))
            await asyncio.sleep(2.0)
            robot.link.cut = True
            with pytest.raises(RpcError) as ended:
                await asyncio.wait_for(drive, 2.0)
            assert ended.value.name == ErrorName.BASE_LINK_DOWN
            robot.link.cut = False
            await asyncio.sleep(2.0)
            drive = asyncio.create_task(robot.call("drive", **{"vx": 0.1, "wz": 0.0, "for": 20.0}))
            await asyncio.sleep(2.0)
            await robot.call("stop")
            with pytest.raises(RpcError) as ended:
                await asyncio.wait_for(drive, 2.0)
            assert ended.value.name == ErrorName.CANCELLED

    virtual_time.run(main())


def test_driving_by_hand_is_clamped_and_a_wall_stops_it() -> None:
    async def main() -> None:
        async with virtual_robot(ceilings.tiles(SEED), SEED, Pose2D(2.0, 0.0, 0.0)) as robot:
            for _ in range(60):
                await robot.drive(Twist2D(9.0, 0.0))
                await asyncio.sleep(0.1)
            assert (await robot.call("status"))["twist"]["vx"] == 0.0  # the bumper vetoes
            assert robot.pose.x < 3.0

    virtual_time.run(main())
