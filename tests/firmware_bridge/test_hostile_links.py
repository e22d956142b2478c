"""Every driver against the device role of its base, over lines that cut up, lose, delay and corrupt what they carry.

What holds for all: a telemetry tells counts that the wheels had (as far as the protocol can detect errors), the driver
comes back within bounded time, nothing waits in a queue, and no wheel turns for a host that is not connected.
"""

from __future__ import annotations

import math
from collections import deque

import pytest

from firmware_bridge.bases import DRIVERS, make_driver
from firmware_bridge.events import Connected, Disconnected, Event, Telemetry
from firmware_bridge.faults import HostileLine
from tools.sim.emulators import BODIES, make_device

STEP = 0.01  # s
SPEED = 6.0  # rad/s
FASTEST = 12.0  # rad/s, what the configuration would allow: 0.42 m/s on the usual wheel
BOOT = 2.5  # s until a base that was reset is connected again
RECOVERY = 1.0  # s, once the line is good again
MEMORY = 0.7  # s: the longest that a report of standing wheels may be under way here
LINE_RATE = 5760  # bytes a second of the slowest line, 57600 baud

# Ticks by which corruption may pass for a reading: CRC-16 lets none through here; a sum of 8 bits and text without
# any are left with what a wheel can turn between two readings. arduino_bridge: twice FASTEST for 0.1 s. create2: 1.5
# times its top speed for 0.12 s, and as its counts have no sign of their own, once more on the way back.
UNDETECTED = {"omnibot": 0.0, "create2": 400.0, "arduino_bridge": 600.0}

FAULTS = {
    "byte by byte": {"split": True},
    "20 % loss": {"loss": 0.2},
    "delay": {"delay": 0.1},
    "bit flips": {"flips": 0.004},
    "garbage": {"garbage": 0.2},
    "all at once": {"split": True, "loss": 0.1, "delay": 0.05, "flips": 0.001, "garbage": 0.1},
}


# A create2 takes commands without frame or checksum: a byte more may switch it off, or send it cleaning. Nothing can
# be promised of a line that corrupts what the host says, so there only the base's words are corrupted.
HARMLESS = {"create2": ("loss", "delay", "split")}


class Bench:
    """Driver, lines, base and wheels that turn as they are told; every telemetry is compared with the wheels."""

    def __init__(self, base: str, seed: int) -> None:
        self._base = base
        self.ticks_per_rev = BODIES[base].ticks_per_rev
        self.host = make_driver(base, self.ticks_per_rev, FASTEST)
        self.device = make_device(base, nonce=0xA0000001)
        self.down, self.up = HostileLine(seed), HostileLine(seed + 1000)
        self.now = 50.0
        self.wheels = [0.0, 0.0]
        self.connected = False
        self.happened: list[Event] = []
        self.errors: list[float] = []  # ticks that each telemetry was off from all that the wheels stood at lately
        self.sent: deque[int] = deque(maxlen=round(1.0 / STEP))  # bytes in each step of the last second
        self._counts: deque[tuple[int, int]] = deque(maxlen=round(MEMORY / STEP))
        self._origin: tuple[int, int] | None = None

    def spoil(self, **faults: float) -> None:
        for name in ("loss", "delay", "garbage", "flips", "split"):
            setattr(self.up, name, faults.get(name, 0.0))
            if name in HARMLESS.get(self._base, (name,)):
                setattr(self.down, name, faults.get(name, 0.0))

    def run(self, seconds: float, speed: float | None = None) -> None:
        """Let time pass; with `speed` (rad/s) the host asks for it at 10 Hz."""
        for tick in range(round(seconds / STEP)):
            if speed is not None and tick % 10 == 0:
                self.host.drive(speed, -0.5 * speed, self.now)
            self.step()

    def step(self) -> None:
        data = self.host.data_to_send()
        self.sent.append(len(data))
        self.down.push(data, self.now)
        for piece in self.down.pull(self.now):
            self.device.receive(piece, self.now)
        self.wheels = [at + STEP * speed for at, speed in zip(self.wheels, self.device.target, strict=True)]
        counts = math.floor(self.wheels[0]), math.floor(self.wheels[1])
        self._counts.append(counts)
        self.device.set_state(*counts, battery_mv=15000)
        self.device.poll(self.now)
        self.up.push(self.device.data_to_send(), self.now)
        for piece in self.up.pull(self.now):
            self._note(self.host.receive(piece, self.now))
        self._note(self.host.poll(self.now))
        self.now += STEP

    def forget_origin(self) -> None:
        """Take what the next telemetry of standing wheels says for right."""
        self._origin = None

    def until_connected(self, limit: float) -> None:
        end = self.now + limit
        while not self.connected and self.now < end:
            self.step()
        assert self.connected, f"not connected within {limit} s"

    def _note(self, events: list[Event]) -> None:
        for event in events:
            match event:
                case Connected():
                    self.connected = True
                    self._origin = None
                    self.happened.append(event)
                case Disconnected():
                    self.connected = False
                    self.happened.append(event)
                case Telemetry(left_ticks=left, right_ticks=right):
                    self._compare(left, right)

    def _compare(self, left: int, right: int) -> None:
        if self._origin is None and len(set(self._counts)) == 1:  # where ticks began is known if the wheels stood
            self._origin = self._counts[-1][0] - left, self._counts[-1][1] - right
        if self._origin is not None:
            told = left + self._origin[0], right + self._origin[1]
            self.errors.append(min(max(abs(told[0] - at[0]), abs(told[1] - at[1])) for at in self._counts))


def bench(base: str, seed: int = 1) -> Bench:
    """Connected over a good line."""
    made = Bench(base, seed)
    made.until_connected(BOOT)
    made.run(MEMORY)
    assert made.errors and max(made.errors) == 0
    made.errors.clear()
    return made


@pytest.mark.parametrize("base", DRIVERS)
@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.parametrize("seed", [10, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(20, 90, 10))])
def test_bad_lines(base: str, name: str, seed: int) -> None:
    made = bench(base, seed)
    faults = FAULTS[name]
    made.spoil(**faults)
    most = 0
    for k in range(8):
        made.run(0.5, SPEED if k % 4 else 0.0)
        most = max(most, sum(made.sent))
    corrupts = faults.get("flips") or faults.get("garbage")
    assert len(made.errors) > 30
    # Encoders that take their direction from the command are a tick or two off around a stop.
    assert max(made.errors) <= (UNDETECTED[base] if corrupts else 2)
    assert most < LINE_RATE / 4
    assert abs(made.wheels[0]) > 0.5 * 3.0 * SPEED / (2.0 * math.pi) * made.ticks_per_rev

    made.spoil()
    made.until_connected(RECOVERY)
    if base == "create2" and corrupts:
        made.forget_origin()  # what such an error added to a sum of counts stays there
    made.run(MEMORY + 0.2, 0.0)
    made.errors.clear()
    made.run(1.0, -SPEED)
    made.run(0.5, 0.0)
    assert made.errors and max(made.errors) <= 2
    assert made.device.target == (0.0, 0.0)


@pytest.mark.parametrize("base", DRIVERS)
def test_connects_over_a_bad_line(base: str) -> None:
    for seed in range(5):
        made = Bench(base, seed)
        made.spoil(**FAULTS["all at once"])
        made.until_connected(BOOT + 2.0)


@pytest.mark.parametrize("base", DRIVERS)
def test_a_dead_line_leaves_nothing_in_a_queue(base: str) -> None:
    made = bench(base)
    made.run(1.0, SPEED)
    usual = sum(made.sent)
    made.down.loss = made.up.loss = 1.0
    made.run(30.0, SPEED)
    assert isinstance(made.happened[-1], Disconnected)
    assert sum(made.sent) <= usual + 100
    made.spoil()
    before = made.wheels.copy()
    made.until_connected(RECOVERY)
    for _ in range(20):  # connected, and not told to drive
        made.step()
        assert max(made.sent) <= 128  # never more than a greeting, a set-point and a request at a time
    if base != "omnibot":  # which has stopped by its own watchdog long ago
        before = made.wheels.copy()
        made.run(0.1)
    assert made.wheels == before


@pytest.mark.parametrize("base", DRIVERS)
@pytest.mark.parametrize("cut", [1, 3, 5])
def test_a_base_that_restarts_in_mid_message(base: str, cut: int) -> None:
    made = bench(base)
    made.run(1.0, SPEED)
    made.spoil(split=True)
    made.host.drive(SPEED, SPEED, made.now)
    request = made.host.data_to_send()
    made.device.receive(request[:cut], made.now)
    made.happened.clear()
    made.device.reset(0xA0000002)
    made.device.receive(request[cut:], made.now)
    end = made.now + BOOT
    while not any(isinstance(event, Connected) for event in made.happened):
        assert made.device.target == (0.0, 0.0)  # no set-point from before, nor one for a base not yet connected
        assert made.now < end
        made.run(STEP, SPEED)
    assert isinstance(made.happened[0], Disconnected)
    assert sum(isinstance(event, Connected) for event in made.happened) == 1
    made.run(0.1, 0.0)
    made.run(0.5, SPEED)
    assert made.device.target != (0.0, 0.0)


@pytest.mark.parametrize("base", DRIVERS)
def test_a_line_that_echoes_is_no_base(base: str) -> None:
    host = make_driver(base, 1000.0, FASTEST)
    for tick in range(500):
        now = tick * STEP
        assert host.poll(now) == []
        assert host.receive(host.data_to_send(), now) == []
