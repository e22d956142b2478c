"""The files for systemd and udev: read by systemd's own tools where they are installed, and agreeing with the code."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from omnibotd.config import ControlConfig, StorageConfig
from omnibotd.daemon import PATIENCE

FILES = Path(__file__).resolve().parents[1] / "systemd"
UNIT = FILES / "omnibotd.service"
PROGRAMS = ("/usr/bin/omnibotd --config /etc/omnibotd/omnibotd.yaml", "/usr/lib/omnibotd/back-off")


def setting(name: str) -> list[str]:
    """The values given to a setting of the unit, in order."""
    return re.findall(rf"^{name}=(.*)$", UNIT.read_text(), re.MULTILINE)


def run(*command: object) -> subprocess.CompletedProcess[str]:
    if shutil.which(str(command[0])) is None:
        pytest.skip(f"{command[0]} is not installed")
    return subprocess.run([str(part) for part in command], capture_output=True, text=True, timeout=30, check=False)


@pytest.fixture(params=["as installed", "with network.conf"])
def startable(request, tmp_path):
    """The unit with programs that exist on any machine, for systemd-analyze looks for them."""
    text = UNIT.read_text()
    for program in PROGRAMS:
        assert f"={program}\n" in text
        text = text.replace(f"={program}\n", "=/bin/true\n")
    path = tmp_path / "omnibotd.service"
    if request.param == "with network.conf":
        text += (FILES / "network.conf").read_text()
    path.write_text(text)
    return path


def test_systemd_understands_the_unit(startable):
    result = run("systemd-analyze", "verify", "--man=no", startable)
    assert (result.returncode, result.stderr) == (0, "")


def test_the_unit_is_exposed_to_little(startable):
    # The threshold is in tenths; 9.6 is a unit that restricts nothing. Its own value is 0.8, 1.6 with a network.
    result = run("systemd-analyze", "security", "--offline=true", "--threshold=20", startable)
    assert result.returncode == 0, result.stdout


def test_the_unit_makes_the_folders_that_the_defaults_name():
    directory = next(item.default for item in StorageConfig.__dataclass_fields__.values())
    assert Path("/var/lib") / setting("StateDirectory")[0] == directory
    control = {name: item.default for name, item in ControlConfig.__dataclass_fields__.items()}
    assert Path("/run") / setting("RuntimeDirectory")[0] == control["socket"].parent
    assert setting("Group") == [control["group"]]


def test_the_unit_opens_cameras_and_usb_serial_ports_and_no_more():
    assert setting("DevicePolicy") == ["closed"]
    classes = {line.split()[0] for line in setting("DeviceAllow")}
    assert classes == {f"char-{name}" for name in ("video4linux", "ttyUSB", "ttyACM", "usb_device")}


def test_every_class_of_devices_is_known_to_the_kernel_before_the_unit_names_it():
    """A class whose module is not loaded yet is left out of what is allowed, and stays out until the next start."""
    modules = {"char-video4linux": "uvcvideo", "char-ttyUSB": "usbserial", "char-ttyACM": "cdc_acm"}
    built_in = {"char-usb_device"}
    wanted = {f"modprobe@{modules[line.split()[0]]}.service" for line in setting("DeviceAllow")[:3]}
    assert {line.split()[0] for line in setting("DeviceAllow")} == {*modules, *built_in}
    assert set(setting("Wants")[0].split()) == set(setting("After")[0].split()) == wanted


def test_the_unit_has_no_network_of_its_own():
    assert setting("PrivateNetwork") == []  # libusb would not hear of a replugged adapter
    assert setting("IPAddressDeny") == ["any"] and setting("IPAddressAllow") == []
    assert setting("RestrictAddressFamilies") == ["AF_UNIX AF_NETLINK"]


def test_the_processes_that_the_daemon_starts_may_make_themselves_nicer():
    """os.nice is setpriority, which is in the group of calls that the unit otherwise takes away."""
    assert "~@privileged @resources" in setting("SystemCallFilter")
    assert setting("SystemCallFilter")[-1].split() == ["@chown", "setpriority"]


def test_a_daemon_that_hangs_or_ends_is_started_again_however_often():
    assert (setting("Type"), setting("Restart"), setting("StartLimitIntervalSec")) == (["notify"], ["always"], ["0"])
    assert 2 <= float(setting("WatchdogSec")[0]) <= 15
    assert setting("RestartPreventExitStatus") == ["2"]  # the exit status of a wrong configuration


def test_a_start_without_camera_or_base_ends_well_before_systemd_gives_it_up():
    assert float(setting("TimeoutStartSec")[0]) >= 4.0 * PATIENCE


def test_the_unit_waits_for_the_longest_back_off():
    waits = [int(number) for number in re.findall(r"sleep (\d+)", (FILES / "back-off").read_text())]
    assert len(waits) == 3 and max(waits) < float(setting("TimeoutStopSec")[0])
    assert setting("RuntimeDirectoryPreserve") == ["restart"]  # or nothing would be counted


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
