"""A base on a pty: whoever opens a serial port can talk to it, and see it fail."""

from __future__ import annotations

import asyncio
import math
import os
import tty
from collections.abc import Callable
from typing import Generic, Protocol, TypedDict, TypeVar, Unpack

from firmware_bridge.faults import HostileLine

PERIOD = 0.005  # seconds: a quarter of the telemetry period
MAX_STEP = 0.1  # seconds: after a stall of the process the wheels have stood still, not jumped
READ_SIZE = 4096  # all a pty holds


class Wheels(Protocol):
    """What the motors drive: the simulated robot behind the serial line."""

    def step(self, dt: float, left_target: float, right_target: float) -> tuple[int, int]:
        """Advance by `dt` seconds at speeds in ticks/s; returns the encoder counts (left, right) so far."""


class IdealWheels:
    """Both wheels follow their set-points with a first-order lag (seconds), on a floor that never slips."""

    def __init__(self, lag: float = 0.05) -> None:
        self._lag = lag
        self._speeds = [0.0, 0.0]
        self._ticks = [0.0, 0.0]

    def step(self, dt: float, left_target: float, right_target: float) -> tuple[int, int]:
        share = 1.0 - math.exp(-dt / self._lag)
        for side, target in enumerate((left_target, right_target)):
            before = self._speeds[side]
            self._speeds[side] += share * (target - before)
            # Exact integral of the exponential over the step.
            self._ticks[side] += target * dt + self._lag * (before - self._speeds[side])
        return math.floor(self._ticks[0]), math.floor(self._ticks[1])


class Senses(TypedDict, total=False):
    """What contacts, range sensor and battery say; the keywords of `OmnibotDevice.set_state`."""

    bumper_left: bool
    bumper_right: bool
    cliff: bool
    wheel_drop: bool
    charging: bool | None
    battery_mv: int
    range_ahead: float | None


class Device(Protocol):
    """A base without wheels or wire, as `firmware_bridge.device.OmnibotDevice` is one."""

    @property
    def target(self) -> tuple[float, float]:
        """Wheel speeds (left, right), ticks/s, as of the last `receive` or `poll`."""

    def set_state(self, left_ticks: int, right_ticks: int, **senses: Unpack[Senses]) -> None:
        """What the sensors say now; ticks as ideal encoders would have counted them since the start."""

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes from the host."""

    def poll(self, now: float) -> None:
        """Mind time; call at least every 10 ms."""

    def data_to_send(self) -> bytes:
        """Bytes for the host since the last call."""

    def reset(self, nonce: int) -> None:
        """The base reboots; only the native protocol has a use for the nonce."""


D = TypeVar("D", bound=Device)


class Emulator(Generic[D]):
    """Runs a device on the far side of `port`; `to_device`, `to_host`, `silent` and `reset` are its faults.

    At every step `wheels` turn and `senses` is asked. The pty lives from here to the end of `run`, or to
    `close`, which is to a host what pulling the cable is.
    """

    def __init__(
        self,
        device: D,
        wheels: Wheels | None = None,
        senses: Callable[[], Senses] | None = None,
        *,
        seed: int = 0,
    ) -> None:
        self.device = device
        self.silent = False
        self.to_device = HostileLine(seed)
        self.to_host = HostileLine(seed + 1)
        self._wheels = IdealWheels() if wheels is None else wheels
        self._senses: Callable[[], Senses] = Senses if senses is None else senses
        # The slave stays open here: else the master fails whenever no host has the port open.
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._port = os.ttyname(self._slave)
        self._open = True
        self._loop: asyncio.AbstractEventLoop | None = None

    @property
    def port(self) -> str:
        """Path for the host to open."""
        return self._port

    def reset(self, nonce: int) -> None:
        """Reboot the MCU; what it was sending is lost, what is on its way to it arrives after the boot."""
        self.device.reset(nonce)
        self.to_host.clear()

    async def run(self) -> None:
        """Until cancelled or closed."""
        loop = self._loop = asyncio.get_running_loop()
        loop.add_reader(self._master, self._read, loop)
        before = loop.time()
        try:
            while self._open:
                now = loop.time()
                self._step(now, min(now - before, MAX_STEP))
                before = now
                await asyncio.sleep(PERIOD)
        finally:
            self.close()

    def close(self) -> None:
        """Pull the cable; harmless when pulled already."""
        if not self._open:
            return
        self._open = False
        if self._loop is not None:
            self._loop.remove_reader(self._master)
        os.close(self._master)
        os.close(self._slave)

    def _read(self, loop: asyncio.AbstractEventLoop) -> None:
        self.to_device.push(os.read(self._master, READ_SIZE), loop.time())

    def _step(self, now: float, dt: float) -> None:
        for data in self.to_device.pull(now):
            self.device.receive(data, now)
        left, right = self._wheels.step(dt, *self.device.target)
        self.device.set_state(left, right, **self._senses())
        self.device.poll(now)
        self.to_host.push(self.device.data_to_send(), now)
        for data in self.to_host.pull(now):
            if not self.silent:
                self._write(data)

    def _write(self, data: bytes) -> None:
        try:
            os.write(self._master, data)
        except BlockingIOError:
            return  # nobody reads the port: a UART would lose the bytes as well
