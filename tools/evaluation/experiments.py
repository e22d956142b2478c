"""What is measured: a taught robot is sent to places of its map again and again."""

from __future__ import annotations

import random
from collections.abc import Awaitable, Callable

from omnibotd.core.geometry import Pose2D
from tools.evaluation.course import Course
from tools.evaluation.lessons import Lesson
from tools.evaluation.summary import Run
from tools.sim.conditions import LIGHTS
from tools.sim.teacher import NEAR_DOCK, Area, free_point
from tools.sim.virtual_robot import somewhere
from tools.sim.world_plugin import World

AT_THE_DOCK = ("dock", "rested", "afar")

Experiment = Callable[[Course], Awaitable[list[Run]]]


async def goto(course: Course) -> list[Run]:
    """To the poses of random nodes, each run from where the last ended (thesis §6.5.6, random goals)."""
    return [course.tell(await course.goto(course.any_node())) for _ in range(course.plan.runs)]


async def starts(course: Course) -> list[Run]:
    """From poses all over the floor, to which the robot is carried, to one goal (thesis §6.4.6 and §6.5.6)."""
    node, runs = course.any_node(), []
    for _ in range(course.plan.runs):
        await course.put(course.any_pose())
        runs.append(course.tell(await course.goto(node)))
    return runs


async def light(course: Course) -> list[Run]:
    """As `goto`, an equal share of the runs under each other light in turn."""
    runs: list[Run] = []
    for number in range(course.plan.runs):
        course.enter(list(LIGHTS)[number * len(LIGHTS) // course.plan.runs])
        runs.append(course.tell(await course.goto(course.any_node())))
    return runs


def lesson(experiment: str, world: World, name: str, seed: int, **how: object) -> Lesson:
    """What the robot must be taught before the experiment; `how`: preset, seconds, speed, standing, axis."""
    rng = random.Random(seed)
    if experiment in AT_THE_DOCK:
        goal = Pose2D(*world.dock)
        area = Area.to_teach(world, (goal.x, goal.y), margin=NEAR_DOCK)
        return Lesson(world=name, seed=seed, area=area, start=Pose2D(*free_point(world, area, rng)), park=goal, **how)
    area = Area.to_teach(world)
    if experiment == "outside":
        area = area.half()
        return Lesson(world=name, seed=seed, area=area, start=Pose2D(*free_point(world, area, rng)), **how)
    return Lesson(world=name, seed=seed, area=area, start=somewhere(world), **how)
