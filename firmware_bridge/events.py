"""What a base driver tells its user: SI units, vendor signs already turned (REP-103, left as the robot sees it)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


class BridgeError(Exception):
    """Base of all errors of the bridge: our own misuse or an impossible configuration, never the peer's bytes."""


@dataclass(frozen=True, slots=True)
class BaseInfo:
    """What a base said of itself when it shook hands."""

    driver: str
    board: str
    firmware: str
    boot_nonce: int
    watchdog: float  # seconds without a set-point after which the base stops itself; 0 where it has no such thing
    ticks_per_rev: float
    capabilities: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Connected:
    """Hands shaken: encoders count from a new origin."""

    info: BaseInfo


@dataclass(frozen=True, slots=True)
class Disconnected:
    """The base restarted, fell silent or refused; nothing moves until the next Connected."""

    reason: str


@dataclass(frozen=True, slots=True)
class Telemetry:
    """State of the base; `stamp` is the host's monotonic time of arrival (s), ticks are unwrapped since Connected."""

    stamp: float
    left_ticks: int
    right_ticks: int
    bumper_left: bool = False
    bumper_right: bool = False
    cliff: bool = False
    wheel_drop: bool = False
    charging: bool | None = None  # None: this base has no charging contact
    battery: float | None = None  # volts
    emergency_stop: bool = False
    range_ahead: float | None = None  # metres from the front edge, inf: nothing within reach; None: not measured
    faults: frozenset[str] = frozenset()


Event = Connected | Disconnected | Telemetry


@dataclass(frozen=True, slots=True)
class LastWords:
    """Bytes for a base that would roll on without its host; true whoever writes them, and after half a command."""

    stand: bytes  # stop the wheels; the connection goes on
    leave: bytes  # stop them, and go where the base is best off without a host


class Driver(Protocol):
    """A base's protocol without I/O: bytes in, events out; the owner moves the bytes and calls `poll` in time."""

    last_words: LastWords | None  # None: the base's own watchdog stops it soon enough

    def receive(self, data: bytes, now: float) -> list[Event]:
        """Take bytes as they came from the line at `now`."""

    def poll(self, now: float) -> list[Event]:
        """Do what time demands (shake hands, repeat, notice silence); call at least every 20 ms."""

    def drive(self, left: float, right: float, now: float) -> None:
        """New wheel set-points, rad/s forward; ignored while not connected. Never repeated by the driver itself."""

    def emergency_stop(self, now: float) -> None:
        """Stop and latch, where the base can."""

    def release(self, now: float) -> None:
        """Release a latched emergency stop."""

    def data_to_send(self) -> bytes:
        """Bytes for the line since the last call."""
