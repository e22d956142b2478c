"""What the robot does by itself: `goto`, `route`, `relocalise` and `dock`."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from omnibotd.control import PERIOD, Feedback, Running
from omnibotd.control_protocol import RpcError
from omnibotd.core.docking.docker import Docker, DockingParameters, staging_pose
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D
from omnibotd.core.jobs import DockingTrip, Job, Relocalisation, Rounds
from omnibotd.core.mapping.topo_map import Dock, TopoMap
from omnibotd.core.navigation.navigator import Tolerance
from omnibotd.io.control_server import Session
from omnibotd.presets import preset_of
from omnibotd.requests.failures import Failures
from omnibotd.requests.params import Params, invalid, pose_values
from omnibotd.requests.robot import Method, Robot

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
    """One job at a time; each request is answered when its job has ended."""

    def __init__(self, robot: Robot, failures: Failures) -> None:
        self._robot, self._failures = robot, failures

    def methods(self) -> dict[str, Method]:
        return {
            "goto": self._goto,
            "route": self._route,
            "relocalise": self._relocalise,
            "dock.save": self._dock_save,
            "dock": self._dock,
        }

    async def _goto(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        at = params.pose("at")
        name = "" if at is not None else params.name("place")
        params.end()
        goal = at or self._place(name)
        began = self._robot.now()
        await self._run("goto", lambda topo_map: self._trip(topo_map, goal), feedback, (goal,))
        return {
            "place": name or None,
            "pose": pose_values(self._robot.control.map_from_base),
            "seconds": round(self._robot.now() - began, 1),
            "error_estimate_m": round(math.sqrt(self._robot.control.goal_filter.variance), 3),
        }

    async def _route(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        names, loops = params.names("places"), params.whole("loops", 1, 1, MAX_LOOPS)
        params.end()
        if not 1 <= len(names) <= MAX_WAYPOINTS:
            raise invalid(f"places: {len(names)} given, expected 1 to {MAX_WAYPOINTS}")
        goals = tuple(self._place(name) for name in names)
        arrivals = _Log(self._robot, names, self._robot.now())

        def make(topo_map: TopoMap) -> Job:
            return Rounds(goals, loops, lambda goal: self._trip(topo_map, goal))

        def progress(values: dict[str, Any]) -> None:
            arrivals.update(values.get("waypoint"), values.get("loop"))
            feedback({**values, "waypoints": len(names), "loops": loops})

        await self._run("route", make, progress, goals)
        arrivals.note()
        return {
            "places": names,
            "loops": loops,
            "seconds": round(self._robot.now() - arrivals.began, 1),
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
        control = self._robot.control
        await self._run(
            "relocalise",
            lambda topo_map: Relocalisation(topo_map, control.goal_filter, control.limits),
            feedback,
        )
        return {
            "map": self._robot.active_map().name,
            "pose": pose_values(control.map_from_base),
            "confidence": control.goal_filter.confidence,
            "sigma": control.place.sigma if control.place else None,
            "seconds": round(self._robot.now() - began, 1),
        }

    async def _dock_save(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        name = params.name("name")
        params.end()
        self._robot.active_map()
        self._robot.refuse_if_busy()
        frame = self._robot.camera.latest
        if frame is None or not self._robot.camera.ok(self._robot.now()):
            raise RpcError.named(ErrorName.CAMERA_DOWN, f"no picture of the dock: {self._robot.camera.reason}")
        pose = self._robot.sure_pose(f"dock {name!r}")
        dock = Dock(pose, await self._robot.off_loop(frame.jpeg))
        await self._robot.edit(lambda topo_map: topo_map.with_dock(name, dock))
        return {"name": name, "pose": pose_values(pose)}

    async def _dock(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        name = params.name("name") if "name" in params else None
        params.end()
        topo_map = self._robot.active_map()
        if name is None and len(topo_map.docks) == 1:
            name = next(iter(topo_map.docks))
        if name is None or name not in topo_map.docks:
            known = ", ".join(sorted(topo_map.docks)) or "none"
            raise RpcError.named(ErrorName.DOCK_NOT_IN_DB, f"dock {name!r} is not saved; docks of this map: {known}")
        if self._robot.base.latest is not None and self._robot.base.latest.charging:
            return {"dock": name, "seconds": 0.0, "retries": 0}
        began = self._robot.now()
        pose = staging_pose(topo_map.docks[name].map_from_dock)
        docker = Docker(name, DockingParameters(max_retries=self._robot.config.docking.max_retries))
        running = await self._run(
            "dock", lambda topo_map: DockingTrip(self._trip(topo_map, pose), docker), feedback, (pose,)
        )
        return {
            "dock": name,
            "seconds": round(self._robot.now() - began, 1),
            "retries": running.last.recoveries,
        }

    def _place(self, name: str) -> Pose2D:
        topo_map = self._robot.active_map()
        if name not in topo_map.places:
            known = ", ".join(sorted(topo_map.places)) or "none"
            raise RpcError.named(ErrorName.NO_SUCH_PLACE, f"no place {name!r}; places of this map: {known}")
        return topo_map.places[name]

    def _trip(self, topo_map: TopoMap, goal: Pose2D) -> Job:
        """A navigator to the goal, by the map's method."""
        settings = self._robot.config.navigation
        return preset_of(topo_map).navigator(
            topo_map,
            goal,
            self._robot.control.goal_filter,
            self._robot.control.limits,
            Tolerance(settings.xy_goal_tolerance, settings.yaw_goal_tolerance),
            self._robot.config.base.robot_radius,
            PERIOD,
        )

    async def _run(
        self, name: str, make: Callable[[TopoMap], Job], feedback: Feedback, goals: tuple[Pose2D, ...] = ()
    ) -> Running:
        """Make the job off the loop, run it and wait for its end; a failure is raised under its own name."""
        robot, control = self._robot, self._robot.control
        robot.refuse_if_busy()
        pose_filter, stops = control.goal_filter, robot.stops
        job = await robot.off_loop(make, robot.active_map())
        robot.refuse_if_stopped(stops)
        robot.refuse_if_busy()
        robot.refuse_if_unsafe()
        if control.goal_filter is not pose_filter:
            raise RpcError.named(ErrorName.BUSY, f"another map came into use while {name} was prepared; ask again")
        robot.goals = goals
        future = control.start(name, job, feedback)
        running = control.running
        assert running is not None
        outcome = await future
        if outcome.error is not None:
            await self._failures.keep(name, outcome, goals)
            raise RpcError.named(outcome.error, outcome.message, outcome.report)
        return running
