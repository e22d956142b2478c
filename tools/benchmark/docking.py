"""One docking estimate, from a picture's bytes to a pose: ours and the thesis', stage by stage, beside peers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import cv2
import numpy as np

from omnibotd.core.docking.lights import Light, Lights
from omnibotd.core.docking.registration import DockRegistration
from omnibotd.core.geometry import Pose2D
from omnibotd.core.thesis.docking import ThesisHoming
from omnibotd.core.vision.frame import Frame, Image
from tools.benchmark import rooms
from tools.benchmark.cycle import DECODING, ORB, WHOLE
from tools.benchmark.measuring import Times, Tracer, settle
from tools.evaluation.orb_homing import OrbHoming

CEILING = 2.2  # m above the camera
DOCK = Pose2D(0.4, -0.3, 0.5)
REACH = 1.0  # m round the dock
# What tracking starts from is as wrong as odometry is after a tenth of a second: 1 cm and half a degree.
PRIOR_ERROR, PRIOR_YAW = 0.01, math.radians(0.5)
SEED = 21

TRACKING, FULL_FIX, LITERAL = "tracking estimate", "full fix", "thesis, literal"
NIGHT_FIX, NIGHT_TRACKING = "full fix beside the dock by night", "tracking by night, views of two other lights"
PEER, APRILTAG = "ORB, matching and RANSAC", "AprilTag detection"
# What ours may cost, in grey decodings of one frame.
MOST_TRACKING, MOST_FIX = 10.0, 30.0
MOST = {TRACKING: MOST_TRACKING, NIGHT_TRACKING: MOST_TRACKING, FULL_FIX: MOST_FIX, NIGHT_FIX: MOST_FIX}
BESIDE = 0.08  # m from the dock

_DOCKING, _THESIS = "omnibotd.core.docking.", "omnibotd.core.thesis.docking:"
_SEEING: Mapping[str, tuple[str, ...]] = {
    "decode": ("omnibotd.core.vision.frame:Frame.grey",),
    "rectify": (_DOCKING + "rectification:Lookup.__call__",),
    "edge strength, people": tuple(_DOCKING + f"ceiling_view:{name}" for name in ("edges", "evened", "unoccluded")),
    "layers": (_DOCKING + "ceiling_view:CeilingView.layer",),
}
_REFINING: Mapping[str, tuple[str, ...]] = {"refinement, walls": (_DOCKING + "refinement:Refinement.refine",)}
STAGES: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    TRACKING: {**_SEEING, **_REFINING, "rest": (_DOCKING + "registration:DockRegistration.track",)},
    FULL_FIX: {
        **_SEEING,
        "rotation cues": (_DOCKING + "rotation:RotationCues.signature", _DOCKING + "coarse:rotation_hypotheses"),
        "shifts": (_DOCKING + "translation:ShiftSearch.find",),
        "candidates": (_DOCKING + "coarse:align", _DOCKING + "coarse:residuals"),
        **_REFINING,
        "rest": (_DOCKING + "registration:DockRegistration.fix",),
    },
    # The rows of the thesis' table 7.2, and its milliseconds at 1.6 GHz.
    LITERAL: {
        "pre-processing (8)": ("omnibotd.core.vision.frame:Frame.grey", _DOCKING + "rectification:Lookup.__call__"),
        "edge histogram (11)": (_THESIS + "edge_histogram",),
        "histogram matching (14)": (_THESIS + "match_histograms",),
        "image rotation (15)": (_THESIS + "turned",),
        "1D images (9)": (_THESIS + "profiles",),
        "1D matching (22)": (_THESIS + "match_profiles",),
    },
}


def measure(frames: int, rounds: int) -> dict[str, Any]:
    """Frames from within a metre of a dock, any heading; round after round, each contestant has them all to itself."""
    snapshot, seen, poses = _pictures(frames)
    estimates = _estimates(snapshot, seen, poses)
    greys = [frame.grey() for frame in seen]
    times, stages = Times(), {name: Times() for name in STAGES}
    for estimate in estimates.values():
        estimate(0)  # tables that are made once
    settle()
    for _ in range(rounds):
        for frame in seen:
            times.measure(DECODING, frame.grey)
        for name, estimate in estimates.items():
            for k in range(frames):
                times.measure(name, partial(estimate, k))
        for name, extract in _peers().items():
            for grey in greys:
                times.measure(name, partial(extract, grey))
        for name, where in STAGES.items():
            with Tracer(where) as tracer:
                for k in range(frames):
                    stages[name].note(tracer.of(partial(estimates[name], k)))
    return _summary(times, stages) | {"jpeg_bytes": round(np.mean([len(frame.data) for frame in seen]))}


def staged(frames: int) -> dict[str, float]:
    """Median ms of each stage of a tracking estimate, and of a whole one."""
    snapshot, seen, poses = _pictures(frames)
    track, whole, stages = _estimates(snapshot, seen, poses)[TRACKING], Times(), Times()
    track(0)
    settle()
    for k in range(frames):
        whole.measure(WHOLE, partial(track, k))
    with Tracer(STAGES[TRACKING]) as tracer:
        for k in range(frames):
            stages.note(tracer.of(partial(track, k)))
    return {name: row["median_ms"] for name, row in (stages.table() | whole.table()).items()}


def _pictures(frames: int) -> tuple[Frame, list[Frame], list[Pose2D]]:
    """The dock's, others from round about, and where from: dock_from_base."""
    poses = dock_poses(frames)
    jpegs = rooms.jpegs(np.array([triple(DOCK), *(triple(DOCK @ pose) for pose in poses)]), 0.4)
    seen = [Frame(float(k), jpeg) for k, jpeg in enumerate(jpegs)]
    return seen[0], seen[1:], poses


def _estimates(snapshot: Frame, seen: list[Frame], poses: list[Pose2D]) -> dict[str, Callable[[int], Any]]:
    ours, literal, peer = (
        make(rooms.CAMERA, snapshot, CEILING) for make in (DockRegistration, ThesisHoming, OrbHoming)
    )
    night, both = _by_night(ours, poses)
    off = Pose2D(PRIOR_ERROR, 0.0, PRIOR_YAW)
    return {
        TRACKING: lambda k: ours.track(seen[k], Pose2D(), poses[k] @ off),
        FULL_FIX: lambda k: ours.fix(seen[k], Pose2D()),
        NIGHT_TRACKING: lambda k: both.track(night[k], Pose2D(), _beside(poses[k]) @ off),
        NIGHT_FIX: lambda k: ours.fix(night[k], Pose2D()),
        LITERAL: lambda k: literal.fix(seen[k], Pose2D()),
        PEER: lambda k: peer.fix(seen[k], Pose2D()),
    }


def _by_night(day: DockRegistration, poses: list[Pose2D]) -> tuple[list[Frame], Lights]:
    """Frames from beside the dock, and its views by day and with the lamps off."""
    truly = np.array([triple(DOCK @ _beside(pose)) for pose in poses])
    night = [Frame(float(k), jpeg) for k, jpeg in enumerate(rooms.jpegs(truly, 0.4, "night"))]
    dusk = Frame(0.0, *rooms.jpegs(np.array([triple(DOCK)]), 0.4, "lamps_off"))
    views = day, DockRegistration(rooms.CAMERA, dusk, CEILING)
    return night, Lights([Light(view, Pose2D()) for view in views])


def _beside(pose: Pose2D) -> Pose2D:
    return Pose2D(BESIDE * pose.x, BESIDE * pose.y, pose.yaw)


def _peers() -> dict[str, Callable[[Image], Any]]:
    """Others' first steps, on a grey picture already decoded."""
    orb = cv2.ORB_create(1000)
    return {ORB: lambda grey: orb.detectAndCompute(grey, None), APRILTAG: _tag_detector()}


def _tag_detector() -> Callable[[Image], Any]:
    """The reference implementation on one thread where it is installed, else OpenCV's."""
    try:
        from pupil_apriltags import Detector  # noqa: PLC0415 - a peer that need not be there
    except ImportError:
        tags = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        if not hasattr(cv2.aruco, "ArucoDetector"):  # before OpenCV 4.7
            return lambda grey: cv2.aruco.detectMarkers(grey, tags)
        return cv2.aruco.ArucoDetector(tags).detectMarkers
    return Detector(families="tag36h11", nthreads=1, quad_decimate=1.0).detect


def dock_poses(count: int) -> list[Pose2D]:
    """dock_from_base."""
    rng = np.random.default_rng(SEED)
    polar = zip(REACH * np.sqrt(rng.random(count)), rng.uniform(-math.pi, math.pi, (count, 2)), strict=True)
    return [Pose2D(r * math.cos(bearing), r * math.sin(bearing), yaw) for r, (bearing, yaw) in polar]


def triple(pose: Pose2D) -> tuple[float, float, float]:
    return pose.x, pose.y, pose.yaw


def _summary(times: Times, stages: Mapping[str, Times]) -> dict[str, Any]:
    unit = times.median(DECODING)
    compared = times.table()
    for name, row in compared.items():
        row["of_decoding"] = times.median(name) / unit
    return {"contestants": compared, "stages": {name: taken.table() for name, taken in stages.items()}}
