"""The base under asyncio: a link that comes and goes, a driver that makes sense of its bytes."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Awaitable, Callable, Iterable
from typing import Any, Protocol

from firmware_bridge.events import BaseInfo, BridgeError, Connected, Disconnected, Driver, Event, LastWords, Telemetry
from omnibotd.io.serial_link import Link, LinkLost, SerialLink, open_serial, resolve_port

__all__ = ["Link", "LinkLost", "MotorBase", "SerialLink", "open_serial", "resolve_port"]

log = logging.getLogger(__name__)

POLL_PERIOD = 0.02  # seconds: what drivers ask for
FIRST_BACKOFF = 0.2  # seconds; doubled at each failure, so that a base unplugged for hours costs nothing
LAST_BACKOFF = 5.0
# A board reset by the opening of its port boots for 2 s. Beyond this only opening anew can help: a half-open
# TCP connection, an adapter that hangs.
HANDSHAKE_LIMIT = 10.0
NO_ANSWER = f"no answer in {HANDSHAKE_LIMIT:.0f} s: check base.port, base.driver and the cable"
SETTLE_LIMIT = 2.0  # seconds; every driver notices silence well before
# Without set-points for so long every base stands: its watchdog or its guard has seen to that. What waits on the line
# is as old, and whatever was being done is not to go on as if nothing had been.
STALL_LIMIT = 1.0  # seconds; a busy PC makes one or two tenths of them
EVENT_LIMIT = 200  # 2-4 s of telemetry at 50-100 Hz: a control tick later than that is beyond odometry's help


class Guard(Protocol):
    """Whoever stops the base when this process no longer can: `omnibotd.io.stop_guard`."""

    @property
    def alive(self) -> bool: ...

    def beat(self, rolling: bool) -> None: ...

    async def close(self) -> None: ...


class MotorBase:
    """Keeps one base connected as long as `run` runs; everything else here is immediate and never waits.

    A set-point is sent once, when `drive` is called: the caller's own tick keeps the base moving, its absence
    stops it: by the base's own watchdog, else by a guard. `open_link` and `start_guard` raise LinkLost when they
    can't. The loop's clock is the only clock.
    """

    def __init__(
        self,
        driver: Driver,
        open_link: Callable[[], Awaitable[Link]],
        start_guard: Callable[[Any, LastWords], Awaitable[Guard]] | None = None,
    ) -> None:
        """`start_guard` takes an open link and is only called for a base without a watchdog of its own."""
        self._driver = driver
        self._open_link = open_link
        self._start_guard = start_guard
        self._guard: Guard | None = None
        self._link: Link | None = None
        self._shaken = False  # the driver holds the base for connected
        self._answered_at = 0.0
        self._polled_at = 0.0
        self._backoff = FIRST_BACKOFF
        self._events: deque[Event] = deque()
        self._info: BaseInfo | None = None
        self._latest: Telemetry | None = None
        self._reason = "not started"

    @property
    def info(self) -> BaseInfo | None:
        """What the base said of itself; None while not connected."""
        return self._info

    @property
    def connected(self) -> bool:
        return self._info is not None

    @property
    def latest(self) -> Telemetry | None:
        """The newest state; None while not connected."""
        return self._latest

    @property
    def reason(self) -> str:
        """Why not connected; empty while connected."""
        return self._reason

    async def run(self) -> None:
        """Connect and reconnect until cancelled; whatever ends it, the driver's last words go out first."""
        try:
            while True:
                try:
                    await self._settle()
                    link = await self._open_link()
                    await self._serve(link)
                except LinkLost as lost:
                    self._disconnect(str(lost))
                await asyncio.sleep(self._backoff)
                self._backoff = min(2.0 * self._backoff, LAST_BACKOFF)
        finally:
            self._disconnect("stopped")

    def drive(self, left: float, right: float) -> None:
        """Wheel speeds, rad/s; ignored while not connected. Zero after a stall: the caller acts on what was before."""
        if self._stalled_for() > STALL_LIMIT:
            left = right = 0.0
        self._driver.drive(left, right, _now())
        self._flush()
        if self._guard is not None:
            self._guard.beat(rolling=left != 0.0 or right != 0.0)

    def stop(self) -> None:
        """A zero set-point."""
        self.drive(0.0, 0.0)

    def emergency_stop(self) -> None:
        """Stop and stay stopped until `release`, also across a restart of the base."""
        self._driver.emergency_stop(_now())
        self._flush()

    def release(self) -> None:
        """End an emergency stop."""
        self._driver.release(_now())
        self._flush()

    def drain(self) -> list[Event]:
        """What happened since the last call, oldest first; beyond EVENT_LIMIT old telemetry is missing."""
        happened = list(self._events)
        self._events.clear()
        return happened

    async def _settle(self) -> None:
        """Wait until the driver, too, knows that the link was gone: what it knew of the base is void."""
        deadline = _now() + SETTLE_LIMIT
        while self._shaken:
            if _now() > deadline:
                raise BridgeError(f"{type(self._driver).__name__} did not notice {SETTLE_LIMIT} s of silence")
            if any(isinstance(event, Disconnected) for event in self._driver.poll(_now())):
                self._shaken = False
            self._driver.data_to_send()
            await asyncio.sleep(POLL_PERIOD)

    async def _serve(self, link: Link) -> None:
        """Move bytes until the link is lost; no base without a watchdog moves without a guard."""
        words = self._driver.last_words
        try:
            if words is not None and self._start_guard is not None:
                self._guard = await self._start_guard(link, words)
            await self._exchange(link)
        finally:
            if words is not None:
                link.write(words.leave)
            self._link = None
            link.close()
            guard, self._guard = self._guard, None
            if guard is not None:
                await asyncio.shield(guard.close())  # it must be gone before the port is opened again

    async def _exchange(self, link: Link) -> None:
        self._link = link
        self._disconnect("waiting for the base to answer")
        reading = asyncio.create_task(self._read(link))
        self._answered_at = self._polled_at = _now()
        try:
            while not reading.done():
                if self._stalled_for() > STALL_LIMIT:
                    raise LinkLost(f"this program stood still for {self._stalled_for():.1f} s")
                self._polled_at = _now()
                self._take(self._driver.poll(_now()))
                self._flush()
                if _now() - self._answered_at > HANDSHAKE_LIMIT:
                    raise LinkLost(NO_ANSWER)
                if self._guard is not None and not self._guard.alive:
                    raise LinkLost("the process that guards the base died")
                await asyncio.wait({reading}, timeout=POLL_PERIOD)
            await reading
        finally:
            self.stop()
            reading.cancel()
            await asyncio.gather(reading, return_exceptions=True)

    def _stalled_for(self) -> float:
        """Seconds for which the event loop has not come round, while there is a link."""
        return 0.0 if self._link is None else _now() - self._polled_at

    async def _read(self, link: Link) -> None:
        while True:
            data = await link.read()
            self._take(self._driver.receive(data, _now()))
            self._flush()

    def _flush(self) -> None:
        data = self._driver.data_to_send()
        if data and self._link is not None:
            self._link.write(data)

    def _take(self, happened: Iterable[Event]) -> None:
        for event in happened:
            self._answered_at = _now()
            match event:
                case Connected(info):
                    log.info("base: %s %s, firmware %s", info.driver, info.board, info.firmware)
                    self._info = info
                    self._reason = ""
                    self._shaken = True
                    self._backoff = FIRST_BACKOFF
                    self._keep(event)
                case Disconnected(reason):
                    self._shaken = False
                    self._disconnect(reason)
                case Telemetry():
                    self._latest = event
                    self._keep(event)

    def _disconnect(self, reason: str) -> None:
        if self._info is not None:
            log.warning("base lost: %s", reason)
        self._info = None
        self._latest = None
        if reason != self._reason:
            self._reason = reason
            self._keep(Disconnected(reason))

    def _keep(self, event: Event) -> None:
        if len(self._events) == EVENT_LIMIT:
            # Telemetry is superseded by the next; a Connected lost would leave odometry on the old origin.
            oldest = next((i for i, kept in enumerate(self._events) if isinstance(kept, Telemetry)), 0)
            del self._events[oldest]
        self._events.append(event)


def _now() -> float:
    return asyncio.get_running_loop().time()
