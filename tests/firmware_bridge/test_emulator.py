"""The emulator's own parts; the pty is tested where a real host opens it (tests/io/test_motor_base.py)."""

from __future__ import annotations

import math
import os
import tty

import pytest

from firmware_bridge.device import OmnibotDevice
from firmware_bridge.emulator import Emulator, IdealWheels


def test_wheels_lag_by_their_time_constant_however_the_time_is_cut() -> None:
    """After t at a step of v: v (t - tau (1 - exp(-t / tau))) ticks."""
    expected = 1000.0 * (0.3 - 0.1 * (1.0 - math.exp(-3.0)))
    for steps in (1, 7, 300):
        wheels = IdealWheels(lag=0.1)
        for _ in range(steps):
            left, right = wheels.step(0.3 / steps, 1000.0, -1000.0)
        assert left == math.floor(expected)
        assert right == math.floor(-expected)


def test_port_is_a_terminal_that_passes_every_byte() -> None:
    emulator = Emulator(OmnibotDevice(1000.0, 1))
    port = os.open(emulator.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    emulator._write(bytes(range(256)))
    assert os.read(port, 1000) == bytes(range(256))
    os.close(port)
    emulator.close()
    emulator.close()
    with pytest.raises(OSError):
        tty.setraw(os.open(emulator.port, os.O_RDWR | os.O_NOCTTY))


def test_nobody_reading_the_port_blocks_nothing() -> None:
    emulator = Emulator(OmnibotDevice(1000.0, 1))
    for _ in range(1000):
        emulator._write(bytes(1000))
    emulator.close()
