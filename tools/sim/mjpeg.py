"""An HTTP server on the loopback interface: pictures as a motion-JPEG stream, and a few JSON resources."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass

_BOUNDARY = "omnibot-frame"
_MAX_HEAD = 8192  # bytes of request line and headers, what common servers allow
_MAX_BODY = 4096  # a pose is under 100 bytes
_MAX_CLIENTS = 8  # a daemon, a browser or two and a recorder
_REQUEST_TIME = 5.0  # s that a client may take to say what it wants
_STALL = 10.0  # s without reading after which a stream's client is cut off
_SEND_BUFFER = 65536  # about one frame, so that what a slow client reads next is not long past

_REASONS = {
    200: "OK",
    400: "Bad Request",
    404: "Not Found",
    405: "Method Not Allowed",
    503: "Service Unavailable",
}

Resource = Callable[[bytes], dict[str, object]]


class RequestError(ValueError):
    """A request that can't be answered; the text goes to the client."""

    def __init__(self, status: int, message: str) -> None:
        super().__init__(message)
        self.status = status


@dataclass(frozen=True, slots=True)
class _Request:
    method: str
    path: str
    body: bytes


class MjpegServer:
    """Serves the latest published picture at /stream to every client at the speed that client reads.

    `resources` maps (method, path) to a function from the request's body to a JSON object; it may raise
    ValueError with a sentence for the client (status 400).
    """

    def __init__(self, resources: Mapping[tuple[str, str], Resource] | None = None) -> None:
        self._resources = dict(resources or {})
        self._frame = b""
        self._number = 0
        self._news = asyncio.Condition()
        self._clients: set[asyncio.Task[None]] = set()
        self._server: asyncio.Server | None = None

    async def start(self, port: int = 0) -> None:
        """Listens on 127.0.0.1; port 0 takes a free one. OSError where the port is taken."""
        self._server = await asyncio.start_server(self._accept, "127.0.0.1", port, limit=_MAX_HEAD)

    @property
    def port(self) -> int:
        assert self._server is not None, "start() comes first"
        return int(self._server.sockets[0].getsockname()[1])

    @property
    def url(self) -> str:
        """Of the stream."""
        return f"http://127.0.0.1:{self.port}/stream"

    async def publish(self, jpeg: bytes) -> None:
        """Makes this the picture that clients get next; one that nobody was ready for is dropped."""
        async with self._news:
            self._frame = jpeg
            self._number += 1
            self._news.notify_all()

    async def close(self) -> None:
        """Stops listening and hangs up on everyone."""
        if self._server is not None:
            self._server.close()
        for client in self._clients:
            client.cancel()
        await asyncio.gather(*self._clients, return_exceptions=True)
        if self._server is not None:
            await self._server.wait_closed()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        client = asyncio.current_task()
        assert client is not None
        crowded = len(self._clients) >= _MAX_CLIENTS
        self._clients.add(client)
        try:
            await (
                _refuse(writer, 503, f"{_MAX_CLIENTS} clients are connected already")
                if crowded
                else self._converse(reader, writer)
            )
        except (ConnectionError, TimeoutError, asyncio.IncompleteReadError):
            pass  # the client went away or fell asleep: its own affair
        except asyncio.CancelledError:
            pass  # close() hangs up; nobody waits for this task's result
        finally:
            self._clients.discard(client)
            writer.transport.abort()

    async def _converse(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            request = await asyncio.wait_for(_read_request(reader), _REQUEST_TIME)
            if (request.method, request.path) == ("GET", "/stream"):
                await self._stream(writer)
            else:
                await _reply(writer, 200, self._answer(request))
        except RequestError as error:
            await _refuse(writer, error.status, str(error))

    def _answer(self, request: _Request) -> dict[str, object]:
        resource = self._resources.get((request.method, request.path))
        if resource is None:
            known = any(path == request.path for _, path in self._resources) or request.path == "/stream"
            raise RequestError(405 if known else 404, f"there is no {request.method} {request.path} here")
        try:
            return resource(request.body)
        except ValueError as error:
            raise RequestError(400, str(error)) from error

    async def _stream(self, writer: asyncio.StreamWriter) -> None:
        _send_promptly(writer)
        writer.write(
            b"HTTP/1.1 200 OK\r\nConnection: close\r\nCache-Control: no-store\r\n"
            b"Content-Type: multipart/x-mixed-replace; boundary=" + _BOUNDARY.encode() + b"\r\n\r\n"
        )
        seen = 0
        while True:
            async with self._news:
                await self._news.wait_for(lambda: self._number != seen)  # noqa: B023 (used before it changes)
                frame, seen = self._frame, self._number
            head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(frame)}\r\n\r\n"
            writer.write(head.encode() + frame + b"\r\n")
            await asyncio.wait_for(writer.drain(), _STALL)


def _send_promptly(writer: asyncio.StreamWriter) -> None:
    """Keeps little on the way: `drain` then returns only when the frame has left this process."""
    writer.transport.set_write_buffer_limits(high=1)
    writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)


async def _read_request(reader: asyncio.StreamReader) -> _Request:
    try:
        head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1").split("\r\n")
    except asyncio.LimitOverrunError as error:
        raise RequestError(400, f"the request's headers exceed {_MAX_HEAD} bytes") from error
    words = head[0].split()
    if len(words) != 3 or not words[2].startswith("HTTP/1."):
        raise RequestError(400, "the first line is no HTTP/1 request")
    headers = {name.strip().lower(): value.strip() for name, _, value in (line.partition(":") for line in head[1:])}
    length = headers.get("content-length", "0")
    if not length.isascii() or not length.isdigit() or int(length) > _MAX_BODY:
        raise RequestError(400, f"Content-Length is {length!r}, expected at most {_MAX_BODY}")
    return _Request(words[0], words[1].partition("?")[0], await reader.readexactly(int(length)))


async def _refuse(writer: asyncio.StreamWriter, status: int, message: str) -> None:
    await _reply(writer, status, {"error": message})


async def _reply(writer: asyncio.StreamWriter, status: int, answer: Mapping[str, object]) -> None:
    body = json.dumps(answer).encode() + b"\n"
    writer.write(
        f"HTTP/1.1 {status} {_REASONS[status]}\r\nConnection: close\r\nContent-Type: application/json\r\n"
        f"Content-Length: {len(body)}\r\n\r\n".encode()
        + body
    )
    await asyncio.wait_for(writer.drain(), _REQUEST_TIME)
    writer.close()
    await asyncio.wait_for(writer.wait_closed(), _REQUEST_TIME)
