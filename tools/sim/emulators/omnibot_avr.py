"""The native base as it is: the compiled firmware in simavr, kept at the pace of the owner's clock.

Motors and encoders are simulated on the MCU's pins; the floor below them is the owner's.
"""

from __future__ import annotations

from typing import Unpack

from firmware_bridge.emulator import Senses
from tools.avr.building import BuildError, ToolsMissing
from tools.avr.robot import UNO, AvrRobot, Board

SimulatorMissing = (ToolsMissing, BuildError)
MAX_STEP = 0.1  # s; after a stall of this process the MCU has missed the time, as the emulator's wheels have


class AvrDevice:
    """A powered board. `turned` tells how far its wheels have gone; nobody else turns them."""

    def __init__(self, board: Board = UNO) -> None:
        """SimulatorMissing says what is not installed, or what the compiler said."""
        self._robot = AvrRobot(board)
        self._now: float | None = None

    @property
    def turned(self) -> tuple[int, int]:
        """Encoder edges (left, right) since power-up."""
        return self._robot.ticks

    @property
    def target(self) -> tuple[float, float]:
        """Speeds of the wheels that are driven, 0 of those that coast; what was asked for, only the firmware knows."""
        left, right = (speed if duty else 0.0 for speed, duty in zip(self._robot.speeds, self._robot.duty, strict=True))
        return left, right

    def set_state(self, left_ticks: int, right_ticks: int, **senses: Unpack[Senses]) -> None:
        """Bumpers, contact and battery; the board has no other senses."""
        self._robot.bump(senses.get("bumper_left", False), senses.get("bumper_right", False))
        self._robot.dock(bool(senses.get("charging")))
        self._robot.battery(senses.get("battery_mv", 12_000) / 1000.0)

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes from the host; they reach the MCU at the speed of the line."""
        self._robot.send(data)

    def poll(self, now: float) -> None:
        """Let the MCU run until now."""
        if self._now is not None:
            self._robot.run(min(max(now - self._now, 0.0), MAX_STEP))
        self._now = now

    def data_to_send(self) -> bytes:
        """What the UART has sent."""
        return self._robot.receive()

    def reset(self, nonce: int) -> None:
        """The reset button; the firmware makes its own nonce."""
        self._robot.reset()
