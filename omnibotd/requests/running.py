"""How a request runs a job: prepare it beside the control loop, start it, wait for its end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from omnibotd.control import PERIOD, Feedback
from omnibotd.control_protocol import RpcError
from omnibotd.core.decision import Decision, Outcome
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D
from omnibotd.core.jobs import Job
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation.navigator import Tolerance
from omnibotd.presets import preset_of
from omnibotd.requests.failures import Failures
from omnibotd.requests.robot import Robot


@dataclass(frozen=True, slots=True)
class Done:
    """A job that ended well: its last decision, its outcome, and the seconds it took."""

    last: Decision
    outcome: Outcome
    seconds: float


class Runner:
    """One job at a time; each request is answered when its job has ended."""

    def __init__(self, robot: Robot, failures: Failures) -> None:
        self._robot, self._failures = robot, failures

    async def run(self, name: str, make: Callable[[], Job], feedback: Feedback, goals: tuple[Pose2D, ...] = ()) -> Done:
        """Make the job off the loop, run it and wait for its end; a failure is raised under its own name."""
        robot, control, began = self._robot, self._robot.control, self._robot.now()
        robot.refuse_if_busy()
        pose_filter, stops = control.goal_filter, robot.stops
        job = await robot.off_loop(make)
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
        return Done(running.last, outcome, round(robot.now() - began, 1))

    def trip(self, topo_map: TopoMap, goal: Pose2D) -> Job:
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
