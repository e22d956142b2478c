"""The firmware as the device role of a simulated robot, in the place of `firmware_bridge.device.OmnibotDevice`."""

from __future__ import annotations

from tools.avr.boards import UNO, Board
from tools.avr.robot import FULL_SPEED, LEFT, RIGHT, AvrRobot

MIN_PERIOD = 0.001  # s; ticks are spread over the time between two states, and there is some


class AvrDevice:
    """Takes the place of an OmnibotDevice: the same calls, but an AVR runs up to the time that each of them names.

    The owner's wheels are the motors: `target` is the speed that the PWM of now would turn them at in the end. The boot
    nonce is the firmware's own. Close it after use.
    """

    def __init__(self, board: Board = UNO, *, full_speed: float = FULL_SPEED) -> None:
        """`full_speed`: ticks/s of the wheels at full PWM. building.ToolsMissing, building.BuildError."""
        self.robot = AvrRobot(board)
        self._full_speed = full_speed
        self._powered_at: float | None = None
        self._state_at = 0.0
        self._senses: tuple[bool, bool, bool, int] | None = None

    def close(self) -> None:
        self.robot.close()

    @property
    def target(self) -> tuple[float, float]:
        """Wheel speeds (left, right), ticks/s, that the motors strive for as they are driven now."""
        left, right = self.robot.duty
        return left * self._full_speed, right * self._full_speed

    def reset(self, nonce: int) -> None:
        """Presses the reset button; which boot it is (`nonce`) the firmware knows better."""
        self.robot.reset()

    def receive(self, data: bytes, now: float) -> None:
        """Bytes from the host: they begin to arrive at `now`."""
        self.poll(now)
        self.robot.send(data)

    def poll(self, now: float) -> None:
        """Lets the firmware run up to `now`; its clock starts at the first call, as it is powered up."""
        if self._powered_at is None:
            self._powered_at = now - self.robot.now
        self.robot.run_until(now - self._powered_at)

    def data_to_send(self) -> bytes:
        """What the firmware has said."""
        return self.robot.receive()

    def set_state(
        self,
        left_ticks: int,
        right_ticks: int,
        *,
        bumper_left: bool = False,
        bumper_right: bool = False,
        cliff: bool = False,
        wheel_drop: bool = False,
        charging: bool | None = None,
        battery_mv: int = 12000,
        range_ahead: float | None = None,
    ) -> None:
        """What the body does now. The wheels make up for the new ticks over the next period, edge by edge.

        The board has no sensor for `cliff`, `wheel_drop` and `range_ahead`.
        """
        period = max(self.robot.now - self._state_at, MIN_PERIOD)
        self._state_at = self.robot.now
        self.robot.roll(LEFT, left_ticks, period)
        self.robot.roll(RIGHT, right_ticks, period)
        senses = (bumper_left, bumper_right, bool(charging), battery_mv)
        if senses != self._senses:
            self._senses = senses
            self.robot.bump(bumper_left, bumper_right)
            self.robot.dock(bool(charging))
            self.robot.battery(battery_mv / 1000.0)
