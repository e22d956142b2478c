"""Drivers of the bases, by the name the configuration calls them."""

from __future__ import annotations

from firmware_bridge.bases.arduino_bridge import ArduinoBridgeHost
from firmware_bridge.bases.create2 import Create2Host
from firmware_bridge.bases.omnibot import OmnibotHost
from firmware_bridge.events import BridgeError, Driver

DRIVERS = ("omnibot", "create2", "arduino_bridge")


def make_driver(name: str, ticks_per_rev: float | None = None, max_wheel_speed: float | None = None) -> Driver:
    """A fresh driver. Encoder counts and top speed (rad/s) of a wheel are for bases that can't tell.

    BridgeError where one of those is missing, or there is no driver of that name.
    """
    match name:
        case "omnibot":
            return OmnibotHost()
        case "create2":
            return Create2Host()
        case "arduino_bridge" if ticks_per_rev is not None and max_wheel_speed is not None:
            return ArduinoBridgeHost(ticks_per_rev, max_wheel_speed)
        case "arduino_bridge":
            raise BridgeError("the driver arduino_bridge needs base.ticks_per_rev: its board can't tell")
    raise BridgeError(f"unknown base driver {name!r}; known: {', '.join(sorted(DRIVERS))}")
