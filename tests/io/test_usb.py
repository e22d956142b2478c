"""USB adapters through the real pyusb on a made-up machine: a backend of its own, and a folder for /sys and /dev."""

from __future__ import annotations

import array
import errno
import fcntl
import functools
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import usb.backend
import usb.core

from omnibotd.io.usb import USBDEVFS_RESET, Adapter, UsbBus, UsbError

UNUSED_FIELDS = (
    *("bLength", "bDescriptorType", "bcdUSB", "bDeviceClass", "bDeviceSubClass", "bDeviceProtocol", "bMaxPacketSize0"),
    *("bcdDevice", "iManufacturer", "iProduct", "bNumConfigurations", "port_number", "speed"),
)


@dataclass
class Device:
    """One thing plugged in; `serial` is what it answers when asked itself."""

    vid: int
    pid: int
    address: int
    ports: tuple[int, ...]
    serial: str | None = None
    bus: int = 1
    ttys: tuple[str, ...] = ()

    @property
    def topology(self) -> str:
        return f"{self.bus}-{'.'.join(map(str, self.ports))}"


@dataclass
class Backend(usb.backend.IBackend):
    """What pyusb asks of libusb."""

    plugged: list[Device]
    resets: list[Device] = field(default_factory=list)
    refusal: int | None = None

    def enumerate_devices(self) -> Iterator[Device]:
        return iter(self.plugged)

    def get_device_descriptor(self, dev: Device) -> SimpleNamespace:
        numbers = {"idVendor": dev.vid, "idProduct": dev.pid, "iSerialNumber": 3 if dev.serial else 0}
        others = dict.fromkeys(UNUSED_FIELDS, 0)
        return SimpleNamespace(**others, **numbers, bus=dev.bus, address=dev.address, port_numbers=dev.ports)

    def open_device(self, dev: Device) -> Device:
        if self.refusal is not None:
            raise usb.core.USBError("refused", None, self.refusal)
        return dev

    def close_device(self, dev_handle: Device) -> None:
        pass

    def ctrl_transfer(
        self, dev_handle: Device, request_type: int, request: int, value: int, index: int, data: Any, timeout: int
    ) -> int:
        """GET_DESCRIPTOR of strings: the languages (0), and the serial number."""
        assert dev_handle.serial is not None
        text = b"\x09\x04" if value & 0xFF == 0 else dev_handle.serial.encode("utf-16-le")
        reply = array.array("B", bytes((2 + len(text), 3)) + text)
        data[: len(reply)] = reply
        return len(reply)

    def reset_device(self, dev_handle: Device) -> None:
        self.resets.append(dev_handle)


@dataclass
class Machine:
    """A folder as the kernel would fill it for what is plugged in."""

    root: Path
    backend: Backend

    @property
    def bus(self) -> UsbBus:
        return self.with_find(functools.partial(usb.core.find, backend=self.backend))

    @property
    def bus_without_libusb(self) -> UsbBus:
        def find(**_: Any) -> Any:
            raise usb.core.NoBackendError("No backend available")

        return self.with_find(find)

    def with_find(self, find: Any) -> UsbBus:
        return UsbBus(self.root / "sys", self.root / "dev", find)

    def tty(self, name: str) -> str:
        return str(self.root / "dev" / name)


def plug(root: Path, device: Device, kernel_knows_serial: bool) -> None:
    """Interface folders as usb-serial and cdc_acm make them; each tty on an interface of its own."""
    usb_devices = root / "sys/bus/usb/devices"
    home = root / "sys/devices/pci/usb1" / device.topology
    home.mkdir(parents=True)
    usb_devices.mkdir(parents=True, exist_ok=True)
    (usb_devices / device.topology).symlink_to(home)
    facts = {"idVendor": f"{device.vid:04x}", "idProduct": f"{device.pid:04x}"}
    facts |= {"busnum": str(device.bus), "devnum": str(device.address)}
    if kernel_knows_serial and device.serial:
        facts["serial"] = device.serial
    for name, text in facts.items():
        (home / name).write_text(text + "\n")
    for number, name in enumerate(device.ttys):
        interface = home / f"{device.topology}:1.{number}"
        folder = interface / name if name.startswith("ttyUSB") else interface / "tty" / name
        folder.mkdir(parents=True)
        (usb_devices / interface.name).symlink_to(interface)
        by_class = root / "sys/class/tty" / name
        by_class.mkdir(parents=True)
        (by_class / "device").symlink_to(folder if name.startswith("ttyUSB") else interface)


def machine(root: Path, *devices: Device, kernel_knows_serial: bool = True) -> Machine:
    for device in devices:
        plug(root, device, kernel_knows_serial)
    return Machine(root, Backend(list(devices)))


def ftdi(**options: Any) -> Device:
    return Device(**{"vid": 0x0403, "pid": 0x6001, "address": 7, "ports": (1, 4), "ttys": ("ttyUSB0",), **options})


UNO = Device(0x2341, 0x0043, 9, (2,), "85736", ttys=("ttyACM0",))


@pytest.mark.parametrize("libusb", [True, False])
def test_found_by_numbers_with_its_ports_in_the_order_of_its_interfaces(tmp_path: Path, libusb: bool) -> None:
    # The kernel names ports as they come: 10 may be the first, and there are more than ten interfaces.
    many = ftdi(serial="FT1", ttys=("ttyUSB10", "ttyUSB2", *(f"ttyUSB{20 + k}" for k in range(10))))
    made = machine(tmp_path, many, UNO)
    bus = made.bus if libusb else made.bus_without_libusb
    ports = tuple(made.tty(name) for name in many.ttys)
    assert bus.find(0x0403, 0x6001) == [Adapter(0x0403, 0x6001, "FT1", "1-1.4", 1, 7, ports)]
    (uno,) = bus.find(0x2341, 0x0043)
    assert (uno.serial, uno.ttys, str(uno)) == ("85736", (made.tty("ttyACM0"),), "usb:2341:0043:85736")
    assert bus.find(0x2341, 0x0001) == []


@pytest.mark.parametrize("libusb", [True, False])
def test_no_usb_at_all(tmp_path: Path, libusb: bool) -> None:
    made = machine(tmp_path)
    bus = made.bus if libusb else made.bus_without_libusb
    assert bus.find(0x0403, 0x6001) == []
    assert bus.adapter_of("/dev/ttyS0") is None


def test_libusb_that_may_not_start_is_none(tmp_path: Path) -> None:
    def find(**_: Any) -> Any:
        raise usb.core.USBError("Other error", -99, None)

    made = machine(tmp_path, ftdi())
    assert len(made.with_find(find).find(0x0403, 0x6001)) == 1


def test_a_number_that_the_kernel_does_not_tell_is_asked_of_the_device(tmp_path: Path) -> None:
    made = machine(tmp_path, ftdi(serial="XY12"), kernel_knows_serial=False)
    assert made.bus.find(0x0403, 0x6001)[0].serial == "XY12"
    made.backend.refusal = errno.EACCES
    assert made.bus.find(0x0403, 0x6001)[0].serial is None


def test_two_alike_are_told_apart_by_topology(tmp_path: Path) -> None:
    first = ftdi(address=30, ports=(1,), ttys=("ttyUSB7",))
    second = ftdi(address=3, ports=(2, 1), ttys=("ttyUSB1",))
    made = machine(tmp_path, second, first)
    assert [adapter.topology for adapter in made.bus.find(0x0403, 0x6001)] == ["1-1", "1-2.1"]
    assert made.bus.find(0x0403, 0x6001)[0].ttys == (made.tty("ttyUSB7"),)


def test_without_a_driver_it_has_no_port(tmp_path: Path) -> None:
    assert machine(tmp_path, ftdi(ttys=())).bus.find(0x0403, 0x6001)[0].ttys == ()


def test_the_adapter_of_a_tty(tmp_path: Path) -> None:
    made = machine(tmp_path, ftdi(), UNO)
    usb_serial, acm = made.bus.adapter_of(made.tty("ttyUSB0")), made.bus.adapter_of(made.tty("ttyACM0"))
    assert usb_serial is not None and usb_serial.topology == "1-1.4"
    assert acm is not None and acm.serial == "85736"
    by_id = tmp_path / "dev/by-id"
    by_id.parent.mkdir()
    by_id.symlink_to(made.tty("ttyACM0"))
    assert made.bus.adapter_of(str(by_id)) == acm


def test_unplugged_while_we_look(tmp_path: Path) -> None:
    made = machine(tmp_path, ftdi())
    (tmp_path / "sys/bus/usb/devices/1-1.4/devnum").unlink()
    assert made.bus_without_libusb.find(0x0403, 0x6001) == []


def test_reset_reaches_that_one_and_no_other(tmp_path: Path) -> None:
    made = machine(tmp_path, ftdi(), ftdi(address=8, ports=(2,), ttys=("ttyUSB1",)))
    adapter = made.bus.find(0x0403, 0x6001)[1]
    made.bus.reset(adapter)
    assert [device.address for device in made.backend.resets] == [8]
    made.backend.plugged.pop()
    with pytest.raises(UsbError, match="gone"):
        made.bus.reset(adapter)


def test_reset_without_the_right_to(tmp_path: Path) -> None:
    made = machine(tmp_path, ftdi())
    (adapter,) = made.bus.find(0x0403, 0x6001)
    made.backend.refusal = errno.EACCES
    with pytest.raises(UsbError, match="permission denied: the udev rules"):
        made.bus.reset(adapter)
    made.backend.refusal = errno.EIO
    with pytest.raises(UsbError, match="refused"):
        made.bus.reset(adapter)


def test_reset_without_libusb_asks_the_kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = machine(tmp_path, ftdi())
    bus = made.bus_without_libusb
    (adapter,) = bus.find(0x0403, 0x6001)
    with pytest.raises(UsbError, match=r"bus/usb/001/007: No such file"):
        bus.reset(adapter)
    node = tmp_path / "dev/bus/usb/001/007"
    node.parent.mkdir(parents=True)
    node.touch()
    with pytest.raises(UsbError, match=r"001/007: Inappropriate ioctl"):  # a file is no device
        bus.reset(adapter)
    asked: list[tuple[str, int]] = []
    monkeypatch.setattr(fcntl, "ioctl", lambda fd, code, arg: asked.append((os.readlink(f"/proc/self/fd/{fd}"), code)))
    bus.reset(adapter)
    assert asked == [(str(node), USBDEVFS_RESET)]
    assert ord("U") << 8 | 20 == USBDEVFS_RESET  # _IO('U', 20): no direction, no size
