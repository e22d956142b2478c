"""Stops a base that has no watchdog of its own when this process no longer can: killed, stopped, or hung.

A second process shares the open port. It hears a beat at every set-point; when the beats end for 0.3 s while the
wheels turn, or for ever because this process died, it says the driver's last words. What it can't help against:
a pulled cable, and a PC that goes down as a whole.
"""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from firmware_bridge.events import LastWords
from omnibotd.io import stop_guard_child
from omnibotd.io.serial_link import LinkLost
from omnibotd.io.stop_guard_child import ROLLING, STANDING

START_LIMIT = 10.0  # s; Python starts in 20 ms, on a very slow PC with a cold disk in a second or two
END_LIMIT = 2.0  # s; it says its last words within 0.5 s


class Port(Protocol):
    """An open serial port or socket."""

    def fileno(self) -> int: ...


class StopGuard:
    """A guard at work; make it by `start`."""

    def __init__(self, process: subprocess.Popen[bytes], heart: socket.socket) -> None:
        self._process, self._heart = process, heart

    @classmethod
    async def start(cls, port: Port, words: LastWords) -> StopGuard:
        """Nothing may move before this has returned. LinkLost where no guard can be had."""
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        with theirs:
            try:
                process = await asyncio.to_thread(_spawn, port.fileno(), theirs.fileno(), words)
            except OSError as error:
                ours.close()
                raise LinkLost(f"no process to guard the base: {error.strerror}") from error
        guard = cls(process, ours)
        try:
            async with asyncio.timeout(START_LIMIT):
                ready = await asyncio.get_running_loop().sock_recv(ours, 1)
        except BaseException as error:
            await guard.close()
            if isinstance(error, TimeoutError):
                raise LinkLost("the process that is to guard the base does not start") from error
            raise
        if not ready:
            await guard.close()
            raise LinkLost("the process that is to guard the base ended at once")
        return guard

    @property
    def alive(self) -> bool:
        return self._process.poll() is None

    def beat(self, rolling: bool) -> None:
        """A set-point has just gone out; `rolling` unless it was zero. Never waits; a dead guard shows in `alive`."""
        with suppress(OSError):
            self._heart.send(ROLLING if rolling else STANDING)

    async def close(self) -> None:
        """Let it say the last words and go; returns when it has gone."""
        self._heart.close()
        await asyncio.to_thread(_wait, self._process)


def _spawn(line: int, heart: int, words: LastWords) -> subprocess.Popen[bytes]:
    # -I -S: no site packages, no environment: it starts in a third of the time.
    program = [sys.executable, "-I", "-S", str(Path(stop_guard_child.__file__))]
    arguments = [str(line), str(heart), words.stand.hex(), words.leave.hex()]
    return subprocess.Popen(
        program + arguments,
        pass_fds=(line, heart),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )


def _wait(process: subprocess.Popen[bytes]) -> None:
    try:
        process.wait(END_LIMIT)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
