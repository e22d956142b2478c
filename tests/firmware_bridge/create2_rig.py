"""Driver and emulator of a Create 2, joined in memory over two lines, in lockstep."""

from __future__ import annotations

from typing import Any

from firmware_bridge.bases.create2 import WHEEL_RADIUS, Create2Host
from firmware_bridge.emulator import IdealWheels
from firmware_bridge.events import Connected, Disconnected, Event, Telemetry
from firmware_bridge.faults import HostileLine
from tools.sim.emulators.create2 import Create2Device

STEP = 0.005  # s
TICK = 0.1  # s, the daemon's


class Rig:
    """Everything between the daemon's set-points and the floor; keeps what the driver told."""

    def __init__(self, seed: int = 0, **options: Any) -> None:
        self.host, self.device = Create2Host(), Create2Device(**options)
        self.to_device, self.to_host = HostileLine(seed), HostileLine(seed + 1)
        self.wheels = IdealWheels(lag=0.08)
        self.turned = (0, 0)  # ticks, as they truly are
        self.senses: dict[str, Any] = {}
        self.events: list[Event] = []
        self.now = 50.0
        self.steps = 0

    def wait(self, seconds: float) -> None:
        """Time passes faster, in steps of 0.1 s."""
        for _ in range(round(seconds / 0.1)):
            self.step(0.1)

    def run(self, seconds: float, left: float | None = None, right: float | None = None) -> list[Event]:
        """Time passes; with speeds (m/s) a set-point every tick. Returns what happened meanwhile."""
        told = len(self.events)
        for _ in range(round(seconds / STEP)):
            if left is not None and right is not None and self.steps % round(TICK / STEP) == 0:
                self.host.drive(left * 1000.0 / WHEEL_RADIUS, right * 1000.0 / WHEEL_RADIUS, self.now)
            self.step()
        return self.events[told:]

    def step(self, dt: float = STEP) -> None:
        self.now += dt
        self.steps += 1
        self.events += self.host.poll(self.now)
        self.to_device.push(self.host.data_to_send(), self.now)
        for data in self.to_device.pull(self.now):
            self.device.receive(data, self.now)
        self.turned = self.wheels.step(dt, *self.device.target)
        self.device.set_state(*self.turned, **self.senses)
        self.device.poll(self.now)
        self.to_host.push(self.device.data_to_send(), self.now)
        for data in self.to_host.pull(self.now):
            self.events += self.host.receive(data, self.now)

    @property
    def connected(self) -> bool:
        changes = [event for event in self.events if isinstance(event, Connected | Disconnected)]
        return bool(changes) and isinstance(changes[-1], Connected)

    @property
    def latest(self) -> Telemetry:
        return next(event for event in reversed(self.events) if isinstance(event, Telemetry))

    @property
    def losses(self) -> list[str]:
        return [event.reason for event in self.events if isinstance(event, Disconnected)]

    @property
    def moving(self) -> bool:
        return self.device.target != (0.0, 0.0)
