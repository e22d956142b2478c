"""The line to a base: any port pyserial opens, under asyncio, without blocking."""

from __future__ import annotations

import asyncio
import errno
import io
import logging
import os
import re
from collections import deque
from typing import Protocol

import serial

from firmware_bridge.events import BridgeError
from omnibotd.io.usb import Adapter, UsbBus, UsbError

log = logging.getLogger(__name__)

WRITE_LIMIT = 4  # writes waiting for the line: at 20-50 set-points a second none is older than 0.2 s
READ_LIMIT = 65536  # bytes not yet read: 6 s at 115200 baud; then the oldest are worth nothing
READ_SIZE = 4096
FRUITLESS = 3  # openings in a row that failed, or brought no byte until given up, before the adapter is reset
RESETS = 3  # of an adapter before a byte comes: what they can't mend takes a person; a base that is off is no fault


class LinkLost(Exception):
    """The port can't be opened or is gone: unplugged, closed, refused. Worth another try later."""


class PortFault(LinkLost):
    """The port is there and ours, and yet can't be opened: so does an adapter that hangs."""


class Link(Protocol):
    """Bytes to and from a base, without blocking."""

    async def read(self) -> bytes:
        """At least one byte; raises LinkLost when there will be no more."""

    def write(self, data: bytes) -> None:
        """Send or drop, never wait, never raise: a loss shows at `read`."""

    def close(self) -> None:
        """Let go of the port; harmless when repeated."""


class SerialLink:
    """A pyserial port under asyncio; a line that takes no more loses the oldest write."""

    def __init__(self, port: serial.Serial) -> None:
        self._port = port
        self._fd = port.fileno()
        self._loop = asyncio.get_running_loop()
        self._received = bytearray()
        self._waiting: deque[bytes] = deque()
        self._lost: str | None = None
        self.heard = False  # whether one byte has ever come
        self._news = asyncio.Event()
        self._loop.add_reader(self._fd, self._on_readable)

    def fileno(self) -> int:
        """The open port, for a process that is to inherit it."""
        return self._fd

    async def read(self) -> bytes:
        while not self._received:
            if self._lost is not None:
                raise LinkLost(self._lost)
            self._news.clear()
            await self._news.wait()
        data = bytes(self._received)
        self._received.clear()
        return data

    def write(self, data: bytes) -> None:
        if self._lost is not None:
            return
        if len(self._waiting) == WRITE_LIMIT:
            del self._waiting[1]  # the first may be half sent: cutting it off would spoil the frame after it
        self._waiting.append(data)
        self._send()

    def close(self) -> None:
        if self._port.is_open:
            self._lose("closed")
            # In a thread: closing waits for the line to drain (tty) or a fixed time (pyserial's sockets).
            self._loop.run_in_executor(None, self._port.close)

    def _on_readable(self) -> None:
        try:
            data = os.read(self._fd, READ_SIZE)
        except BlockingIOError:
            return
        except OSError as error:
            self._lose(f"{self._port.port}: {error.strerror}")
            return
        if data:
            self.heard = True
        else:
            self._lose(f"{self._port.port}: closed by the other side, or unplugged")
        self._received += data
        del self._received[:-READ_LIMIT]
        self._news.set()

    def _send(self) -> None:
        """Send what the line takes; come back when it takes more."""
        try:
            while self._waiting:
                sent = os.write(self._fd, self._waiting[0])
                if sent < len(self._waiting[0]):
                    self._waiting[0] = self._waiting[0][sent:]
                    break
                self._waiting.popleft()
        except BlockingIOError:
            pass
        except OSError as error:
            self._lose(f"{self._port.port}: {error.strerror}")
            return
        if self._waiting:
            self._loop.add_writer(self._fd, self._send)
        else:
            self._loop.remove_writer(self._fd)

    def _lose(self, reason: str) -> None:
        if self._lost is None:
            self._lost = reason
            self._loop.remove_reader(self._fd)
            self._loop.remove_writer(self._fd)
            self._waiting.clear()
            self._news.set()


class SerialPort:
    """One port of the configuration, opened as often as need be; an adapter on USB that hangs is reset."""

    def __init__(self, port: str, baudrate: int, bus: UsbBus | None = None) -> None:
        self._port, self._baudrate = port, baudrate
        self._bus = bus or UsbBus()
        self._link: SerialLink | None = None
        self._fruitless = 0
        self._resets = 0

    async def open(self) -> SerialLink:
        """As `open_serial`; what a replugged adapter is called now is looked up each time."""
        self._judge()
        if self._fruitless >= FRUITLESS and self._resets < RESETS:
            self._fruitless = 0
            await asyncio.to_thread(self._reset)
        try:
            self._link = await open_serial(self._port, self._baudrate, self._bus)
        except PortFault:
            self._fruitless += 1
            raise
        except LinkLost:
            self._fruitless = 0  # not there, or not ours: no reset mends that
            raise
        return self._link

    def _judge(self) -> None:
        """What the link before this one was worth."""
        if self._link is None:
            return
        if self._link.heard:
            self._fruitless = self._resets = 0
        else:
            self._fruitless += 1
        self._link = None

    def _reset(self) -> None:
        adapter = self._adapter()
        if adapter is None:
            return  # not on USB, or not plugged in
        self._resets += 1
        try:
            self._bus.reset(adapter)
            log.warning("%s: no byte in %d openings; USB adapter %s reset", self._port, FRUITLESS, adapter)
        except UsbError as error:
            log.warning("%s: no byte in %d openings, and %s can't be reset: %s", self._port, FRUITLESS, adapter, error)

    def _adapter(self) -> Adapter | None:
        try:
            return self._bus.adapter_of(resolve_port(self._port, self._bus))
        except LinkLost:
            return None


async def open_serial(port: str, baudrate: int, bus: UsbBus | None = None) -> SerialLink:
    """Open a device path, a pty, `usb:VID:PID[:SERIAL]` or `socket://HOST:PORT`.

    LinkLost when that fails now, BridgeError when it never can.
    """
    # In a thread: a socket takes up to 5 s.
    opening = asyncio.ensure_future(asyncio.to_thread(_open, port, baudrate, bus or UsbBus()))
    try:
        opened = await asyncio.shield(opening)
    except asyncio.CancelledError:
        opening.add_done_callback(_close_unused)
        raise
    try:
        return SerialLink(opened)
    except (io.UnsupportedOperation, AttributeError) as error:
        opened.close()
        raise BridgeError(f"base.port {port}: only device paths, usb: and socket:// are supported") from error


def resolve_port(port: str, bus: UsbBus | None = None) -> str:
    """Device path of `usb:VID:PID[:SERIAL]` (hexadecimal, as lsusb prints them); anything else as it is."""
    if not port.startswith("usb:"):
        return port
    match = re.fullmatch(r"usb:([0-9a-fA-F]{4}):([0-9a-fA-F]{4})(?::(.+))?", port)
    if match is None:
        raise BridgeError(f"base.port {port!r} is not usb:VID:PID[:SERIAL] with four hexadecimal digits each")
    vid, pid, number = int(match[1], 16), int(match[2], 16), match[3]
    plugged = [adapter for adapter in (bus or UsbBus()).find(vid, pid) if number in (None, adapter.serial)]
    found = [adapter for adapter in plugged if adapter.ttys]
    if plugged and not found:
        raise LinkLost(f"{port} is plugged in, but the kernel made no serial port of it: is its driver missing?")
    if not found:
        raise LinkLost(f"no serial port belongs to {port}: is the base plugged in? (lsusb lists what is)")
    if len(found) > 1:
        raise LinkLost(f"{port} means any of {', '.join(map(_described, found))}: {_way_out(found)}")
    return found[0].ttys[0]


def _described(adapter: Adapter) -> str:
    return f"{adapter} ({adapter.ttys[0]})"


def _way_out(found: list[Adapter]) -> str:
    """How to tell several alike adapters apart."""
    if len({adapter.serial for adapter in found}) == len(found):
        return "name one"
    return "they have no numbers of their own, so give base.port a path under /dev/serial/by-path"


_HINTS = {
    errno.ENOENT: "no such device; is the base plugged in?",
    errno.EACCES: "permission denied; add the user to the group that owns the port (dialout)",
    errno.EAGAIN: "in use by another program",
    errno.EBUSY: "in use by another program",
}


def _open(port: str, baudrate: int, bus: UsbBus) -> serial.Serial:
    path = resolve_port(port, bus)
    try:
        return serial.serial_for_url(path, baudrate=baudrate, timeout=0, exclusive=True)
    except serial.SerialException as error:
        if error.errno in _HINTS:
            raise LinkLost(f"{path}: {_HINTS[error.errno]}") from error
        raise PortFault(f"{path}: {error}") from error
    except ValueError as error:
        raise BridgeError(f"base.port {port}: {error}") from error


def _close_unused(opening: asyncio.Future[serial.Serial]) -> None:
    if not opening.cancelled() and opening.exception() is None:
        opening.result().close()
