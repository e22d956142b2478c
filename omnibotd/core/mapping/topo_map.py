"""The map: very many nodes indexed by a self-organising map, links, named places and docks (thesis §6.2-6.3).

Immutable: every edit returns another map, so that perception can work on a snapshot while the control tick edits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.errors import MapError
from omnibotd.core.geometry import Pose2D


class EdgeKind(IntEnum):
    """How two nodes came to be linked."""

    ODOMETRY = 0  # driven from one to the next while teaching
    SIMILARITY = 1  # look alike and are close: a loop closure
    PROXIMITY = 2  # neighbours in the relaxed map, both on driven floor


@dataclass(frozen=True)
class Edges:
    """Links (M): node indices `first`, `second` (M,) int32 and `kind` (M,) uint8; offsets are the poses'."""

    first: NDArray[np.int32]
    second: NDArray[np.int32]
    kind: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.first)


@dataclass(frozen=True)
class DockView:
    """What the camera sees at a dock in one light (full-size JPEG), and where exactly the base stood then."""

    jpeg: bytes
    dock_from_base: Pose2D = field(default_factory=Pose2D)


@dataclass(frozen=True)
class Dock:
    """A high-accuracy place: where the base stands when docked, and how it looks there, oldest view first."""

    map_from_dock: Pose2D
    views: tuple[DockView, ...]


@dataclass(frozen=True)
class TopoMap:
    """N nodes, U SOM units of F features. Arrays are never written to after construction.

    codebook (U, F) float32, on a square torus of sqrt(U) x sqrt(U); `units` (N,) best matching unit of each node;
    `snapshots` (N, C) uint8, what each node saw, as the method codes it; `poses` (N, 3) float32 map_from_base;
    `sessions` (N,) number of the teaching drive. `ceiling_height` is metres from camera to ceiling as measured while
    teaching (NaN where unknown). `camera` tells the calibration the map was taught with;
    `recordings` are the files it was taught from, one a session; `method` is the preset that made it and can use it:
    another method's `codebook` and `snapshots` mean something else.
    """

    name: str
    codebook: NDArray[np.float32]
    units: NDArray[np.uint16]
    snapshots: NDArray[np.uint8]
    poses: NDArray[np.float32]
    sessions: NDArray[np.uint16]
    edges: Edges
    ceiling_height: float = float("nan")
    camera: Mapping[str, float] = field(default_factory=dict)
    statistics: Mapping[str, float] = field(default_factory=dict)
    recordings: tuple[str, ...] = ()
    method: str = "default"
    places: Mapping[str, Pose2D] = field(default_factory=dict)
    docks: Mapping[str, Dock] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.poses)

    def pose(self, node: int) -> Pose2D:
        x, y, yaw = (float(value) for value in self.poses[node])
        return Pose2D(x, y, yaw)

    def with_place(self, name: str, map_from_place: Pose2D) -> TopoMap:
        return replace(self, places={**self.places, name: map_from_place})

    def without_place(self, name: str) -> TopoMap:
        if name not in self.places:
            raise MapError(
                f"no place {name!r} in map {self.name!r}; places: {', '.join(sorted(self.places)) or 'none'}"
            )
        return replace(self, places={key: pose for key, pose in self.places.items() if key != name})

    def with_dock(self, name: str, dock: Dock) -> TopoMap:
        return replace(self, docks={**self.docks, name: dock})
