"""Host and device of the native protocol joined in memory, over good lines and bad ones."""

from __future__ import annotations

import math

from firmware_bridge import messages
from firmware_bridge.bases.omnibot import OmnibotHost
from firmware_bridge.device import OmnibotDevice
from firmware_bridge.events import Connected, Event, Telemetry
from firmware_bridge.faults import HostileLine
from firmware_bridge.framing import Decoder

STEP = 0.01  # s
OTHER_VERSION = messages.encode(0x81, 6, b"\x03*")
TURN = 2.0 * math.pi  # rad/s at which a wheel makes one turn, 1000 ticks, a second


class Pair:
    """Both ends, a line each way, a clock, and wheels that do as they are told at once."""

    def __init__(self, seed: int = 1, **faults: float) -> None:
        self.host = OmnibotHost()
        self.device = OmnibotDevice(1000.0, boot_nonce=0xA0000001)
        self.down, self.up = HostileLine(seed), HostileLine(seed + 100)
        for line in (self.down, self.up):
            for name, value in faults.items():
                setattr(line, name, value)
        self.now = 5.0
        self.wheels = [0.0, 0.0]
        self.events: list[Event] = []
        self.targets: set[tuple[int, int]] = set()

    def run(self, seconds: float, drive: tuple[float, float] | None = None) -> None:
        """Let time pass; with `drive`, the host asks for these speeds at 20 Hz."""
        for tick in range(round(seconds / STEP)):
            if drive is not None and tick % 5 == 0:
                self.host.drive(*drive, self.now)
            self.step()

    def step(self) -> None:
        self.down.push(self.host.data_to_send(), self.now)
        for data in self.down.pull(self.now):
            self.device.receive(data, self.now)
            self.targets.add(self.device.target)
        self.wheels = [w + STEP * t for w, t in zip(self.wheels, self.device.target, strict=True)]
        self.device.set_state(*map(round, self.wheels))
        self.device.poll(self.now)
        self.up.push(self.device.data_to_send(), self.now)
        for data in self.up.pull(self.now):
            self.events += self.host.receive(data, self.now)
        self.events += self.host.poll(self.now)
        self.now += STEP

    def happened(self) -> list[Event]:
        """Connections and disconnections so far, and forget them and all telemetry."""
        links = [event for event in self.events if not isinstance(event, Telemetry)]
        self.events = []
        return links

    def latest(self) -> Telemetry:
        return [event for event in self.events if isinstance(event, Telemetry)][-1]


def connected_pair(seed: int = 1, **faults: float) -> Pair:
    pair = Pair(seed, **faults)
    pair.run(0.1)
    assert isinstance(pair.happened()[0], Connected)
    return pair


def kinds_sent(data: bytes) -> list[type[messages.Message]]:
    return [type(messages.parse(frame)) for frame in Decoder().feed(data)]
