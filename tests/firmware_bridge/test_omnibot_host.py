"""The native driver alone, fed by hand."""

from __future__ import annotations

import math
import struct

import pytest

from firmware_bridge import messages
from firmware_bridge.bases import make_driver
from firmware_bridge.bases.omnibot import OmnibotHost
from firmware_bridge.device import OmnibotDevice
from firmware_bridge.events import BridgeError, Disconnected, Telemetry
from firmware_bridge.messages import Hello


def report(nonce: int, left: int, right: int, faults: int = 0) -> bytes:
    """Telemetry by hand, layout as in PROTOCOL.md."""
    payload = struct.pack("<IIiihhBHHBHH", nonce, 0, left, right, 0, 0, 0, faults, 11500, 0, 0, 0)
    return messages.encode(0x83, 0, payload)


def test_encoder_counts_unwrap() -> None:
    host, nonce = OmnibotHost(), 9
    device = OmnibotDevice(1000.0, nonce)
    device.receive(messages.to_bytes(Hello(), 1), 0.0)
    host.receive(device.data_to_send(), 0.0)
    counts = []
    for left, right in ((2**31 - 10, -(2**31) + 5), (-(2**31) + 10, 2**31 - 5), (2**31 - 10, -(2**31) + 5)):
        (event,) = host.receive(report(nonce, left, right), 0.1)
        assert isinstance(event, Telemetry)
        counts.append((event.left_ticks, event.right_ticks))
    assert counts == [(0, 0), (20, -10), (0, 0)]


def test_fault_bits_have_names_even_new_ones() -> None:
    host, device = OmnibotHost(), OmnibotDevice(1000.0, 9)
    device.receive(messages.to_bytes(Hello(), 1), 0.0)
    host.receive(device.data_to_send(), 0.0)
    (event,) = host.receive(report(9, 0, 0, faults=0b1000010010), 0.1)
    assert isinstance(event, Telemetry)
    assert event.faults == {"motor_right", "battery_low", "bit_9"}


def test_other_version_is_refused_with_a_reason() -> None:
    host = OmnibotHost()
    (event,) = host.receive(messages.encode(0x81, 6, b"\x03*"), 0.0)
    assert isinstance(event, Disconnected) and "protocol 3" in event.reason
    host.drive(1.0, 1.0, 0.0)
    assert host.data_to_send() == b""


def test_drivers_by_name() -> None:
    assert isinstance(make_driver("omnibot"), OmnibotHost)
    with pytest.raises(BridgeError, match=r"'segway'; known: .*omnibot"):
        make_driver("segway")


def ahead(nonce: int, millimetres: int) -> bytes:
    return messages.encode(0x84, 0, struct.pack("<IH", nonce, millimetres))


@pytest.mark.parametrize(
    ("data", "age", "metres"),
    [
        (ahead(9, 355), 0.0, 0.355),
        (ahead(9, 65535), 0.0, math.inf),
        (ahead(9, 355), 0.19, 0.355),
        (ahead(9, 355), 0.21, None),
        (ahead(8, 355), 0.0, None),
        (b"", 0.0, None),
    ],
    ids=["near", "nothing within reach", "a little old", "too old", "of another life", "no sensor"],
)
def test_telemetry_carries_the_newest_range(data: bytes, age: float, metres: float | None) -> None:
    host, device = OmnibotHost(), OmnibotDevice(1000.0, 9)
    device.receive(messages.to_bytes(Hello(), 1), 0.0)
    host.receive(device.data_to_send(), 0.0)
    host.receive(data, 1.0)
    (event,) = host.receive(report(9, 0, 0), 1.0 + age)
    assert isinstance(event, Telemetry)
    assert event.range_ahead == metres


def test_a_range_does_not_outlive_the_base_it_came_from() -> None:
    host, device = OmnibotHost(), OmnibotDevice(1000.0, 9)
    device.receive(messages.to_bytes(Hello(), 1), 0.0)
    host.receive(device.data_to_send(), 0.0)
    host.receive(ahead(9, 355), 0.25)
    (event,) = host.poll(0.35)
    assert isinstance(event, Disconnected)
    device.receive(messages.to_bytes(Hello(), 2), 0.36)
    host.receive(device.data_to_send(), 0.36)
    (event,) = host.receive(report(9, 0, 0), 0.4)
    assert isinstance(event, Telemetry)
    assert event.range_ahead is None
