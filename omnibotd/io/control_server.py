"""The daemon's side of the control socket: no client is served at another's expense."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from omnibotd import control_protocol as protocol
from omnibotd.control_protocol import ProtocolError, Request, RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.io.control_socket import listen, peer

log = logging.getLogger(__name__)

MAX_CLIENTS = 32  # far more than people and programs at one robot; each may cost a line and a backlog of memory
MAX_REQUESTS = 16  # in progress on one connection; a robot has one job, the rest are short questions
_STOPS_BEYOND = 4  # a stop is accepted even then, but a flood of stops is no stop
_BACKLOG = 256 * 1024  # bytes a client may leave unread: minutes of events, of which most clients want the newest
_READ = 64 * 1024
_OVERLONG = 1024 * 1024  # a line a little too long is an accident; beyond this the peer doesn't speak our language
_LAST_ANSWERS = 1.0  # s; `echo … | nc -U` closes its sending side before it has read the answer
_LINGER_BYTES = 1 << 30  # what a peer we hang up on may still send, so that it reads our reason instead of EPIPE
_LINGER = 5.0  # s

Params = dict[str, Any]
Feedback = Callable[[Params], None]
Dispatch = Callable[["Session", str, Params, Feedback], Awaitable[Params]]


class Session:
    """One client, named by the kernel; `on_close` callbacks run once, when it goes away or stops sending."""

    def __init__(self, number: int, writer: asyncio.StreamWriter) -> None:
        self.number = number
        self.pid, self.uid = peer(writer.get_extra_info("socket"))
        self.subscribed = False
        self.closed = False
        self._writer = writer
        self._answering = asyncio.Lock()
        self._unread_limit = _BACKLOG
        self._callbacks: list[Callable[[], None]] = []

    def __str__(self) -> str:
        return f"client {self.number} (uid {self.uid}, pid {self.pid})"

    def on_close(self, callback: Callable[[], None]) -> None:
        """Call back when the client goes away; at once if it is gone."""
        if self.closed:
            callback()
        elif callback not in self._callbacks:  # a client that drives asks again ten times a second
            self._callbacks.append(callback)

    def send(self, line: bytes) -> None:
        """Queue a line; a client that leaves too much unread is dropped, nobody waits for it."""
        if self._writer.is_closing():
            return
        if self._writer.transport.get_write_buffer_size() > self._unread_limit:
            log.warning("%s dropped: it left more than %d bytes unread", self, self._unread_limit)
            self._writer.transport.abort()
            return
        self._writer.write(line)

    async def answer(self, line: bytes) -> None:
        """Send a line that may be large, when those before it are read: it waits for a slow client."""
        async with self._answering:
            with contextlib.suppress(ConnectionError):
                await self._writer.drain()
            self._unread_limit = _BACKLOG + len(line)  # what we owe the client isn't held against it
            self.send(line)

    def close(self) -> None:
        """Run the callbacks, once; each is called whatever the others do."""
        self.closed = True
        callbacks, self._callbacks = self._callbacks, []
        for callback in callbacks:
            try:
                callback()
            except Exception:
                log.exception("%s: callback at its end failed", self)


class ControlServer:
    """Serves `path` to `group`: `dispatch(session, method, params, feedback)` returns or raises RpcError.

    Requests of one connection run concurrently. When the client goes away they are cancelled: shield
    what must go on. `subscribe` is answered here.
    """

    def __init__(self, path: Path, group: str | None, dispatch: Dispatch) -> None:
        self._path = path
        self._group = group
        self._dispatch = dispatch
        self._server: asyncio.Server | None = None
        self._inode = 0
        self._clients: dict[asyncio.Task[None], Session] = {}
        self._count = 0

    async def run(self) -> None:
        """Serve until cancelled."""
        await self.start()
        try:
            await asyncio.get_running_loop().create_future()
        finally:
            await self.close()

    async def start(self) -> None:
        """Open the socket; raises ControlSocketError where that can't be done."""
        listener = listen(self._path, self._group)
        self._inode = self._path.stat().st_ino
        self._server = await asyncio.start_unix_server(self._connected, sock=listener, backlog=MAX_CLIENTS)

    async def close(self) -> None:
        """Hang up on everybody and remove the socket, unless another has taken its place."""
        if self._server is None:
            return
        self._server.close()
        for task in self._clients:
            task.cancel()
        await asyncio.gather(*self._clients, return_exceptions=True)
        await self._server.wait_closed()
        self._server = None
        with contextlib.suppress(FileNotFoundError):
            if os.stat(self._path).st_ino == self._inode:
                os.unlink(self._path)

    def broadcast(self, event: Params) -> None:
        """Send an event to every subscriber, without waiting for any."""
        line = protocol.encode_notification("event", event)
        for session in self._clients.values():
            if session.subscribed:
                session.send(line)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._count += 1
        session = Session(self._count, writer)
        try:
            if self._server is None or not self._server.is_serving():
                return
            if len(self._clients) >= MAX_CLIENTS:
                log.warning("%s refused: %d clients are connected", session, len(self._clients))
                reason = f"{MAX_CLIENTS} clients are connected: close one"
                session.send(protocol.encode_error(None, protocol.REFUSED, reason, ErrorName.BUSY))
                return
            await self._attend(session, reader, writer)
        except asyncio.CancelledError:
            # Only `close` cancels a client's task. Python 3.11's streams log a task that ends as cancelled for a bug.
            log.debug("%s hung up on", session)
        finally:
            writer.close()

    async def _attend(self, session: Session, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._clients[task] = session
        log.info("%s connected", session)
        connection = _Connection(session, self._dispatch)
        try:
            if await connection.converse(reader):
                await connection.finish()
            else:
                await connection.close()
                await _linger(reader, writer)
        except ConnectionError as error:
            log.info("%s: %s", session, error)
        finally:
            await connection.close()
            del self._clients[task]
            log.info("%s gone", session)


async def _linger(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Say that nothing more will come and swallow what is under way, for a while and in one buffer."""
    writer.write_eof()
    swallowed = 0
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(_LINGER):
            while swallowed < _LINGER_BYTES and (data := await reader.read(_READ)):
                swallowed += len(data)


class _Connection:
    """The requests in progress of one session."""

    def __init__(self, session: Session, dispatch: Dispatch) -> None:
        self._session = session
        self._dispatch = dispatch
        self._tasks: set[asyncio.Task[None]] = set()

    async def converse(self, reader: asyncio.StreamReader) -> bool:
        """Read requests until the client stops sending (True) or sends a line without end (False)."""
        decoder = protocol.LineDecoder()
        while data := await reader.read(_READ):
            for message in decoder.feed(data):
                self._take(message)
            if decoder.discarded > _OVERLONG:
                log.warning("%s dropped: more than %d bytes without a newline", self._session, _OVERLONG)
                return False
        return True

    async def finish(self) -> None:
        """The client will send no more: tell those who care, and let quick answers still go out."""
        self._session.close()
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=_LAST_ANSWERS)

    async def close(self) -> None:
        """Tell those who care, and end what the client asked for."""
        self._session.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _take(self, message: Request | ProtocolError) -> None:
        if isinstance(message, ProtocolError):
            self._session.send(protocol.encode_error(message.id, message.code, message.message))
        elif len(self._tasks) >= MAX_REQUESTS + (_STOPS_BEYOND if message.method == "stop" else 0):
            reason = f"{MAX_REQUESTS} requests of this connection are in progress"
            self._session.send(protocol.encode_error(message.id, protocol.REFUSED, reason, ErrorName.BUSY))
        else:
            task = asyncio.create_task(self._serve(message))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _serve(self, request: Request) -> None:
        line = await self._outcome(request)
        if request.id is not None:
            await self._session.answer(line)

    async def _outcome(self, request: Request) -> bytes:
        try:
            return protocol.encode_response(request.id, await self._result(request))
        except RpcError as error:
            return protocol.encode_error(request.id, error.code, error.message, error.name, error.report)
        except asyncio.CancelledError:
            task = asyncio.current_task()
            if task is None or task.cancelling():  # it is we who are cancelled, not the job we waited for
                raise
            return protocol.encode_error(request.id, protocol.CANCELLED, "cancelled", ErrorName.CANCELLED)
        except Exception:
            log.exception("%s: %s failed by a mistake of ours", self._session, request.method)
            return protocol.encode_error(
                request.id,
                protocol.INTERNAL_ERROR,
                f"{request.method} failed inside omnibotd: see its log",
                "INTERNAL",
            )

    async def _result(self, request: Request) -> Params:
        if request.method == "subscribe":
            self._session.subscribed = True
            return {}

        def feedback(params: Params) -> None:
            if request.id is not None:
                self._session.send(protocol.encode_notification("feedback", {**params, "id": request.id}))

        return await self._dispatch(self._session, request.method, request.params, feedback)
