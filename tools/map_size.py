"""Size of a map on disk against where it places a robot, snapshot code by snapshot code (launcher: tools/map-size).

For each ceiling one map is trained from a drive of five minutes; its views then go through each code, and the frames of
another drive are placed in the result: tracked, and each from nothing; in the light of teaching and with half the lamps
off. Errors are against the truth, the map being laid onto it as a whole. About two minutes of one core.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping import snapshots
from omnibotd.core.mapping.drive import read_drive
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.mapping.training import TeachingSample, train
from omnibotd.core.navigation.localization import Localizer
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from omnibotd.core.vision.view import RINGS, SECTORS, View
from omnibotd.io.map_format import encode
from tools.sim import ceilings
from tools.sim.world import World

CEILINGS = (ceilings.tiles, ceilings.plain, ceilings.beams)  # seeds below 100: for tuning
LIGHTS = ("nominal", "half_lamps")
CAMERA = CameraModel.equidistant(640, 480, math.radians(190.0))
TAUGHT, TAUGHT_HALF = 300.0, 2.0  # s; m from the room's middle to the edge of the square that is driven
ASKED, ASKED_HALF = 60.0, 1.7
DT, SPEED, TURN_RATE, SLIP = 0.2, 0.3, 1.0, 0.01  # s between frames, m/s, rad/s, relative error of a step
SETTLE = 15  # frames in which a tracking robot may find itself
STEPS = (2.4, 1.8, 1.4, 1.1, 0.8, 0.55, 0.35)  # of the Fourier coefficients, coarse to fine
LIMIT = 250.0  # KB per 1000 nodes that a map may take

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Code:
    """A way to store views (N, RINGS, SECTORS): the bytes (N, `bytes`) they become, and what comes back of them."""

    name: str
    bytes: int
    packed: Callable[[View], NDArray[np.uint8]]
    restored: Callable[[View], View]


@dataclass(frozen=True)
class Samples:
    """True poses of frames, and the frames with odometry."""

    truth: list[Pose2D]
    samples: list[TeachingSample]


@dataclass(frozen=True)
class Room:
    """A map, the views (N, RINGS, SECTORS) and true poses (N, 3) of its nodes, and another drive in each light."""

    topo_map: TopoMap
    views: View
    truth: Floats
    drives: dict[str, Samples]


@dataclass(frozen=True)
class Result:
    """Of one code in all rooms: KB per 1000 nodes; errors (n,) in metres by light, tracked and from nothing."""

    code: Code
    kilobytes: float
    tracked: dict[str, Floats]
    found: dict[str, Floats]


def cells(bits: int, lowest: float, step: float) -> Code:
    """Every cell by itself on an even scale: what maps held before, four bits a cell."""
    widths = np.full(RINGS * SECTORS, bits)

    def levels(views: View) -> NDArray[np.int64]:
        return np.clip(np.rint((views - lowest) / step), 0, 2**bits - 1).astype(int)

    return Code(
        f"cells, {bits} bits",
        widths.sum() // 8,
        lambda views: _bytes(levels(views).reshape(len(views), -1), widths),
        lambda views: (levels(views) * step + lowest).astype(np.float32),
    )


def harmonics(step: float, spread: Floats) -> Code:
    """Fourier coefficients of the rings, `spread` (orders,) wide: the wider, the more levels of one step they get."""
    bits = np.clip(np.round(np.log2(np.maximum(spread / step, 1e-3)) + 1.75), 0, 6).astype(int)
    widths = np.stack([bits, bits], -1)  # of real and imaginary parts
    widths[[0, -1], 1] = 0
    middle = 2**widths // 2

    def levels(views: View) -> NDArray[np.int64]:
        spectra = np.fft.rfft(views, axis=-1)[..., None] / math.sqrt(SECTORS)
        parts = np.concatenate([spectra.real, spectra.imag], -1)
        return np.clip(np.floor(parts / step), -middle, middle - 1).astype(int) + middle

    def restored(views: View) -> View:
        parts = np.where(widths > 0, (levels(views) - middle + 0.5) * step, 0.0)
        spectra = parts @ np.array([1.0, 1j]) * math.sqrt(SECTORS)
        return np.fft.irfft(spectra, n=SECTORS, axis=-1).astype(np.float32)

    every = np.tile(widths.ravel(), RINGS)
    return Code(
        f"harmonics, step {step:.2f}",
        math.ceil(every.sum() / 8),
        lambda views: _bytes(levels(views).reshape(len(views), -1), every),
        restored,
    )


def _bytes(levels: NDArray[np.int64], widths: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Levels (N, parts) in `widths` (parts,) bits each, one behind the other."""
    part = np.repeat(np.arange(len(widths)), widths)
    shift = np.concatenate([np.arange(width)[::-1] for width in widths])
    return np.packbits(((levels[:, part] >> shift) & 1).astype(np.uint8), axis=-1)


def codes(views: View) -> list[Code]:
    """The family, the product's own, and single cells for comparison."""
    spectra = np.fft.rfft(views, axis=-1) / math.sqrt(SECTORS)
    power = (spectra.real**2 + spectra.imag**2).mean((0, 1))
    power[1:-1] /= 2.0  # of a real and an imaginary part each
    return [
        *(harmonics(step, np.sqrt(power)) for step in STEPS),
        Code("omnibotd", snapshots.BYTES, snapshots.pack, lambda views: snapshots.unpack(snapshots.pack(views))),
        cells(2, -1.0, 1.0),
        cells(4, -1.5, 0.35),
    ]


def drive(world: World, seconds: float, half: float, seed: int) -> Samples:
    """Towards random points of a square, turning on the spot where they are to the side; odometry slips."""
    rng = np.random.default_rng(seed)
    true, odom, truth, samples = Pose2D(), Pose2D(), [], []
    goal = Pose2D()
    for number in range(round(seconds / DT)):
        picture = world.render(true.x, true.y, true.yaw, number * DT)
        truth.append(true)
        samples.append(TeachingSample(number * DT, odom, Frame(number * DT, picture)))
        while true.distance(goal) < 0.1:
            goal = Pose2D(*rng.uniform(-half, half, 2))
        off = true.bearing(goal)
        turn = max(-TURN_RATE * DT, min(TURN_RATE * DT, off))
        ahead = SPEED * DT if abs(off) < 0.5 else 0.0
        slip = 1.0 + SLIP * rng.standard_normal(2)
        true = true @ Pose2D(ahead, 0.0, turn)
        odom = odom @ Pose2D(ahead * slip[0], 0.0, turn * slip[1])
    return Samples(truth, samples)


def room(factory: Callable[[int, str], World], seed: int) -> Room:
    taught = drive(factory(seed, LIGHTS[0]), TAUGHT, TAUGHT_HALF, seed)
    kept = read_drive(taught.samples, CAMERA, seed, lambda share: None)
    number = {id(sample.odom_from_base): k for k, sample in enumerate(taught.samples)}
    nodes = [taught.truth[number[id(odom)]] for odom in kept.odom_from_node]
    topo_map = train(factory.__name__, taught.samples, CAMERA, seed=seed, progress=lambda stage, share: None)
    drives = {light: drive(factory(seed, light), ASKED, ASKED_HALF, seed + 50) for light in LIGHTS}
    return Room(topo_map, kept.views, np.array([(pose.x, pose.y, pose.yaw) for pose in nodes]), drives)


def onto_truth(poses: Floats, truth: Floats) -> Callable[[Pose2D], complex]:
    """The rotation and shift that lay the map's nodes best onto where they truly were; positions as x + iy."""
    a, b = poses[:, 0] + 1j * poses[:, 1], truth[:, 0] + 1j * truth[:, 1]
    turn = np.vdot(a - a.mean(), b - b.mean())
    turn /= abs(turn)
    return lambda pose: complex((complex(pose.x, pose.y) - a.mean()) * turn + b.mean())


def placed(where: Room, code: Code) -> tuple[dict[str, Floats], dict[str, Floats]]:
    """Errors of every frame by light, tracked and from nothing, with the map's views as the code leaves them."""
    localizer = _localizer(where.topo_map, code.restored(where.views))
    to_truth = onto_truth(where.topo_map.poses.astype(float), where.truth)
    tracked, found = {}, {}
    for light, asked in where.drives.items():
        for result, forgets in ((tracked, False), (found, True)):
            localizer.reset()
            result[light] = np.array(list(_errors(localizer, asked, to_truth, forgets))[SETTLE:])
    return tracked, found


def _localizer(topo_map: TopoMap, views: View) -> Localizer:
    """As if `views` were what the map's snapshots hold, whatever the code: each one's bytes are its node's number."""
    numbers = np.arange(len(topo_map), dtype="<u4").view(np.uint8).reshape(-1, 4)
    with mock.patch.object(snapshots, "unpack", lambda rows: views[np.ascontiguousarray(rows).view("<u4")[:, 0]]):
        return Localizer(replace(topo_map, snapshots=numbers), CAMERA)


def _errors(
    localizer: Localizer, asked: Samples, to_truth: Callable[[Pose2D], complex], forgets: bool
) -> Iterator[float]:
    for true, sample in zip(asked.truth, asked.samples, strict=True):
        if forgets:
            localizer.reset()
        pose = localizer.update(sample.frame, sample.odom_from_base).map_from_base
        yield abs(to_truth(pose) - complex(true.x, true.y))


def size(where: Room, code: Code) -> float:
    """KB per 1000 nodes of the file, compressed where that pays, links and everything else included."""
    topo_map = replace(where.topo_map, snapshots=code.packed(where.views))
    return len(encode(topo_map)) / len(topo_map) * 1000.0 / 1024.0


def sweep(rooms: Sequence[Room]) -> Iterator[Result]:
    """Every code in every room, the cheapest first."""
    for code in sorted(codes(np.concatenate([where.views for where in rooms])), key=lambda code: code.bytes):
        results = [placed(where, code) for where in rooms]
        tracked, found = ({k: np.concatenate([r[i][k] for r in results]) for k in LIGHTS} for i in (0, 1))
        yield Result(code, float(np.mean([size(where, code) for where in rooms])), tracked, found)


def row(result: Result) -> str:
    """One line of the table; centimetres, at the median and of 95 in 100 frames."""
    numbers = [
        f"{100.0 * np.median(errors):8.1f}{100.0 * np.percentile(errors, 95):7.1f}"
        for light in LIGHTS
        for errors in (result.tracked[light], result.found[light])
    ]
    return f"{result.code.name:22}{result.code.bytes:6}{result.kilobytes:9.0f}  {' '.join(numbers)}"


def draw(results: Sequence[Result], path: Path) -> None:
    """Median error against size; the family as a line, the others as points."""
    mpl.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    panels = zip(figure.subplots(1, 2), ("tracked", "found"), ("tracked", "from a single frame"), strict=True)
    for axes, how, title in panels:
        for light, colour in zip(LIGHTS, ("#2a7fa5", "#c9822b"), strict=True):
            points = {r.code.name: (r.kilobytes, 100.0 * np.median(getattr(r, how)[light])) for r in results}
            family = [at for name, at in points.items() if name.startswith("harmonics")]
            axes.plot(*zip(*family, strict=True), color=colour, marker=".", label=f"harmonics, {light}")
            for name, marker in (("omnibotd", "*"), ("cells, 2 bits", "^"), ("cells, 4 bits", "s")):
                label = name if light == LIGHTS[0] else None
                axes.plot(*points[name], marker, color=colour, markersize=9, label=label)
        axes.axvline(LIMIT, color="#cccccc", zorder=0)
        axes.set(
            title=title, xlabel="KB per 1000 nodes, on disk with links", ylabel="median error (cm)", ylim=(0, None)
        )
    axes.legend(frameon=False)
    figure.savefig(path, dpi=110)


def main() -> int:
    """Prints a table."""
    parser = argparse.ArgumentParser(prog="tools/map-size", description=__doc__)
    parser.add_argument("--seed", type=int, default=1, help="of the ceilings and drives")
    parser.add_argument("--plot", type=Path, help="write a picture of the table there")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    rooms = [room(factory, options.seed) for factory in CEILINGS]
    print(", ".join(f"{len(r.topo_map)} nodes, {len(r.topo_map.edges)} links ({r.topo_map.name})" for r in rooms))
    print(f"{'cm, median and 95 %':37}  " + " ".join(f"{light:^31}" for light in LIGHTS))
    print(f"{'code':22}{'bytes':>6}{'KB/1000':>9}  " + " ".join(2 * [f"{'tracked':>15} {'from nothing':>15}"]))
    results = []
    for result in sweep(rooms):
        results.append(result)
        print(row(result), flush=True)
    if options.plot:
        draw(results, options.plot)
    return 0


if __name__ == "__main__":
    sys.exit(main())
