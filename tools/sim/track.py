"""Where a robot truly was, when: what the simulator remembers and no robot knows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D


@dataclass(frozen=True)
class Track:
    """Stamps (n,) in seconds, ascending, and the true poses (n, 3) then."""

    stamps: NDArray[np.float64]
    poses: NDArray[np.float64]

    @classmethod
    def of(cls, entries: Sequence[tuple[float, Pose2D]]) -> Track:
        poses = [(pose.x, pose.y, pose.yaw) for _, pose in entries]
        return cls(np.array([stamp for stamp, _ in entries]), np.array(poses, np.float64).reshape(-1, 3))

    @classmethod
    def load(cls, path: Path) -> Track:
        with np.load(path) as arrays:
            return cls(arrays["stamps"], arrays["poses"])

    def save(self, path: Path) -> None:
        with path.open("wb") as stream:
            np.savez(stream, stamps=self.stamps, poses=self.poses)

    def at(self, stamp: float) -> Pose2D:
        """The pose of the entry with the nearest stamp."""
        after = int(np.searchsorted(self.stamps, stamp))
        around = np.array([max(after - 1, 0), min(after, len(self.stamps) - 1)])
        nearest = around[np.argmin(np.abs(self.stamps[around] - stamp))]
        return Pose2D(*self.poses[nearest].tolist())
