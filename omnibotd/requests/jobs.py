"""Going somewhere: `goto`, `route` and `relocalise`."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from omnibotd.control import Feedback
from omnibotd.control_protocol import RpcError
from omnibotd.core.docking.docker import staging_pose
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D
from omnibotd.core.jobs import Job, Relocalisation, Rounds
from omnibotd.io.control_server import Session
from omnibotd.requests.params import Params, invalid, pose_values
from omnibotd.requests.robot import Method, Robot
from omnibotd.requests.running import Runner

MAX_WAYPOINTS = 100  # places of one route: a guided tour of a museum has fewer
MAX_LOOPS = 10_000  # a patrol round a flat for a week
LISTED_ARRIVALS = 1000  # the newest ones a route's answer lists; a hundred kilobytes


@dataclass
class _Log:
    """Arrivals of a route, noticed when its job turns to the next way-point."""

    robot: Robot
    names: list[str]
    began: float
    listed: deque[dict[str, Any]] = field(default_factory=lambda: deque(maxlen=LISTED_ARRIVALS))
    count: int = 0

    def update(self, waypoint: int | None, loop: int | None) -> None:
        """The job is on its way to this way-point, in this loop (both from 1); all before it were reached."""
        reached = ((loop or 1) - 1) * len(self.names) + (waypoint or 1) - 1
        if reached > self.count:
            self.note()

    def note(self) -> None:
        """The robot stands at the next way-point."""
        self.listed.append(
            {
                "place": self.names[self.count % len(self.names)],
                "loop": self.count // len(self.names) + 1,
                "pose": pose_values(self.robot.control.map_from_base),
                "seconds": round(self.robot.now() - self.began, 1),
            }
        )
        self.count += 1


class Jobs:
    """Trips, and the search for where it is."""

    def __init__(self, robot: Robot, runner: Runner) -> None:
        self._robot, self._runner = robot, runner

    def methods(self) -> dict[str, Method]:
        return {
            "goto": self._goto,
            "route": self._route,
            "relocalise": self._relocalise,
        }

    async def _goto(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        at = params.pose("at")
        name = "" if at is not None else params.name("place")
        params.end()
        topo_map = self._robot.active_map()
        goal = at or self._place(name)
        done = await self._runner.run("goto", lambda: self._runner.trip(topo_map, goal), feedback, (goal,))
        return {
            "place": name or None,
            "pose": pose_values(self._robot.control.map_from_base),
            "seconds": done.seconds,
            "error_estimate_m": round(math.sqrt(self._robot.control.goal_filter.variance), 3),
        }

    async def _route(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        names, loops = params.names("places"), params.whole("loops", 1, 1, MAX_LOOPS)
        params.end()
        if not 1 <= len(names) <= MAX_WAYPOINTS:
            raise invalid(f"places: {len(names)} given, expected 1 to {MAX_WAYPOINTS}")
        topo_map = self._robot.active_map()
        goals = tuple(self._place(name) for name in names)
        arrivals = _Log(self._robot, names, self._robot.now())

        def make() -> Job:
            return Rounds(goals, loops, lambda goal: self._runner.trip(topo_map, goal))

        def progress(values: dict[str, Any]) -> None:
            arrivals.update(values.get("waypoint"), values.get("loop"))
            feedback({**values, "waypoints": len(names), "loops": loops})

        done = await self._runner.run("route", make, progress, goals)
        arrivals.note()
        return {
            "places": names,
            "loops": loops,
            "seconds": done.seconds,
            "arrived": arrivals.count,
            "arrivals": list(arrivals.listed),
        }

    async def _relocalise(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        params.end()
        self._robot.refuse_if_busy()
        self._robot.refuse_if_unsafe()
        began, stops = self._robot.now(), self._robot.stops
        await self._robot.perception.relocalise()
        feedback({"state": "RECOGNISING"})
        await self._robot.recogniser.wake_up()
        self._robot.refuse_if_stopped(stops)
        control, topo_map = self._robot.control, self._robot.active_map()
        search = partial(Relocalisation, topo_map, control.goal_filter, control.limits)
        await self._runner.run("relocalise", search, feedback)
        return {
            "map": self._robot.active_map().name,
            "pose": pose_values(control.map_from_base),
            "confidence": control.goal_filter.confidence,
            "sigma": control.place.sigma if control.place else None,
            "seconds": round(self._robot.now() - began, 1),
        }

    def _place(self, name: str) -> Pose2D:
        """A named place; a dock's name stands for where docking starts, unless a place has it."""
        topo_map = self._robot.active_map()
        if name in topo_map.places:
            return topo_map.places[name]
        if name in topo_map.docks:
            return staging_pose(topo_map.docks[name].map_from_dock)
        known = ", ".join(sorted({*topo_map.places, *topo_map.docks})) or "none"
        raise RpcError.named(ErrorName.NO_SUCH_PLACE, f"no place {name!r}; places and docks of this map: {known}")
