"""The verb `doctor`: what is shown, and what the exit status says."""

from __future__ import annotations

import argparse
import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from omnibotd import cli, cli_doctor, cli_output, findings, local_checks
from omnibotd.cli_output import LiveLine
from omnibotd.cli_verbs import BadNews
from omnibotd.control_client import NoDaemon
from omnibotd.io.camera_v4l2_modes import Mode, Stream
from omnibotd.requests.status import _stream_values


class Terminal:
    """Stands in for the connection: answers as the daemon would, or is not there."""

    def __init__(self, told: list[findings.Finding] | None, as_json: bool = False) -> None:
        self._told, self.as_json, self.shown = told, as_json, ""
        self.live = LiveLine(quiet=True)

    def ask(self, method: str, params: dict[str, Any], waiting_for: str) -> dict[str, Any]:
        assert (method, params) == ("doctor", {})
        if self._told is None:
            raise NoDaemon("no omnibotd")
        return {"findings": [finding.values() for finding in self._told], "processor_share": 0.25}

    def show(self, result: dict[str, Any], human: str) -> None:
        self.shown = human


OPTIONS = argparse.Namespace(config="/nowhere/omnibotd.yaml")


@pytest.fixture(autouse=True)
def no_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """The PC itself is well, and is not watched for a second."""
    monkeypatch.setattr(local_checks, "machine", lambda daemon_share=None: [findings.processor(0.2, daemon_share)])


def test_a_well_robot_is_told_line_by_line() -> None:
    terminal = Terminal([findings.ok("camera", "fine"), findings.warning("clock", "unkept", "set-ntp")])
    cli_doctor.doctor(terminal, OPTIONS)
    camera, clock, remedy, processor = terminal.shown.splitlines()
    assert camera.split() == ["ok", "camera", "fine"]
    assert clock.startswith("WARNING  clock")
    assert remedy.strip() == "-> set-ntp"
    assert "25% of a core by omnibotd" in processor


def test_anything_wrong_ends_with_1(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(BadNews) as told:
        cli_doctor.doctor(Terminal([findings.wrong("base", "gone", "plug it in")]), OPTIONS)
    assert (told.value.code, str(told.value)) == (1, "wrong: base")
    assert "plug it in" in capsys.readouterr().out


def test_without_a_daemon_it_looks_by_itself_and_ends_with_3(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    code = cli.main(["--socket", str(tmp_path / "none"), "doctor", "--config", str(tmp_path / "omnibotd.yaml")])
    shown = capsys.readouterr()
    assert code == 3
    assert "WRONG    configuration" in shown.out
    assert "NO_DAEMON" in shown.err


def test_as_json_it_is_one_object_with_the_findings(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    config = tmp_path / "omnibotd.yaml"
    assert cli.main(["--socket", str(tmp_path / "none"), "--json", "doctor", "--config", str(config)]) == 3
    answer = json.loads(capsys.readouterr().out)
    assert (answer["ok"], answer["daemon"], answer["error"]["code"]) == (False, False, 3)
    assert {"name", "grade", "found", "remedy"} == set(answer["findings"][0])


def test_the_format_of_a_v4l2_camera_is_shown_by_status() -> None:
    stream = _stream_values(Stream("Test Cam", Mode("MJPG", 640, 480, Fraction(1, 30)), exposure=0.01))
    assert stream == {
        "card": "Test Cam",
        "format": "MJPG",
        "fps": 30.0,
        "exposure_s": 0.01,
        "white_balance_k": None,
        "warnings": [],
    }
    camera = {"source": "/dev/video0", "ok": True, "rate_hz": 29.9, "width": 640, "height": 480, "stream": stream}
    assert cli_output._camera(camera) == "/dev/video0, MJPG 640x480, 29.9 Hz"
