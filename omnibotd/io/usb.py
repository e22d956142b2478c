"""USB serial adapters: found by their numbers whatever the kernel calls them today, and reset when they hang.

pyusb tells which devices are there and where; sysfs tells which tty the kernel made of each. Without libusb, or without
the right to use it, sysfs alone has to do.
"""

from __future__ import annotations

import errno
import fcntl
import logging
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import usb.core
import usb.util

log = logging.getLogger(__name__)

USBDEVFS_RESET = 0x5514  # linux/usbdevice_fs.h: _IO('U', 20)
_NO_ACCESS = "permission denied: the udev rules that come with omnibotd grant it to the group dialout"


class UsbError(Exception):
    """An adapter that can't be reset; the message says why."""


@dataclass(frozen=True, slots=True)
class Adapter:
    """A USB device and the serial ports that the kernel made of it, its first one first."""

    vid: int
    pid: int
    serial: str | None
    topology: str  # bus and ports from the root on, as sysfs spells it: 1-1.4
    bus: int
    address: int  # on the bus; a new one at each plugging in
    ttys: tuple[str, ...]

    def __str__(self) -> str:
        number = "" if self.serial is None else f":{self.serial}"
        return f"usb:{self.vid:04x}:{self.pid:04x}{number}"


class UsbBus:
    """The machine's USB devices; the arguments stand in for the machine in tests."""

    def __init__(
        self,
        sysfs: Path = Path("/sys"),
        dev: Path = Path("/dev"),
        find: Callable[..., Iterable[Any]] = usb.core.find,
    ) -> None:
        self._devices = sysfs / "bus/usb/devices"
        self._ttys = sysfs / "class/tty"
        self._dev = dev
        self._find = find

    def find(self, vid: int, pid: int) -> list[Adapter]:
        """Adapters with these numbers, plugged in now; by bus and port."""
        try:
            found = [self._from_pyusb(device) for device in self._by_pyusb(vid, pid)]
        except (usb.core.NoBackendError, usb.core.USBError) as error:
            log.debug("looking in sysfs, for libusb does not serve: %s", error)
            found = [adapter for adapter in self._by_sysfs() if (adapter.vid, adapter.pid) == (vid, pid)]
        return sorted(found, key=lambda adapter: adapter.topology)

    def adapter_of(self, tty: str) -> Adapter | None:
        """The adapter behind a device path; None for a tty that is not on USB."""
        place = (self._ttys / Path(tty).resolve().name / "device").resolve()
        for folder in (place, *place.parents):
            if (folder / "idVendor").is_file():
                return self._from_sysfs(folder)
        return None

    def reset(self, adapter: Adapter) -> None:
        """As if unplugged and plugged in; it may come back under another name. Raises UsbError."""
        try:
            for device in self._by_pyusb(adapter.vid, adapter.pid):
                if (device.bus, device.address) == (adapter.bus, adapter.address):
                    device.reset()
                    usb.util.dispose_resources(device)
                    return
        except usb.core.NoBackendError:
            self._reset_by_ioctl(adapter)
            return
        except usb.core.USBError as error:
            raise UsbError(_NO_ACCESS if error.errno == errno.EACCES else str(error)) from error
        raise UsbError("it is gone")

    def _by_pyusb(self, vid: int, pid: int) -> Iterator[Any]:
        yield from self._find(find_all=True, idVendor=vid, idProduct=pid)

    def _from_pyusb(self, device: Any) -> Adapter:
        topology = f"{device.bus}-{'.'.join(map(str, device.port_numbers or ()))}"
        # The kernel has read the number when the device came; asking a device that hangs would take seconds.
        serial = _text(self._devices / topology / "serial") or _serial_of(device)
        numbers = device.idVendor, device.idProduct, serial
        return Adapter(*numbers, topology, device.bus, device.address, self._ttys_of(topology))

    def _by_sysfs(self) -> Iterator[Adapter]:
        for folder in self._devices.glob("*"):
            if (folder / "idVendor").is_file():
                adapter = self._from_sysfs(folder)
                if adapter is not None:
                    yield adapter

    def _from_sysfs(self, folder: Path) -> Adapter | None:
        """None when it was unplugged while we looked."""
        try:
            vid, pid = (int(_text(folder / name) or "", 16) for name in ("idVendor", "idProduct"))
            bus, address = (int(_text(folder / name) or "") for name in ("busnum", "devnum"))
        except ValueError:
            return None
        serial = _text(folder / "serial")
        return Adapter(vid, pid, serial, folder.name, bus, address, self._ttys_of(folder.name))

    def _ttys_of(self, topology: str) -> tuple[str, ...]:
        """usb-serial drivers put `ttyUSB0` into the interface's folder, cdc_acm `tty/ttyACM0`."""
        interfaces = sorted(self._devices.glob(f"{topology}:*"), key=_interface_number)
        found = [
            name for interface in interfaces for name in (*interface.glob("ttyUSB*"), *interface.glob("tty/ttyACM*"))
        ]
        return tuple(str(self._dev / path.name) for path in found)

    def _reset_by_ioctl(self, adapter: Adapter) -> None:
        node = self._dev / f"bus/usb/{adapter.bus:03d}/{adapter.address:03d}"
        try:
            descriptor = os.open(node, os.O_WRONLY)
        except OSError as error:
            raise UsbError(_NO_ACCESS if error.errno == errno.EACCES else f"{node}: {error.strerror}") from error
        try:
            fcntl.ioctl(descriptor, USBDEVFS_RESET, 0)
        except OSError as error:
            raise UsbError(f"{node}: {error.strerror}") from error
        finally:
            os.close(descriptor)


def _serial_of(device: Any) -> str | None:
    """Asked of the device itself, which takes the right to open it."""
    try:
        number: str | None = device.serial_number
    except (usb.core.USBError, ValueError, NotImplementedError):
        return None
    finally:
        usb.util.dispose_resources(device)
    return number


def _text(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip() or None
    except OSError:
        return None


def _interface_number(folder: Path) -> int:
    """Of `1-1.4:1.0`, the part after the last dot."""
    number = folder.name.rpartition(".")[2]
    return int(number) if number.isdecimal() else 0
