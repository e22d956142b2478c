"""The base under asyncio: against an emulator on a real pty, and in virtual time against a device in memory."""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from itertools import pairwise
from typing import Any

import pytest

from firmware_bridge.bases.omnibot import OmnibotHost
from firmware_bridge.device import OmnibotDevice
from firmware_bridge.emulator import Emulator, Senses
from firmware_bridge.events import BridgeError, Connected, Disconnected, LastWords, Telemetry
from omnibotd.io import motor_base
from omnibotd.io.motor_base import EVENT_LIMIT, LinkLost, MotorBase, open_serial
from tools.sim import virtual_time

TURN = 2.0 * math.pi
BAUD = 115200


async def until(condition: Callable[[], bool], within: float = 5.0) -> None:
    async with asyncio.timeout(within):
        while not condition():  # noqa: ASYNC110 (what is waited for has no event of its own)
            await asyncio.sleep(0.01)


@asynccontextmanager
async def running(*things: Any) -> Any:
    """Their `run` as tasks; all cancelled and over at the end."""
    tasks = [asyncio.create_task(thing.run()) for thing in things]
    try:
        yield tasks
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


@contextmanager
def emulator(**options: Any) -> Iterator[Emulator]:
    made = Emulator(OmnibotDevice(1000.0, boot_nonce=1), **options)
    try:
        yield made
    finally:
        made.close()


def over_pty(base_on: Callable[[], str]) -> MotorBase:
    return MotorBase(OmnibotHost(), lambda: open_serial(base_on(), BAUD))


def test_connects_drives_and_stops_on_the_way_out() -> None:
    async def main(emulated: Emulator) -> None:
        base = over_pty(lambda: emulated.port)
        assert (base.connected, base.reason) == (False, "not started")
        async with running(emulated, base) as (_, task):
            await until(lambda: base.latest is not None)
            assert base.info is not None and base.info.board == "emulator"
            assert base.reason == ""
            base.drive(TURN, -TURN)
            await until(lambda: emulated.device.target == (1000, -1000))
            await until(lambda: base.latest is not None and base.latest.left_ticks > 50)
            assert base.latest is not None and base.latest.right_ticks < -40
            assert base.latest.bumper_left and base.latest.charging is True
            base.drive(TURN, -TURN)
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task
            # Well before the base's own watchdog.
            await until(lambda: emulated.device.target == (0, 0), within=0.2)
            assert (base.connected, base.reason) == (False, "stopped")

    with emulator(senses=lambda: Senses(bumper_left=True, charging=True)) as emulated:
        asyncio.run(main(emulated))


def test_emergency_stop_and_release() -> None:
    async def main(emulated: Emulator) -> None:
        base = over_pty(lambda: emulated.port)
        async with running(emulated, base):
            await until(lambda: base.connected)
            base.emergency_stop()
            await until(lambda: base.latest is not None and base.latest.emergency_stop)
            base.drive(TURN, TURN)
            base.release()
            await until(lambda: base.latest is not None and not base.latest.emergency_stop)
            assert emulated.device.target == (0, 0)

    with emulator() as emulated:
        asyncio.run(main(emulated))


def test_silence_and_restart_of_the_base() -> None:
    async def main(emulated: Emulator) -> None:
        base = over_pty(lambda: emulated.port)
        async with running(emulated, base):
            await until(lambda: base.connected)
            emulated.silent = True
            await until(lambda: not base.connected)
            assert base.reason == "silent"
            emulated.reset(nonce=2)
            emulated.silent = False
            await until(lambda: base.connected)
            assert base.info is not None and base.info.boot_nonce == 2
        reasons = [e.reason for e in base.drain() if isinstance(e, Disconnected)]
        assert reasons == ["waiting for the base to answer", "silent", "base restarted", "stopped"]

    with emulator() as emulated:
        asyncio.run(main(emulated))


def test_cable_pulled_and_put_back(caplog: pytest.LogCaptureFixture) -> None:
    async def main(first: Emulator, second: Emulator) -> None:
        port = [first.port]
        base = over_pty(lambda: port[0])
        async with running(first, second, base):
            await until(lambda: base.connected)
            first.close()
            await until(lambda: not base.connected)
            assert first.port in base.reason
            port[0] = second.port
            await until(lambda: base.connected)
            base.drive(TURN, TURN)
            await until(lambda: second.device.target == (1000, 1000))

    with emulator() as first, emulator() as second, caplog.at_level(logging.INFO, "omnibotd.io"):
        asyncio.run(main(first, second))
    told = [message.split(":")[0] for message in caplog.messages]
    assert told == ["base", "base lost", "base", "base lost"]
    assert caplog.messages[-1] == "base lost: stopped"


def test_a_noisy_line() -> None:
    async def main(emulated: Emulator) -> None:
        for line in (emulated.to_device, emulated.to_host):
            line.garbage, line.loss, line.split, line.delay = 0.2, 0.1, True, 0.01
        base = over_pty(lambda: emulated.port)
        async with running(emulated, base):
            await until(lambda: base.connected)
            for _ in range(10):
                base.drive(TURN, TURN)
                await asyncio.sleep(0.04)
            assert base.connected
            assert base.latest is not None and base.latest.left_ticks > 100

    with emulator(seed=5) as emulated:
        asyncio.run(main(emulated))


# In virtual time


class MemoryLink:
    """A good line of no length to a device in memory; `cut` unplugs it."""

    def __init__(self, device: OmnibotDevice) -> None:
        self.device = device
        self.cut = False
        self.closed = False
        self.written = b""

    async def read(self) -> bytes:
        while not self.cut:
            await asyncio.sleep(0.005)
            self.device.poll(asyncio.get_running_loop().time())
            data = self.device.data_to_send()
            if data:
                return data
        raise LinkLost("unplugged")

    def write(self, data: bytes) -> None:
        assert not self.closed
        self.written += data
        if not self.cut:
            self.device.receive(data, asyncio.get_running_loop().time())

    def close(self) -> None:
        self.closed = True


def opener(*links: Any) -> Callable[[], Awaitable[Any]]:
    """Opens these in turn; an exception among them is raised."""
    coming = iter(links)

    async def open_link() -> Any:
        link = next(coming)
        if isinstance(link, Exception):
            raise link
        return link

    return open_link


def test_back_off_grows_to_its_limit_and_starts_anew_after_a_connection() -> None:
    tried: list[float] = []
    links: list[MemoryLink] = []

    async def open_link() -> MemoryLink:
        tried.append(asyncio.get_running_loop().time())
        if len(tried) != 8:
            raise LinkLost("no such device")
        links.append(MemoryLink(OmnibotDevice(1000.0, 1)))
        return links[0]

    async def main() -> None:
        base = MotorBase(OmnibotHost(), open_link)
        async with running(base):
            await until(lambda: base.connected, within=60.0)
            tried.append(math.nan)
            links[0].cut = True
            await asyncio.sleep(2.0)
            assert base.reason == "no such device"

    virtual_time.run(main())
    waits = [b - a for a, b in pairwise(tried[:8])]
    assert waits == pytest.approx([0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0])
    assert tried[10] - tried[9] == pytest.approx(0.4)


def test_same_base_on_a_new_link_counts_as_a_new_connection() -> None:
    async def main() -> None:
        device = OmnibotDevice(1000.0, 1)
        first, second = MemoryLink(device), MemoryLink(device)
        base = MotorBase(OmnibotHost(), opener(first, second))
        async with running(base):
            await until(lambda: base.connected)
            device.set_state(700, 700)
            first.cut = True
            await asyncio.sleep(0.05)
            assert (base.connected, base.reason, base.latest) == (False, "unplugged", None)
            assert first.closed
            base.drain()
            await until(lambda: base.latest is not None)
        happened = base.drain()
        assert isinstance(happened[1], Connected)
        assert isinstance(happened[2], Telemetry) and happened[2].left_ticks == 0

    virtual_time.run(main())


def test_a_base_that_never_answers_is_opened_anew() -> None:
    class Deaf(MemoryLink):
        def write(self, data: bytes) -> None:
            self.written += data

    async def main() -> None:
        deaf, good = Deaf(OmnibotDevice(1000.0, 1)), MemoryLink(OmnibotDevice(1000.0, 2))
        base = MotorBase(OmnibotHost(), opener(deaf, good))
        async with running(base):
            await asyncio.sleep(9.9)
            assert not deaf.closed
            await until(lambda: base.connected)
        reasons = [event.reason for event in base.drain() if isinstance(event, Disconnected)]
        assert motor_base.NO_ANSWER in reasons

    virtual_time.run(main())


def test_events_are_bounded_and_connections_outlive_telemetry() -> None:
    async def main() -> None:
        base = MotorBase(OmnibotHost(), opener(MemoryLink(OmnibotDevice(1000.0, 1))))
        async with running(base):
            await asyncio.sleep(60.0)
            happened = base.drain()
            assert base.drain() == []
            assert len(happened) == EVENT_LIMIT
            assert isinstance(happened[0], Disconnected) and isinstance(happened[1], Connected)
            assert happened[-1] == base.latest
            stamps = [event.stamp for event in happened if isinstance(event, Telemetry)]
            assert stamps == sorted(stamps)
            assert stamps[-1] - stamps[0] == pytest.approx(4.0, abs=0.2)  # the newest 198 at 50 Hz

    virtual_time.run(main())


def test_a_driver_s_bug_ends_the_run_and_still_stops_the_wheels() -> None:
    class Buggy(OmnibotHost):
        def poll(self, now: float) -> Any:
            if broken:
                raise RuntimeError("bug")
            return super().poll(now)

    broken: list[bool] = []

    async def main() -> None:
        link = MemoryLink(OmnibotDevice(1000.0, 1))
        base = MotorBase(Buggy(), opener(link))
        async with running(base) as (task,):
            await until(lambda: base.connected)
            base.drive(TURN, TURN)
            assert link.device.target == (1000, 1000)
            broken.append(True)
            await asyncio.sleep(0.05)
            assert link.device.target == (0, 0)
            assert link.closed
            with pytest.raises(RuntimeError, match="bug"):
                await task

    virtual_time.run(main())


def test_a_driver_deaf_to_silence_is_our_bug() -> None:
    class Trusting(OmnibotHost):
        def poll(self, now: float) -> Any:
            self._heard_at = now
            return super().poll(now)

    async def main() -> None:
        link = MemoryLink(OmnibotDevice(1000.0, 1))
        base = MotorBase(Trusting(), opener(link))
        async with running(base) as (task,):
            await until(lambda: base.connected)
            link.cut = True
            with pytest.raises(BridgeError, match="Trusting did not notice"):
                await task

    virtual_time.run(main())


def test_what_was_asked_without_a_link_is_not_sent_later() -> None:
    async def main() -> None:
        link = MemoryLink(OmnibotDevice(1000.0, 1))
        base = MotorBase(OmnibotHost(), opener(LinkLost("not yet"), link))
        async with running(base):
            await asyncio.sleep(0.1)
            base.drive(TURN, TURN)
            await until(lambda: base.connected)
            await asyncio.sleep(0.2)
            assert link.device.target == (0, 0)

    virtual_time.run(main())


def test_after_a_stall_of_this_process_all_begins_anew() -> None:
    async def main() -> None:
        first, second = (MemoryLink(OmnibotDevice(1000.0, k)) for k in range(2))
        base = MotorBase(OmnibotHost(), opener(first, second))
        async with running(base):
            await until(lambda: base.connected)
            base.drive(TURN, TURN)
            time.sleep(motor_base.STALL_LIMIT + 0.1)  # noqa: ASYNC251 (the stall)
            base.drive(TURN, TURN)  # as a control tick that is overdue, too
            assert first.device.target == (0, 0)
            await until(lambda: not base.connected)
            assert "stood still" in base.reason
            assert first.closed and first.device.target == (0, 0)
            await until(lambda: base.connected)
            assert second.device.target == (0, 0)

    asyncio.run(main())


# A base without a watchdog of its own


class SpeakingHost(OmnibotHost):
    """The native driver, as if its base had no watchdog."""

    last_words = LastWords(stand=b"", leave=b"LEAVE")


class FakeGuard:
    """Notes what it is told."""

    def __init__(self, told: list[object]) -> None:
        self.told = told
        self.alive = True

    def beat(self, rolling: bool) -> None:
        self.told.append(rolling)

    async def close(self) -> None:
        await asyncio.sleep(0.2)
        self.told.append("gone")


def test_such_a_base_is_guarded_before_a_byte_goes_out_and_hears_the_last_words() -> None:
    told: list[object] = []

    async def main() -> None:
        link = MemoryLink(OmnibotDevice(1000.0, 1))

        async def start_guard(port: Any, words: LastWords) -> FakeGuard:
            await asyncio.sleep(0.3)
            assert (port, words, link.written) == (link, SpeakingHost.last_words, b"")
            return FakeGuard(told)

        base = MotorBase(SpeakingHost(), opener(link), start_guard)
        async with running(base):
            await until(lambda: base.connected)
            base.drive(TURN, TURN)
            base.stop()
        assert link.written.endswith(b"LEAVE") and link.closed

    virtual_time.run(main())
    # Driven, stopped, and the zero set-point on the way out.
    assert told == [True, False, False, "gone"]


def test_a_dead_guard_ends_the_connection_and_the_next_one_has_another() -> None:
    guards: list[FakeGuard] = []
    told: list[object] = []

    async def start_guard(port: Any, words: LastWords) -> FakeGuard:
        if len(guards) == 1 and not told:
            told.append("refused")
            raise LinkLost("no process")
        guards.append(FakeGuard(told))
        return guards[-1]

    async def main() -> None:
        links = [MemoryLink(OmnibotDevice(1000.0, k)) for k in range(3)]
        base = MotorBase(SpeakingHost(), opener(*links), start_guard)
        async with running(base):
            await until(lambda: base.connected)
            guards[0].alive = False
            guards[0].told = []
            await until(lambda: not base.connected)
            assert "guards the base died" in base.reason
            await until(lambda: base.reason == "no process")
            assert links[1].closed and links[1].written == b"LEAVE"
            await until(lambda: base.connected)
            assert len(guards) == 2

    virtual_time.run(main())


def test_a_base_with_a_watchdog_has_no_guard() -> None:
    async def refuse(port: Any, words: LastWords) -> FakeGuard:
        raise AssertionError("not needed")

    async def main() -> None:
        base = MotorBase(OmnibotHost(), opener(MemoryLink(OmnibotDevice(1000.0, 1))), refuse)
        async with running(base):
            await until(lambda: base.connected)

    virtual_time.run(main())
