"""The control socket served for real: concurrency, bad peers, and what is left when somebody goes away."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import resource
import socket
import stat
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from omnibotd.control_protocol import RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.io.control_server import MAX_CLIENTS, MAX_REQUESTS, ControlServer, Session
from omnibotd.io.control_socket import ControlSocketError

Params = dict[str, Any]


class Robot:
    """A daemon's dispatch with one of each: quick, long, refused, broken."""

    def __init__(self) -> None:
        self.stopped = asyncio.Event()
        self.started = asyncio.Event()
        self.driver_gone = asyncio.Event()
        self.cancelled = asyncio.Event()

    async def dispatch(
        self, session: Session, method: str, params: Params, feedback: Callable[[Params], None]
    ) -> Params:
        return await getattr(self, method)(session, params, feedback)

    async def echo(self, session: Session, params: Params, feedback: Callable[[Params], None]) -> Params:
        return {"got": params, "uid": session.uid, "pid": session.pid}

    async def goto(self, session: Session, params: Params, feedback: Callable[[Params], None]) -> Params:
        feedback({"state": "TURN"})
        self.started.set()
        try:
            await self.stopped.wait()
        except asyncio.CancelledError:
            self.cancelled.set()
            raise
        raise RpcError.named(ErrorName.CANCELLED, "stopped on request")

    async def stop(self, session: Session, params: Params, feedback: Callable[[Params], None]) -> Params:
        self.stopped.set()
        return {}

    async def drive(self, session: Session, params: Params, feedback: Callable[[Params], None]) -> Params:
        session.on_close(self.driver_gone.set)
        return {}

    async def large(self, session: Session, params: Params, feedback: Callable[[Params], None]) -> Params:
        return {"png": "x" * 3_000_000}

    async def broken(self, session: Session, params: Params, feedback: Callable[[Params], None]) -> Params:
        raise ZeroDivisionError

    async def unsayable(self, session: Session, params: Params, feedback: Callable[[Params], None]) -> Params:
        return {"map": object()}

    async def abandoned(self, session: Session, params: Params, feedback: Callable[[Params], None]) -> Params:
        job = asyncio.get_running_loop().create_future()
        job.cancel()
        await job
        return {}


class Peer:
    """A client by hand."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    def ask(self, request_id: int, method: str, **params: Any) -> None:
        request = {"jsonrpc": "2.0", "id": request_id, "method": method, "params": params}
        self.writer.write(json.dumps(request).encode() + b"\n")

    async def hear(self) -> Params:
        message: Params = json.loads(await asyncio.wait_for(self.reader.readline(), 5))
        return message

    async def call(self, method: str, **params: Any) -> Params:
        self.ask(1, method, **params)
        return await self.hear()


class Bench:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.robot = Robot()
        self.server = ControlServer(path, "no-such-group", self.robot.dispatch)
        self._peers: list[Peer] = []

    async def peer(self) -> Peer:
        reader, writer = await asyncio.open_unix_connection(self.path, limit=1 << 23)
        self._peers.append(Peer(reader, writer))
        return self._peers[-1]

    async def hang_up(self) -> None:
        for peer in self._peers:
            peer.writer.close()
            await asyncio.gather(peer.writer.wait_closed(), return_exceptions=True)


@asynccontextmanager
async def serving(path: Path) -> AsyncIterator[Bench]:
    bench = Bench(path)
    await bench.server.start()
    try:
        yield bench
    finally:
        await bench.hang_up()
        await bench.server.close()


@pytest.fixture
def on_bench(tmp_path: Path) -> Callable[[Callable[[Bench], Awaitable[None]]], None]:
    """Run a coroutine against a served robot; no task may be left behind."""

    async def play(scene: Callable[[Bench], Awaitable[None]]) -> None:
        async with serving(tmp_path / "control.sock") as bench:
            await asyncio.wait_for(scene(bench), 20)
        await asyncio.sleep(0)
        assert len(asyncio.all_tasks()) == 1
        assert not (tmp_path / "control.sock").exists()

    return lambda scene: asyncio.run(play(scene))


Run = Callable[[Callable[[Bench], Awaitable[None]]], None]


def test_a_request_is_answered_and_the_peer_is_known(on_bench: Run) -> None:
    async def scene(bench: Bench) -> None:
        answer = await (await bench.peer()).call("echo", a=1)
        assert answer["id"] == 1
        assert answer["result"] == {"got": {"a": 1}, "uid": os.getuid(), "pid": os.getpid()}

    on_bench(scene)


def test_the_socket_is_for_owner_and_group_only(on_bench: Run, caplog: pytest.LogCaptureFixture) -> None:
    async def scene(bench: Bench) -> None:
        assert stat.S_IMODE(bench.path.stat().st_mode) == 0o660

    on_bench(scene)
    assert "no group 'no-such-group'" in caplog.text


def test_stop_overtakes_a_pending_goto(on_bench: Run) -> None:
    async def scene(bench: Bench) -> None:
        peer = await bench.peer()
        peer.ask(1, "goto", place="kitchen")
        assert await peer.hear() == {
            "jsonrpc": "2.0",
            "method": "feedback",
            "params": {"id": 1, "state": "TURN"},
        }
        peer.ask(2, "stop")
        answers = {answer["id"]: answer for answer in (await peer.hear(), await peer.hear())}
        assert answers[2]["result"] == {}
        assert answers[1]["error"] == {
            "code": 130,
            "message": "stopped on request",
            "data": {"name": "CANCELLED"},
        }

    on_bench(scene)


@pytest.mark.parametrize("method", ["broken", "unsayable"])
def test_a_mistake_of_ours_is_answered_logged_and_harms_nobody(
    on_bench: Run, caplog: pytest.LogCaptureFixture, method: str
) -> None:
    async def scene(bench: Bench) -> None:
        peer = await bench.peer()
        assert (await peer.call(method))["error"]["code"] == -32603
        assert (await peer.call("echo"))["result"]["got"] == {}

    on_bench(scene)
    assert f"{method} failed by a mistake of ours" in caplog.text


def test_a_job_cancelled_by_somebody_else_is_answered(on_bench: Run) -> None:
    async def scene(bench: Bench) -> None:
        assert (await (await bench.peer()).call("abandoned"))["error"]["code"] == 130

    on_bench(scene)


def test_requests_in_progress_are_bounded_but_stop_still_gets_through(on_bench: Run) -> None:
    async def scene(bench: Bench) -> None:
        peer = await bench.peer()
        for number in range(MAX_REQUESTS):
            peer.ask(number, "goto")
        for _ in range(MAX_REQUESTS):
            assert (await peer.hear())["method"] == "feedback"
        peer.ask(98, "echo")
        refusal = await peer.hear()
        assert (refusal["id"], refusal["error"]["data"]["name"]) == (98, "BUSY")
        peer.ask(99, "stop")
        answers = [await peer.hear() for _ in range(MAX_REQUESTS + 1)]
        assert {answer["id"] for answer in answers} == {*range(MAX_REQUESTS), 99}

    on_bench(scene)


def test_garbage_is_answered_and_the_connection_lives(on_bench: Run) -> None:
    async def scene(bench: Bench) -> None:
        peer = await bench.peer()
        peer.writer.write(b"\x00\xff garbage\n" + b"x" * 100_000 + b"\n")
        assert [(await peer.hear())["error"]["code"] for _ in range(2)] == [-32700, -32700]
        assert (await peer.call("echo"))["result"]["got"] == {}

    on_bench(scene)


def test_a_driver_that_goes_away_is_noticed(on_bench: Run) -> None:
    async def scene(bench: Bench) -> None:
        peer = await bench.peer()
        for _ in range(20):
            await peer.call("drive")
        peer.writer.close()
        await asyncio.wait_for(bench.robot.driver_gone.wait(), 2)

    on_bench(scene)


def test_requests_of_a_client_that_died_are_cancelled(on_bench: Run) -> None:
    async def scene(bench: Bench) -> None:
        peer = await bench.peer()
        peer.ask(1, "goto")
        await bench.robot.started.wait()
        peer.writer.transport.abort()
        await asyncio.wait_for(bench.robot.cancelled.wait(), 2)

    on_bench(scene)


def test_closing_only_the_sending_side_still_gets_the_answer(on_bench: Run) -> None:
    async def scene(bench: Bench) -> None:
        peer = await bench.peer()
        peer.ask(1, "echo")
        peer.writer.write_eof()
        assert (await peer.hear())["id"] == 1
        assert await peer.reader.read() == b""

    on_bench(scene)


def test_events_go_to_subscribers_only(on_bench: Run) -> None:
    async def scene(bench: Bench) -> None:
        listening, deaf = await bench.peer(), await bench.peer()
        assert (await listening.call("subscribe"))["result"] == {}
        await deaf.call("echo")
        bench.server.broadcast({"stamp": 1.5, "event": "ARRIVED"})
        event = await listening.hear()
        assert event == {"jsonrpc": "2.0", "method": "event", "params": {"stamp": 1.5, "event": "ARRIVED"}}
        assert (await deaf.call("echo"))["id"] == 1

    on_bench(scene)


def test_a_subscriber_that_does_not_read_is_dropped_and_others_go_on(
    on_bench: Run, caplog: pytest.LogCaptureFixture
) -> None:
    async def scene(bench: Bench) -> None:
        slow, quick = await bench.peer(), await bench.peer()
        await slow.call("subscribe")
        slow.writer.transport.pause_reading()  # type: ignore[attr-defined]
        await quick.call("subscribe")
        for number in range(200):
            bench.server.broadcast({"event": "NEWS", "n": number, "padding": "x" * 10_000})
            assert (await quick.hear())["params"]["n"] == number
        assert "dropped: it left more than" in caplog.text

    on_bench(scene)


def test_large_answers_wait_for_a_slow_reader(on_bench: Run) -> None:
    async def scene(bench: Bench) -> None:
        peer = await bench.peer()
        await peer.call("subscribe")
        for number in range(4):
            peer.ask(number, "large")
        await asyncio.sleep(0.05)
        bench.server.broadcast({"event": "NEWS"})
        heard = [await peer.hear() for _ in range(5)]
        assert {message["id"] for message in heard if "id" in message} == {0, 1, 2, 3}

    on_bench(scene)


def test_the_33rd_client_is_refused_with_a_reason(on_bench: Run) -> None:
    async def scene(bench: Bench) -> None:
        peers = [await bench.peer() for _ in range(MAX_CLIENTS)]
        for peer in peers:
            await peer.call("echo")
        late = await bench.peer()
        assert (await late.hear())["error"]["code"] == 4
        assert await late.reader.read() == b""
        assert (await peers[0].call("echo"))["id"] == 1
        peers[0].writer.close()
        await asyncio.sleep(0.05)
        assert (await (await bench.peer()).call("echo"))["id"] == 1

    on_bench(scene)


def test_a_line_without_end_is_swallowed_in_bounded_memory_and_hung_up_on(on_bench: Run) -> None:
    total, piece = 200_000_000, b"x" * 1_000_000

    async def scene(bench: Bench) -> None:
        flood, other = await bench.peer(), await bench.peer()
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        for number in range(total // len(piece)):
            flood.writer.write(piece)
            await flood.writer.drain()
            if number % 50 == 0:
                await asyncio.wait_for(other.call("echo"), 0.5)
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 20_000  # KiB
        assert (await flood.hear())["error"]["code"] == -32700
        assert await flood.reader.read() == b""

    on_bench(scene)


def test_a_stale_socket_is_removed(tmp_path: Path) -> None:
    path = tmp_path / "control.sock"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))

    async def play() -> None:
        async with serving(path) as bench:
            assert (await (await bench.peer()).call("echo"))["id"] == 1

    asyncio.run(play())


def test_a_second_daemon_is_refused_and_the_first_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "control.sock"

    async def play() -> None:
        async with serving(path) as first:
            with pytest.raises(ControlSocketError, match="another omnibotd listens"):
                await Bench(path).server.start()
            assert (await (await first.peer()).call("echo"))["id"] == 1

    asyncio.run(play())


def test_somebody_elses_file_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "control.sock"
    path.write_text("precious")
    with pytest.raises(ControlSocketError, match="no socket"):
        asyncio.run(Bench(path).server.start())
    assert path.read_text() == "precious"


@pytest.mark.parametrize("path", ["missing/control.sock", "x" * 200])
def test_a_place_for_no_socket_is_told_with_its_path(tmp_path: Path, path: str) -> None:
    with pytest.raises(ControlSocketError, match=path):
        asyncio.run(Bench(tmp_path / path).server.start())


def test_at_its_end_it_removes_only_its_own_socket(tmp_path: Path) -> None:
    path = tmp_path / "control.sock"

    async def play() -> None:
        async with serving(path):
            path.unlink()
            path.write_text("the next one's")

    asyncio.run(play())
    assert path.read_text() == "the next one's"


def test_run_serves_until_cancelled_and_ends_what_is_pending(tmp_path: Path) -> None:
    path = tmp_path / "control.sock"

    async def play() -> None:
        bench = Bench(path)
        server = asyncio.create_task(bench.server.run())
        while not path.exists():  # noqa: ASYNC110 - a file tells nobody
            await asyncio.sleep(0)
        peer = await bench.peer()
        peer.ask(1, "goto")
        await bench.robot.started.wait()
        server.cancel()
        await asyncio.gather(server, return_exceptions=True)
        assert bench.robot.cancelled.is_set()
        assert not path.exists()
        await bench.hang_up()

    asyncio.run(play())


def test_clients_come_and_go_in_the_log(on_bench: Run, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)

    async def scene(bench: Bench) -> None:
        await (await bench.peer()).call("echo")

    on_bench(scene)
    assert f"client 1 (uid {os.getuid()}, pid {os.getpid()}) connected" in caplog.text
    assert "gone" in caplog.text
