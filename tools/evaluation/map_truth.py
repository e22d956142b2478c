"""From the map's frame to the world's: nodes stand where the robot truly was when it saw them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.drive import read_drive
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.thesis.training import node_samples
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.io.recording import teaching_samples
from tools.sim.track import Track

NEIGHBOURS = 12  # nodes that vote on where a pose of the map lies: enough to outvote a few that are misplaced

Floats = NDArray[np.float64]


class MapTruth:
    """Poses of the nodes in the map (n, 3) and in the world (n, 3).

    In a `metric` map what is near is near in the world; the thesis' maps are dead reckoning, in which it need not be.
    """

    def __init__(self, in_map: Floats, in_world: Floats, metric: bool = True) -> None:
        self.in_map, self.in_world, self._metric = in_map, in_world, metric
        self._turn = in_world[:, 2] - in_map[:, 2]
        self._scale = math.sqrt(in_world[:, :2].var(0).sum() / in_map[:, :2].var(0).sum()) if metric else 1.0

    def node(self, number: int) -> Pose2D:
        """Where the robot truly was when it saw this node."""
        return Pose2D(*self.in_world[number].tolist())

    def world_from(self, pose: Pose2D, node: int) -> Pose2D:
        """Where a pose of the map, given by somebody who saw `node`, lies in the world.

        Each of the nearest nodes carries it over and the median counts; in a map that is not metric, `node` alone.
        A map made with odometry of a wrong scale has that scale, which is taken out.
        """
        near = self._near(pose) if self._metric else np.array([node])
        dx, dy = self._scale * (np.array([[pose.x], [pose.y]]) - self.in_map[near, :2].T)
        cos, sin = np.cos(self._turn[near]), np.sin(self._turn[near])
        x = float(np.median(self.in_world[near, 0] + cos * dx - sin * dy))
        y = float(np.median(self.in_world[near, 1] + sin * dx + cos * dy))
        return Pose2D(x, y, math.remainder(pose.yaw + math.atan2(sin.sum(), cos.sum()), math.tau))

    def _near(self, pose: Pose2D) -> NDArray[np.intp]:
        away = np.hypot(self.in_map[:, 0] - pose.x, self.in_map[:, 1] - pose.y)
        return np.argpartition(away, min(NEIGHBOURS, len(away)) - 1)[:NEIGHBOURS]


def true_poses(topo_map: TopoMap, recording: Path, model: CameraModel, track: Track) -> Floats:
    """(n, 3) where the robot truly was when it saw each node of the map made of `recording`."""
    if topo_map.method == "thesis":
        stamps = [sample.stamp for sample in node_samples(teaching_samples(recording))]
    else:
        stamps = _node_stamps(recording, model)
    if len(stamps) != len(topo_map):
        raise ValueError(f"map {topo_map.name!r} has {len(topo_map)} nodes, its recording makes {len(stamps)}")
    return np.array([(pose.x, pose.y, pose.yaw) for pose in map(track.at, stamps)])


def _node_stamps(recording: Path, model: CameraModel) -> list[float]:
    """Reads the drive as the training did: nodes know the odometry they were seen at, which tells the frame."""
    stamps: dict[Pose2D, float] = {}
    for sample in teaching_samples(recording):
        stamps.setdefault(sample.odom_from_base, sample.stamp)
    drive = read_drive(teaching_samples(recording), model, 0, lambda share: None)
    return [stamps[pose] for pose in drive.odom_from_node]
