"""What makes the robot move: `drive`, `goto`, `dock`, and `stop`, which is always accepted."""

from __future__ import annotations

import asyncio
import logging
import math
from functools import partial
from typing import Any

from omnibotd.control import PERIOD, Feedback, Running, Teleop
from omnibotd.control_protocol import RpcError
from omnibotd.core.docking.docker import Docker, DockingParameters, staging_pose
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D, Twist2D
from omnibotd.core.jobs import DockingTrip, Job
from omnibotd.core.mapping.topo_map import Dock, TopoMap
from omnibotd.core.navigation.navigator import Navigator, Tolerance
from omnibotd.io.control_server import Session
from omnibotd.requests.params import Params, invalid, pose_values
from omnibotd.requests.robot import Method, Robot
from omnibotd.requests.teaching import Teaching

log = logging.getLogger(__name__)


class Jobs:
    """One job at a time; each request is answered when its job has ended."""

    def __init__(self, robot: Robot, teaching: Teaching) -> None:
        self._robot, self._teaching = robot, teaching

    def methods(self) -> dict[str, Method]:
        return {
            "drive": self._drive,
            "stop": self._stop,
            "goto": self._goto,
            "dock.save": self._dock_save,
            "dock": self._dock,
        }

    async def _drive(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        twist = Twist2D(params.number("vx"), params.number("wz"))
        duration = params.number("for", self._robot.config.base.cmd_vel_timeout)
        lasting = "for" in params or duration != self._robot.config.base.cmd_vel_timeout
        params.end()
        self._robot.refuse_if_busy()
        self._robot.refuse_if_unsafe()
        if not 0.0 < duration <= 3600.0:
            raise invalid(f"for: {duration} given, expected seconds above 0 and up to 3600")
        teleop = Teleop(twist, self._robot.now() + duration, session)
        self._robot.control.teleop = teleop
        if session is not None:
            session.on_close(partial(self._let_go, session))
        if lasting:
            await self._until_over(teleop)
        return {}

    async def _until_over(self, teleop: Teleop) -> None:
        """Wait for the end of a drive; whatever ended it before its time is said."""
        while self._robot.now() < teleop.until:
            if self._robot.control.teleop is not teleop:
                self._robot.refuse_if_unsafe()
                raise RpcError.named(ErrorName.CANCELLED, "the drive was stopped before its time was over")
            await asyncio.sleep(PERIOD)

    def _let_go(self, session: Session) -> None:
        """The client that drove went away: stop now, not at the time-out."""
        teleop = self._robot.control.teleop
        if teleop is not None and teleop.hand is session:
            log.warning("the driving client went away; stopping")
            self._robot.control.halt("the driving client went away")

    async def _stop(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        params.end()
        self._robot.control.halt("stopped on request")
        self._teaching.cancel_training()
        return {}

    async def _goto(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        at = params.pose("at")
        name = "" if at is not None else params.name("place")
        params.end()
        topo_map = self._robot.active_map()
        if at is None:
            if name not in topo_map.places:
                known = ", ".join(sorted(topo_map.places)) or "none"
                raise RpcError.named(ErrorName.NO_SUCH_PLACE, f"no place {name!r}; places of this map: {known}")
            at = topo_map.places[name]
        began = self._robot.now()
        await self._run_job("goto", await self._trip(topo_map, at), feedback)
        return {
            "place": name or None,
            "pose": pose_values(self._robot.control.map_from_base),
            "seconds": round(self._robot.now() - began, 1),
            "error_estimate_m": round(math.sqrt(self._robot.control.goal_filter.variance), 3),
        }

    async def _dock_save(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        name = params.name("name")
        params.end()
        topo_map = self._robot.active_map()
        self._robot.refuse_if_busy()
        frame = self._robot.camera.latest
        if frame is None or not self._robot.camera.ok(self._robot.now()):
            raise RpcError.named(ErrorName.CAMERA_DOWN, f"no picture of the dock: {self._robot.camera.reason}")
        pose = self._robot.sure_pose(f"dock {name!r}")
        await self._robot.edit(topo_map.with_dock(name, Dock(pose, await self._robot.off_loop(frame.jpeg))))
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
        trip = DockingTrip(
            await self._trip(topo_map, pose),
            Docker(name, DockingParameters(max_retries=self._robot.config.docking.max_retries)),
        )
        running = await self._run_job("dock", trip, feedback)
        return {
            "dock": name,
            "seconds": round(self._robot.now() - began, 1),
            "retries": running.last.recoveries,
        }

    async def _trip(self, topo_map: TopoMap, goal: Pose2D) -> Navigator:
        self._robot.refuse_if_busy()
        tolerance = Tolerance(
            self._robot.config.navigation.xy_goal_tolerance, self._robot.config.navigation.yaw_goal_tolerance
        )
        navigator: Navigator = await self._robot.off_loop(
            Navigator,
            topo_map,
            goal,
            self._robot.control.goal_filter,
            self._robot.control.limits,
            tolerance,
            self._robot.config.base.robot_radius,
            PERIOD,
        )
        return navigator

    async def _run_job(self, name: str, job: Job, feedback: Feedback) -> Running:
        """Wait for the job's end; a failure is raised under its own name."""
        self._robot.refuse_if_busy()
        self._robot.refuse_if_unsafe()
        future = self._robot.control.start(name, job, feedback)
        running = self._robot.control.running
        assert running is not None
        outcome = await future
        if outcome.error is not None:
            raise RpcError.named(outcome.error, outcome.message)
        return running
