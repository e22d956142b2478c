"""Anything at all into the driver `create2` and into its emulator: no crash, no growth, back within one frame."""

from __future__ import annotations

import random
import sys
import tracemalloc
from collections.abc import Callable

import pytest
from create2_rig import Rig
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_bridge.bases.create2 import Create2Host
from firmware_bridge.bases.create2_stream import FRAME, REQUEST, Report, StreamDecoder
from firmware_bridge.events import Telemetry
from tools.sim.emulators.create2 import Create2Device

CHUNK = 100_000  # bytes an example; a hundred examples make ten million


def frame(mode: int = 2) -> bytes:
    """A good frame, as the emulator makes it."""
    device = Create2Device()
    for said in (bytes((128,)), REQUEST, bytes((129 + mode,))):
        device.receive(said, 0.0)
    device.poll(0.0)
    return device.data_to_send()


GOOD = frame()


def noise(chance: random.Random, count: int) -> bytes:
    """Random bytes, text, pieces of frames and damaged frames, in any mixture."""

    def damaged() -> bytes:
        bad = bytearray(GOOD)
        for _ in range(chance.randint(1, 3)):
            bad[chance.randrange(len(bad))] = chance.randrange(256)
        return bytes(bad)

    kinds: list[Callable[[], bytes]] = [
        lambda: chance.randbytes(chance.randint(1, 400)),
        lambda: bytes(chance.choices(range(32, 127), k=chance.randint(1, 200))),
        lambda: GOOD[chance.randrange(FRAME) :],
        lambda: GOOD[: chance.randrange(FRAME)],
        lambda: GOOD[:2] * chance.randint(1, 40),
        damaged,
    ]
    data = bytearray()
    while len(data) < count:
        data += chance.choice(kinds)()
    return bytes(data[:count])


def feed(host: Create2Host, data: bytes, chance: random.Random, now: float) -> float:
    """In pieces as a line brings them, polled and driven as the daemon does."""
    at = 0
    while at < len(data):
        size = chance.choice((1, 7, 60, 1000, 4096))
        now += 0.005
        host.receive(data[at : at + size], now)
        host.poll(now)
        host.drive(3.0, 3.0, now)
        assert len(host.data_to_send()) < 100
        at += size
    return now


def back_within_one_frame(host: Create2Host, now: float) -> bool:
    """Half a frame may be pending: the next whole one is understood, whether or not hands must be shaken first."""
    host.poll(now + 0.4)
    host.poll(now + 0.95)
    host.data_to_send()
    passive = frame(0)
    assert len(passive) == FRAME
    host.receive(passive, now + 1.0)  # not this one where garbage has just shaken hands
    return any(isinstance(event, Telemetry) for event in host.receive(passive, now + 1.015))


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.integers(0, 2**32), st.binary(max_size=300))
def test_short_garbage(seed: int, data: bytes) -> None:
    chance, host = random.Random(seed), Create2Host()
    host.poll(0.0)
    now = feed(host, data + noise(chance, 500), chance, 0.0)
    assert back_within_one_frame(host, now)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.binary(max_size=200))
def test_the_frame_behind_any_bytes_is_found_as_soon_as_it_is_whole(data: bytes) -> None:
    decoder = StreamDecoder()
    for k in range(len(data)):
        decoder.feed(data[k : k + 1])
    found = decoder.feed(GOOD)
    assert isinstance(found[-1], Report)


@pytest.mark.slow
@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.integers(0, 2**64))
def test_ten_million_bytes(seed: int) -> None:
    chance, host = random.Random(seed), Create2Host()
    host.poll(0.0)
    now = feed(host, noise(chance, CHUNK), chance, 0.0)
    assert back_within_one_frame(host, now)


@pytest.mark.slow
def test_memory_does_not_grow_with_what_was_fed() -> None:
    chance, host = random.Random(1), Create2Host()
    now = feed(host, noise(chance, CHUNK), chance, 0.0)
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()
    for _ in range(5):
        now = feed(host, noise(chance, CHUNK), chance, now)
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert after - before < 20_000 + sys.getsizeof(b"")


@pytest.mark.slow
@settings(max_examples=50, deadline=None, derandomize=True)
@given(st.integers(0, 2**64))
def test_a_base_that_was_told_anything_is_found_and_stopped(seed: int) -> None:
    """Random bytes to the base: it may clean, sleep, reset or change its baud rate, but the last of those only."""
    chance = random.Random(seed)
    rig = Rig(seed)
    rig.run(0.3, 0.0, 0.0)
    for _ in range(200):
        rig.device.receive(chance.randbytes(chance.randint(1, 30)).replace(bytes((129,)), b""), rig.now)
        rig.step()
    rig.device.wake()
    rig.run(3.0, 0.0, 0.0)
    assert rig.connected and not rig.moving
