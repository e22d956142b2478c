"""The pulse that wakes a Roomba: how the line is set, and ports that have none."""

from __future__ import annotations

import asyncio
import fcntl
import struct
import termios
import tty
from collections.abc import Awaitable, Callable
from os import close, openpty, ttyname
from typing import Any

import pytest

from omnibotd.io.serial_link import open_serial
from omnibotd.io.wake_line import waking
from tools.sim import virtual_time


class Port:
    """An open port, as far as the pulse is concerned."""

    def __init__(self) -> None:
        self.closed = False

    def fileno(self) -> int:
        return 77

    def close(self) -> None:
        self.closed = True


def opening(port: Any) -> Callable[[], Awaitable[Any]]:
    async def open_link() -> Any:
        return port

    return open_link


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch) -> list[tuple[float, str]]:
    """When RTS was asserted and let go."""
    changes: list[tuple[float, str]] = []

    def ioctl(fd: int, request: int, bits: bytes) -> None:
        assert (fd, struct.unpack("i", bits)[0]) == (77, termios.TIOCM_RTS)
        name = {termios.TIOCMBIS: "low", termios.TIOCMBIC: "high"}[request]
        changes.append((asyncio.get_running_loop().time(), name))

    monkeypatch.setattr(fcntl, "ioctl", ioctl)
    return changes


def test_the_line_is_low_for_too_long_to_be_taken_for_a_change_of_baud_rate(line: list[tuple[float, str]]) -> None:
    port = Port()
    assert virtual_time.run(waking(opening(port))()) is port  # type: ignore[arg-type]
    (begin, low), (end, high) = line
    assert (low, high) == ("low", "high")
    assert 0.5 < end - begin <= 1.0
    assert not port.closed


def test_cancelled_meanwhile_the_port_is_closed(line: list[tuple[float, str]]) -> None:
    port = Port()

    async def main() -> None:
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(waking(opening(port))(), 0.5)

    virtual_time.run(main())
    assert port.closed


def test_a_port_without_such_a_line_is_opened_as_it_is() -> None:
    master, slave = openpty()
    tty.setraw(slave)

    async def main() -> None:
        began = asyncio.get_running_loop().time()
        link = await waking(lambda: open_serial(ttyname(slave), 115200))()
        assert asyncio.get_running_loop().time() - began < 0.9
        link.close()

    asyncio.run(main())
    close(master)
    close(slave)
