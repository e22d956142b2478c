"""Messages of the native protocol, typed; field by field in PROTOCOL.md."""

from __future__ import annotations

import enum
import struct
from dataclasses import astuple, dataclass
from typing import ClassVar, Self, get_args

from firmware_bridge.events import BridgeError
from firmware_bridge.framing import Frame, encode

VERSION = 2
NOTHING_AHEAD = 0xFFFF  # in RANGE


class MalformedMessage(Exception):
    """The peer's fault: a whole frame whose content is no message of this protocol."""


class OtherVersion(MalformedMessage):
    """The peer speaks another version of the protocol."""

    def __init__(self, version: int) -> None:
        super().__init__(f"protocol version {version}, expected {VERSION}")
        self.version = version


class Capability(enum.IntFlag):
    """What a base has; bits of HELLO_REPLY."""

    BUMPERS = 1 << 0
    CLIFF = 1 << 1
    WHEEL_DROP = 1 << 2
    CHARGING = 1 << 3
    BATTERY = 1 << 4
    RANGE = 1 << 5
    CONFIGURATION = 1 << 6


class Status(enum.IntFlag):
    """What a base senses; bits of TELEMETRY."""

    BUMPER_LEFT = 1 << 0
    BUMPER_RIGHT = 1 << 1
    CLIFF = 1 << 2
    WHEEL_DROP = 1 << 3
    CHARGING = 1 << 4
    EMERGENCY_STOP = 1 << 5
    MOVING_ALLOWED = 1 << 6  # a set-point is in force: neither watchdog nor emergency stop holds the wheels


class Fault(enum.IntFlag):
    """What is wrong with a base; bits of TELEMETRY."""

    MOTOR_LEFT = 1 << 0
    MOTOR_RIGHT = 1 << 1
    ENCODER_LEFT = 1 << 2
    ENCODER_RIGHT = 1 << 3
    BATTERY_LOW = 1 << 4
    OVERHEATED = 1 << 5
    CONFIGURATION = 1 << 6  # what was stored is damaged: the base drives with its defaults


class Polarity(enum.IntFlag):
    """What is wired the other way round; bits of CONFIGURE and CONFIG."""

    MOTOR_LEFT = 1 << 0
    MOTOR_RIGHT = 1 << 1
    ENCODER_LEFT = 1 << 2
    ENCODER_RIGHT = 1 << 3
    BUMPERS_OPEN = 1 << 4  # switches that open when pressed
    CHARGER_LOW = 1 << 5  # the charging contact is low on the dock


class ConfigSource(enum.IntEnum):
    """Where a base's configuration came from; the last byte of CONFIG."""

    DEFAULT = 0  # nothing was ever stored
    STORED = 1
    DAMAGED = 2  # what was stored fails its checksum: defaults


class _Fixed:
    """A message whose payload is its fields in order, packed by LAYOUT."""

    __slots__ = ()
    CODE: ClassVar[int]
    LAYOUT: ClassVar[struct.Struct]

    def payload(self) -> bytes:
        try:
            return self.LAYOUT.pack(*astuple(self))  # type: ignore[call-overload]
        except struct.error as error:
            raise BridgeError(f"{self} does not fit the wire: {error}") from error

    @classmethod
    def parse(cls, payload: bytes) -> Self:
        try:
            return cls(*cls.LAYOUT.unpack(payload))
        except struct.error as error:
            raise MalformedMessage(f"{cls.__name__} of {len(payload)} bytes: {error}") from error


@dataclass(frozen=True, slots=True)
class Hello(_Fixed):
    """Host: who are you? The base stops, forgets set-points and answers with HelloReply."""

    CODE = 0x01
    LAYOUT = struct.Struct("<B")
    version: int = VERSION


@dataclass(frozen=True, slots=True)
class SetPoint(_Fixed):
    """Host: wheel speeds in ticks/s, for the boot named only; `mcu_us`: when that was, by the base's clock."""

    CODE = 0x02
    LAYOUT = struct.Struct("<IiiI")
    boot_nonce: int
    left: int
    right: int
    mcu_us: int


@dataclass(frozen=True, slots=True)
class Stop(_Fixed):
    """Host: emergency stop, whatever the state; latches until Release; acknowledged."""

    CODE = 0x03
    LAYOUT = struct.Struct("")


@dataclass(frozen=True, slots=True)
class Release(_Fixed):
    """Host: release the emergency stop of the boot named; acknowledged."""

    CODE = 0x04
    LAYOUT = struct.Struct("<I")
    boot_nonce: int


@dataclass(frozen=True, slots=True)
class GetConfig(_Fixed):
    """Host: what are you configured for? Answered with Config by a base with Capability.CONFIGURATION."""

    CODE = 0x05
    LAYOUT = struct.Struct("")


@dataclass(frozen=True, slots=True)
class _Configuration(_Fixed):
    """What differs from robot to robot; units and ranges in PROTOCOL.md."""

    boot_nonce: int
    ticks_per_1000_rev: int
    acceleration: int
    full_speed: int
    max_speed: int
    kp_16: int
    ki: int
    breakaway: int
    polarity: int
    battery_full_scale: int
    battery_low: int
    capabilities: int


@dataclass(frozen=True, slots=True)
class Configure(_Configuration):
    """Host: store this and drive with it; acknowledged when it is stored. Taken only while the wheels are held."""

    CODE = 0x06
    LAYOUT = struct.Struct("<IIIHHBBBBHHH")


@dataclass(frozen=True, slots=True)
class HelloReply(_Fixed):
    """Base: what I am. `board` is ASCII, at most 16 bytes; `ticks_per_1000_rev` avoids floats on the wire."""

    CODE = 0x81
    LAYOUT = struct.Struct("<BHIII16sH")
    version: int
    watchdog_ms: int
    ticks_per_1000_rev: int
    boot_nonce: int
    firmware: int
    board: bytes
    capabilities: int

    @classmethod
    def parse(cls, payload: bytes) -> Self:
        """The first byte is the version in all versions; the rest is read only when it is ours."""
        if payload and payload[0] != VERSION:
            raise OtherVersion(payload[0])
        reply = super(HelloReply, cls).parse(payload)  # named: a slotted dataclass breaks the bare super()
        if reply.ticks_per_1000_rev == 0:
            raise MalformedMessage("HELLO_REPLY with no ticks per revolution")
        return reply


@dataclass(frozen=True, slots=True)
class Ack(_Fixed):
    """Base: done; names type and sequence number of the request."""

    CODE = 0x82
    LAYOUT = struct.Struct("<BB")
    kind: int
    seq: int


@dataclass(frozen=True, slots=True)
class Telemetry(_Fixed):
    """Base: state, unasked. Encoders and `mcu_us` wrap at 32 bits, the counters at 16."""

    CODE = 0x83
    LAYOUT = struct.Struct("<IIiihhBHHBHH")
    boot_nonce: int
    mcu_us: int
    left_ticks: int
    right_ticks: int
    pwm_left: int
    pwm_right: int
    status: int
    faults: int
    battery_mv: int
    setpoint_seq: int
    crc_errors: int
    overruns: int


@dataclass(frozen=True, slots=True)
class Range(_Fixed):
    """Base: millimetres from its front edge to what is ahead, or NOTHING_AHEAD; before the telemetry it belongs to."""

    CODE = 0x84
    LAYOUT = struct.Struct("<IH")
    boot_nonce: int
    ahead_mm: int


@dataclass(frozen=True, slots=True)
class Config(_Configuration):
    """Base: the configuration in force, and where it came from."""

    CODE = 0x85
    LAYOUT = struct.Struct("<IIIHHBBBBHHHB")
    source: int


Message = Hello | SetPoint | Stop | Release | GetConfig | Configure | HelloReply | Ack | Telemetry | Range | Config
_TYPES: dict[int, type[Message]] = {kind.CODE: kind for kind in get_args(Message)}


def to_bytes(message: Message, seq: int) -> bytes:
    """One message as a frame for the line."""
    return encode(message.CODE, seq, message.payload())


def parse(frame: Frame) -> Message:
    """What a frame says; MalformedMessage when it is none of ours."""
    kind = _TYPES.get(frame.kind)
    if kind is None:
        raise MalformedMessage(f"unknown message type 0x{frame.kind:02x}")
    return kind.parse(frame.payload)


def names(flags: enum.IntFlag) -> frozenset[str]:
    """Lower-case names of the bits set; a bit this version has no name for appears as `bit_N`."""
    named = {flag.name.lower() for flag in type(flags) if flag in flags and flag.name}
    unnamed = int(flags) & ~sum(type(flags))
    return frozenset(named | {f"bit_{n}" for n in range(16) if unnamed >> n & 1})
