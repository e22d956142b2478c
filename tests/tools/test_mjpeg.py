"""The stream as clients see it: whole parts, the latest frame only, and nobody harmed by anybody else."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable

import pytest

from tools.sim.mjpeg import MjpegServer

Connection = tuple[asyncio.StreamReader, asyncio.StreamWriter]


def serve(script: Callable[[MjpegServer], Awaitable[None]]) -> None:
    async def run() -> None:
        server = MjpegServer({("GET", "/truth"): lambda _: {"x": 1.5}, ("POST", "/echo"): echo})
        await server.start()
        try:
            await asyncio.wait_for(script(server), 20.0)
        finally:
            await server.close()

    asyncio.run(run())


def echo(body: bytes) -> dict[str, object]:
    if not body:
        raise ValueError("nothing to repeat")
    return {"said": body.decode()}


async def ask(server: MjpegServer, request: bytes) -> Connection:
    reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
    writer.write(request)
    await writer.drain()
    return reader, writer


async def watch(server: MjpegServer) -> Connection:
    reader, writer = await ask(server, b"GET /stream HTTP/1.1\r\nHost: here\r\n\r\n")
    head = (await reader.readuntil(b"\r\n\r\n")).decode()
    assert head.startswith("HTTP/1.1 200 ")
    assert "Content-Type: multipart/x-mixed-replace; boundary=omnibot-frame" in head
    return reader, writer


async def next_part(reader: asyncio.StreamReader) -> bytes:
    head = (await reader.readuntil(b"\r\n\r\n")).decode().split("\r\n")
    assert head[:2] == ["--omnibot-frame", "Content-Type: image/jpeg"]
    name, length = head[2].split(": ")
    assert name == "Content-Length"
    body = await reader.readexactly(int(length) + 2)
    assert body[-2:] == b"\r\n"
    return body[:-2]


async def answer(server: MjpegServer, request: bytes) -> tuple[int, dict[str, object]]:
    reader, writer = await ask(server, request)
    head, _, body = (await reader.read()).partition(b"\r\n\r\n")
    writer.close()
    await writer.wait_closed()
    return int(head.split()[1]), json.loads(body)


def hang_up(*connections: Connection) -> None:
    for _, writer in connections:
        writer.transport.abort()


def test_every_client_gets_each_frame_it_is_quick_enough_for():
    async def script(server: MjpegServer) -> None:
        clients = [await watch(server) for _ in range(3)]
        for frame in (b"one", b"two\r\n--omnibot-frame\r\n", b"\xff\xd8" + bytes(1000)):
            await server.publish(frame)
            assert [await next_part(reader) for reader, _ in clients] == [frame] * 3
        hang_up(*clients)

    serve(script)


def test_newcomer_gets_the_last_frame_at_once():
    async def script(server: MjpegServer) -> None:
        await server.publish(b"old")
        await server.publish(b"last")
        client = await watch(server)
        assert await next_part(client[0]) == b"last"
        hang_up(client)

    serve(script)


def test_slow_client_delays_nobody_and_skips_to_the_latest():
    async def script(server: MjpegServer) -> None:
        slow, quick = await watch(server), await watch(server)
        frames = [number.to_bytes(4, "big") * 100_000 for number in range(60)]  # 24 MB: more than sockets buffer
        for frame in frames:
            await server.publish(frame)
            assert await next_part(quick[0]) == frame
        seen = [int.from_bytes((await next_part(slow[0]))[:4], "big")]
        while seen[-1] != 59:
            seen.append(int.from_bytes((await next_part(slow[0]))[:4], "big"))
        assert seen == sorted(set(seen))
        assert len(seen) < 40
        hang_up(slow, quick)

    serve(script)


def test_client_that_goes_away_leaves_the_others_their_stream():
    async def script(server: MjpegServer) -> None:
        gone, stays = await watch(server), await watch(server)
        hang_up(gone)
        for number in range(5):
            await server.publish(bytes([number]))
            assert await next_part(stays[0]) == bytes([number])
        hang_up(stays)

    serve(script)


@pytest.mark.parametrize(
    ("request_bytes", "status", "reply"),
    [
        (b"GET /truth HTTP/1.1\r\n\r\n", 200, {"x": 1.5}),
        (b"POST /echo?loud HTTP/1.0\r\nContent-Length: 2\r\n\r\nhi", 200, {"said": "hi"}),
        (b"POST /echo HTTP/1.1\r\n\r\n", 400, {"error": "nothing to repeat"}),
        (b"GET /nowhere HTTP/1.1\r\n\r\n", 404, {"error": "there is no GET /nowhere here"}),
        (b"POST /truth HTTP/1.1\r\n\r\n", 405, {"error": "there is no POST /truth here"}),
        (b"\x00\xff garbage\r\n\r\n", 400, {"error": "the first line is no HTTP/1 request"}),
        (
            b"POST /echo HTTP/1.1\r\nContent-Length: 4097\r\n\r\n",
            400,
            {"error": "Content-Length is '4097', expected at most 4096"},
        ),
        (
            b"GET / HTTP/1.1\r\nX: " + b"a" * 9000 + b"\r\n\r\n",
            400,
            {"error": "the request's headers exceed 8192 bytes"},
        ),
    ],
)
def test_requests_get_json_answers(request_bytes, status, reply):
    async def script(server: MjpegServer) -> None:
        assert await answer(server, request_bytes) == (status, reply)

    serve(script)


def test_ninth_client_is_turned_away_and_a_place_is_free_again_after():
    async def script(server: MjpegServer) -> None:
        clients = [await watch(server) for _ in range(8)]
        status, reply = await answer(server, b"GET /truth HTTP/1.1\r\n\r\n")
        assert (status, reply) == (503, {"error": "8 clients are connected already"})
        hang_up(clients.pop())
        await server.publish(b"frame")
        for _ in range(100):
            await asyncio.sleep(0.01)
            await server.publish(b"frame")
            status, _ = await answer(server, b"GET /truth HTTP/1.1\r\n\r\n")
            if status == 200:
                break
        assert status == 200
        hang_up(*clients)

    serve(script)


def test_only_the_loopback_interface_is_served():
    async def script(server: MjpegServer) -> None:
        assert server.url == f"http://127.0.0.1:{server.port}/stream"
        with pytest.raises(OSError):
            await asyncio.open_connection("127.0.0.2", server.port)

    serve(script)
