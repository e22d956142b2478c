"""What a client may ask: the methods of the control socket."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

from omnibotd.calibrations import CalibrationError
from omnibotd.control import Feedback
from omnibotd.control_protocol import METHOD_NOT_FOUND, RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.core.errors import CoreError
from omnibotd.io.control_server import Session
from omnibotd.io.map_store import MapStoreError
from omnibotd.io.recorder import Recorder
from omnibotd.io.recording import RecordingError
from omnibotd.lens_fitting import LensFitter, fit_in_child
from omnibotd.requests.calibrating import Calibrating
from omnibotd.requests.dock_views import DockViews
from omnibotd.requests.dock_watch import DockWatch
from omnibotd.requests.docking import Docking
from omnibotd.requests.doctor import Doctor
from omnibotd.requests.driving import Driving
from omnibotd.requests.failures import Failures
from omnibotd.requests.jobs import Jobs
from omnibotd.requests.lens import LensCalibration
from omnibotd.requests.map_files import MapFiles
from omnibotd.requests.maps import Maps, Pruner
from omnibotd.requests.params import Params
from omnibotd.requests.places import Places
from omnibotd.requests.robot import Robot
from omnibotd.requests.running import Runner
from omnibotd.requests.status import Status
from omnibotd.requests.teaching import Teaching, Trainer
from omnibotd.requests.trail import Trail

# Asked for while a map is being made ready, as in the first seconds after a boot, these wait for it.
_NEED_THE_MAP = frozenset({"goto", "route", "relocalise", "dock", "undock"})


class Requests:
    """Answers requests; long ones when their job has ended."""

    def __init__(
        self,
        robot: Robot,
        trainer: Trainer,
        pruner: Pruner,
        open_recorder: Callable[[Path], Recorder],
        fit_lens: LensFitter = fit_in_child,
    ) -> None:
        self.teaching = Teaching(robot, trainer, open_recorder)
        self.trail = Trail(robot)
        self._robot = robot
        failures = Failures(robot)
        runner = Runner(robot, failures)
        docking = Docking(robot, runner)
        self.dock_watch = DockWatch(robot, docking)
        groups = (
            Status(robot, self.teaching, failures),
            Doctor(robot),
            Driving(robot, self.teaching),
            self.teaching,
            Maps(robot, self.teaching, self.trail, pruner),
            MapFiles(robot),
            Places(robot),
            Jobs(robot, runner),
            docking,
            DockViews(robot, docking),
            Calibrating(robot, runner),
            LensCalibration(robot, runner, fit_lens),
        )
        self._tasks: set[asyncio.Task[dict[str, Any]]] = set()
        self._methods = {name: method for group in groups for name, method in group.methods().items()}

    async def dispatch(
        self, session: Session | None, method: str, params: dict[str, Any], feedback: Feedback
    ) -> dict[str, Any]:
        """Answer one request. Raises RpcError, whose code is the client's exit code."""
        if method not in self._methods:
            known = ", ".join(self._methods)
            raise RpcError(METHOD_NOT_FOUND, ErrorName.INVALID, f"no method {method!r}; there are {known}")
        try:
            return await self._whole(self._answer(method, Params(params), session, feedback))
        except (MapStoreError, RecordingError, CalibrationError) as error:
            raise RpcError.named(ErrorName.STORAGE, str(error)) from error
        except CoreError as error:
            raise RpcError.named(ErrorName.NO_MAP, str(error)) from error

    async def _answer(self, method: str, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        if method in _NEED_THE_MAP:
            await self._robot.until_loaded()
        return await self._methods[method](params, session, feedback)

    async def _whole(self, work: Coroutine[Any, Any, dict[str, Any]]) -> dict[str, Any]:
        """A client that goes away leaves its request running: a map half edited or a file half closed helps nobody.

        What must not outlive its client (driving by hand) hears of its end through the session.
        """
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._done)
        return await asyncio.shield(task)

    def _done(self, task: asyncio.Task[dict[str, Any]]) -> None:
        self._tasks.discard(task)
        if not task.cancelled():
            task.exception()  # seen: whoever still waits gets it, and nobody else is owed it
