"""One robot's way through an experiment: its jobs, each with the truth beside it, and every estimate it makes."""

from __future__ import annotations

import asyncio
import math
import random
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from omnibotd.control import Feedback
from omnibotd.control_protocol import RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D
from omnibotd.core.percept import PlaceEstimate
from tools.evaluation.calibration import Estimate
from tools.evaluation.lessons import Taught
from tools.evaluation.summary import ARRIVED, Run
from tools.sim.conditions import DISTURBED, Stage, expanded
from tools.sim.teacher import CLEARANCE, TRIES, Area, NoWay, free_point

RUN_LIMIT = 600.0  # s; the daemon gives up well before, so this only ends what hangs
SETTLE = 1.0  # s for the wheels to stand before the truth is read
PUT_DOWN = 2.0  # s between putting the robot somewhere and asking something of it

Report = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Plan:
    """How often to run, the seed of all that is random, and the conditions that hold after the teaching."""

    runs: int
    seed: int
    conditions: tuple[str, ...] = ()


class Course:
    """Runs jobs of a taught robot; `area` is where it was taught."""

    def __init__(self, taught: Taught, stage: Stage, area: Area, plan: Plan, report: Report) -> None:
        self.robot, self.topo_map, self.truth = taught.robot, taught.topo_map, taught.truth
        self.stage, self.area, self.plan = stage, area, plan
        self.rng = random.Random(plan.seed)
        self.estimates: list[Estimate] = []
        self._report, self._done, self._busy = report, 0, False
        self._condition = "nominal"
        self.answer: dict[str, Any] = {}  # to the last request that succeeded
        self.robot.overhear(self._note)

    def enter(self, *conditions: str, number: int = 0) -> None:
        """From now on these hold beside those of the plan; `number` of the run, where its conditions change with it."""
        together = tuple(dict.fromkeys((*self.plan.conditions, *conditions)))
        holding = expanded(together, number)
        self.stage.enter(holding, number)
        own = (DISTURBED, *holding[:1]) if DISTURBED in together else together
        self._condition = ",".join(own) or "nominal"

    async def goto(self, node: int) -> Run:
        """Go to the pose of a node; the goal is where it was taught."""
        pose = self.topo_map.pose(node)
        return await self.run(self.truth.node(node), ARRIVED, "goto", at=[pose.x, pose.y, pose.yaw])

    async def run(self, goal: Pose2D, success: str, method: str, *, limit: float = RUN_LIMIT, **params: Any) -> Run:
        """One job, from asking to standing still."""
        loop = asyncio.get_running_loop()
        start, began = self.robot.pose, loop.time()
        error = await self.ask(method, limit, **params)
        seconds = loop.time() - began
        await asyncio.sleep(SETTLE)
        return self.ended(start, goal, seconds, error or success)

    async def ask(self, method: str, limit: float, feedback: Feedback | None = None, **params: Any) -> RpcError | None:
        """One request; its estimates count. Returns why it failed, TIMEOUT after `limit` s."""
        self._busy = True
        try:
            async with asyncio.timeout(limit):
                self.answer = await self.robot.daemon.call(method, params, feedback)
        except RpcError as error:
            return error
        except TimeoutError:
            await self.robot.call("stop")
            return RpcError.named(ErrorName.TIMEOUT, f"{method} was still busy after {limit:.0f} s")
        finally:
            self._busy = False
        return None

    def ended(self, start: Pose2D, goal: Pose2D, seconds: float, how: str | RpcError) -> Run:
        """A run that ends here and now."""
        run = Run(start, goal, self.robot.pose, seconds, str(how), self._condition)
        if isinstance(how, RpcError):
            return replace(run, result=how.name.value, message=how.message, report=how.report)
        return replace(run, report=self.answer.get("report", {}))

    def tell(self, run: Run) -> Run:
        """Report a run that counts."""
        self._done += 1
        degrees = math.degrees(run.error_rad)
        what = f"{run.result} {run.error_m:.3f} m {degrees:.2f} deg in {run.seconds:.1f} s"
        self._report(f"{self._done} {what}")
        return run

    def any_node(self) -> int:
        return self.rng.randrange(len(self.topo_map))

    def any_pose(self) -> Pose2D:
        """Free, in the taught area, at any heading."""
        return Pose2D(*free_point(self.robot.world, self.area, self.rng), self.rng.uniform(-math.pi, math.pi))

    def any_pose_where(self, wanted: Callable[[Pose2D], bool]) -> Pose2D:
        """Free, anywhere in the world, at any heading. Raises NoWay where none of many is wanted."""
        xmin, ymin, xmax, ymax = self.robot.world.bounds
        for _ in range(TRIES):
            pose = Pose2D(
                self.rng.uniform(xmin, xmax), self.rng.uniform(ymin, ymax), self.rng.uniform(-math.pi, math.pi)
            )
            if self.robot.world.free(pose.x, pose.y, CLEARANCE) and wanted(pose):
                return pose
        raise NoWay(f"no fitting free floor found in {self.robot.world.bounds} in {TRIES} tries")

    async def put(self, pose: Pose2D) -> None:
        """Carry the robot there while it has nothing to do."""
        self.robot.teleport(pose)
        await asyncio.sleep(PUT_DOWN)

    def _note(self, place: PlaceEstimate) -> None:
        if self._busy:
            believed = self.truth.world_from(place.map_from_base, place.node)
            error = believed.distance(self.robot.true_pose_at(place.stamp))
            self.estimates.append(Estimate(place.confidence, error))
