"""The serial line under asyncio: ports found, refused and replugged, and lines that block, end or come over TCP."""

from __future__ import annotations

import asyncio
import os
import socket
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from firmware_bridge.events import BridgeError
from omnibotd.io.serial_link import LinkLost, SerialLink, SerialPort, open_serial, resolve_port
from omnibotd.io.usb import Adapter, UsbBus, UsbError

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


class Plugged(UsbBus):
    """What is plugged in, and which of it was reset."""

    def __init__(self, *adapters: Adapter) -> None:
        self.adapters = list(adapters)
        self.resets: list[Adapter] = []
        self.refusal: str | None = None

    def find(self, vid: int, pid: int) -> list[Adapter]:
        return [adapter for adapter in self.adapters if (adapter.vid, adapter.pid) == (vid, pid)]

    def adapter_of(self, tty: str) -> Adapter | None:
        return next((adapter for adapter in self.adapters if tty in adapter.ttys), None)

    def reset(self, adapter: Adapter) -> None:
        self.resets.append(adapter)
        if self.refusal is not None:
            raise UsbError(self.refusal)


def adapter(vid: int, pid: int, serial: str | None, *ttys: str, topology: str = "1-1") -> Adapter:
    return Adapter(vid, pid, serial, topology, bus=1, address=4, ttys=ttys)


ADAPTERS = (
    adapter(0x2341, 0x0043, "A1", "/dev/ttyACM1"),
    adapter(0x2341, 0x0043, "A2", "/dev/ttyACM0"),
    adapter(0x0403, 0x6010, "FT", "/dev/ttyUSB0", "/dev/ttyUSB1"),
    adapter(0x1A86, 0x7523, None, "/dev/ttyUSB2"),
    adapter(0x1A86, 0x7523, None, "/dev/ttyUSB3"),
    adapter(0x10C4, 0xEA60, "0001"),
)


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
    assert resolve_port(given, Plugged(*ADAPTERS)) == device


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ("usb:1a86:5523", "usb:1a86:5523: is the base plugged in"),
        ("usb:2341:0043:A3", "usb:2341:0043:A3: is the base plugged in"),
        ("usb:2341:0043", r"usb:2341:0043:A2 \(/dev/ttyACM0\): name one"),
        ("usb:1a86:7523", r"usb:1a86:7523 \(/dev/ttyUSB3\): .* /dev/serial/by-path"),  # a wrong guess would drive
        ("usb:10c4:ea60", "the kernel made no serial port of it"),
    ],
)
def test_usb_numbers_that_name_no_port_or_several(given: str, reason: str) -> None:
    with pytest.raises(LinkLost, match=reason):
        resolve_port(given, Plugged(*ADAPTERS))


def test_usb_numbers_that_are_none_are_our_user_s_mistake() -> None:
    with pytest.raises(BridgeError, match="four hexadecimal digits"):
        resolve_port("usb:2341", Plugged())


# Hot-plug


@contextmanager
def two_ptys() -> Iterator[list[tuple[int, str]]]:
    pairs = [os.openpty() for _ in range(2)]
    for _, slave in pairs:
        tty.setraw(slave)
    try:
        yield [(master, os.ttyname(slave)) for master, slave in pairs]
    finally:
        for descriptor in (end for pair in pairs for end in pair):
            os.close(descriptor)


def test_an_adapter_that_comes_back_under_another_name_is_found() -> None:
    async def main(first: str, second: str) -> None:
        bus = Plugged(adapter(0x0403, 0x6001, None, first))
        port = SerialPort("usb:0403:6001", BAUD, bus)
        (await port.open()).close()
        bus.adapters = []
        with pytest.raises(LinkLost, match="is the base plugged in"):
            await port.open()
        bus.adapters = [adapter(0x0403, 0x6001, "7", second, topology="1-2")]
        link = await port.open()
        assert os.ttyname(link.fileno()) == second
        link.close()
        assert bus.resets == []

    with two_ptys() as ((_, first), (_, second)):
        asyncio.run(main(first, second))


async def close(link: SerialLink) -> None:
    """And wait until it is."""
    link.close()
    while link._port.is_open:  # noqa: ASYNC110 (a thread closes it)
        await asyncio.sleep(0.001)


async def openings(port: SerialPort, count: int) -> None:
    for _ in range(count):
        await close(await port.open())


@pytest.mark.parametrize("by_path", [False, True])
def test_an_adapter_that_says_nothing_is_reset_after_three_openings_and_three_times_in_all(
    pty: tuple[int, str], by_path: bool
) -> None:
    async def main() -> None:
        bus = Plugged(adapter(0x0403, 0x6001, None, pty[1]))
        port = SerialPort(pty[1] if by_path else "usb:0403:6001", BAUD, bus)
        resets = []
        for _ in range(12):
            await openings(port, 1)
            resets.append(len(bus.resets))
        # Three openings that bring nothing, and the fourth is after a reset.
        assert resets == [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3]
        assert bus.resets == bus.adapters * 3
        await openings(port, 10)
        assert len(bus.resets) == 3

    asyncio.run(main())


def test_one_byte_is_proof_that_it_does_not_hang(pty: tuple[int, str]) -> None:
    master, path = pty

    async def main() -> None:
        bus = Plugged(adapter(0x0403, 0x6001, None, path))
        port = SerialPort(path, BAUD, bus)

        async def hear_something() -> None:
            link = await port.open()
            os.write(master, b"x")
            assert await link.read() == b"x"
            await close(link)

        for _ in range(3):
            await openings(port, 2)
            await hear_something()
        assert bus.resets == []
        await openings(port, 20)
        await hear_something()
        await openings(port, 20)
        assert len(bus.resets) == 6

    asyncio.run(main())


def test_an_adapter_just_plugged_in_gets_its_three_openings(pty: tuple[int, str]) -> None:
    async def main() -> None:
        plugged = [adapter(0x0403, 0x6001, None, pty[1])]
        bus = Plugged(*plugged)
        port = SerialPort("usb:0403:6001", BAUD, bus)
        await openings(port, 2)
        bus.adapters = []
        for _ in range(5):
            with pytest.raises(LinkLost, match="is the base plugged in"):
                await port.open()
        bus.adapters = plugged
        await openings(port, 3)
        assert bus.resets == []

    asyncio.run(main())


def test_a_port_that_can_not_be_opened_is_reset_but_not_one_that_is_missing_or_in_use(
    pty: tuple[int, str], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    hung = tmp_path / "ttyUSB0"
    hung.write_text("")  # opens, and then is no tty, as little as one that hangs

    async def fail(port: SerialPort, times: int, reason: str) -> None:
        for _ in range(times):
            with pytest.raises(LinkLost, match=reason):
                await port.open()

    async def main() -> None:
        bus = Plugged(adapter(0x0403, 0x6001, None, str(hung)), adapter(0x2341, 0x0043, None, pty[1]))
        bus.refusal = "permission denied"
        port = SerialPort(str(hung), BAUD, bus)
        await fail(port, 4, "Could not configure port")
        assert len(bus.resets) == 1
        bus.resets.clear()
        other = await open_serial(pty[1], BAUD)
        await fail(SerialPort(pty[1], BAUD, bus), 10, "in use by another program")
        other.close()
        await fail(SerialPort("usb:0403:ffff", BAUD, bus), 10, "is the base plugged in")
        assert bus.resets == []

    asyncio.run(main())
    assert "usb:0403:6001 can't be reset: permission denied" in caplog.text
