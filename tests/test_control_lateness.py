"""The control loop's own account of its punctuality, and the collector's rounds that would spoil it."""

from __future__ import annotations

import asyncio
import gc
import time
from types import SimpleNamespace

import pytest

from omnibotd import daemon
from omnibotd.config import BaseConfig, CameraConfig, Config
from omnibotd.control import LATE, PERIOD, ControlLoop


def counted(monkeypatch: pytest.MonkeyPatch, naps: list[float]) -> ControlLoop:
    """A loop whose ticks take so long, in seconds, one after the other."""
    config = Config(camera=CameraConfig(source="/dev/video0"), base=BaseConfig(driver="omnibot", port="/dev/ttyUSB0"))
    notifier = SimpleNamespace(watchdog=lambda now: None)

    async def main() -> ControlLoop:
        control = ControlLoop(config, None, None, notifier)
        left = iter(naps)
        monkeypatch.setattr(control, "tick", lambda now: time.sleep(next(left, 0.0)))
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(control.run(), PERIOD * (len(naps) + 2.5))
        return control

    return asyncio.run(main())


def test_a_tick_that_begins_half_a_period_late_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    control = counted(monkeypatch, [0.0, PERIOD + 1.5 * LATE, 0.0])
    assert control.late_ticks >= 1
    assert max(control.lateness) > LATE


def test_what_the_start_has_made_is_left_out_of_the_collectors_rounds() -> None:
    before = gc.get_freeze_count()
    try:
        daemon._settle_memory()
        assert gc.get_freeze_count() > max(before, 10_000)
    finally:
        gc.unfreeze()
