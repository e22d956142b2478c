"""The process that stops a base without a watchdog: on a real pty, against a real death of its daemon."""

from __future__ import annotations

import asyncio
import os
import select
import signal
import subprocess
import sys
import time
import tty
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from firmware_bridge.events import LastWords
from omnibotd.io.serial_link import LinkLost
from omnibotd.io.stop_guard import StopGuard
from omnibotd.io.stop_guard_child import SILENCE

ROOT = Path(__file__).resolve().parents[2]
WORDS = LastWords(stand=b"STAND", leave=b"LEAVE")
# A daemon that beats ten times a second; it says so for a start.
DAEMON = """
import asyncio, os, sys
from firmware_bridge.events import LastWords
from omnibotd.io.stop_guard import StopGuard
async def main():
    with open(sys.argv[1], "r+b", buffering=0) as port:
        guard = await StopGuard.start(port, LastWords(b"STAND", b"LEAVE"))
        print(guard._process.pid, flush=True)
        while True:
            guard.beat(rolling=sys.argv[2] == "rolling")
            await asyncio.sleep(0.1)
asyncio.run(main())
"""


@dataclass
class Line:
    """A pty: `port` is what the daemon opens, the rest is the base's end."""

    master: int
    slave: int

    @property
    def port(self) -> str:
        return os.ttyname(self.slave)

    def fileno(self) -> int:
        return self.slave

    def hears(self, within: float) -> bytes:
        """What comes next, empty when nothing does."""
        ready, _, _ = select.select([self.master], [], [], within)
        return os.read(self.master, 4096) if ready else b""


@pytest.fixture
def line() -> Iterator[Line]:
    master, slave = os.openpty()
    tty.setraw(slave)
    yield Line(master, slave)
    os.close(master)
    os.close(slave)


@pytest.fixture
def daemon(line: Line, request: pytest.FixtureRequest) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-c", DAEMON, line.port, getattr(request, "param", "rolling")]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline()
    yield process
    process.send_signal(signal.SIGCONT)
    process.kill()
    process.communicate()


def test_a_killed_daemon_s_base_stops_at_once(line: Line, daemon: subprocess.Popen[str]) -> None:
    assert line.hears(2.0 * SILENCE) == b""
    killed = time.monotonic()
    daemon.kill()
    assert line.hears(1.0) == b"LEAVE"
    assert time.monotonic() - killed < 0.25
    daemon.wait()
    assert line.hears(2.0 * SILENCE) == b""


def test_a_stopped_daemon_s_base_stands_after_a_moment_and_is_told_so_again(
    line: Line, daemon: subprocess.Popen[str]
) -> None:
    assert line.hears(0.15) == b""
    stopped = time.monotonic()
    daemon.send_signal(signal.SIGSTOP)
    assert line.hears(1.0) == b"STAND"
    assert SILENCE - 0.15 < time.monotonic() - stopped < SILENCE + 0.25
    assert line.hears(1.0) == b"STAND"
    daemon.send_signal(signal.SIGCONT)
    time.sleep(0.15)
    line.hears(0.0)
    assert line.hears(2.0 * SILENCE) == b""


@pytest.mark.parametrize("daemon", ["standing"], indirect=True)
def test_a_standing_base_is_left_alone(line: Line, daemon: subprocess.Popen[str]) -> None:
    daemon.send_signal(signal.SIGSTOP)
    assert line.hears(2.5 * SILENCE) == b""


def test_it_outlives_the_signals_that_end_a_service(line: Line) -> None:
    async def main() -> None:
        guard = await StopGuard.start(line, WORDS)
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            guard._process.send_signal(number)
        await asyncio.sleep(0.1)
        assert guard.alive
        guard.beat(rolling=True)
        await guard.close()
        assert not guard.alive

    asyncio.run(main())
    assert line.hears(0.0) == b"LEAVE"


def test_a_line_that_takes_no_more_is_emptied_for_the_last_words(line: Line) -> None:
    os.set_blocking(line.slave, False)
    with pytest.raises(BlockingIOError):
        while True:
            os.write(line.slave, b"set-point" * 100)

    async def main() -> None:
        await (await StopGuard.start(line, WORDS)).close()

    asyncio.run(main())
    heard = b""
    while more := line.hears(0.1):
        heard += more
    # Of 20 kB of old set-points only what the pty has handed over already, one buffer, comes before them.
    assert heard.endswith(b"LEAVE") and len(heard) < 5000


def test_its_death_shows_and_beats_go_nowhere(line: Line) -> None:
    async def main() -> None:
        guard = await StopGuard.start(line, WORDS)
        guard._process.kill()
        await asyncio.sleep(0.05)
        for _ in range(3):
            guard.beat(rolling=True)
        assert not guard.alive
        await guard.close()

    asyncio.run(main())


def test_one_that_cannot_start_is_told(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(LinkLost, match="ended at once"):
        asyncio.run(StopGuard.start(line, WORDS))
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    with pytest.raises(LinkLost, match="No such file"):
        asyncio.run(StopGuard.start(line, WORDS))


def test_it_stays_small(line: Line) -> None:
    async def main() -> int:
        guard = await StopGuard.start(line, WORDS)
        status = await asyncio.to_thread(Path(f"/proc/{guard._process.pid}/status").read_text)
        await guard.close()
        return int(next(row for row in status.splitlines() if row.startswith("VmRSS")).split()[1])

    assert asyncio.run(main()) < 16_000  # kB
