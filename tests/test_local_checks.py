"""What the doctor finds without the daemon: each fault, told by its name and with a way out."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from omnibotd import local_checks
from omnibotd.config import BaseConfig, CameraConfig, Config, StorageConfig
from omnibotd.findings import Grade


@pytest.fixture
def system(monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """What commands of the system say, by their name; others are not installed."""
    said: dict[str, str] = {}
    monkeypatch.setattr(local_checks, "_told", lambda *command: said.get(command[0]))
    return said


# ---- the machine


@pytest.mark.parametrize(
    ("said", "grade"), [("NTPSynchronized=yes\n", Grade.OK), ("NTPSynchronized=no\n", Grade.WARNING)]
)
def test_the_time_service_is_asked(system: dict[str, str], said: str, grade: Grade) -> None:
    system["timedatectl"] = said
    assert local_checks.clock().grade is grade


def test_a_clock_from_before_this_program_was_installed_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_checks, "time", SimpleNamespace(time=lambda: 86400.0))
    assert local_checks.clock().grade is Grade.WRONG


def test_the_processor_is_watched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """90 of 100 jiffies were worked in between, iowait is none."""
    stat = tmp_path / "stat"
    stat.write_text("cpu  100 0 100 1000 50 0 0 0 0 0\ncpu0 ...\n")

    def sleep(seconds: float) -> None:
        stat.write_text("cpu  150 10 130 1004 56 0 0 0 0 0\n")

    monkeypatch.setattr(local_checks, "time", SimpleNamespace(sleep=sleep))
    (finding,) = local_checks.processor(tmp_path, 0.5)
    assert finding.grade is Grade.WARNING
    assert "90% of this PC's processor in use, 50% of a core by omnibotd" in finding.found


def test_memory_is_read(tmp_path: Path) -> None:
    (tmp_path / "meminfo").write_text("MemTotal: 1000000 kB\nMemAvailable: 50000 kB\n")
    (finding,) = local_checks.memory(tmp_path)
    assert (finding.grade, finding.found) == (Grade.WARNING, "51 MB available")


def test_what_the_kernel_does_not_tell_is_unknown(tmp_path: Path) -> None:
    found = [*local_checks.processor(tmp_path, None), *local_checks.memory(tmp_path)]
    assert [finding.grade for finding in found] == [Grade.UNKNOWN, Grade.UNKNOWN]


# ---- the daemon


@pytest.mark.parametrize(
    ("said", "remedy"),
    [
        ("", "start it"),
        ("LoadState=not-found\nActiveState=inactive\n", "install its systemd unit"),
        ("LoadState=loaded\nActiveState=inactive\n", "systemctl enable --now"),
        ("LoadState=loaded\nActiveState=failed\nResult=watchdog\nNRestarts=7\n", "journalctl -u omnibotd"),
        ("LoadState=loaded\nActiveState=active\nStatusText=idle\n", "systemctl restart"),
    ],
)
def test_why_no_daemon_answers(system: dict[str, str], said: str, remedy: str) -> None:
    system["systemctl"] = said
    finding = local_checks.service("no omnibotd at /run/omnibotd/control.sock")
    assert finding.grade is Grade.WRONG
    assert remedy in finding.remedy


def test_a_bad_configuration_is_told_and_the_rest_is_left(
    system: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(local_checks, "machine", list)
    config = tmp_path / "omnibotd.yaml"
    config.write_text("camera: {source: /dev/video0, fsp: 3}\nbase: {driver: omnibot, port: /dev/ttyUSB0}\n")
    *_, finding = local_checks.without_daemon(config, "none")
    assert finding.grade is Grade.WRONG
    assert "camera.fsp: unknown key" in finding.found


def test_a_good_one_leads_to_every_check(
    system: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(local_checks, "machine", list)
    config = tmp_path / "omnibotd.yaml"
    config.write_text("camera: {source: clips}\nbase: {driver: omnibot, port: /dev/nothing}\nstorage: {directory: .}\n")
    names = [finding.name for finding in local_checks.without_daemon(config, "none")]
    assert names[:3] == ["daemon", "configuration", "camera"]
    assert {"base", "disk", "calibration camera", "calibration spin", "calibration base"} <= set(names)


# ---- the disk, the calibrations


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    assert local_checks.storage(tmp_path).grade in (Grade.OK, Grade.WARNING)
    assert local_checks.storage(tmp_path / "gone").grade is Grade.WRONG


def configured(tmp_path: Path, **camera: Path) -> Config:
    return Config(
        camera=CameraConfig(source="/dev/video0", **camera),
        base=BaseConfig(driver="omnibot", port="/dev/ttyUSB0"),
        storage=StorageConfig(directory=tmp_path),
    )


def test_calibrations_that_are_there_and_not(tmp_path: Path) -> None:
    (tmp_path / "calibration").mkdir()
    (tmp_path / "calibration/spin.yaml").touch()
    grades = {found.name: found.grade for found in local_checks.calibrations(configured(tmp_path))}
    assert grades == {
        "calibration camera": Grade.WARNING,
        "calibration spin": Grade.OK,
        "calibration base": Grade.WARNING,
    }
    lens, *_ = local_checks.calibrations(configured(tmp_path, calibration=tmp_path / "lens.yaml"))
    assert lens.grade is Grade.WRONG
