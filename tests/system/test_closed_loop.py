"""The whole daemon with a simulated robot in virtual time: hand driving, silence on the line, and a first trip."""

import asyncio
import json
import math
from typing import ClassVar

import numpy as np
import pytest

from omnibotd.control_protocol import RpcError
from omnibotd.core.geometry import Pose2D, Twist2D
from omnibotd.core.vision.camera_model import CameraModel
from tests.empty_hall import EmptyHall
from tools.evaluation.__main__ import main
from tools.sim import ceilings, virtual_time
from tools.sim.teacher import Area, Teacher, teach
from tools.sim.virtual_robot import VirtualRobot, virtual_robot
from tools.sim.world_plugin import WorldError


async def _drive(robot: VirtualRobot, twist: Twist2D, seconds: float) -> None:
    """Renews the set-point ten times a second, as a person with a joystick does."""
    for _ in range(round(seconds * 10)):
        await robot.drive(twist)
        await asyncio.sleep(0.1)


def test_drives_at_the_speed_asked_for_and_stops_when_nobody_renews_it() -> None:
    async def live() -> None:
        async with virtual_robot(EmptyHall(), 1) as robot:
            await _drive(robot, Twist2D(0.2, 0.0), 3.0)
            before = robot.pose
            await _drive(robot, Twist2D(0.2, 0.0), 5.0)
            assert before.distance(robot.pose) == pytest.approx(1.0, rel=0.05)  # 1 % error a wheel, and slip
            await asyncio.sleep(1.5)  # cmd_vel_timeout 0.5 s, then 0.4 s of braking at 0.5 m/s^2
            stood = robot.pose
            await asyncio.sleep(2.0)
            assert stood.distance(robot.pose) < 1e-3

    virtual_time.run(live())


def test_wheels_stop_by_themselves_when_the_line_falls_silent() -> None:
    async def live() -> None:
        async with virtual_robot(EmptyHall(), 1) as robot:
            await _drive(robot, Twist2D(0.3, 0.0), 3.0)
            cut_at = robot.pose
            robot.link.cut = True
            await asyncio.sleep(1.0)
            stood = robot.pose
            # 250 ms of the base's watchdog, 100 ms since the last set-point at most, and 80 ms of motor lag, at 0.3 m/s
            assert cut_at.distance(stood) < 0.3 * 0.5
            with pytest.raises(RpcError, match="base") as refused:
                await _drive(robot, Twist2D(0.3, 0.0), 2.0)
            assert refused.value.name == "BASE_LINK_DOWN"
            assert stood.distance(robot.pose) < 1e-3

            robot.link.cut = False
            await asyncio.sleep(2.0)
            assert (await robot.call("status"))["base"]["connected"]
            await _drive(robot, Twist2D(0.3, 0.0), 2.0)
            assert stood.distance(robot.pose) > 0.3

    virtual_time.run(live())


def test_being_carried_is_felt_by_no_wheel() -> None:
    async def live() -> None:
        async with virtual_robot(EmptyHall(), 1) as robot:
            robot.teleport(Pose2D(5.0, 5.0, 1.0))
            await asyncio.sleep(0.5)
            assert robot.daemon.control.odometry.odom_from_base.distance(Pose2D()) < 1e-6
            with pytest.raises(WorldError, match="no room"):
                robot.teleport(Pose2D(9.95, 0.0))

    virtual_time.run(live())


def test_charging_contact_closes_at_the_dock() -> None:
    async def live() -> list[bool]:
        async with virtual_robot(EmptyHall(), 1) as robot:
            felt = []
            for pose in (Pose2D(0.0, 0.0), Pose2D(*EmptyHall.dock)):
                robot.teleport(pose)
                await asyncio.sleep(0.2)
                felt.append((await robot.call("status"))["charging"])
            return felt

    assert virtual_time.run(live()) == [False, True]


def test_a_world_s_own_lens_is_its_calibration() -> None:
    class Calibrated(EmptyHall):
        camera_info: ClassVar = {
            "image_width": 160,
            "image_height": 120,
            "distortion_model": "equidistant",
            "camera_matrix": {"rows": 3, "cols": 3, "data": [36.0, 0.0, 81.0, 0.0, 35.0, 59.0, 0.0, 0.0, 1.0]},
            "distortion_coefficients": {"rows": 1, "cols": 4, "data": [0.01, 0.0, 0.0, 0.0]},
        }

    async def live() -> CameraModel | None:
        async with virtual_robot(Calibrated(), 1) as robot:
            return robot.daemon.perception.model

    model = virtual_time.run(live())
    assert (model.fx, model.fy, model.cx, model.cy) == (36.0, 35.0, 81.0, 59.0)
    assert model.distortion == (0.01, 0.0, 0.0, 0.0)


def test_a_failure_inside_the_daemon_comes_out_as_itself() -> None:
    class Broken(EmptyHall):
        broken = False

        def render(self, x: float, y: float, yaw: float, t: float) -> np.ndarray:
            if self.broken:
                raise ZeroDivisionError("the world ended")
            return super().render(x, y, yaw, t)

    async def live() -> None:
        world = Broken()
        async with virtual_robot(world, 1):
            world.broken = True
            await asyncio.sleep(10.0)

    with pytest.raises(ZeroDivisionError, match="the world ended"):
        virtual_time.run(live())


async def _first_trip() -> tuple[list[tuple[float, float, float]], Pose2D, Pose2D]:
    """Taught 2 m x 2 m for a minute, then sent back to where the recording began: track, start, end."""
    world = ceilings.tiles(11)
    track: list[tuple[float, float, float]] = []
    async with virtual_robot(world, 11) as robot:
        start = robot.pose
        await teach(robot, Teacher(robot, Area.to_teach(world, side=2.0), 11), "room", 60.0)
        trip = asyncio.create_task(robot.call("goto", at=[0.0, 0.0, 0.0]))  # the map begins with the recording
        while not trip.done():
            track.append((robot.pose.x, robot.pose.y, robot.pose.yaw))
            await asyncio.sleep(0.1)
        await trip
        await asyncio.sleep(1.0)
        return track, start, robot.pose


def test_record_train_goto_and_the_same_again_to_the_last_bit() -> None:
    track, start, end = virtual_time.run(_first_trip())
    assert start.distance(end) < 0.15
    assert abs(end.yaw - start.yaw) < math.radians(5.0)
    assert len(track) > 20
    assert virtual_time.run(_first_trip()) == (track, start, end)


def test_evaluation_writes_what_the_contract_says(tmp_path, capsys) -> None:
    out = tmp_path / "out.json"
    arguments = ["--world", "tools.sim.ceilings:plain", "--runs", "2", "--teach", "30", "--seed", "5", "--json"]
    assert main(["goto", *arguments, str(out)]) == 0
    result = json.loads(out.read_text("utf-8"))
    assert list(result) == ["meta", "runs", "summary"]
    assert [result["meta"][key] for key in ("world", "seed", "teach_s")] == ["tools.sim.ceilings:plain", 5, 30.0]
    assert result["meta"]["virtual_s"] > sum(run["seconds"] for run in result["runs"])
    first, second = result["runs"]
    assert math.dist(first["final"][:2], second["start"][:2]) < 0.01  # each starts where the last ended
    for run in result["runs"]:
        assert run["error_m"] == pytest.approx(math.dist(run["goal"][:2], run["final"][:2]))
        assert run["seconds"] > 0.0
    assert sum(result["summary"]["results"].values()) == result["summary"]["n"] == 2
    told = capsys.readouterr()
    assert "error, median" in told.out
    assert "2 ARRIVED" in told.err
