"""The daemon that tools/runaway cuts off: the real one, forked from a process that has loaded its modules once."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import select
import signal
import socket
import sys
import time
from pathlib import Path
from typing import Any

from omnibotd.daemon import main

READY_LIMIT = 30.0  # s until base and camera answer
POLL = 0.05  # s
_FRESH = multiprocessing.get_context("forkserver")
_FRESH.set_forkserver_preload(["tools.runaway_daemon", "tools.runaway_bench"])

HELD_UP, LET_GO = signal.SIGUSR1, signal.SIGUSR2  # hang the event loop; let it go on


class DaemonError(Exception):
    """The daemon does not do what it is here for; the message has its last words."""


def live(config: Path, log: Path) -> None:
    """In a process of its own. SIGUSR1 holds up the whole event loop, as a call that never returns would."""
    with log.open("ab") as file:
        os.dup2(file.fileno(), sys.stderr.fileno())
    signal.pthread_sigmask(signal.SIG_BLOCK, {LET_GO})
    signal.signal(HELD_UP, lambda *_: signal.sigwait({LET_GO}))
    sys.exit(main(["--config", str(config)]))


class Daemon:
    """One daemon after another on the same configuration, and a client that asks it to drive."""

    def __init__(self, config: Path, control: Path, *, with_map: bool) -> None:
        """`control` is the path of its socket; `with_map`: it is not ready before it has loaded one."""
        self._config, self._control, self._with_map = config, control, with_map
        self._log = config.with_suffix(".log")
        self._process: Any = None
        self._hand: Hand | None = None

    @property
    def alive(self) -> bool:
        return self._process is not None and self._process.is_alive()

    @property
    def pid(self) -> int:
        return int(self._process.pid)

    def start(self) -> None:
        self._control.unlink(missing_ok=True)
        self._process = _FRESH.Process(target=live, args=(self._config, self._log), daemon=False)
        self._process.start()

    def end(self) -> None:
        """And all it has started; harmless when it is gone."""
        self._hang_up()
        if self._process is not None:
            send(signal.SIGKILL, [self.pid, *descendants(self.pid)])
            self._process.join()
            self._process = None

    def await_ready(self) -> None:
        """Until it has base, camera and map. DaemonError."""
        end = time.monotonic() + READY_LIMIT
        while time.monotonic() < end and self.alive:
            if self._ready():
                return
            time.sleep(POLL)
        raise DaemonError(f"not ready within {READY_LIMIT:.0f} s; it said:\n{self.said()}")

    def ask(self, method: str, **params: Any) -> None:
        """Raises ConnectionError where it has hung up."""
        assert self._hand is not None, "await_ready comes first"
        self._hand.ask(method, **params)

    @property
    def idle(self) -> bool:
        """Whether what was asked for has ended, or was refused."""
        return self._hand is None or self._hand.answered()

    def _ready(self) -> bool:
        try:
            self._hand = self._hand or Hand(self._control)
            return self._hand.ready(with_map=self._with_map)
        except OSError:
            self._hang_up()
            return False

    def _hang_up(self) -> None:
        if self._hand is not None:
            self._hand.close()
            self._hand = None

    def said(self) -> str:
        return "\n".join(self._log.read_text(errors="replace").splitlines()[-20:])


class Hand:
    """A client of the daemon."""

    def __init__(self, path: Path) -> None:
        """OSError where nobody listens yet."""
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(5.0)
        try:
            self._socket.connect(str(path))
        except OSError:
            self._socket.close()
            raise
        self._received = b""
        self._asked = 0
        self._answers: dict[int, dict[str, Any]] = {}

    def ask(self, method: str, **params: Any) -> None:
        self._asked += 1
        request = {"jsonrpc": "2.0", "id": self._asked, "method": method, "params": params}
        self._socket.sendall(json.dumps(request).encode() + b"\n")

    def answered(self) -> bool:
        """Whether the answer to the last request has come."""
        while select.select([self._socket], [], [], 0.0)[0]:
            self._read()
        return self._asked in self._answers

    def ready(self, *, with_map: bool) -> bool:
        """Whether the daemon has base, camera and map. OSError where it hangs up or keeps silent."""
        self.ask("status")
        while self._asked not in self._answers:
            self._read()
        status = self._answers[self._asked]["result"]
        return bool(status["base"]["connected"] and status["camera"]["ok"] and (status["map"] or not with_map))

    def close(self) -> None:
        self._socket.close()

    def _read(self) -> None:
        data = self._socket.recv(65536)
        if not data:
            raise ConnectionError("the daemon hung up")
        *lines, self._received = (self._received + data).split(b"\n")
        for message in map(json.loads, lines):
            if "id" in message:
                self._answers = {message["id"]: message}  # only the newest is ever asked about


def send(number: signal.Signals, pids: list[int]) -> None:
    """To those that are still there."""
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, number)


def descendants(pid: int) -> list[int]:
    """Children and theirs, as a service's whole control group is killed."""
    found: list[int] = []
    for tasks in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            for child in map(int, tasks.read_text().split()):
                found += [child, *descendants(child)]
    return found
