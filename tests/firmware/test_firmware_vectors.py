"""C and Python read and write the same bytes: the vectors of PROTOCOL.md, and noise."""

from __future__ import annotations

import random
import struct
from pathlib import Path

import pytest

import firmware_bridge
from firmware_bridge import messages
from firmware_bridge.framing import Decoder, encode
from firmware_bridge.messages import Ack, Config, GetConfig, Hello, HelloReply, Stop, Telemetry
from tools.avr.bench import BOOT, Bench

DOCUMENT = Path(firmware_bridge.__file__).with_name("PROTOCOL.md").read_text(encoding="utf-8")
NONCE = 0x2A00BEEF  # of all vectors
EEPROM_NONCE = 16


def rows(header: str) -> list[list[str]]:
    lines = DOCUMENT[DOCUMENT.index(header) :].splitlines()[2:]
    table = lines[: next((i for i, line in enumerate(lines) if not line.startswith("|")), len(lines))]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table]


# The first of each name.
GOOD = {
    name: bytes.fromhex(frame.strip("`")) for name, _, _, frame in reversed(rows("| message | seq | fields | frame |"))
}
BAD = [(why, counter, bytes.fromhex(frame.strip("`"))) for why, counter, frame in rows("| why | counter | frame |")]


def crc(data: bytes) -> int:
    """CRC-16/CCITT-FALSE, bit by bit."""
    register = 0xFFFF
    for byte in data:
        register ^= byte << 8
        for _ in range(8):
            register = register << 1 ^ (0x1021 if register & 0x8000 else 0)
        register &= 0xFFFF
    return register


def born_as(bench: Bench, nonce: int) -> None:
    """Restarts the firmware as the boot `nonce`."""
    before = struct.pack("<I", nonce - 1)
    bench.robot.write_eeprom(EEPROM_NONCE, before + struct.pack("<H", crc(before)))
    bench.robot.reset()
    bench.robot.run(BOOT)
    bench.heard()


def tell(bench: Bench, frame: bytes, wait: float = 0.005) -> bytes:
    """What the firmware answers to these bytes within `wait` seconds."""
    bench.robot.receive()
    bench.robot.deliver(frame)
    bench.robot.run(wait)
    return bench.robot.receive()


def test_the_vectors_of_the_host_are_understood(any_bench: Bench) -> None:
    bench = any_bench
    born_as(bench, NONCE)
    tell(bench, GOOD["Hello"])
    bench.robot.run(0.1)
    bench.robot.deliver(GOOD["SetPoint"])  # number 2, left 1200, right -1200, 0.1 s after boot
    bench.robot.run(0.1)
    report = bench.report()
    assert report.boot_nonce == NONCE and report.setpoint_seq == 2
    assert report.pwm_left > 0 > report.pwm_right
    bench.robot.deliver(GOOD["Stop"])
    assert bench.report().status & messages.Status.EMERGENCY_STOP
    bench.robot.deliver(GOOD["Release"])
    assert not bench.report().status & messages.Status.EMERGENCY_STOP


def test_the_vectors_of_the_base_are_written(any_bench: Bench) -> None:
    bench = any_bench
    born_as(bench, NONCE)
    tell(bench, GOOD["Stop"])
    assert tell(bench, GOOD["Stop"]) == GOOD["Ack"]
    assert tell(bench, GOOD["Configure"], wait=0.1)  # an Ack numbered 3
    assert tell(bench, GOOD["GetConfig"]) == GOOD["Config"]


def test_what_the_base_says_reads_back_byte_for_byte(any_bench: Bench) -> None:
    bench = any_bench
    said = tell(bench, b"\0" + messages.to_bytes(Hello(), 1))
    said += tell(bench, messages.to_bytes(GetConfig(), 2)) + tell(bench, messages.to_bytes(Stop(), 3))
    bench.robot.spin(0, 1000.0)
    bench.robot.spin(1, -1000.0)
    bench.robot.run(1.0)
    said += bench.robot.receive()
    frames = Decoder().feed(said)
    assert {type(messages.parse(frame)) for frame in frames} == {HelloReply, Config, Ack, Telemetry}
    assert b"".join(messages.to_bytes(messages.parse(frame), frame.seq) for frame in frames) == said
    assert [frame.seq for frame in frames] == [(n + 1) % 256 for n in range(len(frames))]


@pytest.mark.parametrize(("why", "counter", "frame"), BAD)
def test_drops_and_counts_as_documented(bench: Bench, why: str, counter: str, frame: bytes) -> None:
    bench.greet()
    assert all(message.__class__ is Telemetry for message in _parsed(tell(bench, frame)))
    report = bench.report()
    assert (report.crc_errors, report.overruns) == (0 if counter == "parse" else 1, 0), why
    assert not report.status & messages.Status.EMERGENCY_STOP


def _parsed(data: bytes) -> list[messages.Message]:
    return [messages.parse(frame) for frame in Decoder().feed(data)]


def noise(rng: random.Random) -> bytes:
    """A piece of a hostile line: random bytes, few zeros or many, and frames whole, cut, changed and doubled."""
    frame = encode(rng.randrange(0x10, 0x80), rng.randrange(256), rng.randbytes(rng.randrange(65)))
    at = rng.randrange(len(frame))
    return rng.choice(
        (
            rng.randbytes(rng.randrange(200)),
            bytes(rng.choice((0, 1, 2, 3, 255)) for _ in range(rng.randrange(100))),
            frame,
            frame * 2,
            frame[:at],
            frame[at:],
            frame[:at] + bytes((frame[at] ^ 1 << rng.randrange(8),)) + frame[at + 1 :],
            b"\0",
        )
    )


def listen_to_noise(bench: Bench, total: int, seed: int) -> None:
    """Feeds `total` bytes to the firmware and to Python's decoder; both must count the same errors."""
    rng = random.Random(seed)
    bench.greet()
    python = Decoder()
    fed = 0
    while fed < total:
        piece = b"\0" + b"".join(noise(rng) for _ in range(20)) + b"\0"
        python.feed(piece)
        bench.robot.deliver(piece)
        fed += len(piece)
        report = bench.report()
        assert report.crc_errors == (python.crc_errors + python.garbage) % 2**16
        assert report.overruns == python.overruns % 2**16
    assert bench.robot.resets == bench.robot.lost_bytes == 0
    assert python.crc_errors and python.overruns and python.garbage
    bench.greet()  # and it is still there


def test_counts_the_errors_of_a_hostile_line_as_python_does(any_bench: Bench) -> None:
    listen_to_noise(any_bench, 20_000, 1)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_ten_million_bytes_of_noise(bench: Bench) -> None:
    listen_to_noise(bench, 10_000_000, 2)
