"""What is measured of a robot that is taken away: carried while on its way, or carried or driven out of its map."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from omnibotd.core.geometry import Pose2D
from omnibotd.core.navigation.navigator import SURE
from tools.evaluation.calibration import RIGHT
from tools.evaluation.course import Course
from tools.evaluation.summary import ARRIVED, Carried, Run
from tools.sim.teacher import ARRIVED as NEAR
from tools.sim.teacher import NoWay, Teacher, clear_way

TOP_SPEED = 0.3  # m/s; a trip takes longer than its distance at this
BEFORE = 0.25  # share of the robots that are carried before they set out
FAR = 1.0  # m between where the robot is taken up and put down
BEYOND = 0.8  # m from every node: well outside the map
LOOKS = 0.1  # s between two looks at what the robot says of itself


@dataclass(frozen=True, slots=True)
class Said:
    """What the robot said of itself at `stamp`: how far (m) from the truth, how sure."""

    stamp: float
    error_m: float
    confidence: float


async def kidnap(course: Course) -> list[Run]:
    """On its way to a random node, or just before, the robot is carried elsewhere in the taught area."""
    runs: list[Run] = []
    for _ in range(course.plan.runs):
        node = course.any_node()
        at = _moment(course, course.truth.node(node))
        if at == 0.0:
            to, lifted = _carry(course), asyncio.get_running_loop().time()
        trip = asyncio.create_task(course.goto(node))
        await asyncio.wait({trip}, timeout=at)
        if at > 0.0 and not trip.done():
            to, lifted = _carry(course), asyncio.get_running_loop().time()
        elif at > 0.0:  # ended before its time, which no sound trip does
            runs.append(course.tell(await trip))
            continue
        said = await _watch(course, trip)
        runs.append(course.tell(replace(await trip, carried=Carried(to, at, recovered(said, lifted)))))
    return runs


async def outside(course: Course) -> list[Run]:
    """Carried and driven out of the map in turn, then sent to a random node: it comes back or says that it can't."""
    runs: list[Run] = []
    for number in range(course.plan.runs):
        if number % 2 == 0 or not await _driven_out(course, runs[-1]):
            await course.put(course.any_pose_where(lambda pose: _beyond(course, pose)))
        runs.append(course.tell(await course.goto(course.any_node())))
    return runs


def recovered(said: Sequence[Said], since: float) -> float | None:
    """Seconds from `since` to the first moment from which the robot said, surely, where it was, and stayed right."""
    right_from: float | None = None
    for look in said:
        if look.error_m > RIGHT:
            right_from = None
        elif right_from is None and look.confidence >= SURE:
            right_from = look.stamp
    return None if right_from is None else right_from - since


def _moment(course: Course, goal: Pose2D) -> float:
    """Seconds after setting out at which to carry the robot: always before it can be there."""
    if course.rng.random() < BEFORE:
        return 0.0
    return course.rng.uniform(0.0, 0.8 * course.robot.pose.distance(goal) / TOP_SPEED)


def _carry(course: Course) -> Pose2D:
    start = course.robot.pose
    to = course.any_pose()
    while to.distance(start) < FAR:
        to = course.any_pose()
    course.robot.teleport(to)
    return to


async def _watch(course: Course, trip: asyncio.Task[Run]) -> list[Said]:
    """What the robot says of itself until the trip is over."""
    loop = asyncio.get_running_loop()
    said: list[Said] = []
    while not trip.done():
        status, place = await course.robot.call("status"), course.robot.daemon.control.place
        error = math.inf
        if status["pose"] is not None and place is not None:
            error = course.truth.world_from(Pose2D(**status["pose"]), place.node).distance(course.robot.pose)
        said.append(Said(loop.time(), error, status["confidence"]))
        await asyncio.wait({trip}, timeout=LOOKS)
    return said


def _beyond(course: Course, pose: Pose2D) -> bool:
    nodes = course.truth.in_world
    return bool(np.hypot(nodes[:, 0] - pose.x, nodes[:, 1] - pose.y).min() >= BEYOND)


async def _driven_out(course: Course, before: Run) -> bool:
    """Drive the robot straight out of the map from where it knows it is; False where no straight way leads out."""
    if before.result != ARRIVED:
        await course.put(course.truth.node(course.any_node()))
        await course.goto(course.any_node())
    here = course.robot.pose
    start = (here.x, here.y)
    try:
        out = course.any_pose_where(
            lambda pose: _beyond(course, pose) and clear_way(course.robot.world, start, (pose.x, pose.y))
        )
    except NoWay:
        return False
    teacher = Teacher(course.robot, course.area, course.plan.seed)
    await teacher.drive_to((out.x, out.y), NEAR)
    await teacher.stand()
    return True
