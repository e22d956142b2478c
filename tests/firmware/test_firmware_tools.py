"""What is round the firmware: the build, the configuration tool, the pty, the plot."""

from __future__ import annotations

import argparse
import asyncio
import time
from pathlib import Path

import pytest

from firmware_bridge.bases.omnibot import OmnibotHost
from firmware_bridge.emulator import Emulator, IdealWheels
from firmware_bridge.events import Connected, Telemetry
from tools import firmware_config, firmware_plot
from tools.avr import building
from tools.avr.bench import Bench
from tools.avr.boards import UNO
from tools.avr.device import AvrDevice


class LockstepLine:
    """The serial line that tools/firmware-config speaks to: each read lets 5 ms pass."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench

    def write(self, data: bytes) -> None:
        self.bench.robot.deliver(data)

    def read(self) -> bytes:
        self.bench.robot.run(0.005)
        return self.bench.robot.receive()

    def clock(self) -> float:
        return self.bench.robot.now


def connect(bench: Bench) -> firmware_config.Board:
    line = LockstepLine(bench)
    return firmware_config.Board(line, line.clock)


def test_the_tool_shows_and_changes_the_configuration(bench: Bench) -> None:
    board = connect(bench)
    shown = firmware_config.show(board).splitlines()
    assert "nothing was ever stored" in shown[0] and "full_speed=4000" in shown
    board.configure({"full_speed": 2300, "max_speed": 2000})
    shown = firmware_config.show(connect(bench)).splitlines()
    assert "stored on the board" in shown[0] and {"full_speed=2300", "max_speed=2000", "kp_16=24"} <= set(shown)


def test_the_tool_says_that_the_board_refused(bench: Bench) -> None:
    with pytest.raises(firmware_config.Failed, match="out of its range"):
        connect(bench).configure({"max_speed": 5000})


class DeadLine:
    """Nobody is there; each read takes 20 ms."""

    def __init__(self) -> None:
        self.now = 0.0

    def write(self, data: bytes) -> None:
        pass

    def read(self) -> bytes:
        self.now += 0.02
        return b""


def test_the_tool_says_that_nobody_answers() -> None:
    line = DeadLine()
    with pytest.raises(firmware_config.Failed, match="is it the right port"):
        firmware_config.Board(line, lambda: line.now)
    assert 2.5 < line.now < 4.0  # longer than a bootloader takes


@pytest.mark.parametrize(("text", "says"), [("speed=1", "no setting"), ("full_speed=fast", "whole number")])
def test_the_tool_explains_what_it_can_not_read(text: str, says: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match=says):
        firmware_config.change(text)


def test_a_compiler_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    assert {"make", "gcc-avr", "gcc"} <= set(building.missing())


def test_what_the_compiler_says_is_told(tmp_path: Path) -> None:
    (tmp_path / "Makefile").write_text("$(BUILD)/uno.hex:\n\t@echo no such thing >&2; false\n")
    with pytest.raises(building.BuildError, match="no such thing"):
        building.firmware("uno", tmp_path)


def test_reads_intel_hex() -> None:
    text = ":02000000AABB99\n:020006001122C5\n:020000020010EC\n:0100000055AA\n:00000001FF\n"
    flash = building.image(text)
    assert flash[:8] == bytes.fromhex("aabb ffff ffff 1122") and flash[0x100] == 0x55 and len(flash) == 0x101
    with pytest.raises(ValueError, match="line 1"):
        building.image(":02000000AABB98\n")


def test_drives_through_a_pty_in_real_time() -> None:
    """The driver of the daemon, a pty, the firmware: only that they understand each other; times are lockstep's."""
    device = AvrDevice(UNO)
    emulator = Emulator(device, IdealWheels(0.08))
    try:
        connected, last = asyncio.run(drive_through_pty(emulator))
    finally:
        device.close()
    assert connected.info.board == "atmega328p"
    assert last.left_ticks > 100 and last.right_ticks < -100
    assert last.faults == frozenset()


async def drive_through_pty(emulator: Emulator) -> tuple[Connected, Telemetry]:
    """Drives until both wheels have turned, or for 10 s."""
    host = OmnibotHost()
    connected: Connected | None = None
    last: Telemetry | None = None
    task = asyncio.create_task(emulator.run())
    with open(emulator.port, "r+b", buffering=0) as port:  # noqa: ASYNC230 - a pty
        asyncio.get_running_loop().add_reader(port, lambda: arrived.append(port.read(4096)))
        arrived: list[bytes] = []
        until = time.monotonic() + 10.0
        while time.monotonic() < until and (last is None or abs(last.right_ticks) <= 100):
            await asyncio.sleep(0.01)
            now = time.monotonic()
            events = host.poll(now)
            while arrived:
                events += host.receive(arrived.pop(0), now)
            connected = next((event for event in events if isinstance(event, Connected)), connected)
            last = next((event for event in reversed(events) if isinstance(event, Telemetry)), last)
            host.drive(5.0, -5.0, now)
            port.write(host.data_to_send())
        asyncio.get_running_loop().remove_reader(port)
    task.cancel()
    assert connected is not None and last is not None
    return connected, last


def test_the_device_follows_ticks_exactly() -> None:
    device = AvrDevice(UNO)
    host = OmnibotHost()
    happened = []
    try:
        for step in range(1, 401):
            now = 1000.0 + step * 0.005
            happened += host.poll(now)
            device.receive(host.data_to_send(), now)
            rolled = min(max(step - 60, 0), 300)  # hands are shaken by then
            device.set_state(rolled * 7, -rolled * 3, charging=step > 200, battery_mv=11_500)
            device.poll(now)
            happened += host.receive(device.data_to_send(), now)
    finally:
        device.close()
    last = happened[-1]
    assert isinstance(last, Telemetry)
    assert (last.left_ticks, last.right_ticks) == (2100, -900)
    assert last.charging and last.battery == pytest.approx(11.5, abs=0.05)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_plot_is_drawn(tmp_path: Path) -> None:
    results = firmware_plot.measure(UNO)
    assert results.missed[: firmware_plot.RATES.index(20_000) + 1] == [0, 0, 0]
    assert results.worst_odometry == 0
    assert all(abs(error) < 0.5 for rows in results.steady.values() for error, _ in rows)
    assert "off by at most 0 ticks" in firmware_plot.table(results)
    firmware_plot.draw(results, UNO, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 10_000
