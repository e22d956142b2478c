"""`calibrate spin` and `calibrate base`: the robot moves, looks at the ceiling, and says what it learnt of itself."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Protocol, TypeVar

from omnibotd.calibration_process import spin_in_child, wheels_in_child
from omnibotd.calibrations import NEXT_START
from omnibotd.control import Feedback
from omnibotd.control_protocol import RpcError
from omnibotd.core.calibration.looks import Look, Looks
from omnibotd.core.calibration.motions import BaseMotion, CalibrationMotion, SpinMotion
from omnibotd.core.calibration.wheels import Scale, WheelsResult
from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.error_name import ErrorName
from omnibotd.core.errors import CoreError
from omnibotd.core.percept import Verdict
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.io.control_server import Session
from omnibotd.requests.params import Params, invalid
from omnibotd.requests.robot import Method, Robot
from omnibotd.requests.running import Runner

log = logging.getLogger(__name__)

ESTIMATING = "ESTIMATING"
INTERNAL_ERROR = Outcome(ErrorName.CALIBRATION_FAILED, "internal error in the calibration, see the log")


class Judged(Protocol):
    """A measurement that knows whether it is worth anything."""

    @property
    def verdict(self) -> Verdict: ...

    @property
    def sentence(self) -> str: ...


R = TypeVar("R", bound=Judged)


class Measurement:
    """Makes a motion, then stands until the estimate made of it has set `ending`: nothing else may start meanwhile."""

    def __init__(self, motion: CalibrationMotion) -> None:
        self._motion = motion
        self.moved = asyncio.Event()
        self.ending: Outcome | None = None

    @property
    def progress(self) -> float:
        return self._motion.progress

    def step(self, seen: Observation) -> Decision:
        """One tick."""
        if not self.moved.is_set():
            decision = self._motion.step(seen)
            if decision.outcome is None or decision.outcome.error is not None:
                return decision
            self.moved.set()
        return Decision(ESTIMATING, outcome=self.ending)


class Calibrating:
    """One measurement at a time, as any job: `stop` ends it, and nothing is stored then."""

    def __init__(self, robot: Robot, runner: Runner) -> None:
        self._robot, self._runner = robot, runner
        self._wheels: WheelsResult | None = None  # of the last drive

    def methods(self) -> dict[str, Method]:
        return {"calibrate.spin": self._spin, "calibrate.base": self._base}

    async def _spin(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        params.end()
        camera = self._camera()
        motion = SpinMotion(self._robot.control.limits)
        result = await self._measure("calibrate spin", motion, partial(spin_in_child, camera=camera), feedback)
        values = {
            "centre": [round(float(value), 3) for value in result.centre],
            "tilt": [round(float(value), 6) for value in result.tilt],
            "tilt_deg": round(math.degrees(math.hypot(*result.tilt)), 3),
            "centre_sigma_px": round(float(result.centre_sigma), 3),
            "tilt_sigma_deg": round(math.degrees(result.tilt_sigma), 4),
        }
        data = f"{result.frames} frames of a turn by {math.degrees(result.turned):.0f} degrees"
        return self._kept("spin", values, f"{result.residual:.2f} px", data, result.sentence)

    async def _base(self, params: Params, session: Session | None, feedback: Feedback) -> dict[str, Any]:
        distance = params.number("distance") if "distance" in params else None
        params.end()
        result = await self._rolled(feedback) if distance is None else self._taped(distance)
        values: dict[str, Any] = {
            "wheel_radius": round(float(result.radius_left + result.radius_right) / 2.0, 6),
            "wheel_ratio": round(float(result.radius_left / result.radius_right), 6),
            "wheel_separation": round(float(result.separation), 5),
            "ratio_sigma": round(float(result.ratio_sigma), 6),
            "separation_sigma": round(float(result.separation_sigma), 5),
            "scale": str(result.scale),
        }
        if result.scale is not Scale.NOMINAL:  # else it is what was configured, and nobody knows how good that is
            values["radius_sigma"] = round(float(result.radius_sigma), 5)
        data = f"{math.degrees(result.turned):.0f} degrees turned, {result.driven:.1f} m driven"
        return self._kept("base", values, f"{result.residual:.1f} times the usual errors", data, result.sentence)

    async def _rolled(self, feedback: Feedback) -> WheelsResult:
        camera, drive = self._camera(), self._robot.control.drive
        height = self._robot.config.docking.ceiling_height
        motion = BaseMotion(self._robot.control.limits)
        estimate = partial(wheels_in_child, camera=camera, drive=drive, ceiling_height=height)
        self._wheels = None  # whatever comes of this drive, a tape can't measure the one before any more
        self._wheels = await self._measure("calibrate base", motion, estimate, feedback)
        return self._wheels

    def _taped(self, distance: float) -> WheelsResult:
        """The last drive, whose length somebody has measured since."""
        if not 0.1 <= distance <= 10.0:
            raise invalid(f"distance: {distance:g} given, expected metres from 0.1 to 10")
        if self._wheels is None:
            told = (
                "mark where the robot stands, say calibrate base, and measure with a tape how far off the mark it ends"
            )
            raise RpcError.named(ErrorName.INVALID, f"there is no drive to measure yet: {told}")
        result = self._wheels.with_distance(distance)
        if result.verdict is not Verdict.ACCEPTED:
            raise RpcError.named(ErrorName.CALIBRATION_FAILED, result.sentence)
        return result

    async def _measure(
        self,
        name: str,
        motion: CalibrationMotion,
        estimate: Callable[[tuple[Look, ...]], R],
        feedback: Feedback,
    ) -> R:
        """Move, showing every frame to the collection, then estimate. Raises RpcError where nothing good came of it."""
        job, looks, perception = Measurement(motion), Looks(), self._robot.perception

        def progress(values: dict[str, Any]) -> None:
            told = {key: values[key] for key in ("state", "navigation_time")}
            feedback({**told, "progress": job.progress, "frames": len(looks.kept)})

        if perception.witness is not None:
            raise RpcError.named(ErrorName.BUSY, "another calibration is looking at the frames; say stop first")
        perception.witness = looks.take
        running = asyncio.ensure_future(self._runner.run(name, lambda: job, progress))
        try:
            await _first(running, job.moved)
        finally:
            perception.witness = None
        result = None if running.done() else await self._estimated(job, estimate, looks.kept)
        await running  # raises how it ended, unless well
        assert result is not None, "a job that ended well has its result"
        return result

    async def _estimated(
        self, job: Measurement, estimate: Callable[[tuple[Look, ...]], R], looks: tuple[Look, ...]
    ) -> R | None:
        """In a thread of its own: the worker goes on saying where the robot is. Sets how the job ends."""
        try:
            result = await asyncio.to_thread(estimate, looks)
        except CoreError as error:
            job.ending = Outcome(ErrorName.CALIBRATION_FAILED, str(error))
            return None
        except Exception:  # our own bug must not leave the robot waiting for its estimate for ever
            log.exception("estimate failed")
            job.ending = INTERNAL_ERROR
            return None
        good = result.verdict is Verdict.ACCEPTED
        job.ending = Outcome(None if good else ErrorName.CALIBRATION_FAILED, result.sentence)
        return result

    def _kept(self, name: str, values: Mapping[str, Any], residual: str, data: str, sentence: str) -> dict[str, Any]:
        """Store the result and tell of it."""
        file = self._robot.stored().keep(name, {"residual": residual, "data": data, **values})
        told = {"calibration": name, "file": str(file), "residual": residual, "data": data, **values}
        return {**told, "message": sentence, "effect": NEXT_START}

    def _camera(self) -> CameraModel:
        """The lens in force; refused before anything moves where a result could not be had or kept."""
        self._robot.refuse_if_busy()
        self._robot.refuse_if_unsafe()
        self._robot.stored()
        camera, now = self._robot.camera, self._robot.now()
        model = self._robot.perception.model
        if model is None or not camera.ok(now):
            raise RpcError.named(ErrorName.CAMERA_DOWN, f"no pictures to calibrate by: {camera.reason}")
        return model


async def _first(running: asyncio.Future[Any], moved: asyncio.Event) -> None:
    """Until the motion is made, or the job has ended otherwise."""
    waiting = asyncio.ensure_future(moved.wait())
    await asyncio.wait({running, waiting}, return_when=asyncio.FIRST_COMPLETED)
    waiting.cancel()
