"""One cycle, from a picture's bytes to a velocity command: both presets, stage by stage, beside peers' first steps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any
from unittest import mock

import cv2
import numpy as np

from omnibotd.core.decision import Observation
from omnibotd.core.geometry import Pose2D, Twist2D
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation.goal_filter import GoalFilter
from omnibotd.core.navigation.navigator import SURE, Tolerance
from omnibotd.core.safety import Limits
from omnibotd.core.thesis import route
from omnibotd.core.thesis.links import Links
from omnibotd.core.vision.frame import Frame
from omnibotd.presets import preset_of
from tools.benchmark import literal, rooms
from tools.benchmark.measuring import Times, Tracer, settle

PERIOD = 0.1  # s between frames, and of the control tick
STEP = 0.03  # m between frames, at 0.3 m/s
DRIVE_SEED = 11  # another drive than the one the map was taught on
LIMITS = Limits(0.3, 1.0, 0.5, 2.0)
RADIUS = 0.17  # m, of the robot
# Frames after a start are not counted: the first look into the whole map, and cold caches.
WARM_UP = 5

_CORE = "omnibotd.core."
STAGES: Mapping[str, tuple[str, ...]] = {
    "decode at reduced size": (_CORE + "vision.frame:Frame.grey",),
    "relative gradient": (_CORE + "vision.view:relative_gradient",),
    "sampling the view": (_CORE + "vision.view:Viewer.texture", _CORE + "vision.view:Viewer.normalised"),
    "spectrum": (_CORE + "vision.descriptor:Descriptor.spectrum", _CORE + "navigation.localization:harmonics"),
    "SOM probe": (_CORE + "navigation.node_index:NodeIndex.alike",),
    "nodes near by": (
        _CORE + "navigation.node_index:NodeIndex.near",
        _CORE + "navigation.node_index:NodeIndex.distance",
    ),
    "correlation": (_CORE + "navigation.node_index:NodeIndex.compare", _CORE + "navigation.localization:correlate"),
    "hypotheses": tuple(
        _CORE + "navigation.hypotheses:Hypotheses." + name
        for name in ("move", "weigh", "propose", "supported", "place")
    ),
    "regression": (_CORE + "mapping.regression:refine",),
    "rest of localisation": (_CORE + "navigation.localization:Localizer.update",),
    "goal filter": (
        _CORE + "navigation.goal_filter:GoalFilter.predict",
        _CORE + "navigation.goal_filter:GoalFilter.update",
    ),
    "navigator step": (_CORE + "navigation.navigator:Navigator.step",),
}

DECODING, ORB, AKAZE = "grey decoding, full size", "ORB, 1000 features", "AKAZE"
DEFAULT, THESIS, LITERAL = "default preset", "thesis preset, one search a goal", "thesis, literal: one search a cycle"

WHOLE = "in all"
TRACED = {DEFAULT: STAGES, LITERAL: literal.STAGES}


@dataclass(frozen=True)
class Footage:
    """A drive as the camera and the odometry tell it."""

    frames: list[Frame]
    odom_from_base: list[Pose2D]

    @classmethod
    def of(cls, count: int) -> Footage:
        poses = rooms.waypoints(count, STEP, DRIVE_SEED, 0.8 * rooms.HALF)
        start = Pose2D(*poses[0])
        pictures = rooms.jpegs(poses, PERIOD)
        return cls(
            [Frame(PERIOD * k, jpeg) for k, jpeg in enumerate(pictures)],
            [start.inverse() @ Pose2D(*pose) for pose in poses],
        )


class Cycle:
    """What perception and control do with one frame, by the method of the map."""

    def __init__(self, topo_map: TopoMap) -> None:
        self._map, self._preset = topo_map, preset_of(topo_map)
        self._localizer = self._preset.localizer(topo_map, rooms.CAMERA)
        self.restart()

    def restart(self) -> None:
        """Begin a trip to a far corner from an unknown place."""
        self._localizer.reset()
        self._filter = GoalFilter()
        goal = self._map.pose(int(np.argmin(self._map.poses[:, 0] + self._map.poses[:, 1])))
        arguments = (self._map, goal, self._filter, LIMITS, Tolerance(0.05, 0.05), RADIUS, PERIOD)
        self._navigator = self._preset.navigator(*arguments)

    def step(self, frame: Frame, odom_from_base: Pose2D) -> Twist2D:
        """From the frame to the velocity command."""
        place = self._localizer.update(frame, odom_from_base)
        self._filter.predict(odom_from_base)
        self._filter.update(place, SURE)
        return self._navigator.step(Observation(frame.stamp, odom_from_base, place)).twist


class LiteralCycle(Cycle):
    """The thesis preset with a uniform-cost search in every cycle, as its text has it."""

    def __init__(self, topo_map: TopoMap) -> None:
        self._links = Links.of(topo_map)
        # The links in rows would be kept from cycle to cycle, so only the search itself is done again.
        self._rows: Any = None
        self._put_in_rows = route._adjacency
        super().__init__(topo_map)

    def step(self, frame: Frame, odom_from_base: Pose2D) -> Twist2D:
        with mock.patch.object(route, "_adjacency", self._kept_rows):
            route.Route(self._links, len(self._map), 0)
        return super().step(frame, odom_from_base)

    def _kept_rows(self, *links: Any) -> Any:
        if self._rows is None:
            self._rows = self._put_in_rows(*links)
        return self._rows


def measure(nodes: int, frames: int, rounds: int, perceptions: int) -> dict[str, Any]:
    """Round after round, each has the whole drive to itself, so that all meet the same machine, and warm caches."""
    topo_map = rooms.large_map(nodes)
    literal_map = literal.thesis_map(nodes, perceptions)
    cycles = {DEFAULT: Cycle(topo_map), THESIS: Cycle(literal_map), LITERAL: LiteralCycle(literal_map)}
    footage, times, stages = Footage.of(frames), Times(), {name: Times() for name in TRACED}
    greys = [frame.grey() for frame in footage.frames]
    peers = _peers()
    settle()
    for _ in range(rounds):
        for k in range(frames):
            times.measure(DECODING, footage.frames[k].grey)
        for name, cycle in cycles.items():
            _drive(cycle, footage, lambda step, name=name: times.measure(name, step))
        for name, extract in peers.items():
            for grey in greys:
                times.measure(name, lambda extract=extract, grey=grey: extract(grey))
        for name, where in TRACED.items():
            with Tracer(where) as tracer:
                _drive(cycles[name], footage, lambda step, name=name: stages[name].note(tracer.of(step)))
    sizes = {"nodes": nodes, "links": len(topo_map.edges), "thesis_links": len(literal_map.edges)}
    return _summary(times, stages) | sizes | {"jpeg_bytes": _size(footage.frames)}


def staged(nodes: int, frames: int) -> dict[str, float]:
    """Median ms of each stage of the default cycle, and of a whole one."""
    cycle, footage, whole, stages = Cycle(rooms.large_map(nodes)), Footage.of(frames), Times(), Times()
    settle()
    _drive(cycle, footage, lambda step: whole.measure(WHOLE, step))
    with Tracer(STAGES) as tracer:
        _drive(cycle, footage, lambda step: stages.note(tracer.of(step)))
    return {name: row["median_ms"] for name, row in (stages.table() | whole.table()).items()}


def _drive(cycle: Cycle, footage: Footage, counted: Callable[[Callable[[], Any]], Any]) -> None:
    cycle.restart()
    for k, (frame, odom) in enumerate(zip(footage.frames, footage.odom_from_base, strict=True)):
        step = partial(cycle.step, frame, odom)
        counted(step) if k >= WARM_UP else step()


def _peers() -> dict[str, Callable[[Any], Any]]:
    """What feature-based methods begin with, on a grey picture already decoded."""
    peers = {ORB: cv2.ORB_create(1000)}
    if hasattr(cv2, "AKAZE_create"):  # OpenCV 5 has moved it out
        peers[AKAZE] = cv2.AKAZE_create()
    return {name: lambda grey, peer=peer: peer.detectAndCompute(grey, None) for name, peer in peers.items()}


def _summary(times: Times, stages: Mapping[str, Times]) -> dict[str, Any]:
    unit, ours = times.median(DECODING), times.median(DEFAULT)
    compared = times.table()
    for name, row in compared.items():
        row["of_decoding"] = times.median(name) / unit
        row["of_default"] = times.median(name) / ours
    return {"contestants": compared, "stages": {name: taken.table() for name, taken in stages.items()}}


def _size(frames: Iterable[Frame]) -> int:
    return round(np.mean([len(frame.data) for frame in frames]))
