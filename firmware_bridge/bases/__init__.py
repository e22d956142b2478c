"""Drivers of the bases, by the name the configuration calls them."""

from __future__ import annotations

from collections.abc import Callable

from firmware_bridge.bases.omnibot import OmnibotHost
from firmware_bridge.events import BridgeError, Driver

_DRIVERS: dict[str, Callable[[], Driver]] = {"omnibot": OmnibotHost}


def make_driver(name: str) -> Driver:
    """A fresh driver; BridgeError naming the known ones when there is none of that name."""
    try:
        return _DRIVERS[name]()
    except KeyError:
        raise BridgeError(f"unknown base driver {name!r}; known: {', '.join(sorted(_DRIVERS))}") from None
