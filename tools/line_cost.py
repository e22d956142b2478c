"""What talking to each base costs a second: bytes on the line and time in its driver (launcher: tools/line-cost).

Driver and simulated base are joined in memory, in lockstep, while the base drives and tells all it can. The time is
the processor's for the driver alone, fed every 5 ms as a UART's interrupt does.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypeVar

from firmware_bridge.bases import make_driver
from firmware_bridge.emulator import Device, IdealWheels
from firmware_bridge.events import Driver, Event, Telemetry
from tools.sim.emulators import BODIES, driver_of, make_device

T = TypeVar("T")

STEP, TICK = 0.005, 0.1  # s
WARM_UP = 3.0  # s until hands are shaken and the base drives
BITS_A_BYTE = 10  # with start and stop bit
BAUD = {"omnibot": 115200, "create2": 115200, "arduino_bridge": 57600}
MAX_WHEEL_SPEED = 12.0  # rad/s


@dataclass(frozen=True, slots=True)
class Cost:
    """Of one second."""

    base: str
    telemetry: float
    bytes_from_base: float
    bytes_to_base: float
    share_from_base: float  # of what the line can carry
    share_to_base: float
    driver_ms: float


class Talk:
    """A driver and its base; counts bytes and the driver's time."""

    def __init__(self, base: str, range_ahead: float | None) -> None:
        self._driver: Driver = make_driver(base, BODIES[base].ticks_per_rev, MAX_WHEEL_SPEED)
        self._device: Device = make_device(base, nonce=1)
        self._wheels, self._range = IdealWheels(), range_ahead
        self._now = 0.0
        self._steps = 0
        self.told, self.said, self.telemetry, self.seconds = 0, 0, 0, 0.0

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP)):
            self._step()

    def _step(self) -> None:
        self._now += STEP
        self._steps += 1
        self._take(self._timed(lambda: self._driver.poll(self._now)))
        if self._steps % round(TICK / STEP) == 0:
            speed = 0.0 if self._now < WARM_UP / 2.0 else 5.0
            self._timed(lambda: self._driver.drive(speed, 0.9 * speed, self._now))
        said = self._timed(self._driver.data_to_send)
        self.said += len(said)
        self._device.receive(said, self._now)
        left, right = self._wheels.step(STEP, *self._device.target)
        self._device.set_state(left, right, charging=False, range_ahead=self._range)
        self._device.poll(self._now)
        told = self._device.data_to_send()
        self.told += len(told)
        if told:
            self._take(self._timed(lambda: self._driver.receive(told, self._now)))

    def _timed(self, work: Callable[[], T]) -> T:
        began = time.thread_time()
        result = work()
        self.seconds += time.thread_time() - began
        return result

    def _take(self, happened: list[Event]) -> None:
        self.telemetry += sum(isinstance(event, Telemetry) for event in happened)


def measure(base: str, seconds: float) -> Cost:
    """While driving, hands long shaken; a native base with its range sensor."""
    talk = Talk(base, range_ahead=0.7)
    talk.run(WARM_UP)
    talk.told = talk.said = talk.telemetry = 0
    talk.seconds = 0.0
    talk.run(seconds)
    line = BAUD[driver_of(base)] / BITS_A_BYTE
    told, said = talk.told / seconds, talk.said / seconds
    return Cost(base, talk.telemetry / seconds, told, said, told / line, said / line, 1000.0 * talk.seconds / seconds)


def main() -> int:
    """A table on stdout."""
    parser = argparse.ArgumentParser(prog="tools/line-cost", description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0, help="of the base's time, for each base")
    parser.add_argument("--json", type=Path, metavar="OUT")
    options = parser.parse_args()
    costs = [measure(base, options.seconds) for base in BAUD]
    print(f"{'base':16}{'telemetry':>10}{'from base':>16}{'to base':>16}{'driver':>12}")
    for cost in costs:
        print(
            f"{cost.base:16}{cost.telemetry:7.1f}/s {cost.bytes_from_base:6.0f} B/s {100 * cost.share_from_base:4.1f} %"
            f" {cost.bytes_to_base:6.0f} B/s {100 * cost.share_to_base:4.1f} % {cost.driver_ms:6.2f} ms/s"
        )
    if options.json is not None:
        options.json.write_text(json.dumps([asdict(cost) for cost in costs], indent=1) + "\n", "utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
