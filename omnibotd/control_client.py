"""The client's side of the control socket: blocking, standard library only, so that omnibotctl starts in a blink."""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

from omnibotd import control_protocol as protocol
from omnibotd.core.error_name import ErrorName

PATIENCE = 5.0  # s of silence after which the daemon is asked for its status; as long again and it is given up
_TICK = 1.0  # s between calls of `on_wait`
_MAX_LINE = 64 * 1024 * 1024  # bytes; the longest answer is a picture of a map, a few megabytes

Params = dict[str, Any]


class NoDaemon(Exception):
    """Nobody listens, or whoever does has stopped answering."""


class RemoteError(Exception):
    """The daemon's answer is an error: `code` and `name` as it sent them, the message for a person, and a failed job's
    `report` of what was seen and expected."""

    def __init__(self, code: int, name: str, message: str, report: Params | None = None) -> None:
        super().__init__(message)
        self.code = code
        self.name = name
        self.report = report if isinstance(report, dict) else {}


class Client:
    """One connection. Every wait ends when the daemon falls silent, as NoDaemon."""

    def __init__(self, path: str) -> None:
        """Connect; raises NoDaemon, or RemoteError NOT_PERMITTED where this user may not."""
        self._path = path
        self._lines = protocol.LineSplitter(_MAX_LINE)
        self._arrived: list[Params] = []
        self._last_id = 0
        self._socket = _connected(path)

    def close(self) -> None:
        self._socket.close()

    def call(
        self,
        method: str,
        params: Params,
        on_feedback: Callable[[Params], None] = lambda _: None,
        on_wait: Callable[[float], None] = lambda _: None,
    ) -> Params:
        """The result of a request, however long it takes while the daemon gives a sign of life; raises RemoteError.

        `on_wait(seconds)` is called about once a second while nothing comes.
        """
        request_id = self._send(method, params)
        patience = PATIENCE if method == "status" else 2 * PATIENCE
        began = heard = time.monotonic()
        asked = False
        while True:
            message = self._receive(_TICK)
            now = time.monotonic()
            if message is None:
                asked = self._doubt(now - heard, patience, asked)
                on_wait(now - began)
                continue
            heard, asked = now, False
            if message.get("id") == request_id:
                return _result(message)
            params = message.get("params") or {}
            if message.get("method") == "feedback" and params.pop("id", None) == request_id:
                on_feedback(params)

    def events(self) -> Iterator[Params]:
        """Every event from now on, until the daemon ends."""
        self.call("subscribe", {})
        while True:
            message = self._receive(_TICK)
            if message is not None and message.get("method") == "event":
                yield message["params"]

    def stop(self) -> None:
        """Cancel what runs and wait, for a while, for the daemon to say so; raises NoDaemon where it doesn't."""
        request_id = self._send("stop", {})
        deadline = time.monotonic() + PATIENCE
        while (left := deadline - time.monotonic()) > 0:
            message = self._receive(left)
            if message is not None and message.get("id") == request_id:
                _result(message)
                return
        raise NoDaemon(f"omnibotd did not confirm the stop within {PATIENCE:.0f} s")

    def _doubt(self, silence: float, patience: float, asked: bool) -> bool:
        """Ask a silent daemon, once, whether it lives, and give it up when its patience is spent."""
        if silence >= patience:
            raise NoDaemon(f"omnibotd at {self._path} has not answered for {silence:.0f} s")
        if silence >= PATIENCE and not asked:
            self._send("status", {})
            return True
        return asked

    def _send(self, method: str, params: Params) -> int:
        self._last_id += 1
        try:
            self._socket.sendall(protocol.encode_request(self._last_id, method, params))
        except OSError as error:
            raise NoDaemon(f"the connection to omnibotd is lost: {error.strerror or error}") from error
        return self._last_id

    def _receive(self, timeout: float) -> Params | None:
        """The next message, None when none came in time."""
        deadline = time.monotonic() + timeout
        while not self._arrived:
            readable, _, _ = select.select([self._socket], [], [], max(0.0, deadline - time.monotonic()))
            if not readable:
                return None
            self._take(self._read())
        return self._arrived.pop(0)

    def _read(self) -> bytes:
        try:
            data = self._socket.recv(64 * 1024)
        except OSError as error:
            raise NoDaemon(f"the connection to omnibotd is lost: {error.strerror or error}") from error
        if not data:
            raise NoDaemon("omnibotd closed the connection: it was stopped, or this client was too slow (see its log)")
        return data

    def _take(self, data: bytes) -> None:
        for line in self._lines.feed(data):
            try:
                message = None if line is None else protocol.parse(line)
            except ValueError:
                message = None
            if not isinstance(message, dict):
                raise NoDaemon(f"whoever listens at {self._path} does not speak omnibotd's language")
            self._arrived.append(message)


def _connected(path: str) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        connection.settimeout(PATIENCE)
        connection.connect(path)
    except PermissionError as error:
        connection.close()
        message = f"no permission for {path}: join its group (usermod -aG omnibot USER), then log in again"
        raise RemoteError(protocol.REFUSED, ErrorName.NOT_PERMITTED, message) from error
    except OSError as error:
        connection.close()
        message = f"no omnibotd at {path} ({error.strerror or error}): is it running? (systemctl status omnibotd)"
        raise NoDaemon(message) from error
    return connection


def _result(message: Params) -> Params:
    error = message.get("error")
    if error is None:
        result: Params = message.get("result") or {}
        return result
    try:
        data = error["data"]
        raise RemoteError(int(error["code"]), str(data["name"]), str(error["message"]), data.get("report"))
    except (AttributeError, KeyError, TypeError, ValueError) as malformed:
        raise NoDaemon(f"omnibotd's answer can't be read: {error}") from malformed
