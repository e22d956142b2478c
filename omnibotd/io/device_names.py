"""Names under which udev keeps a device whatever the kernel calls it today."""

from __future__ import annotations

from pathlib import Path

CAMERAS, SERIALS = Path("/dev/v4l/by-id"), Path("/dev/serial/by-id")


def camera_by_id(path: str, folder: Path = CAMERAS) -> str | None:
    """The lasting name of a kernel's /dev/videoN; None where there is none, or it is no such name."""
    return _lasting(path, folder)


def serial_by_id(path: str, folder: Path = SERIALS) -> str | None:
    """The lasting name of a kernel's /dev/ttyUSBN or ttyACMN."""
    return _lasting(path, folder)


def _lasting(path: str, folder: Path) -> str | None:
    device = Path(path)
    if device.is_symlink() or not folder.is_dir():
        return None
    names = (link for link in sorted(folder.iterdir()) if link.resolve() == device.resolve())
    return next((str(link) for link in names), None)
