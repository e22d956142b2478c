"""Bases to simulate, by name: device roles written from what is known of them, not from their drivers.

Each is sans-IO and has the shape of `firmware_bridge.device.OmnibotDevice`; `omnibot-avr` is the firmware itself.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from firmware_bridge.device import OmnibotDevice
from firmware_bridge.emulator import Device
from tools.sim.emulators.arduino_bridge import ArduinoBridgeBoard
from tools.sim.emulators.create2 import Create2Device
from tools.sim.plant import Body

# Their wheels; those of `arduino_bridge` are what the configuration takes for granted.
BODIES = {
    "omnibot": Body(),
    "omnibot-avr": Body(),
    "create2": Body(wheel_radius=0.036, wheel_separation=0.235, ticks_per_rev=508.8),
    "arduino_bridge": Body(),
}


class BaseUnavailable(Exception):
    """A base that can't be simulated here; the message says what is missing."""


@runtime_checkable
class TurningDevice(Device, Protocol):
    """A base with motors of its own: it says how far its wheels have turned, and nobody turns them by `target`."""

    @property
    def turned(self) -> tuple[int, int]:
        """Ticks (left, right) since power-up, as ideal encoders count them."""


def driver_of(base: str) -> str:
    """The driver that talks to a base of BODIES."""
    return base.removesuffix("-avr")


def make_device(base: str, nonce: int) -> Device:
    """A fresh base of that name, one of BODIES. BaseUnavailable says what this machine lacks."""
    match base:
        case "create2":
            return Create2Device()
        case "arduino_bridge":
            return ArduinoBridgeBoard()
        case "omnibot-avr":
            return _avr()
    return OmnibotDevice(BODIES[base].ticks_per_rev, nonce)


def _avr() -> Device:
    # Only here: it needs a C compiler for the AVR, and simavr.
    from tools.sim.emulators.omnibot_avr import AvrDevice, SimulatorMissing  # noqa: PLC0415

    try:
        return AvrDevice()
    except SimulatorMissing as error:
        raise BaseUnavailable(f"base omnibot-avr: {error}") from error
