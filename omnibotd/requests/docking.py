"""Docks: save them, dock, leave the dock, and measure how well that goes."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from omnibotd.control import Feedback
from omnibotd.control_protocol import RpcError
from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.docking.approach import Limits
from omnibotd.core.docking.docker import DockingParameters, staging_pose
from omnibotd.core.docking.glance import Glance
from omnibotd.core.docking.sightings import agree
from omnibotd.core.docking.trials import Spread, Trial, Trials, offsets, summary
from omnibotd.core.docking.undocking import ProvenUndocking, Undocking
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D
from omnibotd.core.jobs import Job
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.io.control_server import Session
from omnibotd.presets import DockingTask, preset_of
from omnibotd.requests.params import Params, pose_values
from omnibotd.requests.robot import Method, Robot
from omnibotd.requests.running import Done, Runner

MAX_TRIALS = 1000  # half a minute each: a night
IN_DOCK = 0.3  # m from its pose within which a robot is in the dock and may not turn round
HELD, HELD_YAW = 0.1, math.radians(10.0)  # m, rad within which a robot is held by its dock, contact or not
UNMOVED, UNMOVED_YAW = 0.005, math.radians(0.5)  # m, rad of odometry that are none


@dataclass(frozen=True, slots=True)
class Docked:
    """Where a job left the robot docked."""

    name: str
    odom_from_base: Pose2D
    dock_from_base: Pose2D


class Arrived:
    """A trip that is over before it began."""

    def step(self, seen: Observation) -> Decision:
        """Done."""
        return Decision("ARRIVING", outcome=Outcome(None, "there"))


class Docking:
    """`dock`, `undock` and `dock --trials`."""

    def __init__(self, robot: Robot, runner: Runner) -> None:
        self._robot, self._runner = robot, runner
        self._docked: Docked | None = None

    def methods(self) -> dict[str, Method]:
        return {"dock": self._dock, "undock": self._undock}

    def docked_at(self, name: str) -> Pose2D | None:
        """The dock_from_base at which it docked there, None where it did not, or its wheels have turned since."""
        here, docked = self._robot.control.odometry.odom_from_base, self._docked
        if docked is None or docked.name != name or not agree(docked.odom_from_base, here, UNMOVED, UNMOVED_YAW):
            return None
        return docked.dock_from_base

    def resting_in(self) -> str | None:
        """The dock in which the robot seems to rest with nothing to do, by a method that measures in metres."""
        robot = self._robot
        topo_map, latest = robot.perception.topo_map, robot.base.latest
        if not robot.recogniser.idle() or topo_map is None or topo_map.method == "thesis":
            return None
        # A contact that is open tells that it is not in its dock; a base that has none tells nothing.
        return None if latest is None or latest.charging is False else self._likely()

    async def _dock(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        name = params.name("name") if "name" in params else None
        trials = params.whole("trials", None, 1, MAX_TRIALS) if "trials" in params else None
        params.end()
        name = self._known(name)
        if trials is not None:
            return await self._measure(name, trials, feedback)
        goal = self._map().docks[name].map_from_dock
        done = await self._runner.run("dock", lambda: self._trip(name), feedback, (staging_pose(goal),))
        self._remember(name, done)
        return {
            "dock": name,
            "seconds": done.seconds,
            "retries": done.last.recoveries,
            "offset": pose_values(_offset(done.outcome.report)),
            "message": done.outcome.message,
            "report": dict(done.outcome.report),
        }

    async def _measure(self, name: str, count: int, feedback: Feedback) -> dict[str, Any]:
        parameters = self._parameters()
        limits = Limits(parameters.max_linear_velocity, parameters.max_angular_velocity, 0.0, 0.0)
        starts = offsets(count, random.getrandbits(32))
        job = Trials(starts, limits, lambda: self._trip(name), lambda: self._short(name))

        def progress(values: dict[str, Any]) -> None:
            docked = sum(trial.error is None for trial in job.trials)
            retries = values.pop("number_of_recoveries")
            number = min(len(job.trials) + 1, count)
            feedback({**values, "trial": number, "trials": count, "docked": docked, "retries": retries})

        done = await self._runner.run("dock", lambda: job, progress)
        if job.trials[-1].error is None:
            self._remember(name, done)
        spreads = summary(job.trials)
        return {
            "dock": name,
            "seconds": done.seconds,
            "trials": [_trial(number, trial) for number, trial in enumerate(job.trials, 1)],
            "docked": sum(trial.error is None for trial in job.trials),
            "mean": {key: _rounded(spread, "mean") for key, spread in spreads.items()},
            "sd": {key: _rounded(spread, "sd") for key, spread in spreads.items()},
        }

    async def _undock(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        params.end()
        latest = self._robot.base.latest
        name = self._likely()
        make = self._undocking
        if not (latest is not None and latest.charging):
            if name is None:
                raise RpcError.named(ErrorName.NOT_DOCKED, "not docked: not charging, and no dock of the map is near")
            make = partial(self._proven, name)
        began = self._robot.control.odometry.odom_from_base
        done = await self._runner.run("undock", make, feedback)
        back = began.distance(self._robot.control.odometry.odom_from_base)
        return {"dock": name, "seconds": done.seconds, "distance_m": round(back, 3)}

    # ---- jobs

    def _trip(self, name: str) -> Job:
        """Docks from anywhere; off the loop, or in a control tick for a map in use."""
        topo_map = self._map()
        pose = topo_map.docks[name].map_from_dock
        glance = Glance(name, IN_DOCK, by_touch=self._can_only_be_in(name)) if self._may_be_in(pose) else None
        task = DockingTask(name, pose, self._parameters(), self._robot.control.goal_filter, glance)
        return preset_of(topo_map).docking(partial(self._runner.trip, topo_map), task)

    def _short(self, name: str) -> Job:
        """Docks from about the staging pose, whatever the map thinks."""
        topo_map = self._map()
        task = DockingTask(name, topo_map.docks[name].map_from_dock, self._parameters())
        return preset_of(topo_map).docking(lambda goal: Arrived(), task)

    def _undocking(self) -> Job:
        parameters = self._parameters()
        return Undocking(Limits(parameters.max_linear_velocity, parameters.max_angular_velocity, 0.0, 0.0))

    def _proven(self, name: str) -> Job:
        by_memory = self.docked_at(name) is not None
        return ProvenUndocking(Glance(name, HELD, HELD_YAW), self._undocking(), by_memory=by_memory)

    def _parameters(self) -> DockingParameters:
        base, usual = self._robot.config.base, DockingParameters()
        return DockingParameters(
            max_linear_velocity=min(usual.max_linear_velocity, base.max_linear_velocity),
            max_angular_velocity=min(usual.max_angular_velocity, base.max_angular_velocity),
            max_retries=self._robot.config.docking.max_retries,
        )

    # ---- which dock

    def _map(self) -> TopoMap:
        return self._robot.active_map()

    def _known(self, name: str | None) -> str:
        """The dock that is meant: named, or the only one."""
        docks = self._map().docks
        if name is None and len(docks) == 1:
            return next(iter(docks))
        if name is None or name not in docks:
            known = ", ".join(sorted(docks)) or "none; stand the robot in its dock and say dock save NAME"
            told = "say which dock" if name is None and docks else f"dock {name or ''!r} is not saved"
            raise RpcError.named(ErrorName.DOCK_NOT_IN_DB, f"{told}; docks of this map: {known}")
        return name

    def _likely(self) -> str | None:
        """The dock in which the robot stands if it stands in one: where it docked, the nearest, or the only one."""
        topo_map = self._robot.perception.topo_map
        docks = {} if topo_map is None else topo_map.docks
        if self._docked is not None and self._docked.name in docks and self.docked_at(self._docked.name) is not None:
            return self._docked.name
        here = self._robot.known_pose()
        if here is None:
            return next(iter(docks)) if len(docks) == 1 else None
        near = {name: dock.map_from_dock.distance(here) for name, dock in docks.items()}
        nearest = min(near, key=lambda name: near[name], default=None)
        return nearest if nearest is not None and near[nearest] < 2 * IN_DOCK else None

    def _may_be_in(self, map_from_dock: Pose2D) -> bool:
        """Whether to look before going anywhere: the map puts the robot there, doesn't know, or the base charges."""
        here, latest = self._robot.known_pose(), self._robot.base.latest
        charging = latest is not None and bool(latest.charging)
        return charging or here is None or here.distance(map_from_dock) < IN_DOCK

    def _can_only_be_in(self, name: str) -> bool:
        """Whether a robot that charges in the dark must be in this dock: so say wheels, map, or want of another one."""
        here, docks = self._robot.known_pose(), self._map().docks
        if self.docked_at(name) is not None:
            return True
        return len(docks) == 1 if here is None else here.distance(docks[name].map_from_dock) < IN_DOCK

    def _remember(self, name: str, done: Done) -> None:
        pose = _offset(done.outcome.report) or Pose2D()
        self._docked = Docked(name, self._robot.control.odometry.odom_from_base, pose)


def _offset(report: Mapping[str, float | str]) -> Pose2D | None:
    """Where the base stands in the dock, by an outcome's report."""
    if "dock_x" not in report:
        return None
    return Pose2D(*(float(report[key]) for key in ("dock_x", "dock_y", "dock_yaw")))


def _trial(number: int, trial: Trial) -> dict[str, Any]:
    return {
        "trial": number,
        "start": pose_values(trial.start),
        "seconds": round(trial.seconds, 1),
        "retries": trial.retries,
        "offset": pose_values(trial.offset),
        "result": "DOCKED" if trial.error is None else trial.error.value,
        "message": trial.message,
    }


def _rounded(spread: Spread | None, key: str) -> float | None:
    return None if spread is None else round(float(getattr(spread, key)), 5)
