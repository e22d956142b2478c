"""The driver `create2` and an independent emulator of its base: the OI's modes, and lines that fail."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from create2_rig import STEP, Rig

from firmware_bridge.bases.create2 import Create2Host
from firmware_bridge.bases.create2_stream import FRAME, StreamDecoder
from firmware_bridge.events import Connected, Telemetry
from tools.sim.emulators.create2 import BANNER, FULL, OFF, PASSIVE, SAFE

TICKS_PER_METRE = 508.8 / (3.14159265 * 0.072)


def ready(seed: int = 0, **options: bool) -> Rig:
    rig = Rig(seed, **options)
    rig.run(0.3, 0.0, 0.0)
    assert rig.connected and rig.device.mode == SAFE
    return rig


def test_connects_within_two_frames_drives_and_tells_how_far() -> None:
    rig = Rig()
    rig.run(0.06)
    assert rig.connected
    rig.run(0.2, 0.0, 0.0)
    rig.run(4.0, 0.2, 0.25)
    rig.run(1.0, 0.0, 0.0)
    # A first-order motor covers speed times time in the end.
    assert rig.turned == pytest.approx((0.8 * TICKS_PER_METRE, 1.0 * TICKS_PER_METRE), abs=20)
    assert (rig.latest.left_ticks, rig.latest.right_ticks) == rig.turned


def test_a_creep_below_the_base_s_lowest_speed_still_moves_it() -> None:
    rig = ready()
    rig.run(10.0, 0.004, 0.006)
    assert rig.turned == pytest.approx((0.04 * TICKS_PER_METRE, 0.06 * TICKS_PER_METRE), abs=0.005 * TICKS_PER_METRE)


def test_odometry_survives_every_change_of_direction_though_the_encoders_know_none() -> None:
    rig, chance = ready(), random.Random(3)
    for _ in range(40):
        rig.run(chance.uniform(0.3, 1.5), chance.uniform(-0.3, 0.3), chance.uniform(-0.3, 0.3))
    rig.run(1.0, 0.0, 0.0)
    told = (rig.latest.left_ticks, rig.latest.right_ticks)
    # At a reversal a tick or two are counted the wrong way, while a wheel creeps to rest; they have both signs.
    assert told == pytest.approx(rig.turned, abs=40)
    assert abs(rig.device._sensors.encoders[0] - rig.turned[0] % 65536) > 200  # what the base itself counted


def test_encoders_wrap_without_a_trace() -> None:
    rig = ready()
    rig.run(35.0, 0.5, -0.5)
    rig.run(0.5, 0.05, -0.05)
    rig.run(1.0, 0.0, 0.0)
    assert rig.turned[0] > 2**15 and rig.turned[1] < -(2**15)
    # In the frame in which a wheel is told to stand, counts have both signs: 0.05 m/s for 15 ms.
    assert (rig.latest.left_ticks, rig.latest.right_ticks) == pytest.approx(rig.turned, abs=4)
    assert rig.losses == []


# Modes


def test_at_a_cliff_it_stops_stays_and_is_only_let_back() -> None:
    rig = ready()
    rig.run(1.0, 0.2, 0.2)
    rig.senses = {"cliff": True}
    rig.run(STEP)
    assert not rig.moving
    rig.run(1.0, 0.2, 0.2)
    assert not rig.moving and rig.device.mode == SAFE and rig.latest.cliff
    rig.run(0.5, -0.1, 0.1)
    assert not rig.moving
    rig.run(0.3, -0.1, -0.1)
    assert rig.moving and rig.device.mode == SAFE
    assert rig.losses == []


def test_at_a_cliff_it_goes_on_after_a_set_point_of_zero() -> None:
    rig = ready()
    rig.run(1.0, 0.2, 0.2)
    rig.senses = {"cliff": True}
    rig.run(0.2, 0.2, 0.2)
    rig.senses = {}
    rig.run(0.5, 0.2, 0.2)
    assert not rig.moving
    rig.run(0.1, 0.0, 0.0)
    rig.run(0.2, 0.2, 0.2)
    assert rig.moving


def test_a_dropped_wheel_keeps_it_passive_until_it_stands_again() -> None:
    rig = ready()
    rig.run(1.0, 0.2, 0.2)
    rig.senses = {"wheel_drop": True}
    rig.run(0.5, 0.0, 0.0)
    assert rig.device.mode == PASSIVE and rig.latest.wheel_drop and not rig.moving
    rig.run(0.3, -0.2, -0.2)
    assert rig.device.mode == PASSIVE
    rig.senses = {}
    rig.run(0.1, 0.0, 0.0)
    assert rig.device.mode == SAFE
    assert rig.losses == []


@pytest.mark.parametrize("safe_on_dock", [True, False])
def test_on_its_dock_it_charges_stays_awake_and_leaves_when_asked(safe_on_dock: bool) -> None:
    rig = ready(safe_on_dock=safe_on_dock)
    rig.run(1.0, 0.1, 0.1)
    rig.senses = {"charging": True}
    rig.run(0.2, 0.1, 0.1)
    assert rig.latest.charging and not rig.moving
    rig.run(1.5, 0.0, 0.0)
    assert rig.device.mode == PASSIVE and rig.device._sensors.charging == 2
    rig.wait(620.0)
    assert rig.connected and rig.device.mode == PASSIVE
    before = rig.turned[0]
    rig.run(2.5, -0.1, -0.1)
    assert rig.device.mode == (SAFE if safe_on_dock else FULL)
    assert rig.turned[0] < before - 0.1 * TICKS_PER_METRE
    rig.senses = {}
    rig.run(0.3, -0.1, -0.1)
    assert rig.device.mode == SAFE
    assert rig.losses == []


def test_off_the_dock_it_never_sleeps() -> None:
    rig = ready()
    rig.wait(400.0)
    assert rig.connected and rig.device.mode == SAFE


def test_a_base_that_cleans_by_itself_was_taken_over_and_is_taken_back() -> None:
    rig = ready()
    rig.run(1.0, 0.2, 0.2)
    rig.device.press_clean()
    rig.run(0.3, 0.2, 0.2)
    assert len(rig.losses) == 1 and "button" in rig.losses[0]
    assert rig.connected and rig.device.mode == SAFE
    assert not rig.moving
    rig.run(0.1, 0.0, 0.0)
    rig.run(0.2, 0.2, 0.2)
    assert rig.moving


def test_a_sleeping_base_is_silent_until_woken() -> None:
    rig = Rig()
    rig.device.asleep = True
    rig.run(3.0, 0.2, 0.2)
    assert not rig.connected and rig.losses == []
    rig.device.wake()
    rig.run(0.6)
    assert rig.connected


# Lines that fail


def hostile(fault: Callable[[Rig], None], seed: int) -> Rig:
    rig = ready(seed)
    fault(rig)
    return rig


FAULTS: dict[str, Callable[[Rig], None]] = {
    "byte by byte": lambda rig: [setattr(line, "split", True) for line in (rig.to_device, rig.to_host)],
    "a fifth lost": lambda rig: [setattr(line, "loss", 0.2) for line in (rig.to_device, rig.to_host)],
    "late": lambda rig: [setattr(line, "delay", 0.08) for line in (rig.to_device, rig.to_host)],
    "garbage": lambda rig: [setattr(line, "garbage", 0.2) for line in (rig.to_host,)],
    "flips": lambda rig: [setattr(line, "flips", 0.005) for line in (rig.to_host,)],
}


@pytest.mark.parametrize("fault", FAULTS)
def test_goes_on_over_a_line_that_fails_and_its_counts_stay_true(fault: str) -> None:
    rig = hostile(FAULTS[fault], seed=11)
    for speed in (0.2, -0.2, 0.1):
        rig.run(2.0, speed, 0.5 * speed)
    rig.run(2.0, 0.0, 0.0)
    assert rig.connected and rig.losses == []
    assert not rig.moving
    assert rig.latest.left_ticks == pytest.approx(rig.turned[0], abs=25)
    assert rig.latest.right_ticks == pytest.approx(rig.turned[1], abs=25)


def test_a_set_point_that_lost_any_byte_is_mended_by_the_next() -> None:
    for lost in range(9):
        rig = ready()
        rig.run(0.5, 0.2, 0.2)
        rig.host.drive(0.0, 0.0, rig.now)
        whole = rig.host.data_to_send()
        assert len(whole) == 9
        rig.device.receive(whole[:lost] + whole[lost + 1 :], rig.now)
        rig.run(0.25, 0.0, 0.0)
        assert not rig.moving and rig.device.mode == SAFE, lost


def test_what_another_host_left_half_said_moves_nothing() -> None:
    halves = [b"\x91\x01", b"\x89\x00\xc8\x00", b"\x94\x20", b"\x8c\x00\x10", b"\x8b", b"\x95\x30"]
    for half in halves:
        rig = Rig()
        rig.device.receive(b"\x80\x83" + half, rig.now)
        for _ in range(100):
            rig.step()
            assert not rig.moving, half
        assert rig.connected, half


def test_last_words_stop_it_whatever_was_half_said() -> None:
    words = Create2Host.last_words
    assert words is not None
    for half in (b"", b"\x91", b"\x91\x00\xc8\x00", b"\x94\x10", b"\x8c\x00\x10\x40"):
        for said, mode in ((words.stand, SAFE), (words.leave, PASSIVE)):
            rig = ready()
            rig.run(0.5, 0.2, 0.2)
            rig.device.receive(half, rig.now)
            rig.device.receive(said, rig.now)
            assert not rig.moving and rig.device.mode == mode, half


def test_flips_on_the_way_to_the_base_never_outlive_the_next_set_points() -> None:
    rig = ready(seed=23)
    rig.to_device.flips = 0.01
    rig.run(60.0, 0.1, 0.1)
    rig.to_device.flips = 0.0
    rig.run(2.5, 0.0, 0.0)  # a reset takes a second
    assert rig.connected and not rig.moving and rig.device.mode == SAFE


@pytest.mark.parametrize("moment", range(0, FRAME, 5))
def test_a_reboot_in_the_middle_of_a_frame_ends_the_connection_and_the_next_counts_from_zero(moment: int) -> None:
    rig = ready()
    rig.run(1.0, 0.2, 0.2)
    whole = b""
    while not whole:
        rig.now += STEP
        rig.device.poll(rig.now)
        whole = rig.device.data_to_send()
    rig.events += rig.host.receive(whole[:moment], rig.now)
    rig.device.reset()
    rig.run(0.3, 0.2, 0.2)
    assert len(rig.losses) == 1 and not rig.connected
    assert not rig.moving and rig.device.mode == OFF
    told = len(rig.events)
    rig.run(1.5, 0.2, 0.2)
    connection, first = rig.events[told : told + 2]
    assert isinstance(connection, Connected) and connection.info.boot_nonce == 2
    assert isinstance(first, Telemetry) and (first.left_ticks, first.right_ticks) == (0, 0)
    assert not rig.moving  # the trip of before is not resumed by itself


def test_the_banner_is_boot_text() -> None:
    assert len(StreamDecoder().feed(BANNER)) >= 1
