"""Where the robot has been: the last trajectory, drawn by `map plot`."""

from __future__ import annotations

import asyncio
import math
from collections import deque

from omnibotd.requests.robot import Robot

PERIOD = 0.2  # s between looks
STEP = 0.03  # m between points kept: a standing robot fills nothing
JUMP = 0.5  # m between two looks that were not driven: the robot was carried or found itself anew
POINTS = 5000  # 150 m of way at least, a few hundred kilobytes

Point = tuple[float, float]


class Trail:
    """The newest stretch of way in the active map, as strokes that break where the pose jumped."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._nodes: object = None  # of the map the points are in: edits of places keep them
        self._points: deque[tuple[Point, bool]] = deque(maxlen=POINTS)  # and whether it goes on from the one before

    async def watch(self) -> None:
        """Note where the robot goes, for ever."""
        while True:
            await asyncio.sleep(PERIOD)
            self.note()

    def note(self) -> None:
        topo_map, here = self._robot.perception.topo_map, self._robot.control.map_from_base
        nodes = topo_map.poses if topo_map is not None else None
        if nodes is not self._nodes:
            self._nodes = nodes
            self._points.clear()
        if here is None or nodes is None:
            return
        away = math.dist((here.x, here.y), self._points[-1][0]) if self._points else math.inf
        if away >= STEP:
            self._points.append(((here.x, here.y), away < JUMP))

    def strokes(self) -> list[list[Point]]:
        """Lines of two points and more, oldest first."""
        strokes: list[list[Point]] = []
        for point, goes_on in self._points:
            if not goes_on or not strokes:
                strokes.append([])
            strokes[-1].append(point)
        return [stroke for stroke in strokes if len(stroke) > 1]
