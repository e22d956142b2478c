"""Tells systemd how we are (sd_notify): ready, alive, stopping."""

from __future__ import annotations

import os
from collections.abc import Mapping

from sdnotify import SystemdNotifier


class Notifier:
    """Speaks to the service manager, or to nobody where there is none (no NOTIFY_SOCKET)."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._systemd = SystemdNotifier() if environment.get("NOTIFY_SOCKET") else None
        if self._systemd is not None and self._systemd.socket is not None:
            self._systemd.socket.setblocking(False)  # a busy systemd must not stop the robot's event loop
        self._period = _watchdog_period(environment)
        self._fed: float | None = None

    def ready(self) -> None:
        """The start is over: units ordered after this one may start."""
        self._tell("READY=1")

    def status(self, text: str) -> None:
        """One line for `systemctl status`."""
        self._tell("STATUS=" + " ".join(text.split()))

    def watchdog(self, now: float) -> None:
        """Report life, to be called by each control tick that worked; passed on every half watchdog time."""
        if self._period is not None and (self._fed is None or now - self._fed >= self._period):
            self._fed = now
            self._tell("WATCHDOG=1")

    def stopping(self) -> None:
        """The shutdown begins."""
        self._tell("STOPPING=1")

    def close(self) -> None:
        """Let go of the socket; what is told afterwards reaches nobody."""
        if self._systemd is not None and self._systemd.socket is not None:
            self._systemd.socket.close()
        self._systemd = None

    def _tell(self, state: str) -> None:
        """Never fails: what can't be told is lost, and a report of life too many lost ends in a restart."""
        if self._systemd is not None:
            # The package writes Latin-1, systemd reads UTF-8: have it write the bytes of the latter.
            self._systemd.notify(state.encode().decode("latin-1"))


def _watchdog_period(environment: Mapping[str, str]) -> float | None:
    """Seconds between reports: half of what systemd waits, as sd_watchdog_enabled(3) advises; else None.

    WATCHDOG_PID says whom systemd watches: children inherit the variables but are not meant.
    """
    wait, pid = environment.get("WATCHDOG_USEC", ""), environment.get("WATCHDOG_PID", str(os.getpid()))
    if not wait.isdecimal() or int(wait) == 0 or pid != str(os.getpid()):
        return None
    return int(wait) * 1e-6 / 2.0
