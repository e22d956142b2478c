"""Acceptance on the real frames, where the data is present."""

from __future__ import annotations

import numpy as np
import pytest

from tools import real_frames

pytestmark = pytest.mark.skipif(
    not (real_frames.DATA / "data.raw.gz").exists(),
    reason=f"{real_frames.DATA} absent: real frames aren't part of the project",
)


def test_headings_and_places_follow_the_reference() -> None:
    report = real_frames.run(real_frames.DATA)
    assert np.median(np.abs(report.view_error)) < 3.0
    assert np.median(np.abs(report.registration_error)) < 1.0
    assert report.tracked.within.mean() >= 0.8
    assert report.found.within.mean() >= 0.9
    assert report.accepted
    assert real_frames.draw(report).std() > 0
