"""What is measured of docking: from near and from afar, and what many runs come to."""

from __future__ import annotations

import asyncio
import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

from omnibotd.control_protocol import RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D
from omnibotd.requests.dock_watch import PERIOD
from tools.evaluation.course import RUN_LIMIT, Course
from tools.evaluation.summary import DOCKED, Run
from tools.sim.conditions import LIGHTS
from tools.sim.teacher import Teacher, save_dock
from tools.sim.virtual_robot import somewhere
from tools.sim.world_plugin import World

DOCK = "dock"
RADIUS = 1.0  # m round the dock from which docking starts
LIMIT = 1200.0  # s; the thesis' method, lost, makes 60 steps before it gives up
REST = 2.5 * PERIOD  # s of each light: two looks of the robot's at it
# Docked within this it stands in the dock; who says so elsewhere is wrong.
GOOD_M, GOOD_RAD = 0.02, math.radians(1.0)


def in_the_open(world: World) -> tuple[float, float, float]:
    """Where a dock is that stands at no wall: beside the middle, askew, so that nothing is lined up with the room."""
    pose = somewhere(world) @ Pose2D(0.15, -0.1, 0.4)
    return pose.x, pose.y, pose.yaw


async def dock(course: Course) -> list[Run]:
    """From random free poses within a metre of the dock, at any heading, to which the robot was carried."""
    return await _from_near(course, await _saved(course))


async def rested(course: Course) -> list[Run]:
    """As `dock`, of a robot that has rested in its dock before while every light came and went."""
    goal = await _saved(course)
    for light in (None, *LIGHTS):
        course.stage.enter([light] if light else [])
        await asyncio.sleep(REST)
    return await _from_near(course, goal)


async def _from_near(course: Course, goal: Pose2D) -> list[Run]:
    runs: list[Run] = []
    for number in range(course.plan.runs):
        course.enter(number=number)
        await course.put(course.any_pose_where(lambda pose: pose.distance(goal) <= RADIUS))
        runs.append(course.tell(await course.run(goal, DOCKED, "dock", limit=LIMIT, name=DOCK)))
    return runs


async def afar(course: Course) -> list[Run]:
    """From anywhere in the map: out of the dock and to a random node first, which does not count."""
    goal = await _saved(course)
    runs: list[Run] = []
    for number in range(course.plan.runs):
        course.enter(number=number)
        await _away(course)
        runs.append(course.tell(await course.run(goal, DOCKED, "dock", limit=LIMIT, name=DOCK)))
    return runs


async def _saved(course: Course) -> Pose2D:
    """The dock's true pose; it is saved before any passing condition comes."""
    course.stage.enter(())
    goal = Pose2D(*course.robot.world.dock)
    await save_dock(course.robot, Teacher(course.robot, course.area, course.plan.seed), DOCK, goal)
    return goal


async def _away(course: Course) -> None:
    """Where the trip ends does not matter; a robot that will not leave the dock is carried."""
    left = await course.ask("undock", RUN_LIMIT)
    node = course.any_node()
    if left is None or left.name is ErrorName.NOT_DOCKED:
        pose = course.topo_map.pose(node)
        left = await course.ask("goto", RUN_LIMIT, at=[pose.x, pose.y, pose.yaw])
    if isinstance(left, RpcError):
        await course.put(course.truth.node(node))


@dataclass(frozen=True, slots=True)
class DockingSummary:
    """Errors (m and degrees) are of the runs that said they docked; `good` is the share of all runs that docked within
    2 cm and 1 degree, `false_docked` the number of those that said so elsewhere; `mean_steps` where steps are counted.
    """

    n: int
    docked: int
    mean_m: float | None
    max_m: float | None
    mean_deg: float | None
    max_deg: float | None
    good: float
    false_docked: int
    median_s: float
    mean_steps: float | None

    @classmethod
    def of(cls, runs: Sequence[Run]) -> DockingSummary:
        """Of at least one run."""
        said = [run for run in runs if run.result == DOCKED]
        metres, degrees = [run.error_m for run in said], [math.degrees(run.error_rad) for run in said]
        good = sum(run.error_m <= GOOD_M and run.error_rad <= GOOD_RAD for run in said)
        steps = [float(run.report["steps"]) for run in said if "steps" in run.report]  # type: ignore[arg-type]
        return cls(
            n=len(runs),
            docked=len(said),
            mean_m=statistics.fmean(metres) if said else None,
            max_m=max(metres, default=None),
            mean_deg=statistics.fmean(degrees) if said else None,
            max_deg=max(degrees, default=None),
            good=good / len(runs),
            false_docked=len(said) - good,
            median_s=statistics.median(run.seconds for run in runs),
            mean_steps=statistics.fmean(steps) if steps else None,
        )


def docking_summary(runs: Sequence[Run]) -> dict[str, object]:
    """Of all runs, and under `by_condition` of those under each, where there were several."""
    names = dict.fromkeys(run.condition for run in runs)
    parts = {name: asdict(DockingSummary.of([run for run in runs if run.condition == name])) for name in names}
    return asdict(DockingSummary.of(runs)) | ({"by_condition": parts} if len(parts) > 1 else {})


def figures(part: Mapping[str, float | None]) -> dict[str, str]:
    """For a person, by name."""
    return {
        "docked": f"{part['docked']} of {part['n']}",
        "mean": _in(part["mean_m"], 1000.0, "mm"),
        "worst": _in(part["max_m"], 1000.0, "mm"),
        "heading, mean": _in(part["mean_deg"], 1.0, "°", 2),
        "heading, worst": _in(part["max_deg"], 1.0, "°", 2),
        "within 2 cm, 1°": f"{part['good']:.0%}",
        "false": f"{part['false_docked']}",
        "time, median": _in(part["median_s"], 1.0, "s", 0),
        "steps, mean": _in(part["mean_steps"], 1.0, "", 0),
    }


def _in(value: float | None, factor: float, unit: str, digits: int = 1) -> str:
    return "" if value is None else f"{factor * value:.{digits}f} {unit}".rstrip()
