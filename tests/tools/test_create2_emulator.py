"""The emulated Create 2 against the Open Interface's specification and bytes that others recorded from real ones."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tools.sim.emulators.create2 import BOOT_TIME, FULL, OFF, PASSIVE, SAFE, SLEEP_AFTER, Create2Device
from tools.sim.emulators.create2_sensors import GROUPS, SIZES

VECTORS = Path(__file__).resolve().parents[3] / "shared/data/serial_vectors/oi_vectors.txt"
START, TO_SAFE, TO_FULL = bytes((128,)), bytes((131,)), bytes((132,))
TICKS_PER_METRE = 508.8 / (math.pi * 0.072)


def vector(name: str) -> bytes:
    if not VECTORS.exists():
        pytest.skip(f"{VECTORS} is not there")
    (line,) = (line for line in VECTORS.read_text().splitlines() if line.split()[:1] == [name])
    return bytes(map(int, line.split()[1:]))


def base(*said: bytes) -> Create2Device:
    device = Create2Device()
    for data in said:
        device.receive(data, 0.0)
    device.data_to_send()
    return device


def speeds(device: Create2Device) -> tuple[float, float]:
    """mm/s, as the wheels really turn."""
    left, right = device.target
    return left / TICKS_PER_METRE * 1000.0, right / TICKS_PER_METRE * 1000.0


def test_sizes_of_the_groups_are_those_of_the_specification() -> None:
    told = {0: 26, 1: 10, 2: 6, 3: 10, 4: 14, 5: 12, 6: 52, 100: 80, 101: 28, 106: 12, 107: 9}
    assert {number: SIZES[number] for number in GROUPS} == told


def test_the_packets_lie_where_a_real_base_put_them() -> None:
    """A recorded group 100 with 14 stale bytes before it."""
    data, at, found = vector("group100")[14:], 0, {}
    for number in GROUPS[100]:
        found[number] = int.from_bytes(data[at : at + SIZES[number]], "big", signed=number in (23, 24, 43, 44))
        at += SIZES[number]
        if at >= len(data) - 2:
            break
    assert (found[22], found[23], found[24], found[25], found[26]) == (15608, -111, 20, 1902, 2068)
    assert [found[number] for number in (28, 29, 30, 31)] == [2372, 2432, 2396, 2076]
    assert (found[35], found[43], found[44]) == (PASSIVE, 3, 3)


def test_a_stream_has_the_form_and_the_sum_of_the_published_example() -> None:
    example = vector("stream_ok")
    device = base(START, vector("stream_req"))
    device.poll(0.0)
    device.poll(0.016)
    frame = device.data_to_send()[-len(example) :]
    assert [frame[k] for k in (0, 1, 2, 5)] == [example[k] for k in (0, 1, 2, 5)]
    assert sum(frame) % 256 == sum(example) % 256 == 0
    assert sum(vector("stream_badsum")) % 256 != 0


def test_the_stream_comes_every_15_ms_pauses_and_goes_on() -> None:
    device = base(START, bytes((148, 1, 35)))

    def frames(begin: float) -> int:
        for k in range(301):
            device.poll(begin + k * 0.005)
        return device.data_to_send().count(bytes((19, 2, 35)))

    assert frames(0.0) == pytest.approx(100, abs=1)
    device.receive(vector("pause_stream"), 2.0)
    assert frames(2.0) == 0
    device.receive(bytes((150, 1)), 4.0)
    assert frames(4.0) == pytest.approx(100, abs=1)


@pytest.mark.parametrize("ids", [(35, 200), (100, 100, 100)], ids=["unknown", "more than fits"])
def test_a_stream_that_can_not_be_is_none(ids: tuple[int, ...]) -> None:
    device = base(START, bytes((148, len(ids), *ids)))
    device.poll(0.0)
    device.poll(0.1)
    assert device.data_to_send() == b""


def test_lists_and_packets_are_answered_bare() -> None:
    device = base(START, TO_SAFE)
    device.set_state(0, 0, bumper_left=True, battery_mv=15000)
    device.receive(vector("query_list"), 0.0)
    assert device.data_to_send() == bytes((2, 0))
    device.receive(bytes((142, 3)), 0.0)
    assert device.data_to_send()[1:3] == (15000).to_bytes(2, "big")


def test_distance_and_angle_are_cleared_by_reading() -> None:
    device = base(START, TO_FULL)
    device.set_state(0, 0)
    device.set_state(round(TICKS_PER_METRE), round(1.1 * TICKS_PER_METRE))
    device.receive(bytes((149, 2, 19, 20)), 0.0)
    told = device.data_to_send()
    assert int.from_bytes(told[:2], "big") == pytest.approx(1050, abs=1)
    assert int.from_bytes(told[2:], "big") == pytest.approx(math.degrees(0.1 / 0.235), abs=1)
    device.receive(bytes((149, 2, 19, 20)), 0.0)
    assert device.data_to_send() == bytes(4)


@pytest.mark.parametrize(
    ("said", "left", "right"),
    [
        (bytes((145, 0, 200, 0xFF, 0x38)), -200, 200),  # right first
        (bytes((137, 0, 200, 0x80, 0)), 200, 200),
        (bytes((137, 0, 200, 0x7F, 0xFF)), 200, 200),
        (bytes((137, 0, 200, 0, 1)), -200, 200),  # counter-clockwise
        (bytes((137, 0, 200, 0xFF, 0xFF)), 200, -200),
        (bytes((137, 0, 200, 0, 235)), 100, 300),  # a left bend
        (bytes((146, 0, 255, 0, 0)), 0, 500),
        (bytes((145, 3, 0xE8, 3, 0xE8)), 500, 500),  # 1 m/s asked
    ],
)
def test_wheels_turn_as_told_within_their_steps(said: bytes, left: int, right: int) -> None:
    assert speeds(base(START, TO_SAFE, said)) == pytest.approx((left, right), abs=14.3)


def test_the_recorded_drive_is_an_arc_to_the_left_backwards() -> None:
    left, right = speeds(base(START, TO_SAFE, vector("drive")))
    assert left > right and (left + right) / 2.0 == pytest.approx(-200, abs=15)


def test_speeds_come_in_steps_of_28_5_mm_a_second() -> None:
    device = base(START, TO_SAFE)
    seen = set()
    for speed in range(0, 100):
        device.receive(bytes((145, 0, speed, 0, speed)), 0.0)
        seen.add(round(speeds(device)[0], 1))
    assert seen == {0.0, 28.5, 57.0, 85.5}


def test_commands_are_heard_in_their_modes_only() -> None:
    drive = bytes((145, 0, 100, 0, 100))
    for said, mode, moves in (
        ((), OFF, False),
        ((START,), PASSIVE, False),
        ((START, TO_SAFE), SAFE, True),
        ((START, TO_FULL), FULL, True),
        ((TO_SAFE,), OFF, False),
        ((START, TO_SAFE, bytes((173,))), OFF, False),
        ((START, TO_SAFE, bytes((143,))), PASSIVE, True),  # seeks its dock by itself
    ):
        device = base(*said, drive)
        assert (device.mode, device.target != (0.0, 0.0)) == (mode, moves), said


def test_a_set_point_holds_for_ever() -> None:
    device = base(START, TO_SAFE, bytes((145, 0, 100, 0, 100)))
    for k in range(1000):
        device.poll(k * 1.0)
    assert device.mode == SAFE and device.target != (0.0, 0.0)


def test_a_command_that_lacks_a_byte_takes_the_next_one_s() -> None:
    device = base(START, TO_SAFE, bytes((145, 0, 100, 0)), bytes((145, 0, 0, 0, 0)))
    left, right = speeds(device)
    assert right == pytest.approx(100, abs=15) and left == pytest.approx(145, abs=15)


def test_safe_mode_ends_at_a_cliff_ahead_a_dropped_wheel_and_a_charger_but_full_mode_does_not() -> None:
    for senses in ({"cliff": True}, {"wheel_drop": True}, {"charging": True}):
        for enter, left_to_itself in ((TO_SAFE, True), (TO_FULL, False)):
            device = base(START, enter, bytes((145, 0, 100, 0, 100)))
            device.set_state(0, 0, **senses)
            assert (device.mode == PASSIVE) is left_to_itself
            assert (device.target == (0.0, 0.0)) is left_to_itself


def test_it_may_leave_a_cliff_backwards() -> None:
    device = base(START, TO_SAFE)
    device.set_state(0, 0, cliff=True)
    assert device.mode == SAFE
    device.receive(bytes((145, 0xFF, 0x9C, 0xFF, 0x9C)), 0.0)
    assert device.mode == SAFE and device.target[0] < 0.0


def test_it_charges_only_when_left_to_itself() -> None:
    device = base(START, TO_FULL)
    device.set_state(0, 0, charging=True)
    device.receive(bytes((149, 2, 21, 34)), 0.0)
    device.receive(START, 0.0)
    device.receive(bytes((149, 2, 21, 34)), 0.0)
    assert device.data_to_send() == bytes((0, 2, 2, 2))


def test_encoders_count_in_the_direction_of_the_command_and_up_without_one() -> None:
    device = base(START, TO_FULL)
    device.set_state(0, 0)
    counts = []
    for said, turned in ((100, 10), (-100, 0), (-100, -10), (0, -20), (0, -5)):
        speed = said.to_bytes(2, "big", signed=True)
        device.receive(bytes((145,)) + speed + speed, 0.0)
        device.set_state(turned, turned)
        device.receive(bytes((142, 43)), 0.0)
        counts.append(int.from_bytes(device.data_to_send(), "big", signed=True))
    assert counts == [10, 0, -10, 0, 15]


def test_it_sleeps_after_five_minutes_left_to_itself_and_is_deaf_until_woken() -> None:
    device = base(START)
    for k in range(int(SLEEP_AFTER) + 3):
        device.poll(float(k))
    device.receive(START, 400.0)
    assert device.asleep and device.mode == OFF
    device.wake()
    device.receive(START, 400.0)
    assert device.mode == PASSIVE


def test_a_reset_forgets_all_prints_its_banner_and_boots_for_a_second() -> None:
    device = base(START, TO_SAFE, bytes((148, 1, 35)), bytes((145, 0, 100, 0, 100)))
    device.set_state(500, 500)
    device.receive(bytes((7,)), 1.0)
    assert (device.mode, device.target) == (OFF, (0.0, 0.0))
    device.poll(1.0)
    assert len(device.data_to_send()) > 100
    device.receive(START, 1.5)
    assert device.mode == OFF
    device.receive(START, 1.0 + BOOT_TIME)
    assert device.mode == PASSIVE
    device.receive(bytes((142, 43)), 3.0)
    assert device.data_to_send() == bytes(2)


def test_another_baud_rate_makes_the_line_useless() -> None:
    device = base(START, bytes((129, 7)), TO_SAFE)
    assert device.mode == PASSIVE
