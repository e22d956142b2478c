"""MJPEG streams: the parser by itself, and the camera on a real server."""

import asyncio
import contextlib
import math
import socket
import threading
from collections.abc import Callable

import pytest
from camera_pictures import HEIGHT, WIDTH, jpeg, running, until

from omnibotd.config import CameraConfig
from omnibotd.io import camera_http
from omnibotd.io.camera import Camera, CameraError
from omnibotd.io.camera_http import MAX_PART, MultipartJpegs


def part(body: bytes, length: int | None = None) -> bytes:
    lines = ["--frame", "Content-Type: image/jpeg"] + ([] if length is None else [f"Content-Length: {length}"])
    return "\r\n".join([*lines, "", ""]).encode() + body + b"\r\n"


PICTURES = [jpeg(level) for level in (40, 120, 250)]


@pytest.mark.parametrize("sized", [True, False])
@pytest.mark.parametrize("step", [1, 7, 1000, 10**6])
def test_parts_come_whole_however_the_stream_is_cut(sized, step):
    stream = b"\r\n".join(part(picture, len(picture) if sized else None) for picture in PICTURES)
    parser = MultipartJpegs()
    found = [body for at in range(0, len(stream), step) for body in parser.feed(stream[at : at + step])]
    assert found == PICTURES


def test_a_part_is_out_with_its_last_byte():
    for sized in (True, False):
        parser = MultipartJpegs()
        assert parser.feed(part(PICTURES[0], len(PICTURES[0]) if sized else None)[:-2]) == [PICTURES[0]]


def test_a_part_that_lies_of_its_length_costs_itself_alone():
    stream = part(PICTURES[0], len(PICTURES[0]) - 100) + part(PICTURES[1], len(PICTURES[1]))
    assert MultipartJpegs().feed(stream) == [PICTURES[0][:-100], PICTURES[1]]


def test_a_picture_cut_short_without_a_length_does_not_spoil_the_next():
    stream = part(PICTURES[0][:-100]) + part(PICTURES[1])
    assert PICTURES[1] in MultipartJpegs().feed(stream)


def test_a_gigantic_part_is_refused_at_its_header_or_at_the_bound():
    with pytest.raises(CameraError, match="more than 8 MB"):
        MultipartJpegs().feed(part(b"", MAX_PART + 1))
    parser = MultipartJpegs()
    parser.feed(part(b"\xff\xd8"))
    with pytest.raises(CameraError, match="more than 8 MB"):
        for _ in range(MAX_PART // 65536 + 1):
            parser.feed(bytes(65536))


class StreamServer:
    """An HTTP server on a real socket; each connection is answered by the next of `scripts`, the last one for ever."""

    HEADER = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n\r\n"

    def __init__(self, *scripts: Callable[[socket.socket, threading.Event], None]) -> None:
        self._scripts = list(scripts)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._listener.settimeout(0.02)
        self.closing = threading.Event()
        self.request = b""
        self._threads = [threading.Thread(target=self._accept)]

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/video?size=small"

    def _accept(self) -> None:
        while not self.closing.is_set():
            with contextlib.suppress(TimeoutError):
                connection, _ = self._listener.accept()
                script = self._scripts.pop(0) if len(self._scripts) > 1 else self._scripts[0]
                self._threads.append(threading.Thread(target=self._serve, args=(connection, script)))
                self._threads[-1].start()

    def _serve(self, connection: socket.socket, script: Callable[[socket.socket, threading.Event], None]) -> None:
        with connection, contextlib.suppress(OSError):  # the camera hangs up when it likes
            connection.settimeout(2.0)
            self.request = connection.recv(4096)
            script(connection, self.closing)

    def __enter__(self) -> "StreamServer":
        self._threads[0].start()
        return self

    def __exit__(self, *_: object) -> None:
        self.closing.set()
        for thread in self._threads:
            thread.join(5.0)
            assert not thread.is_alive()
        self._listener.close()


def sends(*parts: bytes, repeat: bool = False, header: bytes = StreamServer.HEADER, hold: bool = True):
    """A script: the header, the parts 10 ms apart (over and over with `repeat`), then silence or the end."""

    def script(connection: socket.socket, closing: threading.Event) -> None:
        connection.sendall(header)
        while True:
            for body in parts:
                connection.sendall(body)
                if closing.wait(0.01):
                    return
            if not repeat:
                break
        if hold:
            closing.wait(10.0)

    return script


def sized(level: int) -> bytes:
    return part(jpeg(level), len(jpeg(level)))


def test_a_stream_gives_frames_as_sent_with_their_time_size_and_rate():
    async def scenario() -> None:
        with StreamServer(sends(sized(40), sized(120), repeat=True)) as server:
            loop = asyncio.get_running_loop()
            started = loop.time()
            async with running(Camera(CameraConfig(source=server.url))) as camera:
                assert not camera.ok(loop.time()) and camera.age(loop.time()) == math.inf
                first = await asyncio.wait_for(camera.wait_newer(0.0), 5.0)
                second = await asyncio.wait_for(camera.wait_newer(first.stamp), 5.0)
                assert started < first.stamp < second.stamp <= loop.time()
                assert {first.data, second.data} <= {jpeg(40), jpeg(120)}
                await until(lambda: camera.rate_hz > 0 and camera.latest.stamp > started + 0.3)
                assert 30 < camera.rate_hz <= 130  # 10 ms apart and what a busy machine adds
                assert (camera.ok(loop.time()), camera.reason, camera.size) == (True, "", (WIDTH, HEIGHT))
            assert server.request.startswith(b"GET /video?size=small HTTP/1.1\r\n")

    asyncio.run(scenario())


def test_a_stalled_stream_is_noticed_within_a_second_and_opened_again():
    async def scenario() -> None:
        with StreamServer(sends(sized(40)), sends(sized(120), repeat=True)) as server:
            loop = asyncio.get_running_loop()
            async with running(Camera(CameraConfig(source=server.url))) as camera:
                stalled = await asyncio.wait_for(camera.wait_newer(0.0), 5.0)
                await until(lambda: camera.reason != "")
                assert loop.time() - stalled.stamp < 1.5
                assert "no picture for 1 s" in camera.reason and not camera.ok(loop.time())
                assert camera.rate_hz == 0.0
                assert camera.latest is stalled
                assert await until(lambda: camera.ok(loop.time())) < 1.5
                assert camera.latest.data == jpeg(120) and camera.reason == ""

    asyncio.run(scenario())


def test_a_stream_that_breaks_off_is_opened_again_and_damaged_frames_are_counted_and_dropped():
    async def scenario() -> None:
        broken = sends(part(b"garbage", 7), part(jpeg(40)[:200], 200), sized(120), hold=False)
        with StreamServer(broken, sends(sized(250), repeat=True)) as server:
            async with running(Camera(CameraConfig(source=server.url))) as camera:
                assert (await asyncio.wait_for(camera.wait_newer(0.0), 5.0)).data == jpeg(120)
                await until(lambda: "the stream ended" in camera.reason)
                assert camera.bad_frames == 2
                waited = await until(lambda: camera.latest.data == jpeg(250))
                assert waited < 1.5 and camera.reason == "" and camera.bad_frames == 2

    asyncio.run(scenario())


@pytest.mark.parametrize(
    ("script", "reason"),
    [
        (sends(header=b"HTTP/1.0 404 Not Found\r\n\r\n", hold=False), "answers 404 Not Found"),
        (sends(header=b"HTTP/1.0 200 OK\r\nContent-Type: text/html\r\n\r\n", hold=False), "sends text/html, expected"),
        (sends(header=b"SSH-2.0-OpenSSH_9.2\r\n", hold=False), "SSH-2.0"),
        (sends(part(b"", 10**9), hold=False), "more than 8 MB"),
        (sends(header=b"", hold=False), "closed connection without response"),
    ],
)
def test_a_server_that_sends_no_stream_is_told_by_what_it_sends(script, reason):
    with StreamServer(script) as server, pytest.raises(CameraError, match=reason) as caught:
        list(camera_http.http_frames(server.url))
    assert str(caught.value).startswith(f"http://127.0.0.1:{server.port}/video?size=small: ")


def test_a_stream_that_drips_without_completing_a_picture_is_given_up(monkeypatch):
    monkeypatch.setattr(camera_http, "FRAME_TIMEOUT", 0.1)
    with StreamServer(sends(b"x", repeat=True)) as server, pytest.raises(CameraError, match=r"picture for 0\.1 s"):
        list(camera_http.http_frames(server.url))


def test_a_server_that_is_not_there_is_told():
    with socket.create_server(("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    with pytest.raises(CameraError, match="Connection refused"):
        list(camera_http.http_frames(f"http://127.0.0.1:{port}/"))
