"""What is kept in EEPROM: the configuration with its checksum, and the number of the boot."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest

from firmware_bridge.messages import ConfigSource, Configure, Fault, Hello, Polarity, to_bytes
from tools.avr.bench import BOOT, Bench
from tools.avr.robot import FULL_SPEED, LEFT, RIGHT

EEPROM_NONCE = 16, 12  # address, bytes
EEPROM_CONFIG = 32

WANTED = {
    "ticks_per_1000_rev": 508_800,
    "acceleration": 6000,
    "full_speed": 2200,
    "max_speed": 2000,
    "kp_16": 12,
    "ki": 8,
    "breakaway": 10,
    "polarity": 0,
    "battery_full_scale": 17_000,
    "battery_low": 6400,
    "capabilities": 0x51,  # bumpers, battery
}


def settings(bench: Bench) -> dict[str, int]:
    found = bench.settings()
    return {name: getattr(found, name) for name in WANTED}


def source(bench: Bench) -> int:
    return bench.settings().source


def restart(bench: Bench) -> None:
    bench.robot.reset()
    bench.robot.run(BOOT)
    bench.greet()


def test_a_new_board_has_defaults_and_no_fault(any_bench: Bench) -> None:
    any_bench.greet()
    assert source(any_bench) == ConfigSource.DEFAULT
    assert any_bench.report().faults == 0


def test_what_was_stored_survives_a_restart(any_bench: Bench) -> None:
    bench = any_bench
    bench.greet()
    assert bench.configure(**WANTED)
    assert settings(bench) == WANTED
    restart(bench)
    assert settings(bench) == WANTED and source(bench) == ConfigSource.STORED
    assert bench.greet().ticks_per_1000_rev == 508_800
    assert bench.greet().capabilities == 0x51


def test_to_configure_twice_is_harmless(bench: Bench) -> None:
    bench.greet()
    assert bench.configure(**WANTED) and bench.configure(**WANTED)
    assert settings(bench) == WANTED


@pytest.mark.parametrize("at", [0, 1, 8, 20, 22, 23, 24])
def test_damage_is_noticed(bench: Bench, at: int) -> None:
    bench.greet()
    defaults = settings(bench)
    bench.configure(**WANTED)
    (byte,) = bench.robot.eeprom(EEPROM_CONFIG + at, 1)
    bench.robot.write_eeprom(EEPROM_CONFIG + at, bytes((byte ^ 0x04,)))
    restart(bench)
    assert source(bench) == ConfigSource.DAMAGED and settings(bench) == defaults
    assert bench.report().faults == Fault.CONFIGURATION
    assert bench.configure(**WANTED)
    assert bench.report().faults & Fault.CONFIGURATION == 0


def test_a_reset_while_it_is_stored_leaves_the_old_the_new_or_defaults(bench: Bench) -> None:
    bench.greet()
    defaults = settings(bench)
    other = WANTED | {"full_speed": 3000, "kp_16": 20, "acceleration": 9000, "battery_low": 5000}
    bench.configure(**WANTED)
    outcomes = set()
    rng = random.Random(6)
    for n in range(30):
        bench.say(Configure(bench.nonce, **(other, WANTED)[n % 2]))
        bench.robot.run(rng.uniform(0.0, 0.03))
        restart(bench)
        outcomes.add(source(bench))
        assert settings(bench) in (WANTED, other, defaults)
        assert (source(bench) == ConfigSource.DAMAGED) == (settings(bench) == defaults)
    assert outcomes == {ConfigSource.STORED, ConfigSource.DAMAGED}


@pytest.mark.parametrize(
    "change",
    [
        {"ticks_per_1000_rev": 0},
        {"acceleration": 0},
        {"acceleration": 1_000_001},
        {"full_speed": 0, "max_speed": 0},
        {"max_speed": 0},
        {"max_speed": 2201},
        {"breakaway": 128},
        {"capabilities": 0x11},
        {"capabilities": 0x53},
    ],
)
def test_what_can_not_be_driven_with_is_refused(bench: Bench, change: dict[str, int]) -> None:
    bench.greet()
    assert not bench.configure(**WANTED | change)
    assert source(bench) == ConfigSource.DEFAULT


def test_no_configuration_while_it_drives_or_for_another_boot(bench: Bench) -> None:
    bench.greet()
    bench.hold(1500, 1500, 0.2)
    assert not bench.configure(**WANTED)
    bench.rest()
    assert not bench.configure(**WANTED, boot_nonce=bench.nonce + 1)
    assert source(bench) == ConfigSource.DEFAULT


def test_no_setpoint_is_applied_while_it_is_stored(bench: Bench) -> None:
    bench.greet()
    messages = (Configure(bench.nonce, **WANTED), bench.setpoint(1500, 1500))
    begin = bench.robot.now
    bench.robot.deliver(b"".join(to_bytes(message, n + 10) for n, message in enumerate(messages)))
    bench.robot.run(0.05)
    assert bench.robot.driven_at < begin


@pytest.mark.parametrize("side", [LEFT, RIGHT])
@pytest.mark.parametrize("turned", ["motor", "encoder"])
def test_polarity_puts_the_wiring_right(bench: Bench, side: int, turned: str) -> None:
    bench.greet()
    assert bench.configure(polarity=Polarity[f"{turned}_{'left' if side == LEFT else 'right'}".upper()])
    bench.robot.motor(side, -FULL_SPEED)
    bench.hold(1000, 1000, 1.5)
    report = bench.report()
    assert report.faults == 0
    assert report.left_ticks > 1000 and report.right_ticks > 1000
    # A wheel whose encoder is turned over is counted forward while the simulator counts it backward.
    assert bench.robot.ticks[side] > 1000 if turned == "motor" else bench.robot.ticks[side] < -1000


def test_contacts_that_work_the_other_way_round(bench: Bench) -> None:
    bench.greet()
    assert bench.configure(polarity=Polarity.BUMPERS_OPEN | Polarity.CHARGER_LOW)
    bench.robot.bump(True, True)
    bench.robot.dock(True)
    bench.report()
    assert bench.report().status == 0
    bench.robot.bump(False, False)
    bench.robot.dock(False)
    bench.report()
    assert bench.report().status == 0b10011


def test_each_boot_has_a_number_of_its_own(bench: Bench) -> None:
    """Power is cut at moments all over the writing of the number, half a microsecond apart."""
    seen = [bench.greet().boot_nonce]
    for cut in range(40):
        bench.robot.reset()
        before = bench.robot.eeprom(*EEPROM_NONCE)
        while bench.robot.eeprom(*EEPROM_NONCE) == before:
            bench.robot.run(0.5e-6)
        bench.robot.run(cut * 0.5e-6)
        restart(bench)
        seen.append(bench.nonce)
    assert all(after > before for before, after in pairwise(seen))
    assert seen[-1] <= 81  # none is used up for nothing


def test_damaged_numbers_begin_anew_and_the_base_still_answers(bench: Bench) -> None:
    bench.robot.write_eeprom(EEPROM_NONCE[0], b"\0" * EEPROM_NONCE[1])
    restart(bench)
    assert bench.nonce == 1
    bench.say(Hello())
    bench.say(bench.setpoint(1000, 1000))
    assert bench.report().setpoint_seq == bench.seq
