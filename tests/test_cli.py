"""omnibotctl against a daemon of scripted answers: what is asked, what is shown, and how it exits."""

from __future__ import annotations

import asyncio
import base64
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
from typing import Any

import pytest

from omnibotd import cli, cli_output, control_client
from omnibotd.control_protocol import RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.io.control_server import ControlServer, Session

Params = dict[str, Any]
PNG = b"\x89PNG\r\n\x1a\n" + bytes(200_000)

STATUS: Params = {
    "version": "0.1.0",
    "uptime_s": 3725.0,
    "state": "IDLE",
    "map": "flat",
    "pose": {"x": 1.0, "y": -2.0, "yaw": 1.5707963},
    "confidence": 0.98,
    "sigma": 0.03,
    "place": "kitchen",
    "battery": 14.83,
    "charging": True,
    "job": None,
    "recording": None,
    "base": {"connected": True, "driver": "create2", "board": "Roomba", "firmware": "3.5", "reason": ""},
    "camera": {"source": "/dev/video0", "ok": True, "rate_hz": 24.96, "age_s": 0.04, "width": 640, "height": 480},
    "loop": {"period_ms": 50.0, "late_ms_p99": 1.25, "late_ms_max": 3.5, "ticks": 100},
    "memory_mb": 84.2,
}
ANSWERS: dict[str, Params] = {
    "status": STATUS,
    "stop": {},
    "drive": {},
    "record.start": {"map": "flat", "path": "/maps/recordings/flat.0001.mcap"},
    "record.stop": {
        "map": "flat",
        "seconds": 301.0,
        "distance_m": 61.25,
        "frames": 3010,
        "bytes": 120_500_000,
        "coverage_m2": 14.5,
        "warnings": ["a plain ceiling: expect less accuracy"],
    },
    "map.list": {
        "maps": [
            {"name": "flat", "nodes": 1200, "bytes": 900_000, "active": True, "trained": True, "recording_bytes": 0},
            {"name": "attic", "nodes": 0, "bytes": 0, "active": False, "trained": False, "recording_bytes": 5_000},
            {"name": "old", "nodes": None, "bytes": 12, "active": False, "trained": True, "recording_bytes": 0},
        ]
    },
    "map.use": {"map": "flat", "nodes": 1200},
    "map.info": {
        "map": "flat",
        "nodes": 1200,
        "links": {"odometry": 1199, "similarity": 300, "proximity": 50},
        "bytes": 900_000,
        "places": {"desk": {"x": 1.0, "y": 2.0, "yaw": 0.0}},
        "docks": {},
        "ceiling_height": None,
        "statistics": {"topographic_error": 0.0512},
    },
    "map.plot": {"map": "flat", "png": base64.b64encode(PNG).decode()},
    "map.verify": {"ok": True, "sections": [{"name": "poses", "bytes": 14400, "ok": True}], "message": "all is well"},
    "place.add": {"name": "desk", "pose": {"x": 1.0, "y": 2.0, "yaw": 0.0}},
    "place.list": {"places": {"desk": {"x": -1.0, "y": 2.0, "yaw": 3.1415927}}, "docks": {}},
    "place.rename": {"name": "table", "pose": {"x": 1.0, "y": 2.0, "yaw": 0.0}},
    "place.delete": {},
    "map.prune": {"map": "flat", "nodes": 800, "nodes_before": 1200, "bytes": 600_000, "kept": "/maps/flat.omap~"},
    "map.delete": {"map": "flat", "kept": "/maps/flat.omap~"},
    "train": {"map": "flat", "nodes": 1200, "links": {"odometry": 1199}, "seconds": 42.0, "warnings": []},
    "goto": {"place": "kitchen", "pose": {"x": 3.0, "y": 4.0, "yaw": 0.0}, "seconds": 12.5, "error_estimate_m": 0.04},
    "route": {
        "places": ["desk", "sofa"],
        "loops": 1,
        "seconds": 75.0,
        "arrived": 2,
        "arrivals": [
            {"place": "desk", "loop": 1, "pose": {"x": 1.0, "y": 2.0, "yaw": 0.0}, "seconds": 30.5},
            {"place": "sofa", "loop": 1, "pose": {"x": -1.0, "y": 0.5, "yaw": 3.1415927}, "seconds": 75.0},
        ],
    },
    "relocalise": {
        "map": "flat",
        "pose": {"x": 1.0, "y": 2.0, "yaw": 0.0},
        "confidence": 0.934,
        "sigma": 0.03,
        "seconds": 4.2,
    },
    "dock": {"dock": "home", "seconds": 20.0, "retries": 1},
    "dock.save": {"name": "home", "pose": {"x": 0.0, "y": 0.0, "yaw": 0.0}},
    "undock": {"dock": "home", "seconds": 7.5, "distance_m": 0.503},
    "calibrate.spin": {
        "calibration": "spin",
        "file": "/maps/calibration/spin.yaml",
        "centre": [319.2, 240.1],
        "tilt": [0.0175, -0.0087],
        "centre_sigma_px": 0.11,
        "tilt_sigma_deg": 0.02,
        "residual": "0.31 px",
        "message": "the camera leans by 1.1 degrees",
        "effect": "takes effect at the next start of omnibotd",
    },
    "calibrate.base": {
        "calibration": "base",
        "file": "/maps/calibration/base.yaml",
        "wheel_radius": 0.0361,
        "wheel_ratio": 1.0021,
        "wheel_separation": 0.2312,
        "residual": "0.20%",
        "message": "good to 0.2 %",
        "effect": "takes effect at the next start of omnibotd",
    },
    "calibrate.camera": {
        "calibration": "camera",
        "file": "/maps/calibration/camera.yaml",
        "rms_px": 0.314,
        "covered_deg": 84.2,
        "edge_sigma_px": 0.43,
        "message": "",
        "effect": "takes effect at the next start of omnibotd",
        "warnings": ["maps taught before may be refused"],
    },
}


class Daemon:
    """Answers as scripted, in a thread of its own, and remembers what it was asked."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.answers = dict(ANSWERS)
        self.asked: list[tuple[str, Params]] = []
        self.failure: RpcError | None = None
        self.feedback: list[Params] = []
        self.pending = False  # answer jobs only after a stop
        self.stopped = asyncio.Event()
        self._loop = asyncio.new_event_loop()
        self._server = ControlServer(path, "no-such-group", self._dispatch)
        self._thread = threading.Thread(target=self._loop.run_forever)

    def start(self) -> None:
        self._thread.start()
        self.run(self._server.start())

    def run(self, work: Any) -> None:
        asyncio.run_coroutine_threadsafe(work, self._loop).result(5)

    def close(self) -> None:
        self.run(self._server.close())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def tell(self, event: Params) -> None:
        self._loop.call_soon_threadsafe(self._server.broadcast, event)

    async def _dispatch(
        self, session: Session, method: str, params: Params, feedback: Callable[[Params], None]
    ) -> Params:
        self.asked.append((method, params))
        if method == "stop":
            self.stopped.set()
            return {}
        for values in self.feedback:
            feedback(values)
        if self.pending:
            await self.stopped.wait()
            raise RpcError.named(ErrorName.CANCELLED, "stopped on request")
        if self.failure is not None:
            raise self.failure
        return self.answers[method]


@pytest.fixture
def daemon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Daemon]:
    daemon = Daemon(tmp_path / "control.sock")
    daemon.start()
    monkeypatch.setenv("OMNIBOT_SOCKET", str(daemon.path))
    monkeypatch.chdir(tmp_path)
    yield daemon
    daemon.close()


@pytest.fixture(autouse=True)
def untouched_signals() -> Iterator[None]:
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


def spawn(*words: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "omnibotd.cli", *words]
    root = Path(__file__).parents[1]
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


@pytest.mark.parametrize(
    ("error", "exit_code"),
    [
        (RpcError.named(ErrorName.LOST, "lost after 10 m"), 1),
        (RpcError.named(ErrorName.FAILED_TO_STAGE, "the way is blocked"), 1),
        (RpcError.named(ErrorName.BUSY, "a job is running"), 4),
        (RpcError.named(ErrorName.EMERGENCY_STOP, "the button is pressed"), 4),
        (RpcError.named(ErrorName.NOT_PERMITTED, "no"), 4),
        (RpcError.named(ErrorName.CANCELLED, "another client said stop"), 130),
        (RpcError.named(ErrorName.INVALID, "vx: too fast"), 2),
        (RpcError(-32601, ErrorName.INVALID, "no such method"), 1),
    ],
)
def test_a_refusal_or_failure_is_told_with_its_name_and_exit_code(
    daemon: Daemon, capsys: pytest.CaptureFixture[str], error: RpcError, exit_code: int
) -> None:
    daemon.failure = error
    assert cli.main(["goto", "kitchen"]) == exit_code
    printed = capsys.readouterr()
    assert printed.out == ""
    assert f"omnibotctl: {error.name}: {error.message}" in printed.err
    assert cli.main(["goto", "kitchen", "--json"]) == exit_code
    assert json.loads(capsys.readouterr().out) == {
        "ok": False,
        "error": {"code": exit_code, "name": error.name, "message": error.message},
    }


def test_a_failed_job_is_explained_line_by_line(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> None:
    report = {"confidence": 0.1234567, "expected_confidence": 0.6, "metres_since_sure": 2.0, "x": -1.5}
    report |= {"expected_node": 812, "state": "SEARCHING"}
    daemon.failure = RpcError.named(ErrorName.LOST, "no view fits the map surely", report)
    assert cli.main(["goto", "kitchen"]) == 1
    assert capsys.readouterr().err.splitlines() == [
        "omnibotctl: LOST: no view fits the map surely",
        "  confidence         0.1235, expected 0.6",
        "  metres since sure  2",
        "  x                  -1.5 m",
        "  expected node      812",
        "  state              SEARCHING",
    ]
    assert cli.main(["goto", "kitchen", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["error"]["report"] == report


def test_status_names_the_last_failure(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> None:
    failure = {"time": "2026-01-02T03:04:05+00:00", "job": "goto", "error": "LOST", "message": "no view fits"}
    daemon.answers["status"] = STATUS | {"last_failure": failure | {"file": "/maps/failures/0003.json"}}
    cli.main(["status"])
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("last failure  goto at 2026-01-02T03:04:05+00:00: LOST, no view fits")
    assert last.endswith("/maps/failures/0003.json")


def test_a_route_is_told_arrival_by_arrival(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> None:
    progress = {"state": "FOLLOWING", "waypoint": 2, "waypoints": 2, "loop": 1, "loops": 3, "distance_remaining": 1.5}
    daemon.feedback = [progress | {"navigation_time": 12.0, "confidence": 0.97, "number_of_recoveries": 1}]
    assert cli.main(["route", "desk", "sofa"]) == 0
    printed = capsys.readouterr()
    where = "FOLLOWING  way-point 2 of 2  loop 1 of 3  1.50 m to go  confidence 0.97  1 recovery  12.0 s"
    assert printed.err == f"round desk, sofa: {where}\n"
    assert printed.out.splitlines() == [
        "LOOP  PLACE       AFTER  POSE",
        "   1  desk       30.5 s  x 1.000 m  y 2.000 m  yaw 0.0°",
        "   1  sofa   1 min 15 s  x -1.000 m  y 0.500 m  yaw 180.0°",
        "arrived 2 times in 1 min 15 s",
    ]


@pytest.mark.parametrize(
    ("words", "shown"),
    [
        ("relocalise", "found after 4.2 s in map flat: x 1.000 m  y 2.000 m  yaw 0.0°, confidence 0.93"),
        ("map delete flat", "map flat is deleted; its file stays as /maps/flat.omap~, and its recordings are kept"),
        ("map prune --nodes 800", "pruned from 1200 to 800 nodes; the version before is /maps/flat.omap~"),
        ("place rename desk table", "table saved at x 1.000 m  y 2.000 m  yaw 0.0°"),
    ],
)
def test_what_was_done_is_said(daemon: Daemon, capsys: pytest.CaptureFixture[str], words: str, shown: str) -> None:
    assert cli.main(words.split()) == 0
    assert capsys.readouterr().out.splitlines()[0] == shown


def test_info_lists_the_drives_and_what_is_not_learnt_yet(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> None:
    daemon.answers["map.info"] = ANSWERS["map.info"] | {
        "sessions": [
            {"session": 0, "recording": "flat.0001.mcap", "nodes": 900},
            {"session": 1, "recording": "flat.0002.mcap", "nodes": 300},
        ],
        "recordings": [
            {"file": "flat.0002.mcap", "bytes": 2_000_000, "trained": True},
            {"file": "flat.0003.mcap", "bytes": 1_000, "trained": False},
        ],
    }
    cli.main(["map", "info"])
    words = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["session", "1", "900", "flat.0001.mcap", "not", "on", "disk"] in words
    assert ["session", "2", "300", "flat.0002.mcap", "2.0", "MB"] in words
    assert ["untrained", "flat.0003.mcap", "1.0", "kB"] in words


def test_status_is_an_aligned_table(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> None:
    cli.main(["status"])
    assert capsys.readouterr().out.splitlines() == [
        "omnibotd    0.1.0, up 1 h 2 min, 84 MB",
        "state       IDLE",
        "map         flat",
        "pose        x 1.000 m  y -2.000 m  yaw 90.0°",
        "confidence  0.98, sure, within 0.03 m",
        "place       kitchen",
        "battery     14.8 V, charging",
        "base        create2, connected, Roomba 3.5",
        "camera      /dev/video0, 640x480, 25.0 Hz, newest 0.04 s old",
        "loop        50 ms, late p99 1.2 ms, max 3.5 ms",
    ]


def test_status_says_what_is_wrong(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> None:
    daemon.answers["status"] = STATUS | {
        "map": None,
        "pose": None,
        "confidence": 0.1,
        "sigma": None,
        "place": None,
        "battery": None,
        "charging": None,
        "job": {"name": "goto", "state": "RECOVER", "distance_remaining": 2.5, "number_of_recoveries": 2},
        "recording": {"map": "flat", "seconds": 5, "distance_m": 1.0, "frames": 50, "bytes": 999, "coverage_m2": 0.25},
        "base": {"connected": False, "driver": "create2", "board": None, "firmware": None, "reason": "no such port"},
        "camera": {"source": "/dev/video0", "ok": False, "rate_hz": 0.0, "age_s": None, "reason": "unplugged"},
    }
    cli.main(["status"])
    shown = capsys.readouterr().out
    for text in (
        "state       goto  RECOVER  2.50 m to go  2 recoveries",
        "recording   map flat, 5.0 s, 1.0 m driven, 0.2 m² covered, 50 frames, 999 B",
        "pose        unknown",
        "confidence  0.10, lost",
        "base        create2, NOT CONNECTED: no such port",
        "camera      /dev/video0, NO PICTURES: unplugged",
    ):
        assert text in shown.splitlines()


def test_maps_are_listed_with_numbers_flush_right(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> None:
    cli.main(["map", "list"])
    assert capsys.readouterr().out.splitlines() == [
        "   NAME       NODES      SIZE  RECORDINGS",
        "*  flat        1200  900.0 kB           -",
        "   attic  untrained       0 B      5.0 kB",
        "   old      damaged      12 B           -",
    ]


def test_places_are_shown_in_degrees(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> None:
    cli.main(["place", "list"])
    assert capsys.readouterr().out.splitlines()[1].split() == ["place", "desk", "-1.000", "2.000", "180.0"]


def test_warnings_go_to_standard_error(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> None:
    cli.main(["record", "stop"])
    printed = capsys.readouterr()
    assert "5 min 1 s, 61.2 m driven, 14.5 m² covered, 3010 frames, 120.5 MB" in printed.out
    assert "warning: a plain ceiling" in printed.err


def test_the_picture_of_a_map_is_written(daemon: Daemon, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["map", "plot"]) == 0
    assert (tmp_path / "flat.png").read_bytes() == PNG
    assert cli.main(["--json", "map", "plot", "flat", "-o", "there.png"]) == 0
    assert (tmp_path / "there.png").read_bytes() == PNG
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["file"] == "there.png"
    daemon.answers["map.plot"] = {"map": "flat", "svg": base64.b64encode(b"<svg/>").decode()}
    assert cli.main(["map", "plot", "-o", "there.SVG"]) == 0
    assert daemon.asked[-1] == ("map.plot", {"format": "svg"})
    assert (tmp_path / "there.SVG").read_bytes() == b"<svg/>"
    daemon.answers["map.plot"] = ANSWERS["map.plot"]
    assert cli.main(["map", "plot", "-o", "missing/there.png"]) == 1
    assert "STORAGE: missing/there.png: No such file" in capsys.readouterr().err


def test_a_damaged_map_fails_and_tells_the_section(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> None:
    sections = [{"name": "poses", "bytes": 9, "ok": True}, {"name": "docks", "bytes": 70, "ok": False}]
    daemon.answers["map.verify"] = {"ok": False, "sections": sections, "message": "section 'docks': damaged"}
    assert cli.main(["map", "verify"]) == 1
    printed = capsys.readouterr()
    assert "docks  70 B  DAMAGED" in printed.out
    assert "section 'docks': damaged" in printed.err
    assert cli.main(["map", "verify", "--json"]) == 1
    whole = json.loads(capsys.readouterr().out)
    assert (whole["ok"], whole["error"]["code"], whole["sections"]) == (False, 1, sections)


def test_feedback_is_plain_lines_without_a_terminal_and_at_most_one_a_second(
    daemon: Daemon, capsys: pytest.CaptureFixture[str]
) -> None:
    daemon.feedback = [{"state": "FOLLOW", "distance_remaining": 3.0 - 0.1 * n, "confidence": 0.9} for n in range(20)]
    assert cli.main(["goto", "kitchen"]) == 0
    printed = capsys.readouterr()
    assert printed.err.splitlines() == ["to kitchen: FOLLOW  3.00 m to go  confidence 0.90"]
    assert printed.out == "arrived after 12.5 s: x 3.000 m  y 4.000 m  yaw 0.0°, within 0.04 m\n"


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


def test_watch_shows_again_until_the_daemon_ends(daemon: Daemon, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("omnibotd.cli_verbs._WATCH", 0.01)
    threading.Timer(0.3, lambda: daemon.run(daemon._server.close())).start()
    assert cli.main(["--json", "status", "--watch"]) == 3
    assert len(daemon.asked) > 3


def test_on_a_terminal_the_live_line_is_written_over(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "20")
    live = cli_output.LiveLine(quiet=True)
    live.show("a line that is much longer than the terminal")
    live.show("short")
    live.clear()
    assert capsys.readouterr().err == "\ra line that is much\x1b[K\rshort\x1b[K\r\x1b[K"


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.04, "0.0 s"), (59.9, "59.9 s"), (60, "1 min 0 s"), (3599.6, "1 h 0 min"), (7300, "2 h 1 min")],
)
def test_durations_are_short(seconds: float, text: str) -> None:
    assert cli_output.duration(seconds) == text


def test_it_starts_without_what_is_slow_to_import() -> None:
    code = "import sys, omnibotd.cli; print({'numpy', 'cv2', 'asyncio', 'msgpack'} & set(sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "set()\n"
