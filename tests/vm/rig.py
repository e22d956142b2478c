"""The guest and what is outside it, joined: what a test says of the robot's PC in one line."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from debian_image import Image
from guest import Guest, GuestError
from outside import Outside

from omnibotd.core.geometry import Pose2D
from tools.sim import ceilings

SEED = 1
START = (-0.6, -1.2, 0.0)
EVENT_LOOP, WORKERS = "control, base and requests", "perception and camera"
ON_THE_LINE = 0.2  # s of the host until QEMU has read what was sent
TICKS_A_SECOND = 100  # in which the guest's kernel counts processor time
PATIENCE = 1800.0  # s of the host: CI's has two cores, others may be busier


class Rig:
    """A robot's PC that has just been switched on."""

    def __init__(self, image: Image, folder: Path, found: dict[str, tuple[float, str]]) -> None:
        world = ceilings.tiles(SEED)
        self.dock = Pose2D(*world.dock)
        self.guest = Guest(image.disk, image.kernel, image.initrd, folder)
        self.outside = Outside(folder, world, START, SEED)
        self.outside.start()
        self._found = found
        self._adapters = 0

    def close(self) -> None:
        try:
            self.outside.close()
        finally:
            self.guest.close()

    def note(self, what: str, amount: float, unit: str = "s") -> None:
        """A line of the table."""
        self._found[what] = round(amount, 2), unit

    @contextmanager
    def watch(self, doing: str) -> Iterator[None]:
        """Lines of the table: how much of the guest's processor each part of the daemon takes meanwhile."""
        before = self._spent()
        yield
        after = self._spent()
        elapsed = after.pop("clock") - before.pop("clock")
        for part, spent in after.items():
            self.note(f"{part}, while it {doing}", 100.0 * (spent - before[part]) / elapsed, "%")

    def _spent(self) -> dict[str, float]:
        """Processor seconds of the daemon's threads so far, and the guest's seconds since boot."""
        (pid,) = self.unit("MainPID")
        uptime, *stats = self.guest.sh(f"cut -d' ' -f1 /proc/uptime; cat /proc/{pid}/task/*/stat").splitlines()
        spent = {"clock": float(uptime), EVENT_LOOP: 0.0, WORKERS: 0.0}
        for stat in stats:
            user, system = stat.rpartition(")")[2].split()[11:13]
            part = EVENT_LOOP if stat.startswith(f"{pid} ") else WORKERS
            spent[part] += (int(user) + int(system)) / TICKS_A_SECOND
        return spent

    @contextmanager
    def taken(self, device: str) -> Iterator[None]:
        """Somebody else has it open, too: what is unplugged and plugged in again meanwhile gets another name."""
        pid = self.guest.sh(f"exec sleep 1000 <{device} >/dev/null 2>&1 & echo $!")
        yield
        self.guest.sh(f"kill {pid}")

    # ---- plugs

    def plug_base(self) -> None:
        self._adapters += 1
        self.guest.plug_base(f"adapter{self._adapters}")
        self.outside.base_is_plugged(True)

    def unplug_base(self) -> None:
        # QEMU falls over a byte for an adapter that is on its way out (usb_wakeup without a bus, 7.2).
        self.outside.base_is_plugged(False)
        time.sleep(ON_THE_LINE)
        self.guest.unplug(f"adapter{self._adapters}")

    # ---- the daemon

    def ctl(self, words: str) -> str:
        return self.guest.sh(f"omnibotctl {words}")

    def status(self) -> dict[str, Any]:
        """As `omnibotctl status` has it, without starting a Python for it."""
        return self.outside.do(self.outside.ask("status"))

    def until(self, good: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        """The first status that is good; the daemon may be down for a while."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            try:
                status = self.status()
                if good(status):
                    return status
            except TimeoutError:
                status = {"answered": False}
            time.sleep(0.2)
        raise GuestError(f"not so after {PATIENCE:.0f} s: {status}")

    def until_whole(self) -> dict[str, Any]:
        return self.until(lambda status: status["base"]["connected"] and status["camera"]["ok"])

    def unit(self, *names: str) -> list[str]:
        """Properties of the daemon's unit."""
        said = self.guest.sh(f"systemctl show -p {','.join(names)} omnibotd")
        values = dict(line.split("=", 1) for line in said.splitlines())
        return [values[name] for name in names]

    def exposure(self) -> float:
        """What systemd-analyze says of the unit: 0 for shut, 10 for open."""
        said = self.guest.sh("systemd-analyze --no-pager security omnibotd")
        return float(said.rpartition("omnibotd.service: ")[2].split()[0])

    def restarts(self) -> int:
        return int(self.unit("NRestarts")[0])

    def until_active(self) -> tuple[float, float]:
        """Guest seconds since boot at which the unit was started and at which it was ready."""
        end = time.monotonic() + PATIENCE
        while self.unit("ActiveState") != ["active"]:
            if time.monotonic() > end:
                raise GuestError(self.guest.sh("systemctl status --no-pager omnibotd", check=False))
            time.sleep(2.0)
        started, ready = self.unit("InactiveExitTimestampMonotonic", "ActiveEnterTimestampMonotonic")
        return int(started) * 1e-6, int(ready) * 1e-6

    def fall(self, signal: str) -> tuple[float, float]:
        """Send the daemon's process a signal; guest seconds of that, and of the READY that follows."""
        before = self.restarts()
        (pid,) = self.unit("MainPID")
        fell = float(self.guest.sh(f"cut -d' ' -f1 /proc/uptime; kill -{signal} {pid}"))
        end = time.monotonic() + PATIENCE
        while self.restarts() == before:
            if time.monotonic() > end:
                raise GuestError(f"no restart after {signal}")
            time.sleep(2.0)
        return fell, self.until_active()[1]

    def log(self, pattern: str, unit: str = "-u omnibotd") -> list[float]:
        """Guest seconds since boot of the journal's lines that match."""
        said = self.guest.sh(f"journalctl {unit} -b -o short-monotonic --no-pager")
        lines = re.findall(r"^\[ *([\d.]+)\] (.*)$", said, re.MULTILINE)
        return [float(moment) for moment, line in lines if re.search(pattern, line)]

    # ---- trips

    def set_out(self, words: str) -> None:
        """Start a trip by `omnibotctl`, and wait until it drives."""
        self.guest.sh(f"(omnibotctl {words} >/tmp/trip 2>&1; echo $? >/tmp/trip.done) >/dev/null 2>&1 &")
        try:
            self.outside.do(self.outside.until(lambda: self.outside.robot.driven))
        except TimeoutError as error:
            said = self.guest.sh("cat /tmp/trip.done /tmp/trip; omnibotctl status", check=False)
            raise GuestError(f"does not drive for {words!r} from {self.outside.robot.pose}: {said}") from error

    def stopped(self) -> float:
        """Seconds of the world until no wheel is driven."""
        return self.outside.do(self.outside.until(lambda: not self.outside.robot.driven))

    def seen(self) -> float:
        """Seconds of the world until the daemon has a picture."""
        began = self.outside.robot.seconds
        self.until(lambda status: status["camera"]["ok"])
        return self.outside.robot.seconds - began

    def trip(self) -> tuple[int, str]:
        """Exit status and words of the trip."""
        ended = "while [ ! -e /tmp/trip.done ]; do sleep 0.3; done"
        said = self.guest.sh(f"{ended}; cat /tmp/trip.done /tmp/trip; rm /tmp/trip.done")
        status, _, words = said.partition("\n")
        return int(status), words

    def probe(self, program: str) -> dict[str, Any]:
        """What a Python program prints as JSON that runs as the daemon does: its user, its unit, its limits."""
        self.guest.sh(
            "sed -e '/^Type=/d;/^NotifyAccess=/d;/^WatchdogSec=/d;/^Restart/d;/^Runtime/d;/^ExecStopPost=/d' "
            "-e 's#^ExecStart=.*#Type=oneshot\\nExecStart=/usr/bin/python3 /srv/probe.py#' "
            "/lib/systemd/system/omnibotd.service >/run/systemd/system/probe.service"
        )
        self.guest.sh(f"cat >/srv/probe.py <<'END'\n{program}\nEND\nchmod 644 /srv/probe.py; systemctl daemon-reload")
        self.guest.run("systemctl start probe")
        said = self.guest.sh("journalctl -u probe -o cat --no-pager")
        answers = [line for line in said.splitlines() if line.startswith("{")]
        if not answers:
            raise GuestError(said)
        found: dict[str, Any] = json.loads(answers[-1])
        return found
