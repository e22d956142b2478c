"""The native protocol, host and device joined: the emergency stop."""

from __future__ import annotations

import pytest
from omnibot_pair import TURN, connected_pair, kinds_sent

from firmware_bridge import messages
from firmware_bridge.bases.omnibot import OmnibotHost
from firmware_bridge.device import OmnibotDevice
from firmware_bridge.events import Disconnected
from firmware_bridge.messages import Hello, SetPoint, Stop


def test_emergency_stop_latches_until_release() -> None:
    pair = connected_pair()
    pair.run(0.5, drive=(TURN, TURN))
    pair.host.emergency_stop(pair.now)
    pair.step()
    assert pair.device.target == (0, 0)
    pair.run(1.0, drive=(TURN, TURN))
    assert pair.device.target == (0, 0) and pair.device.emergency_stopped
    assert pair.latest().emergency_stop
    pair.host.release(pair.now)
    pair.run(0.1)
    assert not pair.device.emergency_stopped
    assert pair.device.target == (0, 0)
    pair.run(0.1, drive=(TURN, TURN))
    assert pair.device.target == (1000, 1000)
    assert not pair.latest().emergency_stop


def test_latched_base_refuses_the_set_points_of_any_host() -> None:
    device = OmnibotDevice(1000.0, 9)
    for message in (Hello(), Stop(), Hello(), SetPoint(9, 5, 5, 0)):
        device.receive(messages.to_bytes(message, 1), 0.0)
    assert device.target == (0, 0)


@pytest.mark.parametrize("seed", range(5))
def test_emergency_stop_gets_through_a_bad_line(seed: int) -> None:
    pair = connected_pair(seed=seed)
    pair.down.loss = pair.up.loss = 0.5
    pair.host.emergency_stop(pair.now)
    pair.run(0.6)
    assert pair.device.emergency_stopped
    pair.host.release(pair.now)
    pair.run(0.6)
    assert not pair.device.emergency_stopped


def test_emergency_stop_before_hands_are_shaken() -> None:
    host = OmnibotHost()
    host.emergency_stop(0.0)
    assert kinds_sent(host.data_to_send()) == [Stop]


def test_no_set_point_is_sent_while_a_stop_is_wanted() -> None:
    pair = connected_pair()
    pair.host.emergency_stop(pair.now)
    pair.host.drive(TURN, TURN, pair.now)
    assert kinds_sent(pair.host.data_to_send()) == [Stop]


def test_emergency_stop_outlives_a_restart() -> None:
    pair = connected_pair()
    pair.host.emergency_stop(pair.now)
    pair.run(0.1)
    pair.device.reset(0xA0000002)
    assert not pair.device.emergency_stopped
    pair.run(1.0, drive=(TURN, TURN))
    assert pair.device.emergency_stopped
    assert pair.targets <= {(0, 0)}


def test_retries_are_bounded_and_acknowledgement_ends_them() -> None:
    pair = connected_pair()
    pair.host.emergency_stop(pair.now)
    pair.run(2.0)
    assert pair.happened() == []
    pair.down.loss = 1.0
    pair.host.release(pair.now)
    pair.run(0.9)
    assert pair.happened() == []
    pair.run(0.4)  # the clock of this test stretches 50 ms to up to 60
    assert pair.happened()[0] == Disconnected("no acknowledgement of RELEASE")


def test_stop_cancels_a_release_under_way() -> None:
    pair = connected_pair()
    pair.host.emergency_stop(pair.now)
    pair.run(0.1)
    pair.down.loss = 1.0
    pair.host.release(pair.now)
    pair.run(0.1)
    pair.host.emergency_stop(pair.now)
    pair.down.loss = 0.0
    pair.run(0.3)
    assert pair.device.emergency_stopped
