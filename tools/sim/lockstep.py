"""A simulated robot whose time is told by the daemon's set-points: for a daemon on a machine slower than real time.

A set-point of the native protocol says what the base's clock showed when it was sent, by the daemon's own clock since
the last telemetry. Each lets the world live on until then, so wheels, telemetry and pictures keep step with the daemon
however slowly it gets on. While none comes (it starts, hangs, or its cable is pulled) the owner calls `idle`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

import cv2

from firmware_bridge import messages
from firmware_bridge.device import OmnibotDevice
from firmware_bridge.framing import Decoder
from tools.sim.plant import Body, Pose, SimulatedRobot
from tools.sim.world_plugin import World

STEP = 0.02  # s, the period of telemetry
GREETING_STEPS = 2  # of life at each greeting: the first telemetry answers it, and only then there are set-points
LONGEST = 1.0  # s that one set-point may let pass; a daemon that stood still so long gives up its link
STEPS_A_FRAME = 10  # 5 pictures a second, what recordings keep
JPEG_QUALITY = 85


class LockstepRobot:
    """A body in a world behind the native protocol. `seconds` is how long it has lived.

    `on_picture` is given a JPEG every STEPS_A_FRAME, `on_tick` is called after each tick.
    """

    def __init__(self, world: World, pose: Pose, seed: int, on_picture: Callable[[bytes], None]) -> None:
        self._world, self._on_picture = world, on_picture
        self._plant = SimulatedRobot(world, pose, seed, Body())
        self._device = OmnibotDevice(Body().ticks_per_rev, seed)
        self._device.poll(0.0)  # it boots with the world
        self._listener = Decoder()
        self._steps = 0
        self._ticks = [0, 0]
        self.on_tick: Callable[[], None] = lambda: None

    @property
    def seconds(self) -> float:
        return self._steps * STEP

    @property
    def pose(self) -> Pose:
        """Where it truly is."""
        return self._plant.pose

    @property
    def driven(self) -> bool:
        """Whether a set-point other than zero is in force."""
        return self._device.target != (0, 0)

    @property
    def at_dock(self) -> bool:
        return self._plant.at_dock()

    def receive(self, data: bytes) -> bytes:
        """Bytes from the daemon; what the base answers. A set-point holds from the moment that it tells."""
        sent, greeted = b"", False
        for message in self._messages(data):
            greeted = greeted or isinstance(message, messages.Hello)
            if isinstance(message, messages.SetPoint):
                sent += self._live(self._steps_until(message.mcu_us))
                self.on_tick()
        self._device.receive(data, self.seconds)
        return sent + self._live(GREETING_STEPS if greeted else 0)

    def idle(self, seconds: float) -> bytes:
        """Live on without a set-point; the bytes that the base sends meanwhile."""
        return self._live(round(seconds / STEP))

    def _live(self, steps: int) -> bytes:
        sent = b""
        for _ in range(steps):
            self._steps += 1
            left, right = self._plant.step(STEP, *self._device.target)
            self._ticks = [self._ticks[0] + left, self._ticks[1] + right]
            bumper_left, bumper_right = self._plant.bumpers
            self._device.set_state(
                *self._ticks, bumper_left=bumper_left, bumper_right=bumper_right, charging=self._plant.at_dock()
            )
            self._device.poll(self.seconds)
            sent += self._device.data_to_send()
            if self._steps % STEPS_A_FRAME == 0:
                self._on_picture(self._photograph())
        return sent + self._device.data_to_send()

    def _steps_until(self, mcu_us: int) -> int:
        """Whole steps to the moment, rounded so that the world neither gains nor loses; both clocks began at once."""
        ahead = (mcu_us - int(self.seconds * 1e6) + 2**31) % 2**32 - 2**31
        return max(0, round(min(ahead * 1e-6, LONGEST) / STEP))

    def _messages(self, data: bytes) -> Iterator[messages.Message]:
        for frame in self._listener.feed(data):
            with contextlib.suppress(messages.MalformedMessage):
                yield messages.parse(frame)

    def _photograph(self) -> bytes:
        image = self._world.render(*self._plant.pose, self.seconds)
        return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes())
