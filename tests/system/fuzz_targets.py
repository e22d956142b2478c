"""Everything here that makes sense of bytes from outside, in one form for the fuzzers."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from firmware_bridge import framing, messages
from firmware_bridge.bases import DRIVERS, make_driver
from firmware_bridge.bases.arduino_bridge import LineReader
from firmware_bridge.bases.create2_stream import FLUSH, REQUEST, START, StreamDecoder
from firmware_bridge.device import OmnibotDevice
from omnibotd.control_protocol import MAX_LINE, LineDecoder, encode_request
from tools.sim.emulators.create2 import Create2Device

SMALL = 4096  # bytes of a pickled parser of serial lines, whose frames have less than 200
STEP = 0.004  # s between two pieces: what a read of a serial port returns


@dataclass(frozen=True)
class Target:
    """`make` returns a fresh `feed`, and the object whose size must stay below `memory` bytes.

    `valid` is a frame, and `holds` tells whether what `feed` returned has it; None where only survival counts.
    """

    name: str
    make: Callable[[], tuple[Callable[[bytes], Sequence[Any]], object]]
    valid: bytes
    holds: Callable[[Sequence[Any]], bool] | None
    memory: int = SMALL


def _parser(kind: Callable[[], Any]) -> Callable[[], tuple[Callable[[bytes], Sequence[Any]], object]]:
    def make() -> tuple[Callable[[bytes], Sequence[Any]], object]:
        parser = kind()
        return parser.feed, parser

    return make


def _peer(kind: Callable[[], Any]) -> Callable[[], tuple[Callable[[bytes], Sequence[Any]], object]]:
    """A whole driver or device, polled and drained as its owner would."""

    def make() -> tuple[Callable[[bytes], Sequence[Any]], object]:
        peer, now = kind(), [100.0]

        def feed(data: bytes) -> Sequence[Any]:
            now[0] += STEP
            happened = [peer.receive(data, now[0]), peer.poll(now[0])]
            assert len(peer.data_to_send()) <= 1024
            return happened

        return feed, peer

    return make


def _create2_frame() -> bytes:
    base = Create2Device()
    base.receive(FLUSH + START + REQUEST, 0.0)
    for tick in range(10):
        base.poll(0.01 * tick)
        if data := base.data_to_send():
            return data
    raise AssertionError("no frame within 0.1 s")


_NATIVE = framing.encode(7, 1, b"payload")
_HELLO = messages.to_bytes(messages.Hello(), 1)
_TOLD = {"omnibot": _HELLO, "create2": _create2_frame(), "arduino_bridge": b"57600\r\n12 -34\r\n"}

TARGETS = (
    Target("framing", _parser(framing.Decoder), _NATIVE, lambda found: framing.Frame(7, 1, b"payload") in found),
    Target("arduino lines", _parser(LineReader), b"12 -34\r\n", lambda found: b"12 -34" in found),
    Target("create2 stream", _parser(StreamDecoder), _create2_frame(), bool),
    Target(
        "control lines",
        _parser(LineDecoder),
        encode_request(5, "status", {}),
        lambda found: any(getattr(request, "method", None) == "status" for request in found),
        memory=MAX_LINE + SMALL,
    ),
    *(
        Target(f"{base} driver", _peer(lambda base=base: make_driver(base, 1440.0, 12.0)), _TOLD[base], None)  # type: ignore[misc]
        for base in DRIVERS
    ),
    Target("omnibot device", _peer(lambda: OmnibotDevice(1440.0, 1)), _HELLO, None),
)

_MEANINGFUL = b'0123456789 -\r\n\0\x13\x1d{}[]",:eE.\\uOKbme'


def noise(kind: str, seed: int, size: int, valid: bytes) -> bytes:
    """`size` bytes or so of one kind of nonsense."""
    source = random.Random(seed)
    match kind:
        case "any":
            return source.randbytes(size)
        case "one byte":
            return bytes((source.randrange(256),)) * size
        case "meaningful":
            return bytes(source.choices(_MEANINGFUL, k=size))
        case "frames":
            return valid * (size // len(valid) + 1)
    spoiled = bytearray(valid * (size // len(valid) + 1))  # one byte in twenty
    for _ in range(len(spoiled) // 20 + 1):
        spoiled[source.randrange(len(spoiled))] = source.randrange(256)
    return bytes(spoiled)


KINDS = ("any", "one byte", "meaningful", "frames", "spoiled frames")


def pieces(data: bytes, seed: int) -> list[bytes]:
    """Cut as reads would cut it: mostly short, some long."""
    source = random.Random(seed)
    found, at = [], 0
    while at < len(data):
        size = source.choice((1, 7, 64, 512, 4096))
        found.append(data[at : at + size])
        at += size
    return found


def check_recovery(target: Target, feed: Callable[[bytes], Sequence[Any]]) -> None:
    """Of two valid frames after whatever came before, the second is understood: the first may complete that."""
    if target.holds is not None:
        feed(target.valid)
        assert target.holds(feed(target.valid)), f"{target.name} does not find its frame"
