"""Linking a drive to itself, where places look like others."""

from __future__ import annotations

import numpy as np

from omnibotd.core.mapping.drive import read_drive
from omnibotd.core.mapping.links import PathLinker
from omnibotd.core.vision.descriptor import Descriptor, harmonics
from tests.teaching import CAMERA, waypoint_drive
from tools.sim import ceilings


def test_no_quarter_turn_is_seen_half_way_between_square_lamps() -> None:
    """There a view is as like the one before turned by 90 degrees; a map of a hall was folded at such a place."""
    taught = waypoint_drive(ceilings.hall(8), seconds=90.0, half=1.7, seed=3)
    drive = read_drive(taught.samples, CAMERA, 0, lambda share: None)
    true_yaw = {sample.odom_from_base: pose.yaw for sample, pose in zip(taught.samples, taught.truth, strict=True)}
    yaw = np.array([true_yaw[odom] for odom in drive.odom_from_node])
    linker = PathLinker(drive.steps(), harmonics(drive.views), Descriptor.spectrum(drive.views))
    linker.run(lambda share: None)
    seen = linker.links.turns()
    assert len(seen) > len(yaw)
    assert np.abs(np.angle(np.exp(1j * seen.misfit(yaw)))).max() < 0.3
    off = linker.poses[:, 2] - yaw
    assert np.abs(np.angle(np.exp(1j * (off - off[0])))).max() < 0.1
