"""The files for systemd and udev: read by systemd's own tools where they are installed, and agreeing with the code."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from omnibotd.config import ControlConfig, StorageConfig

FILES = Path(__file__).resolve().parents[1] / "systemd"
UNIT = FILES / "omnibotd.service"
STARTED_BY = "ExecStart=/opt/omnibotd/bin/omnibotd --config /etc/omnibotd/omnibotd.yaml"


def setting(name: str) -> list[str]:
    """The values given to a setting of the unit, in order."""
    return re.findall(rf"^{name}=(.*)$", UNIT.read_text(), re.MULTILINE)


def run(*command: object) -> subprocess.CompletedProcess[str]:
    if shutil.which(str(command[0])) is None:
        pytest.skip(f"{command[0]} is not installed")
    return subprocess.run([str(part) for part in command], capture_output=True, text=True, timeout=30, check=False)


@pytest.fixture
def startable(tmp_path):
    """The unit with a program that exists on any machine: systemd-analyze looks for it."""
    assert STARTED_BY in UNIT.read_text()
    path = tmp_path / "omnibotd.service"
    path.write_text(UNIT.read_text().replace(STARTED_BY, "ExecStart=/bin/true"))
    return path


def test_systemd_understands_the_unit(startable):
    result = run("systemd-analyze", "verify", "--man=no", startable)
    newer = ("RestartSteps", "RestartMaxDelaySec")  # unknown before systemd 254, which says it ignores them
    complaints = [line for line in result.stderr.splitlines() if not any(name in line for name in newer)]
    assert (result.returncode, complaints) == (0, [])


def test_the_unit_is_exposed_to_little(startable):
    # The threshold is in tenths: up to 2.0 systemd says OK, 9.6 is a unit that restricts nothing.
    result = run("systemd-analyze", "security", "--offline=true", "--threshold=20", startable)
    assert result.returncode == 0, result.stdout


def test_the_unit_makes_the_folders_that_the_defaults_name():
    directory = next(item.default for item in StorageConfig.__dataclass_fields__.values())
    assert Path("/var/lib") / setting("StateDirectory")[0] == directory
    control = {name: item.default for name, item in ControlConfig.__dataclass_fields__.items()}
    assert Path("/run") / setting("RuntimeDirectory")[0] == control["socket"].parent
    assert setting("Group") == [control["group"]]


def test_the_unit_opens_cameras_and_serial_ports_and_no_more():
    assert setting("DevicePolicy") == ["closed"]
    classes = {line.split()[0] for line in setting("DeviceAllow")}
    assert classes == {f"char-{name}" for name in ("video4linux", "ttyUSB", "ttyACM", "ttyS", "usb_device")}


def test_a_daemon_that_hangs_or_ends_is_started_again_however_often():
    assert (setting("Type"), setting("Restart"), setting("StartLimitIntervalSec")) == (["notify"], ["always"], ["0"])
    assert 2 <= float(setting("WatchdogSec")[0]) <= 15


def test_systemd_understands_the_users_and_they_are_the_units(tmp_path):
    # Below an empty root, so that it does not matter who exists on this machine.
    result = run("systemd-sysusers", "--dry-run", f"--root={tmp_path}", FILES / "omnibotd.sysusers")
    assert result.returncode == 0, result.stderr
    assert "Creating group 'omnibot'" in result.stderr and "Creating user 'omnibotd'" in result.stderr
    members = re.findall(r"^m omnibotd (\w+)$", (FILES / "omnibotd.sysusers").read_text(), re.MULTILINE)
    assert set(members) == {*setting("Group"), *setting("SupplementaryGroups")[0].split()}


def test_systemd_understands_the_temporary_files(tmp_path):
    (tmp_path / "etc").mkdir()
    (tmp_path / "etc/passwd").write_text("root:x:0:0::/root:/bin/sh\nomnibotd:x:0:0::/:/bin/sh\n")
    (tmp_path / "etc/group").write_text("root:x:0:\nomnibot:x:0:\n")
    result = run("systemd-tmpfiles", "--create", f"--root={tmp_path}", FILES / "omnibotd.tmpfiles")
    if "Operation not permitted" in result.stderr:
        pytest.skip("systemd-tmpfiles may only be run by root")
    assert (result.returncode, result.stderr) == (0, "")
    assert oct((tmp_path / "var/lib/omnibotd").stat().st_mode & 0o777) == "0o750"
    assert oct((tmp_path / "etc/omnibotd").stat().st_mode & 0o777) == "0o755"


def test_udev_rules_have_the_form_that_udev_reads():
    """No udev here, so by its grammar: comma-separated KEY{attribute}OPERATOR"value", matches before assignments."""
    term = re.compile(r'([A-Z]+)(\{[^}]+\})?(==|!=|=|\+=|:=)"[^"]*"')
    matches = {"ACTION", "SUBSYSTEM", "SUBSYSTEMS", "KERNEL", "DRIVER", "ATTRS", "TEST"}
    rules = [line for line in (FILES / "99-omnibotd.rules").read_text().splitlines() if line and line[0] != "#"]
    assert len(rules) >= 5
    for rule in rules:
        terms = [term.fullmatch(part) for part in rule.split(", ")]
        assert all(terms), rule
        assigns = [match[3] not in ("==", "!=") for match in terms]
        assert any(assigns) and assigns == sorted(assigns), rule
        assert not any(assign and match[1] in matches for match, assign in zip(terms, assigns, strict=True)), rule
