"""From a teaching drive to a map (thesis §6.3): views, SOM, nodes, links, relaxation, statistics.

Runs in a process of its own; imports scipy through its parts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import pairwise

import numpy as np

from omnibotd.core.docking.ceiling_height import visual_height
from omnibotd.core.errors import TrainingError
from omnibotd.core.mapping import snapshots
from omnibotd.core.mapping.calibration import calibration_of
from omnibotd.core.mapping.drive import Drive, TeachingSample, read_drive
from omnibotd.core.mapping.edges import make_edges
from omnibotd.core.mapping.links import PathLinker
from omnibotd.core.mapping.refinement import refined_poses
from omnibotd.core.mapping.som import Som, side_for
from omnibotd.core.mapping.statistics import describe
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.descriptor import Descriptor, Harmonics, correlate, harmonics

__all__ = ["TeachingSample", "train"]

Progress = Callable[[str, float], None]

# Two metres of driving: less can't be relaxed or navigated.
_FEWEST_NODES = 25
# Views 8 cm apart correlate at 0.8 under any structured ceiling, noise at 0.
_LEAST_LIKENESS = 0.3


def train(
    name: str, samples: Iterable[TeachingSample], camera: CameraModel, *, seed: int = 0, progress: Progress
) -> TopoMap:
    """A map of the drive; its origin is the pose of the first sample. `progress` takes a stage and a share in [0, 1].

    TrainingError where there are too few samples, no motion, or nothing to see.
    """
    drive = read_drive(samples, camera, seed, lambda share: progress("reading", 0.6 * share))
    views = harmonics(drive.views)
    check_drive(drive, views)
    progress("som", 0.6)
    som = Som.train(drive.spectra, side_for(len(drive.views)), seed)
    spectra = Descriptor.spectrum(drive.views)
    linker = PathLinker(drive.steps(), views, spectra)
    linker.run(lambda share: progress("links", 0.62 + 0.25 * share))
    progress("refining", 0.87)
    poses = refined_poses(drive.views, linker)
    poses[:, 2] = np.arctan2(np.sin(poses[:, 2]), np.cos(poses[:, 2]))
    progress("statistics", 0.92)
    edges = make_edges(poses, linker.links)
    statistics = describe(drive, som, views, poses, edges)
    progress("done", 1.0)
    return TopoMap(
        name=name,
        codebook=som.codebook,
        units=som.bmu(spectra).astype(np.uint16),
        snapshots=snapshots.pack(drive.views),
        poses=poses.astype(np.float32),
        sessions=np.zeros(len(poses), np.uint16),
        edges=edges,
        ceiling_height=_ceiling_height(drive, camera),
        camera=calibration_of(camera),
        statistics=statistics,
    )


def check_drive(drive: Drive, views: Harmonics) -> None:
    """TrainingError where there are too few samples, no motion, or nothing to see."""
    _check_enough(drive)
    _check_likeness(views)


def _check_enough(drive: Drive) -> None:
    if drive.samples < _FEWEST_NODES:
        raise TrainingError(
            f"the recording holds {drive.samples} samples with frame and odometry, at least {_FEWEST_NODES} are "
            "needed: drive round for a minute or more"
        )
    if len(drive.views) < _FEWEST_NODES:
        raise TrainingError(
            f"the robot hardly moved: {len(drive.views)} places 8 cm or 15 degrees apart in {drive.samples} samples, "
            f"at least {_FEWEST_NODES} are needed; if it did drive, odometry isn't arriving (see omnibotctl status)"
        )


def _check_likeness(views: Harmonics) -> None:
    scores = [correlate(after, before[None])[1][0] for before, after in pairwise(views)]
    likeness = float(np.median(scores))
    if likeness < _LEAST_LIKENESS:
        raise TrainingError(
            f"the frames show nothing that lasts: views of neighbouring places agree to {likeness:.2f}, at least "
            f"{_LEAST_LIKENESS} is needed; is the lens cap off, the light on, and is the ceiling more than bare paint?"
        )


def _ceiling_height(drive: Drive, camera: CameraModel) -> float:
    """Median over pairs of frames, metres; NaN where fewer than half of them agree on anything."""
    heights = [visual_height(camera, pair.first, pair.second, pair.second_from_first) for pair in drive.pairs]
    known = [height for height in heights if height is not None]
    return float(np.median(known)) if 2 * len(known) > len(heights) else float("nan")
