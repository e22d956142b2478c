"""`map export` and `map import` over a real socket, from the command line to the store and back."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import json
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from omnibotd import cli, control_client
from omnibotd.control_protocol import RpcError
from omnibotd.core.geometry import Pose2D
from omnibotd.io.control_server import ControlServer, Session
from omnibotd.io.map_store import MapStore, MapStoreError
from omnibotd.requests.map_files import MapFiles
from omnibotd.requests.params import Params
from tests.made_maps import made_map


class Daemon:
    """A control socket behind which there is a store and nothing else, in a thread of its own."""

    def __init__(self, directory: Path) -> None:
        self.store = MapStore(directory / "store")
        self._loop = asyncio.new_event_loop()
        robot: Any = SimpleNamespace(store=self.store, now=self._loop.time)
        self.requests = 0
        self._methods = MapFiles(robot).methods()
        self._server = ControlServer(directory / "control.sock", "no-such-group", self._dispatch)
        self._thread = threading.Thread(target=self._loop.run_forever)
        self._thread.start()
        asyncio.run_coroutine_threadsafe(self._server.start(), self._loop).result(5)

    def close(self) -> None:
        asyncio.run_coroutine_threadsafe(self._server.close(), self._loop).result(5)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.run_until_complete(self._loop.shutdown_default_executor())
        self._loop.close()

    async def _dispatch(self, session: Session, method: str, params: dict[str, Any], feedback: Any) -> dict[str, Any]:
        self.requests += 1
        try:
            return await self._methods[method](Params(params), session, feedback)
        except MapStoreError as error:
            raise RpcError(1, "STORAGE", str(error)) from error  # type: ignore[arg-type]


@pytest.fixture
def daemon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Daemon]:
    daemon = Daemon(tmp_path)
    daemon.store.save(made_map(nodes=2000))
    monkeypatch.setenv("OMNIBOT_SOCKET", str(tmp_path / "control.sock"))
    monkeypatch.chdir(tmp_path)
    yield daemon
    daemon.close()


def test_there_and_back_is_the_same_file(daemon: Daemon, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["map", "export", "flat", "-o", "safe.omap"]) == 0
    safe = tmp_path / "safe.omap"
    on_disk = daemon.store.file("flat").read_bytes()
    assert len(on_disk) > 300_000
    assert safe.read_bytes() == on_disk
    assert daemon.requests > 1
    assert not (tmp_path / "safe.omap.part").exists()
    assert cli.main(["map", "import", "safe.omap"]) == 0
    assert daemon.store.file("safe").read_bytes() == on_disk
    out = capsys.readouterr().out.splitlines()
    assert out[0].startswith("wrote safe.omap, ")
    assert out[1] == "imported as safe, 2000 nodes; to use it say map use safe"


def test_the_same_again_changes_nothing_and_another_content_is_refused(
    daemon: Daemon, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cli.main(["map", "export", "flat"])
    daemon.requests = 0
    assert cli.main(["--json", "map", "import", "flat.omap"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["unchanged"] is True
    assert daemon.requests == 1  # the file did not travel again
    edited = made_map(nodes=2000).with_place("new", Pose2D())
    daemon.store.save(edited)
    assert cli.main(["map", "import", "flat.omap"]) == 1
    assert "STORAGE: map 'flat' exists with other content: choose another name (--name)" in capsys.readouterr().err
    assert daemon.store.load("flat").places == edited.places
    assert cli.main(["map", "import", "flat.omap", "--name", "older"]) == 0
    assert "new" not in daemon.store.load("older").places


def test_a_file_that_is_no_whole_map_gets_no_name(
    daemon: Daemon, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sound = daemon.store.file("flat").read_bytes()
    damaged = np.frombuffer(sound, np.uint8).copy()
    damaged[200_000] ^= 4
    for name, data in (("cut", sound[:-1]), ("hurt", damaged.tobytes()), ("text", b"hello\n")):
        (tmp_path / name).write_bytes(data)
        assert cli.main(["map", "import", name]) == 1
        assert f"STORAGE: map '{name}': section" in capsys.readouterr().err
    assert [entry.name for entry in daemon.store.list()] == ["flat"]
    assert not (daemon.store.directory / ".import").exists()


@pytest.mark.parametrize("words", ["map import none.omap", "map export flat -o missing/x.omap"])
def test_files_that_can_not_be_read_or_written_are_named(
    daemon: Daemon, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(words.split()) == 1
    name = words.rsplit(maxsplit=1)[-1]
    assert f"STORAGE: {name}: No such file" in capsys.readouterr().err


def test_an_export_that_fails_leaves_the_older_file(
    daemon: Daemon, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "safe.omap").write_text("the older one")
    assert cli.main(["map", "export", "none", "-o", "safe.omap"]) == 1
    assert "no map 'none'" in capsys.readouterr().err
    assert (tmp_path / "safe.omap").read_text() == "the older one"
    assert sorted(path.name for path in tmp_path.glob("safe*")) == ["safe.omap"]


def test_a_name_that_can_not_be_one_is_wrong_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "my map.omap").touch()
    assert cli.main(["--socket", "/nonexistent", "map", "import", str(tmp_path / "my map.omap")]) == 2
    assert "say --name NAME" in capsys.readouterr().err


def piece(client: control_client.Client, data: bytes, offset: int, name: str = "attic") -> dict[str, Any]:
    sha256, part = hashlib.sha256(data).hexdigest(), base64.b64encode(data[offset : offset + 30_000]).decode()
    return client.call(
        "map.import", {"map": name, "offset": offset, "bytes": len(data), "sha256": sha256, "data": part}
    )


def test_one_import_at_a_time_and_a_client_that_goes_away_makes_room(daemon: Daemon, tmp_path: Path) -> None:
    data = daemon.store.file("flat").read_bytes()
    path = str(tmp_path / "control.sock")
    first, second = control_client.Client(path), control_client.Client(path)
    piece(first, data, 0)
    with pytest.raises(control_client.RemoteError, match="is being imported"):
        piece(second, data, 0)
    with pytest.raises(control_client.RemoteError, match="begin at offset 0"):
        piece(second, data, 30_000)
    first.close()
    for _ in range(100):
        try:
            piece(second, data, 0)
            break
        except control_client.RemoteError:
            threading.Event().wait(0.02)
    received = 30_000
    while received < len(data):
        received = piece(second, data, received)["received"]
    second.close()
    assert daemon.store.file("attic").read_bytes() == data


@pytest.mark.parametrize(
    "change",
    [{"data": "?"}, {"data": ""}, {"bytes": 0}, {"bytes": 10**12}, {"offset": -1}, {"sha256": 5}, {"map": "../x"}],
)
def test_a_malformed_piece_is_refused(daemon: Daemon, tmp_path: Path, change: dict[str, Any]) -> None:
    client = control_client.Client(str(tmp_path / "control.sock"))
    params = {"map": "attic", "offset": 0, "bytes": 10, "sha256": "", "data": base64.b64encode(b"x").decode()}
    with pytest.raises(control_client.RemoteError) as refused:
        client.call("map.import", params | change)
    client.close()
    assert refused.value.code == -32602
