"""What omnibotctl shows of the answers of a daemon."""

from __future__ import annotations

import base64
import json
import sys
import threading
from pathlib import Path

import pytest
from scripted_daemon import ANSWERS, PNG, STATUS, Daemon

from omnibotd import cli, cli_output
from omnibotd.control_protocol import RpcError
from omnibotd.core.error_name import ErrorName


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
