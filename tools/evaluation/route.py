"""What is measured of rounds: five way-points visited again and again, each arrival against its own goal."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from typing import Any

from tools.evaluation.course import RUN_LIMIT, SETTLE, Course
from tools.evaluation.summary import ARRIVED, Run

WAYPOINTS, SPACING = 5, 1.0  # metres, so that there is a way between two


async def route(course: Course) -> list[Run]:
    """Round the way-points, as many loops as there are runs; each arrival counts (thesis §6.5.6).

    A way-point that is not reached ends a route; the next route begins with the one after it.
    """
    nodes = await _named_places(course)
    total = course.plan.runs * len(nodes)
    runs: list[Run] = []
    while len(runs) < total:
        first = len(runs) % len(nodes)
        tour = _Tour(course, [*nodes[first:], *nodes[:first]])
        runs += await tour.drive(math.ceil((total - len(runs)) / len(nodes)))
    return runs[:total]


class _Tour:
    """One request; notes where the robot truly is each time that it turns to the next way-point."""

    def __init__(self, course: Course, nodes: Sequence[int]) -> None:
        self._course, self._nodes = course, nodes
        self._runs: list[Run] = []
        self._start, self._began = course.robot.pose, asyncio.get_running_loop().time()

    async def drive(self, loops: int) -> list[Run]:
        """The arrivals, and the failure if one ended it."""
        limit = RUN_LIMIT * loops * len(self._nodes)
        places = [_place(node) for node in self._nodes]
        error = await self._course.ask("route", limit, self._watch, places=places, loops=loops)
        await asyncio.sleep(SETTLE)
        self._note(error or ARRIVED)
        return self._runs

    def _watch(self, values: dict[str, Any]) -> None:
        """Feedback comes before the wheels turn towards the next way-point."""
        if "waypoint" in values and (values["loop"] - 1) * len(self._nodes) + values["waypoint"] - 1 > len(self._runs):
            self._note(ARRIVED)

    def _note(self, how: Any) -> None:
        now = asyncio.get_running_loop().time()
        goal = self._course.truth.node(self._nodes[len(self._runs) % len(self._nodes)])
        run = self._course.ended(self._start, goal, now - self._began, how)
        self._runs.append(self._course.tell(run))
        self._start, self._began = run.final, now


async def _named_places(course: Course) -> list[int]:
    """Random nodes, each some way from all the others, as many as the map has room for; saved as places."""
    chosen: list[int] = []
    nodes = list(range(len(course.topo_map)))
    course.rng.shuffle(nodes)
    for node in nodes:
        here = course.truth.node(node)
        if len(chosen) < WAYPOINTS and all(here.distance(course.truth.node(other)) >= SPACING for other in chosen):
            chosen.append(node)
    for node in chosen:
        pose = course.topo_map.pose(node)
        await course.robot.call("place.add", name=_place(node), at=[pose.x, pose.y, pose.yaw])
    return chosen


def _place(node: int) -> str:
    return f"node-{node}"
