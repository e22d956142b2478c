"""What `omnibotctl doctor` can find out about camera and base by itself, where no daemon has them open.

Needs neither numpy nor OpenCV, for the client does not.
"""

from __future__ import annotations

import errno
import grp
import os
import socket
import stat
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from urllib.parse import urlsplit

from omnibotd import findings
from omnibotd.config import CameraConfig
from omnibotd.findings import Finding, ok, unknown, warning, wrong
from omnibotd.io.camera_errors import CameraError
from omnibotd.io.camera_v4l2_device import Device
from omnibotd.io.camera_v4l2_modes import Wanted, best, differences
from omnibotd.io.device_names import camera_by_id, serial_by_id
from omnibotd.io.serial_link import LinkLost, resolve_port

STREAMED = 2.0  # s over which frames are counted
FIRST_FRAME = 5.0  # s; a webcam takes 1-3 to start its stream
PATIENCE = 2.0  # s for a network camera to accept


def camera(settings: CameraConfig) -> Iterator[Finding]:
    if settings.source.startswith("http://"):
        yield _stream(settings.source)
    elif not settings.source.startswith("/dev/"):
        exists = Path(settings.source).exists()
        remedy = "see camera.source in the configuration"
        yield (
            ok("camera", f"recording {settings.source}") if exists else wrong("camera", f"no {settings.source}", remedy)
        )
    else:
        yield from _device(settings)


def _stream(url: str) -> Finding:
    parts = urlsplit(url)
    try:
        socket.create_connection((parts.hostname or "", parts.port or 80), PATIENCE).close()
    except OSError as error:
        return wrong(
            "camera", f"{url}: {error.strerror or error}", "start the stream; see camera.source and the network"
        )
    return ok("camera", f"{url} accepts connections; pictures are the daemon's to judge")


def _device(settings: CameraConfig) -> Iterator[Finding]:
    path = settings.source
    try:
        yield from access("camera permissions", path, "video")
        with closing(Device(path)) as device:
            yield from _formats(device, settings)
    except OSError as error:
        yield wrong(
            "camera", f"{path}: {error.strerror}{_by_whom(error, path)}", _REMEDIES.get(error.errno or 0, _REPLUG)
        )
    except CameraError as error:
        yield wrong("camera", str(error), "see camera.source; ls -l /dev/v4l/by-id shows what is plugged in")
    lasting = findings.stable_name("camera", "camera.source", path, camera_by_id(path))
    if lasting is not None:
        yield lasting


_REPLUG = "replug the camera; try another port and cable"
_REMEDIES = {
    errno.ENOENT: "plug the camera in; ls -l /dev/v4l/by-id shows which there are, camera.source names the one to use",
    errno.EACCES: "run this as root, or join the group: usermod -aG video YOU",
    errno.EBUSY: "end the other program, then systemctl restart omnibotd",
}


def _formats(device: Device, settings: CameraConfig) -> Iterator[Finding]:
    """What it offers, what would be taken, and how many pictures really come."""
    wanted = Wanted(settings.width, settings.height, settings.fps)
    mode = best(device.modes(wanted), wanted)
    offered = ", ".join(device.formats())
    if mode is None:
        yield wrong("camera", f"{device.card} offers {offered}, none we can read", "take another camera: MJPG or YUYV")
        return
    yield ok("camera", f"{device.card} offers {offered}; {mode} would be taken")
    for difference in differences(mode, wanted):
        yield warning("camera settings", difference, "change the configuration to what the camera can do")
    device.use(mode)
    device.start()
    yield _counted(device, min(settings.fps, mode.fps))


def _counted(device: Device, wanted: float) -> Finding:
    if device.newest(FIRST_FRAME) is None:
        return wrong("frame rate", f"no picture in {FIRST_FRAME:g} s", _REPLUG)
    began = time.monotonic()
    count = 0
    while time.monotonic() < began + STREAMED:
        count += device.newest(STREAMED) is not None
    return findings.frame_rate(count / (time.monotonic() - began), wanted)


def _by_whom(error: OSError, path: str) -> str:
    """The program that has the device open, as far as this user may see."""
    if error.errno != errno.EBUSY:
        return ""
    device = os.path.realpath(path)
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        try:
            if os.readlink(link) == device and link.parts[2] != str(os.getpid()):
                return f", by {(link.parents[1] / 'comm').read_text().strip()} (process {link.parts[2]})"
        except OSError:
            continue
    return ""


def access(name: str, path: str, group: str) -> Iterator[Finding]:
    """Whether a member of `group`, as the daemon's user is, may read and write the device. OSError: it is not there."""
    facts = os.stat(path)
    try:
        owner = grp.getgrgid(facts.st_gid).gr_name
    except KeyError:
        owner = str(facts.st_gid)
    if owner != group or facts.st_mode & 0o060 != 0o060:
        remedy = "install systemd/99-omnibotd.rules, then udevadm control --reload && udevadm trigger"
        yield wrong(name, f"{path} is {stat.filemode(facts.st_mode)} of group {owner}, not rw of {group}", remedy)


def serial_port(port: str) -> Iterator[Finding]:
    """Where the base should be. Not opened: that restarts an Arduino, and only the daemon speaks its language."""
    try:
        path = resolve_port(port)
    except LinkLost as error:
        yield wrong(
            "base", f"{port}: {error}", "plug the adapter in; lsusb and ls -l /dev/serial/by-id show what is there"
        )
        return
    if "://" in path:
        yield unknown("base", f"{port}: only the daemon can try it")
        return
    try:
        if Path(path).name.startswith("tty"):  # not for a pty of a simulated base
            yield from access("base permissions", path, "dialout")
        yield ok("base", f"{path} is there")
    except OSError as error:
        remedy = "plug the adapter in; ls -l /dev/serial/by-id shows which there are, base.port names the one to use"
        yield wrong("base", f"{path}: {error.strerror}", remedy)
    lasting = findings.stable_name("base", "base.port", port, serial_by_id(port))
    if lasting is not None:
        yield lasting
