"""What is measured: a robot is taught a room, then sent to places of its map, or to its dock, again and again."""

from __future__ import annotations

import asyncio
import math
import random
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omnibotd.control_protocol import RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.drive import read_drive
from omnibotd.io.recording import teaching_samples
from tools.evaluation.summary import Run
from tools.sim.teacher import CLEARANCE, NEAR_DOCK, TRIES, Area, NoWay, Teacher, free_point, save_dock, teach
from tools.sim.virtual_robot import VirtualRobot

MAP = "evaluated"
DOCK = "dock"
RUN_LIMIT = 600.0  # s; the daemon gives up well before, so this only ends what hangs
SETTLE = 1.0  # s for the wheels to stand before the truth is read
PUT_DOWN = 2.0  # s between putting the robot somewhere and asking something of it
DOCK_RADIUS = 1.0  # m round the dock from which docking starts

Report = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Plan:
    """How long to teach (s), how often to run, and the seed of all that is random."""

    runs: int
    seed: int
    teach: float


Experiment = Callable[[VirtualRobot, Plan, Report], Awaitable[list[Run]]]


async def goto(robot: VirtualRobot, plan: Plan, report: Report) -> list[Run]:
    """Goes to the poses of random nodes, each run from where the last ended; the goal is where the node was taught."""
    teacher = Teacher(robot, Area.to_teach(robot.world), plan.seed)
    recording = await teach(robot, teacher, MAP, plan.teach)
    taught = true_poses(robot, recording)
    topo_map = robot.store.load(MAP)
    report(f"taught {len(topo_map)} nodes in {plan.teach:.0f} s")
    rng = random.Random(plan.seed)
    runs: list[Run] = []
    for _ in range(plan.runs):
        node = rng.randrange(len(topo_map))
        pose = topo_map.pose(node)
        runs.append(await _run(robot, taught[node], "ARRIVED", "goto", at=[pose.x, pose.y, pose.yaw]))
        report(_progress(runs, plan))
    return runs


async def dock(robot: VirtualRobot, plan: Plan, report: Report) -> list[Run]:
    """Docks from random free poses within a metre of the dock, at any heading, to which the robot was carried."""
    goal = Pose2D(*robot.world.dock)
    rng = random.Random(plan.seed)
    area = Area.to_teach(robot.world, (goal.x, goal.y), margin=NEAR_DOCK)
    robot.teleport(Pose2D(*free_point(robot.world, area, rng)))
    teacher = Teacher(robot, area, plan.seed)
    await teach(robot, teacher, MAP, plan.teach, park=goal)
    await save_dock(robot, teacher, DOCK, goal)
    report(f"taught {plan.teach:.0f} s round the dock and saved it")
    runs: list[Run] = []
    for _ in range(plan.runs):
        robot.teleport(_beside(robot, goal, rng))
        await asyncio.sleep(PUT_DOWN)
        runs.append(await _run(robot, goal, "DOCKED", "dock", name=DOCK))
        report(_progress(runs, plan))
    return runs


EXPERIMENTS: dict[str, Experiment] = {"goto": goto, "dock": dock}


def true_poses(robot: VirtualRobot, recording: Path) -> list[Pose2D]:
    """Where the robot truly was when it saw each node of the map made of `recording`."""
    stamps: dict[Pose2D, float] = {}
    for sample in teaching_samples(recording):
        stamps.setdefault(sample.odom_from_base, sample.stamp)
    model = robot.daemon.perception.model
    assert model is not None
    drive = read_drive(teaching_samples(recording), model, 0, lambda share: None)
    return [robot.true_pose_at(stamps[pose]) for pose in drive.odom_from_node]


async def _run(robot: VirtualRobot, goal: Pose2D, success: str, method: str, **params: Any) -> Run:
    loop = asyncio.get_running_loop()
    start, began = robot.pose, loop.time()
    result = await _outcome(robot, success, method, params)
    seconds = loop.time() - began
    await asyncio.sleep(SETTLE)
    return Run(start, goal, robot.pose, seconds, result)


async def _outcome(robot: VirtualRobot, success: str, method: str, params: dict[str, Any]) -> str:
    """`success`, or the name of the error."""
    try:
        async with asyncio.timeout(RUN_LIMIT):
            await robot.call(method, **params)
    except RpcError as error:
        return error.name.value
    except TimeoutError:
        await robot.call("stop")
        return ErrorName.TIMEOUT.value
    return success


def _beside(robot: VirtualRobot, dock: Pose2D, rng: random.Random) -> Pose2D:
    """A random free pose on the disc round the dock."""
    for _ in range(TRIES):
        away, bearing = DOCK_RADIUS * math.sqrt(rng.random()), rng.uniform(-math.pi, math.pi)
        x, y = dock.x + away * math.cos(bearing), dock.y + away * math.sin(bearing)
        if robot.world.free(x, y, CLEARANCE):
            return Pose2D(x, y, rng.uniform(-math.pi, math.pi))
    raise NoWay(f"no free floor found within {DOCK_RADIUS} m of the dock in {TRIES} tries")


def _progress(runs: list[Run], plan: Plan) -> str:
    run = runs[-1]
    degrees = math.degrees(run.error_rad)
    return f"{len(runs)}/{plan.runs} {run.result} {run.error_m:.3f} m {degrees:.2f} deg in {run.seconds:.1f} s"
