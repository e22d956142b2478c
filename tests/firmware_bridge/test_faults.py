"""A line must fail as it was told to, and the same way each time."""

from __future__ import annotations

from firmware_bridge.faults import MAX_CHUNKS, HostileLine

MESSAGES = [bytes([n]) * 10 for n in range(200)]


def through(line: HostileLine) -> list[bytes]:
    for data in MESSAGES:
        line.push(data, 0.0)
    return line.pull(0.0)


def test_a_good_line() -> None:
    assert through(HostileLine(1)) == MESSAGES


def test_loses_the_share_asked_for_and_the_same_ones_each_time() -> None:
    survivors = []
    for _ in range(2):
        line = HostileLine(3)
        line.loss = 0.2
        survivors.append(through(line))
    assert survivors[0] == survivors[1]
    assert 140 <= len(survivors[0]) <= 180  # 160 +- 3.5 sigma
    assert set(survivors[0]) <= set(MESSAGES)


def test_delay_keeps_the_order_even_when_it_shrinks() -> None:
    line = HostileLine(1)
    line.delay = 0.5
    line.push(b"first", 0.0)
    line.delay = 0.0
    line.push(b"second", 0.1)
    assert line.pull(0.49) == []
    assert line.pull(0.5) == [b"first", b"second"]


def test_flips_turn_single_bits() -> None:
    line = HostileLine(2)
    line.flips = 0.1
    sent, got = b"".join(MESSAGES), b"".join(through(line))
    wrong = [(a ^ b).bit_count() for a, b in zip(sent, got, strict=True) if a != b]
    assert set(wrong) == {1}
    assert 150 <= len(wrong) <= 250  # 200 +- 3.7 sigma


def test_garbage_adds_and_split_cuts() -> None:
    line = HostileLine(4)
    line.garbage = 1.0
    line.push(b"x", 0.0)
    assert len(line.pull(0.0)[0]) > 1
    line.garbage = 0.0
    line.split = True
    line.push(b"abc", 0.0)
    assert line.pull(0.0) == [b"a", b"b", b"c"]


def test_what_is_on_its_way_is_bounded_and_can_be_lost() -> None:
    line = HostileLine(5)
    for n in range(MAX_CHUNKS + 10):
        line.push(n.to_bytes(2, "big"), 0.0)
    arrived = line.pull(0.0)
    assert (len(arrived), arrived[0]) == (MAX_CHUNKS, (10).to_bytes(2, "big"))
    line.push(b"x", 0.0)
    line.clear()
    assert line.pull(1.0) == []
