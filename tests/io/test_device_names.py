"""Lasting names, as udev keeps them."""

from pathlib import Path

from omnibotd.io.device_names import camera_by_id, serial_by_id


def test_a_device_is_found_by_its_lasting_name(tmp_path: Path) -> None:
    (tmp_path / "by-id").mkdir()
    for device in ("video0", "video1"):
        (tmp_path / device).touch()
        (tmp_path / "by-id" / f"usb-cam-{device}").symlink_to(tmp_path / device)
    names = tmp_path / "by-id"
    assert camera_by_id(str(tmp_path / "video1"), names) == str(names / "usb-cam-video1")
    assert camera_by_id(str(names / "usb-cam-video1"), names) is None  # it is one
    assert camera_by_id(str(tmp_path / "video7"), names) is None
    assert serial_by_id(str(tmp_path / "video1"), tmp_path / "no-such-folder") is None
