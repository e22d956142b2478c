"""The device side of the usb-redir protocol: a simulated USB device that QEMU's `usb-redir` plugs into a guest.

Without sockets and without a clock: the owner moves the bytes. Numbers and layouts are those of usbredirproto.h 0.7;
all are little-endian. Only what a device with control and bulk transfers needs is here.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

VERSION = b"omnibotd simulated camera"


class Packet(IntEnum):
    """Types of packets."""

    HELLO = 0
    DEVICE_CONNECT = 1
    DEVICE_DISCONNECT = 2
    RESET = 3
    INTERFACE_INFO = 4
    EP_INFO = 5
    SET_CONFIGURATION = 6
    GET_CONFIGURATION = 7
    CONFIGURATION_STATUS = 8
    SET_ALT_SETTING = 9
    GET_ALT_SETTING = 10
    ALT_SETTING_STATUS = 11
    CANCEL_DATA_PACKET = 21
    CONTROL_PACKET = 100
    BULK_PACKET = 101


class Capability(IntEnum):
    """Bits of what both sides must be able to do: a hello names them, what both named holds."""

    CONNECT_DEVICE_VERSION = 1
    DEVICE_DISCONNECT_ACK = 3
    EP_INFO_MAX_PACKET_SIZE = 4
    IDS_64BITS = 5
    BULK_LENGTH_32BITS = 6


class Status(IntEnum):
    """How a transfer ended."""

    SUCCESS = 0
    CANCELLED = 1
    STALL = 4


HIGH_SPEED = 2
TO_HOST = 0x80  # bit of an endpoint's address and of a request's type
_CAPABILITIES = sum(1 << bit for bit in Capability)
_SHORT, _LONG = struct.Struct("<III"), struct.Struct("<IIQ")  # type, length, id
_CONTROL = struct.Struct("<BBBBHHH")  # endpoint, request, type, status, value, index, length
_BULK = struct.Struct("<BBHIH")  # endpoint, status, length, stream, upper half of length
_ENDPOINTS = 32  # 0-15 towards the device, 16-31 towards the host
_UNUSED = 255
WAITING_LIMIT = 64  # bulk transfers; uvcvideo keeps five


class RedirError(Exception):
    """The peer is no QEMU that this understands."""


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One besides endpoint 0: bulk."""

    address: int
    interface: int
    packet_size: int


@dataclass(frozen=True, slots=True)
class Interface:
    """What the host chooses a driver by."""

    number: int
    usb_class: int
    subclass: int


@dataclass(frozen=True, slots=True)
class Identity:
    """What goes into the notice that a device was plugged in."""

    vendor: int
    product: int
    release: int
    usb_class: int
    subclass: int
    protocol: int


@dataclass(frozen=True, slots=True)
class Setup:
    """A control request as it stands on the wire."""

    request: int
    kind: int
    value: int
    index: int
    length: int


class Device(Protocol):
    """What is plugged in."""

    identity: Identity
    interfaces: tuple[Interface, ...]
    endpoints: tuple[Endpoint, ...]

    def control(self, setup: Setup, data: bytes) -> bytes | None:
        """The answer to a request, empty to one that carries data; None stalls."""

    def configured(self) -> None:
        """The host has configured or reset the device."""


@dataclass(slots=True)
class _Transfer:
    number: int
    endpoint: int
    length: int


class RedirSession:
    """One time that the device is plugged in: from the hello to the disconnect."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._received = bytearray()
        self._sending = bytearray()
        self._wide = False  # 64-bit ids, from the peer's hello on
        self._greeted = False
        self._waiting: list[_Transfer] = []
        self._configuration = 0
        self._send(Packet.HELLO, VERSION.ljust(64, b"\0") + struct.pack("<I", _CAPABILITIES))

    @property
    def wanted(self) -> int:
        """Bytes that the host's oldest unanswered bulk transfer has room for; 0 without one."""
        return self._waiting[0].length if self._waiting else 0

    def receive(self, data: bytes) -> None:
        """Take bytes from QEMU. Raises RedirError."""
        self._received += data
        for kind, number, body in self._packets():
            if not self._greeted and kind != Packet.HELLO:
                raise RedirError(f"packet {kind} before the hello")
            self._take(kind, number, body)

    def data_to_send(self) -> bytes:
        """Bytes for QEMU since the last call."""
        data = bytes(self._sending)
        self._sending.clear()
        return data

    def answer(self, data: bytes) -> None:
        """Fill the oldest bulk transfer; at most `wanted` bytes, and fewer end what the device was saying."""
        self._finish(self._waiting.pop(0), Status.SUCCESS, data)

    def unplug(self) -> None:
        """As if the cable were pulled."""
        self._send(Packet.DEVICE_DISCONNECT)

    def _packets(self) -> Iterator[tuple[int, int, bytes]]:
        while True:
            header = _LONG if self._wide else _SHORT
            if len(self._received) < header.size:
                return
            kind, length, number = header.unpack_from(self._received)
            if len(self._received) < header.size + length:
                return
            body = bytes(self._received[header.size : header.size + length])
            del self._received[: header.size + length]
            yield kind, number, body

    def _send(self, kind: Packet, body: bytes = b"", number: int = 0) -> None:
        header = _LONG if self._wide and kind != Packet.HELLO else _SHORT
        self._sending += header.pack(kind, len(body), number) + body

    def _take(self, kind: int, number: int, body: bytes) -> None:
        match kind:
            case Packet.HELLO:
                self._greet(body)
            case Packet.RESET:
                self._restart()
            case Packet.SET_CONFIGURATION:
                self._configuration = body[0]
                self._restart()
                self._describe()
                self._send(Packet.CONFIGURATION_STATUS, bytes([Status.SUCCESS, self._configuration]), number)
            case Packet.GET_CONFIGURATION:
                self._send(Packet.CONFIGURATION_STATUS, bytes([Status.SUCCESS, self._configuration]), number)
            case Packet.SET_ALT_SETTING:
                self._send(Packet.ALT_SETTING_STATUS, bytes([Status.SUCCESS, body[0], body[1]]), number)
            case Packet.GET_ALT_SETTING:
                self._send(Packet.ALT_SETTING_STATUS, bytes([Status.SUCCESS, body[0], 0]), number)
            case Packet.CANCEL_DATA_PACKET:
                self._cancel(number)
            case Packet.CONTROL_PACKET:
                self._control(number, body)
            case Packet.BULK_PACKET:
                self._queue(number, body)

    def _greet(self, body: bytes) -> None:
        (theirs,) = struct.unpack_from("<I", body, 64)
        if ~theirs & _CAPABILITIES:
            raise RedirError(f"the peer lacks abilities: it has {theirs:#x}, {_CAPABILITIES:#x} are needed")
        self._greeted = self._wide = True
        self._describe()
        who = self._device.identity
        numbers = (HIGH_SPEED, who.usb_class, who.subclass, who.protocol, who.vendor, who.product, who.release)
        self._send(Packet.DEVICE_CONNECT, struct.pack("<BBBBHHH", *numbers))

    def _describe(self) -> None:
        """Interfaces and endpoints, as tables of fixed size."""
        interfaces = self._device.interfaces
        columns = ([i.number for i in interfaces], [i.usb_class for i in interfaces], [i.subclass for i in interfaces])
        body = struct.pack("<I", len(interfaces)) + b"".join(bytes(c).ljust(32, b"\0") for c in columns) + bytes(32)
        self._send(Packet.INTERFACE_INFO, body)
        types, owners, sizes = [_UNUSED] * _ENDPOINTS, [0] * _ENDPOINTS, [0] * _ENDPOINTS
        for zero in (0, 16):
            types[zero], sizes[zero] = 0, 64
        for endpoint in self._device.endpoints:
            place = endpoint.address & 15 | (endpoint.address & TO_HOST) >> 3
            types[place], owners[place], sizes[place] = 2, endpoint.interface, endpoint.packet_size
        self._send(Packet.EP_INFO, bytes(types) + bytes(_ENDPOINTS) + bytes(owners) + struct.pack("<32H", *sizes))

    def _restart(self) -> None:
        self._waiting.clear()
        self._device.configured()

    def _control(self, number: int, body: bytes) -> None:
        endpoint, request, kind, _, value, index, length = _CONTROL.unpack_from(body)
        answer = self._device.control(Setup(request, kind, value, index, length), body[_CONTROL.size :])
        status = Status.STALL if answer is None else Status.SUCCESS
        reading = bool(kind & TO_HOST)
        data = (answer or b"")[:length] if reading else b""
        done = len(data) if reading else length
        header = _CONTROL.pack(endpoint, request, kind, status, value, index, done)
        self._send(Packet.CONTROL_PACKET, header + data, number)

    def _queue(self, number: int, body: bytes) -> None:
        endpoint, _, low, _, high = _BULK.unpack_from(body)
        if len(self._waiting) == WAITING_LIMIT:
            raise RedirError(f"more than {WAITING_LIMIT} bulk transfers at once")
        self._waiting.append(_Transfer(number, endpoint, high << 16 | low))

    def _cancel(self, number: int) -> None:
        for transfer in self._waiting:
            if transfer.number == number:
                self._waiting.remove(transfer)
                self._finish(transfer, Status.CANCELLED, b"")
                return

    def _finish(self, transfer: _Transfer, status: Status, data: bytes) -> None:
        header = _BULK.pack(transfer.endpoint, status, len(data) & 0xFFFF, 0, len(data) >> 16)
        self._send(Packet.BULK_PACKET, header + data, transfer.number)
