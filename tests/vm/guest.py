"""A Debian guest in QEMU: its power, its plugs (QMP) and its shell (qemu-guest-agent)."""

from __future__ import annotations

import base64
import contextlib
import itertools
import json
import select
import socket
import subprocess
import time
from pathlib import Path
from typing import Any

# Emulated, for /dev/kvm is not to be had everywhere. One processor that does one thousand million instructions a second
# of the guest's own time, however slow the host: the class of an Atom N270, whose instruction set core2duo is near to.
MACHINE = "-accel tcg,tb-size=512 -icount shift=0,sleep=on -cpu core2duo -smp 1 -m 1024 -machine pc -nic none"
KERNEL = "root=/dev/vda ro console=ttyS0 quiet systemd.show_status=0 net.ifnames=0 mitigations=off audit=0"
BOOT_LIMIT = 3000.0  # s of the host, which others may keep busy: 45 s with a core to itself
COMMAND_LIMIT = 3000.0  # training takes 20 s of the guest, two minutes with a core


class GuestError(Exception):
    """The guest did not do as told; the message holds what it said."""


class JsonLine:
    """Requests over a Unix socket that answers in lines of JSON: QMP, and the guest's agent."""

    def __init__(self, path: Path, patience: float = 20.0) -> None:
        end = time.monotonic() + patience
        self._socket = socket.socket(socket.AF_UNIX)
        while True:
            try:
                self._socket.connect(str(path))
                break
            except OSError as error:
                if time.monotonic() > end:
                    raise GuestError(f"{path}: {error}") from error
                time.sleep(0.05)
        self._received = b""

    def send(self, name: str, **arguments: Any) -> None:
        self._socket.sendall(json.dumps({"execute": name, "arguments": arguments}).encode() + b"\n")

    def receive(self, patience: float) -> dict[str, Any]:
        """The next line. Raises TimeoutError."""
        end = time.monotonic() + patience
        while b"\n" not in self._received:
            if not select.select([self._socket], [], [], max(0.0, end - time.monotonic()))[0]:
                raise TimeoutError
            data = self._socket.recv(65536)
            if not data:
                raise GuestError("the machine is gone")
            self._received += data
        line, _, self._received = self._received.partition(b"\n")
        message: dict[str, Any] = json.loads(line.lstrip(b"\xff"))
        return message

    def ask(self, name: str, patience: float = 300.0, **arguments: Any) -> Any:
        self.send(name, **arguments)
        end = time.monotonic() + patience
        while True:
            message = self.receive(end - time.monotonic())
            if "return" in message:
                return message["return"]
            if "error" in message:
                raise GuestError(f"{name}: {message['error']['desc']}")

    def close(self) -> None:
        self._socket.close()


class Guest:
    """One machine; its disk is the image, and what is written to it is forgotten at its end."""

    def __init__(self, image: Path, kernel: Path, initrd: Path, folder: Path) -> None:
        """Switches it on. `folder` takes its sockets and what it says."""
        self.folder = folder
        self._numbers = itertools.count(int(time.time()) % 2**20 * 1024)
        self._log = (folder / "qemu.log").open("w")
        self.process = subprocess.Popen(
            self._command(image, kernel, initrd), stdin=subprocess.DEVNULL, stdout=self._log, stderr=self._log
        )
        self.monitor = JsonLine(folder / "qmp")
        self.monitor.receive(20.0)
        self.monitor.ask("qmp_capabilities")
        self._agent = JsonLine(folder / "agent")

    def _command(self, image: Path, kernel: Path, initrd: Path) -> list[str]:
        def line(name: str) -> list[str]:
            return ["-chardev", f"socket,id={name},path={self.folder / name},server=on,wait=off"]

        return [
            # The world outside must be on time where the processor is busy; the guest's own time waits with it.
            *("nice", "-n", "5"),
            *("qemu-system-x86_64", "-nodefaults", "-no-user-config", "-display", "none", *MACHINE.split()),
            *("-drive", f"file={image},format=raw,if=virtio,cache=unsafe,snapshot=on"),
            *("-kernel", str(kernel), "-initrd", str(initrd), "-append", KERNEL),
            *("-serial", f"file:{self.folder / 'console.log'}", "-rtc", "clock=vm", "-device", "virtio-rng-pci"),
            *(part for name in ("qmp", "clock") for part in ("-qmp", f"unix:{self.folder / name},server=on,wait=off")),
            *("-device", "virtio-serial-pci"),
            *(*line("agent"), "-device", "virtserialport,chardev=agent,name=org.qemu.guest_agent.0"),
            *(*line("control"), "-device", "virtserialport,chardev=control,name=control"),
            *("-device", "qemu-xhci,id=xhci", *line("camera"), *line("base")),
            *("-device", "usb-redir,id=webcam,chardev=camera,bus=xhci.0"),
        ]

    def wait(self, limit: float = BOOT_LIMIT) -> None:
        """Until its agent answers. A guest that is slow to answer is asked less and less often."""
        end, patience = time.monotonic() + limit, 2.0
        while time.monotonic() < end:
            if self.process.poll() is not None:
                raise GuestError((self.folder / "qemu.log").read_text() or "the machine has ended")
            if self._answers(patience) and self._answers(120.0):  # the second drops what the first ones left
                return
            patience = min(1.5 * patience, 120.0)
        raise GuestError(f"no answer after {limit:.0f} s: {(self.folder / 'console.log').read_text()[-2000:]}")

    def _answers(self, patience: float) -> bool:
        number, end = next(self._numbers), time.monotonic() + patience
        self._agent.send("guest-sync", id=number)
        with contextlib.suppress(TimeoutError):
            while self._agent.receive(end - time.monotonic()).get("return") != number:
                pass
            return True
        return False

    def sh(self, command: str, patience: float = COMMAND_LIMIT, check: bool = True) -> str:
        """What a shell command says. Raises GuestError where it fails."""
        status, said = self.run(command, patience)
        if check and status != 0:
            raise GuestError(f"{command}: exit status {status}: {said}")
        return said

    def run(self, command: str, patience: float = COMMAND_LIMIT) -> tuple[int, str]:
        """Exit status and output of a shell command. Raises GuestError where it takes too long."""
        arguments = {"path": "/bin/sh", "arg": ["-c", command], "capture-output": True}
        pid = self._agent.ask("guest-exec", **arguments)["pid"]
        end = time.monotonic() + patience
        while time.monotonic() < end:
            state = self._agent.ask("guest-exec-status", pid=pid)
            if state["exited"]:
                parts = (base64.b64decode(state.get(key, "")) for key in ("out-data", "err-data"))
                said = b"".join(parts).decode(errors="replace").strip()
                return state.get("exitcode", 128 + state.get("signal", 0)), said
            time.sleep(0.3)
        raise GuestError(f"{command}: not done after {patience:.0f} s")

    def plug_base(self, name: str) -> None:
        """An FTDI adapter (0403:6001) whose other end is the socket `base`."""
        self.monitor.ask("device_add", driver="usb-serial", id=name, chardev="base", bus="xhci.0")

    def unplug(self, name: str) -> None:
        self.monitor.ask("device_del", id=name)

    def reset(self) -> None:
        """As the button does: nothing is written out first."""
        self.monitor.ask("system_reset")
        self._agent.close()
        self._agent = JsonLine(self.folder / "agent")

    def close(self) -> None:
        with contextlib.suppress(GuestError, OSError, TimeoutError):
            self.monitor.ask("quit", patience=3.0)
        try:
            self.process.wait(10)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        for held in (self.monitor, self._agent, self._log):
            held.close()
