"""What the doctor finds of camera and base without the daemon: each fault, told by its name and with a way out."""

from __future__ import annotations

import errno
import grp
import os
import time
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace

import pytest

from omnibotd import device_checks
from omnibotd.config import CameraConfig
from omnibotd.findings import Finding, Grade
from tests.io.v4l2_kernel import META, Kernel

MODES = {(640, 480): [(1, 30), (1, 15)]}


def only(found: Iterable[Finding], grade: Grade) -> Finding:
    """The one finding of this grade."""
    (finding,) = [finding for finding in found if finding.grade is grade]
    return finding


@pytest.fixture
def device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Plugs in a camera whose device file belongs to `group`."""
    monkeypatch.setattr(device_checks, "STREAMED", 0.05)
    monkeypatch.setattr(device_checks, "FIRST_FRAME", 0.05)

    def plug(kernel: Kernel, group: str = "video") -> list[Finding]:
        path = tmp_path / "video0"
        kernel.install(path, monkeypatch)
        path.chmod(0o660)
        monkeypatch.setattr(device_checks, "grp", SimpleNamespace(getgrgid=lambda _: SimpleNamespace(gr_name=group)))
        return list(device_checks._device(CameraConfig(source=str(path))))

    return plug


def test_a_good_camera_is_told_with_what_it_offers_and_counted(device) -> None:
    kernel = Kernel({"MJPG": MODES, "YUYV": MODES}, refill=b"jpeg")
    camera, rate = device(kernel)
    assert camera.grade is Grade.OK
    assert camera.found == "Test Cam offers MJPG, YUYV; MJPG 640x480 at 15 Hz would be taken"
    assert rate.name == "frame rate"
    assert rate.grade is Grade.OK  # this one has a picture ready whenever it is asked


def test_a_camera_without_pictures(device) -> None:
    assert "no picture" in only(device(Kernel({"MJPG": MODES})), Grade.WRONG).found


def test_a_camera_of_other_formats_or_sizes(device) -> None:
    assert "H264, none we can read" in only(device(Kernel({"H264": MODES})), Grade.WRONG).found


def test_a_camera_without_the_size_that_is_asked_for(device) -> None:
    found = device(Kernel({"MJPG": {(320, 240): [(1, 15)]}}, refill=b"jpeg"))
    assert "no 640x480" in only(found, Grade.WARNING).found


def test_a_second_device_of_a_camera(device) -> None:
    assert "second device" in only(device(Kernel({"MJPG": MODES}, caps=META)), Grade.WRONG).found


def test_a_camera_in_use_is_told_with_by_whom(device, tmp_path: Path) -> None:
    finding = only(device(Kernel({"MJPG": MODES}, refuse={5: errno.EBUSY})), Grade.WRONG)
    assert "busy" in finding.found
    assert "end the other program" in finding.remedy


def test_a_camera_that_its_group_may_not_use(device) -> None:
    finding = only(device(Kernel({"MJPG": MODES}, refill=b"jpeg"), group="root"), Grade.WRONG)
    assert finding.name == "camera permissions"
    assert "99-omnibotd.rules" in finding.remedy


def test_no_camera(tmp_path: Path) -> None:
    (finding,) = device_checks.camera(CameraConfig(source="/dev/video-of-nobody"))
    assert finding.grade is Grade.WRONG
    assert "plug the camera in" in finding.remedy


def test_no_stream_and_no_recording(tmp_path: Path) -> None:
    (stream,) = device_checks.camera(CameraConfig(source="http://127.0.0.1:9/stream"))
    (recording,) = device_checks.camera(CameraConfig(source=str(tmp_path / "gone")))
    assert (stream.grade, recording.grade) == (Grade.WRONG, Grade.WRONG)
    (there,) = device_checks.camera(CameraConfig(source=str(tmp_path)))
    assert there.grade is Grade.OK


def test_a_base_that_is_not_there() -> None:
    (by_path,) = device_checks.serial_port("/dev/ttyUSB-of-nobody")
    (by_number,) = device_checks.serial_port("usb:dead:beef")
    assert (by_path.grade, by_number.grade) == (Grade.WRONG, Grade.WRONG)
    assert "base.port" in by_path.remedy
    (unknown,) = device_checks.serial_port("socket://127.0.0.1:4000")
    assert unknown.grade is Grade.UNKNOWN


@pytest.mark.parametrize(
    ("group", "mode", "good"), [(None, 0o660, True), (None, 0o600, False), ("audio", 0o660, False)]
)
def test_a_base_is_for_its_group(tmp_path: Path, group: str | None, mode: int, good: bool) -> None:
    port = tmp_path / "ttyUSB0"
    port.touch()
    port.chmod(mode)
    own = grp.getgrgid(port.stat().st_gid).gr_name
    found = list(device_checks.access("base permissions", str(port), group or own))
    assert (not found) == good


def test_the_program_that_holds_a_device_is_found(tmp_path: Path) -> None:
    """Here only this process does, which is not told of."""
    held = tmp_path / "device"
    with held.open("w"):
        assert device_checks._by_whom(OSError(errno.EBUSY, "busy"), str(held)) == ""
    child = os.posix_spawnp("sh", ["sh", "-c", f"exec 3>{held}; sleep 5"], os.environ)
    try:
        deadline = time.monotonic() + 5.0
        while not (told := device_checks._by_whom(OSError(errno.EBUSY, "busy"), str(held))):
            assert time.monotonic() < deadline
        assert f"(process {child})" in told
    finally:
        os.kill(child, 9)
        os.waitpid(child, 0)
