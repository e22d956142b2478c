"""Driving by hand, and `stop`, which is always accepted."""

from __future__ import annotations

import asyncio
import logging
from functools import partial
from typing import Any

from omnibotd.control import PERIOD, Feedback, Teleop
from omnibotd.control_protocol import RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Twist2D
from omnibotd.io.control_server import Session
from omnibotd.requests.params import Params, invalid
from omnibotd.requests.robot import Method, Robot
from omnibotd.requests.teaching import Teaching

log = logging.getLogger(__name__)


class Driving:
    """A set-point holds for a moment: a hand that lets go, or a client that goes away, stops the robot."""

    def __init__(self, robot: Robot, teaching: Teaching) -> None:
        self._robot, self._teaching = robot, teaching

    def methods(self) -> dict[str, Method]:
        return {
            "drive": self._drive,
            "stop": self._stop,
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
        self._robot.stops += 1
        self._robot.control.halt("stopped on request")
        self._teaching.cancel_training()
        return {}
