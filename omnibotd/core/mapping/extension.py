"""Maps that grow: another teaching drive (other light, other day, a new corner) is added to an old map.

Nothing old moves: nodes, places and docks keep their poses, and old snapshots stay beside the new ones, so that the map
knows the same floor in every light it was taught in.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np

from omnibotd.core.errors import TrainingError
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping import snapshots
from omnibotd.core.mapping.calibration import calibration_differs
from omnibotd.core.mapping.drive import Drive, TeachingSample, read_drive
from omnibotd.core.mapping.edges import make_edges
from omnibotd.core.mapping.joining import Nodes, Spectra, join
from omnibotd.core.mapping.links import PathLinker
from omnibotd.core.mapping.refinement import refined_poses
from omnibotd.core.mapping.relaxation import Floats
from omnibotd.core.mapping.som import Som, side_for
from omnibotd.core.mapping.statistics import describe
from omnibotd.core.mapping.topo_map import EdgeKind, Edges, TopoMap
from omnibotd.core.mapping.training import check_drive
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.descriptor import Descriptor, Harmonics, harmonics
from omnibotd.core.vision.view import View

Progress = Callable[[str, float], None]

# Nodes, about a metre of driving, over which a placed drive must keep the shape that odometry gives it, and the share
# of distance by which it may not: 0.016 to 0.025 where nodes were placed to 3 to 6 cm, 0.046 to 0.051 where to 10 cm.
_SPAN, _BENT = 12, 0.04


def extend(
    topo_map: TopoMap, samples: Iterable[TeachingSample], camera: CameraModel, *, seed: int = 0, progress: Progress
) -> TopoMap:
    """The map with another drive in it, one session more. `progress` takes a stage and a share in [0, 1].

    TrainingError where the drive is no good, was taken with another camera, or can't be joined to the map.
    """
    if differs := calibration_differs(topo_map, camera):
        raise TrainingError(differs)
    drive = read_drive(samples, camera, seed, lambda share: progress("reading", 0.5 * share))
    old_views = snapshots.unpack(topo_map.snapshots)
    known = len(topo_map)
    old = Nodes(topo_map.poses.astype(np.float64), harmonics(old_views), Descriptor.spectrum(old_views))
    new_views = harmonics(drive.views)
    check_drive(drive, new_views)
    own = PathLinker(drive.steps(), new_views, Descriptor.spectrum(drive.views))
    own.run(lambda share: progress("links", 0.5 + 0.2 * share))
    linker = _united(old, own, lambda share: progress("joining", 0.7 + 0.1 * share))
    progress("refining", 0.8)
    views = np.concatenate([old_views, drive.views])
    poses = refined_poses(views, linker)
    poses[known:, 2] = np.arctan2(np.sin(poses[known:, 2]), np.cos(poses[known:, 2]))
    _check_shape(linker.steps[known:], poses[known:])
    progress("som", 0.9)
    return _grown(topo_map, drive, views, poses, linker, seed, progress)


def _united(old: Nodes, own: PathLinker, progress: Callable[[float], None]) -> PathLinker:
    """The drive's own nodes and links, behind the old nodes, and linked to them."""
    drive = Nodes(own.poses, own.views, own.spectra)
    start, sightings = join(drive, old, progress)
    known = len(old.poses)
    linker = PathLinker(
        np.concatenate([np.zeros((known, 3)), own.steps]),
        np.concatenate([old.views, own.views]),
        np.concatenate([old.spectra, own.spectra]),
        known,
    )
    linker.poses[:known], linker.poses[known:] = old.poses, start
    # The sightings pull the drive into place; from there it is linked anew, node by node, to what is really near.
    linker.links = own.links.moved(known)
    for index, node in enumerate(sightings.node):
        one = slice(index, index + 1)
        linker.links.add(int(node) + known, sightings.old[one], sightings.turn[one], sightings.score[one], place=True)
    linker.relax(len(linker.steps), rounds=6)
    linker.links = own.links.moved(known)
    linker.revisit_known()
    return linker


def _check_shape(steps: Floats, poses: Floats) -> None:
    """TrainingError where the drive had to be bent to fit: what is placed so badly would spoil the map.

    Steps (N, 3), the first unused, and poses (N, 3). Wheels of another size than believed change no shape.
    """
    before = np.concatenate([[0.0], np.cumsum(steps[1:-1, 2])])
    c, s = np.cos(before), np.sin(before)
    x, y = c * steps[1:, 0] - s * steps[1:, 1], s * steps[1:, 0] + c * steps[1:, 1]
    driven = _spans(np.concatenate([np.zeros((1, 2)), np.cumsum(np.stack([x, y], 1), axis=0)]))
    placed = _spans(poses[:, :2])
    scaled = driven * (placed.sum() / driven.sum())
    bent = float(np.abs(placed - scaled).sum() / scaled.sum())
    if bent > _BENT:
        raise TrainingError(
            f"the drive does not fit the map: placed by what the camera saw, its way differs by {bent:.1%} from what "
            f"odometry says, {_BENT:.1%} are tolerated; places look too much alike in this light: drive in a light "
            "more like that of the map, or start a new map with --fresh"
        )


def _spans(positions: Floats) -> Floats:
    """Distances from each position (N, 2) to the one `_SPAN` later."""
    return np.asarray(np.hypot(*(positions[_SPAN:] - positions[:-_SPAN]).T))


def _grown(
    topo_map: TopoMap, drive: Drive, views: View, poses: Floats, linker: PathLinker, seed: int, progress: Progress
) -> TopoMap:
    """The old map's nodes, untouched, and the new ones behind them; the index and the statistics anew."""
    known, session = len(topo_map), int(topo_map.sessions.max()) + 1
    spectra = Descriptor.spectrum(views)
    som = Som.train(spectra, side_for(len(spectra)), seed)
    edges = _edges(topo_map.edges, poses, linker)
    progress("statistics", 0.95)
    grown = replace(
        topo_map,
        codebook=som.codebook,
        units=som.bmu(spectra).astype(np.uint16),
        snapshots=np.concatenate([topo_map.snapshots, snapshots.pack(drive.views)]),
        poses=np.concatenate([topo_map.poses, poses[known:].astype(np.float32)]),
        sessions=np.concatenate([topo_map.sessions, np.full(len(drive.views), session, np.uint16)]),
        edges=edges,
        statistics=_statistics(topo_map.statistics, drive, spectra, som, linker.views, poses, edges),
    )
    progress("done", 1.0)
    return grown


def _edges(old: Edges, poses: Floats, linker: PathLinker) -> Edges:
    """The old links as they are, and all that touch a new node."""
    known = linker.known
    found = make_edges(poses, linker.links)
    low, high = np.minimum(found.first, found.second), np.maximum(found.first, found.second)
    between_drives = (found.kind == EdgeKind.ODOMETRY) & (low == known - 1)
    new = (high >= known) & ~between_drives
    return Edges(
        np.concatenate([old.first, found.first[new]]),
        np.concatenate([old.second, found.second[new]]),
        np.concatenate([old.kind, found.kind[new]]),
    )


def _statistics(
    old: Mapping[str, float],
    drive: Drive,
    spectra: Spectra,
    som: Som,
    views: Harmonics,
    poses: Floats,
    edges: Edges,
) -> dict[str, float]:
    """Of the whole map; of drives the totals, and what is no total as the new drive has it."""
    samples = int(old.get("samples", 0.0)) + drive.samples
    steps = drive.steps()[1:]
    driven, new = np.hypot(steps[:, 0], steps[:, 1]), np.diff(poses[-len(drive.views) :, :2], axis=0)
    whole = replace(drive, samples=samples, spectra=spectra, odom_from_node=[Pose2D(*pose) for pose in poses])
    return describe(whole, som, views, poses, edges) | {
        "path_length": old.get("path_length", 0.0) + float(driven.sum()),
        "odometry_residual": float(np.median(np.abs(np.hypot(new[:, 0], new[:, 1]) - driven))),
    }
