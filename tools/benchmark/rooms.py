"""Maps and drives for the benchmarks, made in seconds: rendered rooms, true poses, no training.

A map's nodes are views rendered along a random drive, stored at their true poses with a few centimetres of noise: what
localisation costs depends on the views, the bucket sizes and the density, not on how the poses were found.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from unittest import mock

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping import snapshots
from omnibotd.core.mapping.som import Som, side_for
from omnibotd.core.mapping.topo_map import EdgeKind, Edges, TopoMap
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.descriptor import Descriptor
from omnibotd.core.vision.frame import Frame
from omnibotd.core.vision.view import View
from tools.sim import ceilings
from tools.sim.compass_tiles import with_compass_tiles
from tools.sim.lens import Lens
from tools.sim.world_plugin import World

Floats = NDArray[np.float64]

FOV_DEG = 190.0
CAMERA = CameraModel.equidistant(640, 480, math.radians(FOV_DEG))
SMALL = Lens(160, 120, FOV_DEG, 60.0)
JPEG_QUALITY = 90
HALF = 2.0  # m: a room is taught over 4 x 4 m, as in the thesis
SPACING, TURN = 0.08, math.radians(15.0)  # between nodes, as the trainer sets them
FULLEST = 4000  # nodes a room: the thesis' 250 a square metre
POSE_NOISE = 0.02  # m, of stored poses: what relaxation leaves
ROOM_SPACING = 5.0  # m between the middles of neighbouring rooms of a large map
SEED = 7
# Every view of a large map is a mixture of this many rendered rooms seen from the same pose.
MIXED = 4
SAMPLES_A_UNIT = 10  # of spectra that train the SOM, as in the thesis


def waypoints(count: int, spacing: float, seed: int, half: float = HALF) -> Floats:
    """(count, 3) poses `spacing` m or 15 degrees apart of a base that drives from one random point to the next."""
    rng = np.random.default_rng(seed)
    pose, goal = Pose2D(), Pose2D(*rng.uniform(-half, half, 2))
    poses = []
    for _ in range(count):
        poses.append((pose.x, pose.y, pose.yaw))
        while pose.distance(goal) < 2 * spacing:
            goal = Pose2D(*rng.uniform(-half, half, 2))
        off = pose.bearing(goal)
        turn = max(-TURN, min(TURN, off))
        ahead = spacing if abs(off) < 0.5 else 0.0
        pose = pose @ Pose2D(ahead * math.cos(turn / 2), ahead * math.sin(turn / 2), turn)
    return np.array(poses)


@functools.cache
def world(seed: int = SEED, light: str = "nominal") -> World:
    """A room of a tuning seed, with the tiles that the thesis' compass needs."""
    return with_compass_tiles(ceilings.tiles(seed, light))


def jpegs(poses: Floats, period: float, light: str = "nominal") -> list[bytes]:
    """The pictures of a drive as a webcam sends them, `period` s apart."""
    pictures = (world(light=light).render(*pose, period * k) for k, pose in enumerate(poses))
    quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    return [cv2.imencode(".jpg", picture, quality)[1].tobytes() for picture in pictures]


@functools.cache
def views(seed: int, nodes: int) -> View:
    """(nodes, RINGS, SECTORS) seen along the drive in the room of `seed`.

    The camera has a quarter of the size, which is what views are made from anyway: a picture takes 1 ms, not 13.
    """
    with mock.patch("tools.sim.world.Lens", lambda: SMALL):
        small = with_compass_tiles(ceilings.tiles(seed))
    descriptor = Descriptor(CameraModel.equidistant(SMALL.width, SMALL.height, math.radians(FOV_DEG)))
    poses = waypoints(nodes, SPACING, SEED)
    return np.stack([descriptor.view(Frame(0.0, small.render(*pose, 0.2 * k))) for k, pose in enumerate(poses)])


def large_map(nodes: int, per_room: int = FULLEST) -> TopoMap:
    """One room of up to `per_room` nodes, beyond that as many rooms side by side, at the same density."""
    packed, spectra, poses = [], [], []
    for seen, where in _rooms(nodes, min(nodes, per_room)):
        packed.append(snapshots.pack(seen))
        spectra.append(Descriptor.spectrum(seen))
        poses.append(where.astype(np.float32))
    side = side_for(nodes)
    som = Som.train(_fair_sample(np.concatenate(spectra), SAMPLES_A_UNIT * side**2), side)
    positions = np.concatenate(poses)
    return TopoMap(
        name=f"{nodes} nodes",
        codebook=som.codebook,
        units=np.concatenate([som.bmu(block) for block in spectra]).astype(np.uint16),
        snapshots=np.concatenate(packed),
        poses=positions,
        sessions=np.zeros(nodes, np.uint16),
        edges=near_links(positions[:, :2]),
    )


def _rooms(nodes: int, per_room: int) -> Iterator[tuple[View, Floats]]:
    """Views and poses, room by room. The first is a rendered one.

    The views of each further one are those of four rendered rooms from the same pose, mixed with the room's own
    weights: as smooth over the floor as a rendered room, and unlike any other.
    """
    count = math.ceil(nodes / per_room)
    rendered = [views(SEED + k, per_room) for k in range(MIXED if count > 1 else 1)]
    rng = np.random.default_rng(SEED)
    drive, across = waypoints(per_room, SPACING, SEED), math.ceil(math.sqrt(count))
    for room in range(count):
        seen = rendered[0] if room == 0 else _mixed(rendered, rng)
        poses = drive + np.array([ROOM_SPACING * (room % across), ROOM_SPACING * (room // across), 0.0])
        poses[:, :2] += POSE_NOISE * rng.standard_normal((per_room, 2))
        left = nodes - room * per_room
        yield seen[:left], poses[:left]


def _mixed(rendered: list[View], rng: np.random.Generator) -> View:
    weights = rng.standard_normal(len(rendered)).astype(np.float32)
    mixture = sum((share * room for share, room in zip(weights, rendered, strict=True)), np.float32(0.0))
    mixture = mixture - mixture.mean((1, 2), keepdims=True)
    return np.asarray(mixture / mixture.std((1, 2), keepdims=True), np.float32)


def _fair_sample(spectra: NDArray[np.float32], most: int) -> NDArray[np.float32]:
    count = len(spectra)
    chosen = np.random.default_rng(SEED).choice(count, min(count, most), replace=False)
    return np.asarray(spectra[np.sort(chosen)])


def near_links(positions: NDArray[np.float32]) -> Edges:
    """Driven from each node to the next but across rooms, and to six neighbours."""
    nodes = len(positions)
    driven = np.column_stack([np.arange(nodes - 1), np.arange(1, nodes)])
    driven = driven[np.linalg.norm(np.diff(positions, axis=0), axis=1) < 1.0]
    _, other = cKDTree(positions).query(positions, min(7, nodes))
    near = np.column_stack([np.repeat(np.arange(nodes), other.shape[1]), other.ravel()])
    near = np.unique(np.sort(near[near[:, 0] != near[:, 1]], axis=1), axis=0)
    pairs = np.concatenate([driven, near]).astype(np.int32)
    kinds = np.repeat([EdgeKind.ODOMETRY, EdgeKind.PROXIMITY], [len(driven), len(near)])
    return Edges(pairs[:, 0], pairs[:, 1], kinds.astype(np.uint8))
