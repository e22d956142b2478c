"""omnibotctl against a daemon of scripted answers: what is asked, how it exits, and its signals."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from scripted_daemon import ANSWERS, STATUS, Daemon, Params

from omnibotd import cli, control_client
from omnibotd.control_protocol import RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.io.control_server import Session


def spawn(*words: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "omnibotd.cli", *words]
    root = Path(__file__).parents[2]
    env = {**os.environ, "PYTHONPATH": str(root)}
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env)


def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.parametrize(
    ("words", "method", "params"),
    [
        ("status", "status", {}),
        ("drive 0.2 0.5 --for 3", "drive", {"vx": 0.2, "wz": 0.5, "for": 3.0}),
        ("drive -0.1 -.5 --for 1e-1", "drive", {"vx": -0.1, "wz": -0.5, "for": 0.1}),
        ("drive -1e-2 -2 --for 1", "drive", {"vx": -0.01, "wz": -2.0, "for": 1.0}),
        ("record start flat", "record.start", {"map": "flat"}),
        ("record stop", "record.stop", {}),
        ("train flat", "train", {"map": "flat"}),
        ("train flat --fresh", "train", {"map": "flat", "fresh": True}),
        ("map list", "map.list", {}),
        ("map use flat", "map.use", {"map": "flat"}),
        ("map info", "map.info", {}),
        ("map info flat", "map.info", {"map": "flat"}),
        ("map verify flat", "map.verify", {"map": "flat"}),
        ("map plot", "map.plot", {}),
        ("map prune --nodes 800", "map.prune", {"nodes": 800}),
        ("map prune flat --nodes 800", "map.prune", {"map": "flat", "nodes": 800}),
        ("map delete flat", "map.delete", {"map": "flat"}),
        ("place add desk", "place.add", {"name": "desk"}),
        ("place add desk --at -1,2,-0.5", "place.add", {"name": "desk", "at": [-1.0, 2.0, -0.5]}),
        ("place list", "place.list", {}),
        ("place rename desk table", "place.rename", {"name": "desk", "to": "table"}),
        ("place delete desk", "place.delete", {"name": "desk"}),
        ("goto kitchen", "goto", {"place": "kitchen"}),
        ("goto --at -1,0,3", "goto", {"at": [-1.0, 0.0, 3.0]}),
        ("route desk", "route", {"places": ["desk"]}),
        ("route desk sofa --loops 3", "route", {"places": ["desk", "sofa"], "loops": 3}),
        ("relocalise", "relocalise", {}),
        ("dock", "dock", {}),
        ("dock home", "dock", {"name": "home"}),
        ("dock save home", "dock.save", {"name": "home"}),
        ("dock save home --fresh", "dock.save", {"name": "home", "fresh": True}),
        ("undock", "undock", {}),
        ("calibrate spin", "calibrate.spin", {}),
        ("calibrate base", "calibrate.base", {}),
        ("calibrate base --distance 1.21", "calibrate.base", {"distance": 1.21}),
        ("calibrate camera", "calibrate.camera", {}),
        ("calibrate camera --board 8x5 --square 0.03", "calibrate.camera", {"board": "8x5", "square": 0.03}),
        ("stop", "stop", {}),
    ],
)
def test_every_verb_asks_what_the_contract_says(
    daemon: Daemon, capsys: pytest.CaptureFixture[str], words: str, method: str, params: Params
) -> None:
    assert cli.main(words.split()) == 0
    assert daemon.asked == [(method, params)]
    capsys.readouterr()
    assert cli.main(["--json", *words.split()]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1
    printed = json.loads(lines[0])
    assert (printed["ok"], printed["error"]) == (True, None)
    if method != "map.plot":
        assert {key: printed[key] for key in ANSWERS[method] if key != "ok"} == {
            key: value for key, value in ANSWERS[method].items() if key != "ok"
        }


@pytest.mark.parametrize(
    "words",
    [
        "",
        "fly",
        "drive 0.1",
        "drive fast 0",
        "drive nan 0",
        "drive 0.1 0 --for",
        "goto",
        "goto kitchen --at 1,2,3",
        "goto --at 1,2",
        "goto --at 1,2,x",
        "goto --at 1,2,inf",
        "dock save",
        "dock home attic",
        "dock home --trials 0",
        "dock home --trials 2.5",
        "dock home --fresh",
        "dock save home --trials 3",
        "undock home",
        "calibrate",
        "calibrate camera -o here.yaml",
        "calibrate camera --images /nonexistent",
        "calibrate camera --square big",
        "calibrate base --distance",
        "map",
        "map burn",
        "map prune",
        "map prune --nodes none",
        "map prune --nodes 0",
        "map export",
        "map import",
        "map delete",
        "route",
        "route desk --loops 0",
        "route desk --loops 1.5",
        "place rename desk",
        "place add",
        "status --wat",
    ],
)
def test_wrong_usage_exits_2_even_without_a_daemon(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--socket", "/nonexistent", *words.split()]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("omnibotctl: USAGE: ")
    assert cli.main(["--socket", "/nonexistent", "--json", *words.split()]) == 2
    assert json.loads(capsys.readouterr().out)["error"]["code"] == 2


def test_without_a_daemon_it_exits_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--socket", str(tmp_path / "none"), "status"]) == 3
    assert "is it running?" in capsys.readouterr().err
    assert cli.main(["--json", "--socket", str(tmp_path / "none"), "status"]) == 3
    assert json.loads(capsys.readouterr().out)["error"]["name"] == "NO_DAEMON"


def test_without_permission_it_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def forbidden(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(control_client.socket.socket, "connect", forbidden)
    assert cli.main(["--socket", str(tmp_path / "none"), "status"]) == 4
    assert "NOT_PERMITTED" in capsys.readouterr().err


@pytest.fixture
def mute(tmp_path: Path) -> Iterator[str]:
    """Accepts connections and never says a word."""
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "mute.sock"))
        listener.listen()
        yield str(tmp_path / "mute.sock")


@pytest.mark.parametrize("verb", ["status", "stop", "map list"])
def test_a_daemon_that_says_nothing_is_given_up(
    mute: str, verb: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control_client, "PATIENCE", 0.1)
    monkeypatch.setattr(control_client, "_TICK", 0.02)
    assert cli.main(["--socket", mute, *verb.split()]) == 3
    assert "has not answered" in capsys.readouterr().err


def test_a_silent_job_is_waited_for_while_the_daemon_lives(daemon: Daemon, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control_client, "PATIENCE", 0.05)
    monkeypatch.setattr(control_client, "_TICK", 0.01)
    daemon.pending = True

    def stop() -> None:
        with contextlib.closing(control_client.Client(str(daemon.path))) as other:
            other.stop()

    stopper = threading.Timer(0.6, stop)
    real_dispatch = daemon._server._dispatch

    async def dispatch(session: Session, method: str, params: Params, feedback: Callable[[Params], None]) -> Params:
        return STATUS if method == "status" else await real_dispatch(session, method, params, feedback)

    daemon._server._dispatch = dispatch
    stopper.start()
    waiting = control_client.Client(str(daemon.path))
    with contextlib.closing(waiting), pytest.raises(control_client.RemoteError) as raised:
        waiting.call("train", {"map": "flat"})
    stopper.join()
    assert raised.value.code == 130


def test_a_daemon_that_speaks_another_language_is_told_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "web.sock"))
        listener.listen()

        def answer() -> None:
            with listener.accept()[0] as connection:
                connection.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")
                connection.recv(1000)

        web = threading.Thread(target=answer)
        web.start()
        assert cli.main(["--socket", str(tmp_path / "web.sock"), "status"]) == 3
        web.join()
    assert "does not speak omnibotd's language" in capsys.readouterr().err


@pytest.mark.parametrize(("words", "number"), [("goto kitchen", signal.SIGINT), ("train flat", signal.SIGTERM)])
def test_ctrl_c_during_a_job_stops_the_robot_and_exits_130(daemon: Daemon, words: str, number: int) -> None:
    daemon.pending = True
    process = spawn(*words.split())
    until(lambda: daemon.asked)
    process.send_signal(number)
    out, err = process.communicate(timeout=10)
    assert process.returncode == 130
    assert daemon.asked[-1] == ("stop", {})
    assert out == ""
    assert "CANCELLED: cancelled: the robot was told to stop, and confirmed it" in err


def test_drive_repeats_the_set_point_until_ctrl_c_and_then_stops(daemon: Daemon) -> None:
    process = spawn("drive", "0.1", "-0.5")
    until(lambda: daemon.asked)
    began = time.monotonic()
    until(lambda: len(daemon.asked) >= 6)
    assert 0.35 < time.monotonic() - began < 2.0
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=10)
    assert process.returncode == 130
    assert daemon.asked[-1] == ("stop", {})
    assert set(map(str, daemon.asked[:-1])) == {str(("drive", {"vx": 0.1, "wz": -0.5}))}
    assert "Ctrl-C stops" in err


def test_a_refused_drive_ends_at_once(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> None:
    daemon.failure = RpcError.named(ErrorName.EMERGENCY_STOP, "the button is pressed")
    assert cli.main(["drive", "0.1", "0"]) == 4
    assert len(daemon.asked) == 1


def test_an_unconfirmed_stop_is_shouted(daemon: Daemon) -> None:
    async def deaf(*_: object) -> Params:
        await asyncio.sleep(60)
        return {}

    daemon._server._dispatch = deaf
    process = spawn("goto", "kitchen", "--json")
    until(lambda: daemon._server._clients)
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    time.sleep(0.3)
    daemon.run(daemon._server.close())
    out, _ = process.communicate(timeout=10)
    assert process.returncode == 130
    assert "STOP WAS NOT CONFIRMED" in json.loads(out)["error"]["message"]


def test_events_are_one_json_object_a_line(daemon: Daemon) -> None:
    process = spawn("events")
    until(lambda: any(session.subscribed for session in daemon._server._clients.values()))
    for number in range(3):
        daemon.tell({"stamp": 1.5, "event": "NEWS", "n": number})
    assert process.stdout is not None
    lines = [json.loads(process.stdout.readline()) for _ in range(3)]
    assert lines == [{"stamp": 1.5, "event": "NEWS", "n": number} for number in range(3)]
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=10)
    assert process.returncode == 130


def test_a_reader_that_leaves_is_no_error(daemon: Daemon) -> None:
    process = spawn("events")
    until(lambda: any(session.subscribed for session in daemon._server._clients.values()))
    assert process.stdout is not None
    process.stdout.close()
    daemon.tell({"event": "NEWS"})
    assert process.wait(10) == 0
    assert process.stderr is not None
    assert process.stderr.read() == ""
    process.stderr.close()


def test_it_starts_without_what_is_slow_to_import() -> None:
    code = "import sys, omnibotd.cli; print({'numpy', 'cv2', 'asyncio', 'msgpack'} & set(sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "set()\n"
