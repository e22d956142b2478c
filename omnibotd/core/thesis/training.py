"""From a recording to the thesis' map: phase I learns the perceptual space, phase II builds the map (§6.3, §6.5)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.errors import TrainingError
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.calibration import calibration_of
from omnibotd.core.mapping.drive import TeachingSample
from omnibotd.core.mapping.som import Som
from omnibotd.core.mapping.topo_map import EdgeKind, Edges, TopoMap
from omnibotd.core.thesis import links, som
from omnibotd.core.thesis.responses import Classifier, pack
from omnibotd.core.thesis.vector import Perceiver
from omnibotd.core.vision.camera_model import CameraModel

Floats = NDArray[np.float32]

LEARNING = 500.0  # s: phase I, of which 1000 perceptions at 2 Hz train the SOM
LEARNING_PERIOD, NODE_PERIOD = 0.5, 1.0  # s
# s. The thesis drives twice, 75 minutes in all. A recording shorter than this has too little left after phase I, so
# that all of it becomes nodes [assumed].
ALL_BECOMES_NODES = 1000.0
_FEWEST_SAMPLES = som.SIDE**2  # one for each unit: 50 s
_SHORTEST_PATH = 2.0  # m


@dataclass(frozen=True, slots=True)
class Use:
    """A sample, what it is used for, and seconds since the first."""

    sample: TeachingSample
    elapsed: float
    learn: bool
    node: bool


def schedule(samples: Iterable[TeachingSample]) -> Iterator[Use]:
    """Those samples that are used: the first of each half second of phase I, of each second for nodes."""
    start: float | None = None
    learnt = noted = -1
    for sample in samples:
        start = sample.stamp if start is None else start
        elapsed = round(sample.stamp - start, 6)  # or 499.9999999 would be a half second of its own
        half_second, second = int(elapsed / LEARNING_PERIOD), int(elapsed / NODE_PERIOD)
        use = Use(sample, elapsed, elapsed < LEARNING and half_second > learnt, second > noted)
        if use.learn or use.node:
            learnt, noted = max(learnt, half_second), max(noted, second)
            yield use


def node_samples(samples: Iterable[TeachingSample]) -> list[TeachingSample]:
    """The samples that become nodes, in the map's order, given that the tiles are in sight from the first one on."""
    uses = [use for use in schedule(samples) if use.node]
    return [use.sample for use in uses if _becomes_node(use.elapsed, uses[-1].elapsed)]


def train_thesis(
    name: str,
    samples: Iterable[TeachingSample],
    camera: CameraModel,
    *,
    seed: int = 0,
    progress: Callable[[str, float], None],
) -> TopoMap:
    """A map of method `thesis`; its axes are the compass's, its origin is where the first perception was had.

    Node positions are dead reckoning and never relaxed: the thesis keeps no global metric consistency (§6.3).
    TrainingError where there is too little to learn from, or no compass.
    """
    drive = _Drive(camera, seed, progress)
    for use in schedule(samples):
        drive.take(use)
    nodes, codebook = drive.finish()
    progress("links", 0.95)
    responses = np.array([node.response for node in nodes], np.float32)
    units = responses.argmin(1).astype(np.uint16)
    threshold = links.similarity_threshold(responses)
    edges = _edges(len(nodes), links.similar_pairs(responses, units, threshold))
    statistics = {**drive.statistics(), **_described(units, edges), links.THRESHOLD: threshold}
    progress("done", 1.0)
    return TopoMap(
        name=name,
        codebook=codebook,
        units=units,
        snapshots=pack(responses),
        poses=np.array([(node.pose.x, node.pose.y, node.pose.yaw) for node in nodes], np.float32),
        sessions=np.zeros(len(nodes), np.uint16),
        edges=edges,
        camera=calibration_of(camera),
        statistics=statistics,
        method="thesis",
    )


def _becomes_node(elapsed: float, total: float) -> bool:
    return elapsed >= LEARNING or total < ALL_BECOMES_NODES


@dataclass(frozen=True, slots=True)
class _Look:
    """A perception and where dead reckoning has it, in compass axes."""

    elapsed: float
    pose: Pose2D
    vector: Floats
    learn: bool
    node: bool


@dataclass(frozen=True, slots=True)
class _Node:
    elapsed: float
    pose: Pose2D
    response: Floats


class _Drive:
    """The drive as it streams through: vectors are kept of phase I only (32 MB), nodes keep their responses."""

    def __init__(self, camera: CameraModel, seed: int, progress: Callable[[str, float], None]) -> None:
        self._perceiver, self._seed, self._progress = Perceiver(camera), seed, progress
        self._early: list[_Look] = []
        self._nodes: list[_Node] = []
        self._codebook: Floats | None = None
        self._odom: Pose2D | None = None
        self._pose = Pose2D()
        self._total = self._path = 0.0
        self._samples = self._seen = 0

    def take(self, use: Use) -> None:
        """Perceive one sample, and file it under its phase."""
        self._samples, self._total = self._samples + 1, use.elapsed
        perception = self._perceiver.perceive(use.sample.frame, use.sample.odom_from_base)
        if perception is None:
            return
        self._seen += perception.heading.seen
        self._reckon(use.sample.odom_from_base, perception.heading.yaw)
        look = _Look(use.elapsed, self._pose, perception.vector, use.learn, use.node)
        if use.elapsed < LEARNING:
            self._early.append(look)
            self._progress("reading", 0.3 * use.elapsed / LEARNING)
            return
        if self._codebook is None:
            self._codebook = self._learn()
        self._nodes.append(self._classified(look, Classifier(self._codebook)))

    def finish(self) -> tuple[list[_Node], Floats]:
        """Nodes in order, and the codebook."""
        if self._codebook is None:
            self._codebook = self._learn()
        classifier = Classifier(self._codebook)
        early = [self._classified(look, classifier) for look in self._early if look.node]
        nodes = [node for node in early + self._nodes if _becomes_node(node.elapsed, self._total)]
        return nodes, self._codebook

    def statistics(self) -> dict[str, float]:
        """Of the drive and the SOM, by name; compass_seen is the share of samples in which the tiles were seen."""
        assert self._codebook is not None
        vectors, trained = self._learning(), Som(self._codebook)
        return {
            "samples": float(self._samples),
            "som_samples": float(len(vectors)),
            "path_length": self._path,
            "compass_seen": self._seen / self._samples,
            "quantization_error": trained.quantization_error(vectors),
            "topographic_error": trained.topographic_error(vectors),
        }

    def _reckon(self, odom_from_base: Pose2D, yaw: float) -> None:
        """Add the step by odometry, turned into compass axes by the heading it began with."""
        if self._odom is not None:
            step = self._odom.inverse() @ odom_from_base
            x, y = self._pose.transform(step.x, step.y)
            self._path += Pose2D().distance(step)
        else:
            x = y = 0.0
        self._odom, self._pose = odom_from_base, Pose2D(x, y, yaw)

    def _learning(self) -> Floats:
        return np.array([look.vector for look in self._early if look.learn], np.float32)

    def _learn(self) -> Floats:
        vectors = self._learning()
        if not len(vectors) and self._samples:
            raise TrainingError(
                "no frame to learn from shows both tiles: this method takes its heading from a red and a blue square "
                "on the ceiling; put them up, or set navigation.preset to default"
            )
        if len(vectors) < _FEWEST_SAMPLES:
            raise TrainingError(
                f"the recording gives {len(vectors)} perceptions at 2 Hz, at least {_FEWEST_SAMPLES} are needed: drive "
                "round for a minute or more"
            )
        if self._path < _SHORTEST_PATH:
            raise TrainingError(
                f"the robot hardly moved: {self._path:.1f} m by odometry, at least {_SHORTEST_PATH:.0f} m are needed; "
                "if it did drive, odometry isn't arriving (see omnibotctl status)"
            )
        return som.train(vectors, seed=self._seed, progress=lambda share: self._progress("som", 0.3 + 0.6 * share))

    @staticmethod
    def _classified(look: _Look, classifier: Classifier) -> _Node:
        return _Node(look.elapsed, look.pose, classifier(look.vector))


def _edges(nodes: int, similar: NDArray[np.int32]) -> Edges:
    driven = np.column_stack([np.arange(nodes - 1), np.arange(1, nodes)]).astype(np.int32)
    pairs = np.concatenate([driven, similar])
    kinds = np.repeat([EdgeKind.ODOMETRY, EdgeKind.SIMILARITY], [len(driven), len(similar)]).astype(np.uint8)
    return Edges(pairs[:, 0].copy(), pairs[:, 1].copy(), kinds)


def _described(units: NDArray[np.uint16], edges: Edges) -> dict[str, float]:
    """How nodes spread over the units, and how many links of each kind there are."""
    sizes = np.bincount(units, minlength=som.SIDE**2)
    return {
        "empty_units": float((sizes == 0).sum()),
        "largest_bucket": float(sizes.max()),
        "odometry_links": float((edges.kind == EdgeKind.ODOMETRY).sum()),
        "similarity_links": float((edges.kind == EdgeKind.SIMILARITY).sum()),
    }
