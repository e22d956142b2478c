"""What is on the line can be reckoned from the protocols; the drivers' time only has to be told."""

from __future__ import annotations

import pytest

from tools.line_cost import measure


def test_bytes_on_a_roomba_s_line_are_those_of_its_frames_and_set_points() -> None:
    cost = measure("create2", 3.0)
    # 14 packets of 1 or 2 bytes with ids, head and sum: 36 bytes every 15 ms; 4 zeros and 5 bytes ten times a second.
    packets = 14 + 9 * 1 + 5 * 2
    assert cost.telemetry == pytest.approx(1.0 / 0.015, rel=0.02)
    assert cost.bytes_from_base == pytest.approx((packets + 3) / 0.015, rel=0.02)
    assert cost.bytes_to_base == pytest.approx(90.0, rel=0.05)
    assert cost.share_from_base == pytest.approx(cost.bytes_from_base / 11520.0)
    assert 0.0 < cost.driver_ms < 1000.0
