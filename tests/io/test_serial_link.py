"""The serial line under asyncio: ports found and refused, and lines that block, end or come over TCP."""

from __future__ import annotations

import asyncio
import os
import socket
import tty
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from serial.tools import list_ports

from firmware_bridge.events import BridgeError
from omnibotd.io.serial_link import LinkLost, open_serial, resolve_port

BAUD = 115200


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    """Master descriptor and slave path; the slave stays open."""
    master, slave = os.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    os.close(slave)
    os.close(master)


def test_reads_and_writes(pty: tuple[int, str]) -> None:
    master, path = pty

    async def main() -> None:
        link = await open_serial(path, BAUD)
        link.write(b"to the base")
        assert os.read(master, 100) == b"to the base"
        os.write(master, b"from the base")
        assert await link.read() == b"from the base"
        link.close()
        link.close()
        link.write(b"too late")
        with pytest.raises(LinkLost, match="closed"):
            await link.read()

    asyncio.run(main())


def test_a_blocked_line_loses_the_oldest_waiting_writes_and_cuts_none_in_half(pty: tuple[int, str]) -> None:
    master, path = pty
    os.set_blocking(master, False)
    size = 1000

    async def main() -> bytes:
        link = await open_serial(path, BAUD)
        for n in range(1, 251):  # far more than a pty holds
            link.write(bytes([n]) * size)
        received = b""
        for _ in range(200):
            await asyncio.sleep(0.001)
            try:
                received += os.read(master, 65536)
            except BlockingIOError:
                if received.endswith(bytes([250]) * size):
                    break
        link.close()
        return received

    received = asyncio.run(main())
    numbers = list(dict.fromkeys(received))
    assert received == b"".join(bytes([n]) * size for n in numbers)
    assert numbers == sorted(numbers)
    assert len(numbers) < 250
    assert numbers[-3:] == [248, 249, 250]


def test_over_tcp() -> None:
    async def main(server: socket.socket) -> None:
        link = await open_serial(f"socket://127.0.0.1:{server.getsockname()[1]}", BAUD)
        peer, _ = server.accept()
        with peer:
            link.write(b"ping")
            assert peer.recv(10) == b"ping"
            peer.sendall(b"pong")
            assert await link.read() == b"pong"
        with pytest.raises(LinkLost, match="closed by the other side"):
            await link.read()
        link.close()

    with socket.create_server(("127.0.0.1", 0)) as server:
        asyncio.run(main(server))


def test_refusals_say_what_to_do(pty: tuple[int, str]) -> None:
    async def main() -> None:
        with pytest.raises(LinkLost, match="/dev/ttyNONE: no such device; is the base plugged in"):
            await open_serial("/dev/ttyNONE", BAUD)
        with pytest.raises(BridgeError, match="only device paths"):
            await open_serial("loop://", BAUD)
        with pytest.raises(BridgeError, match="invalid URL"):
            await open_serial("warp://enterprise", BAUD)
        link = await open_serial(pty[1], BAUD)
        with pytest.raises(LinkLost, match="in use by another program"):
            await open_serial(pty[1], BAUD)
        link.close()

    asyncio.run(main())


def port(device: str, vid: int, pid: int, serial_number: str | None) -> SimpleNamespace:
    return SimpleNamespace(device=device, vid=vid, pid=pid, serial_number=serial_number)


PORTS = [
    port("/dev/ttyACM1", 0x2341, 0x0043, "A1"),
    port("/dev/ttyACM0", 0x2341, 0x0043, "A2"),
    port("/dev/ttyUSB1", 0x0403, 0x6010, "FT"),
    port("/dev/ttyUSB0", 0x0403, 0x6010, "FT"),
    port("/dev/ttyS0", 0, 0, None),
]


@pytest.fixture
def ports(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(list_ports, "comports", lambda: PORTS)


@pytest.mark.usefixtures("ports")
@pytest.mark.parametrize(
    ("given", "device"),
    [
        ("usb:2341:0043:A1", "/dev/ttyACM1"),
        ("usb:2341:0043:A2", "/dev/ttyACM0"),
        ("usb:0403:6010", "/dev/ttyUSB0"),  # one adapter with two ports: the first
        ("/dev/serial/by-id/x", "/dev/serial/by-id/x"),
    ],
)
def test_ports_by_usb_numbers(given: str, device: str) -> None:
    assert resolve_port(given) == device


@pytest.mark.usefixtures("ports")
def test_usb_numbers_that_name_no_port_or_several() -> None:
    with pytest.raises(LinkLost, match="usb:1a86:7523: is the base plugged in"):
        resolve_port("usb:1a86:7523")
    with pytest.raises(LinkLost, match=r"usb:2341:0043:A2 \(/dev/ttyACM0\): name one"):
        resolve_port("usb:2341:0043")
    with pytest.raises(BridgeError, match="four hexadecimal digits"):
        resolve_port("usb:2341")
