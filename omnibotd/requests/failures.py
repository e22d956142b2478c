"""Failed jobs are kept with what the robot saw, so that it can be asked afterwards why."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Sequence
from datetime import datetime
from typing import Any

from omnibotd.core.decision import Outcome
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D
from omnibotd.core.vision.frame import Frame
from omnibotd.io.failures import FailureStore
from omnibotd.requests.params import pose_values
from omnibotd.requests.robot import Robot

log = logging.getLogger(__name__)

# What the way, the map or the view is to blame for. A pulled plug or a pressed button needs no picture.
KEPT = {
    ErrorName.LOST,
    ErrorName.BLOCKED,
    ErrorName.NO_ROUTE,
    ErrorName.TIMEOUT,
    ErrorName.FAILED_TO_STAGE,
    ErrorName.FAILED_TO_DETECT_DOCK,
    ErrorName.FAILED_TO_CONTROL,
    ErrorName.FAILED_TO_CHARGE,
}
_TOLD = ("time", "job", "error", "message", "file")


class Failures:
    """Keeps the newest; `last` is what `status` tells of the newest one, None before the first."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._store = FailureStore(robot.store.directory / "failures")
        self.last = _told(self._store.last())

    async def keep(self, job: str, outcome: Outcome, goals: Sequence[Pose2D]) -> None:
        """Write report and picture of a job that failed; a full disk is logged and spoils nothing else."""
        if outcome.error not in KEPT:
            return
        facts = self._facts(job, outcome, goals)
        self.last = _told(facts)
        try:
            facts["file"] = await asyncio.to_thread(self._write, facts, self._robot.camera.latest)
        except OSError as error:
            log.error("the report of the failed %s is not kept: %s", job, error)
            return
        self.last = _told(facts)

    def _write(self, facts: dict[str, Any], frame: Frame | None) -> str:
        return str(self._store.save(facts, frame.jpeg() if frame is not None else None))

    def _facts(self, job: str, outcome: Outcome, goals: Sequence[Pose2D]) -> dict[str, Any]:
        topo_map, control = self._robot.perception.topo_map, self._robot.control
        return {
            "time": datetime.now().astimezone().isoformat(timespec="seconds"),
            "job": job,
            "error": str(outcome.error),
            "message": outcome.message,
            "map": topo_map.name if topo_map else None,
            "goals": [pose_values(goal) for goal in goals],
            "pose": pose_values(control.map_from_base),
            "odometry": pose_values(control.odometry.odom_from_base),
            "report": dict(outcome.report),
        }


def _told(facts: dict[str, Any] | None) -> dict[str, Any] | None:
    return None if facts is None else {key: facts.get(key) for key in _TOLD}
