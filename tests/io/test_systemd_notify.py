import contextlib
import os
import socket

import pytest

from omnibotd.io.systemd_notify import Notifier


@pytest.fixture
def manager(tmp_path, monkeypatch):
    """A datagram socket in the place of systemd's; gives what was told so far."""
    path = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as server:
        server.bind(path)
        server.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", path)

        def told() -> list[str]:
            messages = []
            with contextlib.suppress(BlockingIOError):
                while True:
                    messages.append(server.recv(4096).decode("utf-8"))
            return messages

        yield told


@pytest.fixture
def notifier(manager, monkeypatch):
    monkeypatch.setenv("WATCHDOG_USEC", "2000000")
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))
    with contextlib.closing(Notifier()) as notifier:
        yield notifier


def test_systemd_is_told_of_the_start_the_state_and_the_end(manager, notifier):
    notifier.ready()
    notifier.status("driving to Küche\n at  0.3 m/s — READY=1")
    notifier.stopping()
    assert manager() == ["READY=1", "STATUS=driving to Küche at 0.3 m/s — READY=1", "STOPPING=1"]


def test_the_watchdog_is_fed_at_once_and_then_every_half_of_its_time(manager, notifier):
    times = [100.0 + 0.05 * tick for tick in range(61)]  # three seconds of control ticks
    fed = []
    for now in times:
        notifier.watchdog(now)
        fed += [(message, round(now - 100.0, 2)) for message in manager()]
    assert fed == [("WATCHDOG=1", moment) for moment in (0.0, 1.0, 2.0, 3.0)]


@pytest.mark.parametrize(("usec", "pid"), [(None, None), ("0", None), ("soon", None), ("-5", None), ("2000000", "1")])
def test_no_watchdog_is_fed_that_nobody_watches(manager, monkeypatch, usec, pid):
    for name, value in (("WATCHDOG_USEC", usec), ("WATCHDOG_PID", pid)):
        monkeypatch.setenv(name, value) if value else monkeypatch.delenv(name, raising=False)
    with contextlib.closing(Notifier()) as notifier:
        notifier.watchdog(1.0)
        notifier.ready()
    assert manager() == ["READY=1"]


def test_without_systemd_nothing_happens(monkeypatch):
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    notifier = Notifier()
    notifier.ready()
    notifier.watchdog(0.0)
    notifier.close()


def test_a_systemd_that_does_not_read_never_blocks(manager, notifier):
    for _ in range(10_000):  # far more than a datagram socket queues
        notifier.status("busy")
    assert 0 < len(manager()) < 10_000


def test_after_the_end_nothing_is_told(manager, notifier):
    notifier.close()
    notifier.ready()
    assert manager() == []
