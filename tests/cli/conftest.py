"""omnibotctl in this process, and a daemon that answers as scripted."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from scripted_daemon import Daemon


@pytest.fixture
def daemon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Daemon]:
    daemon = Daemon(tmp_path / "control.sock")
    daemon.start()
    monkeypatch.setenv("OMNIBOT_SOCKET", str(daemon.path))
    monkeypatch.chdir(tmp_path)
    yield daemon
    daemon.close()


@pytest.fixture(autouse=True)
def untouched_signals() -> Iterator[None]:
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)
