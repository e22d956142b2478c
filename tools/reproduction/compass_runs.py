"""Every compass on the drives of section 4.4: in a mirror, under ceilings, and on the real frames of a lamp grid."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.compass.ceiling_tracker import CeilingTracker
from omnibotd.core.compass.image_flow import ImageFlow
from omnibotd.core.compass.labrosse import Labrosse, ReferenceLabrosse
from omnibotd.core.compass.registered import Registered
from omnibotd.core.compass.round_view import Levelling, RoundView
from omnibotd.core.compass.turn import Compass
from omnibotd.core.compass.two_point import TwoPointFlow
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from tools.real_frames import DATA
from tools.reproduction.compass_drive import Drive, bare, drive, filmed, in_mirror, overhead
from tools.reproduction.compass_score import Score
from tools.sim import ceilings, reporting
from tools.sim.panorama import PanoramaError
from tools.sim.world import World

Floats = NDArray[np.float64]
Runs = dict[str, list[Score]]  # of each method, one for each seed

COMPASSES: dict[str, Callable[[], Compass]] = {
    "2-point flow": TwoPointFlow,
    "1D image flow": ImageFlow,
    "Labrosse (partial)": Labrosse,
    "Labrosse with reference": ReferenceLabrosse,
}
THESIS = ("2-point flow", "1D image flow", "Labrosse (partial)")
OURS = "ceiling tracker"
REGISTRATION = "registration of docking"
CEILINGS = {
    "tiles": ceilings.tiles,
    "beams": ceilings.beams,
    "photo": ceilings.photo,
    "ducts": reporting.ducts,
    "plain": ceilings.plain,
}
# Rooms and drives that nobody looked at while anything was tuned, which was done on 1 and 2; of ducts nothing ever was.
SEEDS = (41, 42, 43)
FRAMES, QUICK_FRAMES = 250, 16
SIMULATED = (0.5, math.radians(20.0))  # m/s and rad/s (§4.4.1)
REAL = (0.3, math.radians(28.0))  # m/s (§4.4.2), and what turns by the printed 0.0093 rad a frame
TEXTURED = 70  # frames of the real run until there was no texture
_LENS = CameraModel.equidistant(640, 480, math.radians(190.0))
_REDUCTION = 2  # of the fisheye's pictures, as for the tracker


@cache
def simulated(quick: bool) -> Runs:
    """In a mirror, between tiles and furniture."""
    return _of_seeds(quick, lambda seed, frames: _compared(*_simulated_views(seed, frames)))


@cache
def stand_in(quick: bool) -> Runs:
    """In a mirror, for the real run: from frame 70 on the walls have no edges."""
    return _of_seeds(quick, lambda seed, frames: _compared(*_half_bare_views(seed, frames)))


@cache
def under(quick: bool) -> dict[str, Runs]:
    """Under ceilings: the thesis' three and ours on the same frames; without the photographs where not here."""
    found = {}
    for name in ["plain"] if quick else CEILINGS:
        try:
            found[name] = _of_seeds(quick, lambda seed, frames, name=name: _under(name, seed, frames))
        except PanoramaError:
            continue
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """Errors (n,) of the heading, degrees, by method, on real frames."""

    errors: dict[str, Floats]


@cache
def followed(quick: bool) -> Followed | None:
    """On the frames of the lamp grid; None where they are not here."""
    film = filmed(DATA)
    if film is None:
        return None
    frames = film.frames[: 2 * QUICK_FRAMES] if quick else film.frames
    true = film.heading[: len(frames)]
    levelled = Levelling(film.camera, _REDUCTION)
    headings = {
        name: np.concatenate([[0.0], np.cumsum(turns)])
        for name, (turns, _) in _by_pairs([levelled(frame) for frame in frames]).items()
    }
    headings[OURS] = _tracked(frames, film.camera, film.height)
    headings[REGISTRATION] = _registered(frames, film.camera)
    # Backwards the same frames are another drive.
    backwards = frames[::-1]
    headings[f"{OURS}, backwards"] = true[-1] + _tracked(backwards, film.camera, film.height)[::-1]
    headings[f"{REGISTRATION}, backwards"] = true[-1] + _registered(backwards, film.camera)[::-1]
    return Followed({name: np.degrees(heading - true) for name, heading in headings.items()})


def _of_seeds(quick: bool, run: Callable[[int, int], dict[str, Score]]) -> Runs:
    frames = QUICK_FRAMES if quick else FRAMES
    runs = [run(seed, frames) for seed in (SEEDS[:1] if quick else SEEDS)]
    return {method: [scores[method] for scores in runs] for method in runs[0]}


def _simulated_views(seed: int, frames: int) -> tuple[Drive, list[RoundView]]:
    driven = drive(seed, *SIMULATED, frames)
    return driven, in_mirror(ceilings.tiles(seed), driven)


def _half_bare_views(seed: int, frames: int) -> tuple[Drive, list[RoundView]]:
    driven, world = drive(seed, *REAL, frames), ceilings.tiles(seed)
    textured = min(TEXTURED, frames // 2)
    views = in_mirror(world, Drive(driven.poses[:textured])) + in_mirror(bare(world), driven)[textured:]
    return driven, views


def _under(name: str, seed: int, frames: int) -> dict[str, Score]:
    world: World = CEILINGS[name](seed)
    driven = drive(seed, *SIMULATED, frames)
    seen, levelled = overhead(world, driven), Levelling(_LENS, _REDUCTION)
    scores = _compared(driven, [levelled(frame) for frame in seen])
    scores[OURS] = Score.of(driven.turns, np.diff(_tracked(seen, _LENS, world.room.rise)), 0)
    scores[REGISTRATION] = Score.of(driven.turns, np.diff(_registered(seen, _LENS)), 0)
    return scores


def _compared(driven: Drive, views: Sequence[RoundView]) -> dict[str, Score]:
    return {name: Score.of(driven.turns, turns, failures) for name, (turns, failures) in _by_pairs(list(views)).items()}


def _by_pairs(views: Sequence[RoundView]) -> dict[str, tuple[Floats, int]]:
    """Turns (n - 1,) and failures of each compass."""
    found = {}
    for name, make in COMPASSES.items():
        compass = make()
        turns = [compass.turn(before, now) for before, now in pairwise(views)]
        found[name] = np.array([turn.angle for turn in turns]), sum(not turn.ok for turn in turns)
    return found


def _tracked(frames: Sequence[Frame], camera: CameraModel, height: float) -> Floats:
    """Heading (n,) by sight alone, not wrapped."""
    tracker = CeilingTracker(camera, height)
    return np.unwrap([tracker.update(frame).pose.yaw for frame in frames])


def _registered(frames: Sequence[Frame], camera: CameraModel) -> Floats:
    """Heading (n,) by what docking registers ceilings with, not wrapped."""
    compass = Registered(camera)
    return np.cumsum([compass.turn(frame).angle for frame in frames])
