"""Is a lens measured well enough to be believed, and if not, where is the board to be held?"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.calibration import lens_model
from omnibotd.core.calibration.lens_fit import TOLERANCE, Fit, Observations, normal_equations
from omnibotd.core.percept import Verdict

Floats = NDArray[np.float64]
Circle = tuple[float, float, float]
"""Of the image: cx, cy, radius, px."""

# Eight unknowns of the lens could be had from two views; that they agree shows from some more.
FEWEST_VIEWS = 5
# Where the projection's uncertainty is looked at (rad): the view of the ceiling ends there.
RIM = math.radians(80.0)
# Uncertainty tolerated there, and misfit, in shares of the longer side: 1.3 and 1 px of 640.
_MOST_SIGMA, _MOST_RMS = 0.002, 0.0016
# Corners must have been seen out to this share of the way to the picture's edge, or of the rim where that is nearer.
_LEAST_REACH = 0.75
# In a sector, corners beyond this share of the way to its edge say how the lens is there.
_SECTOR_REACH = 0.5
# Neighbouring sectors (of 45 degrees) without any that are tolerated: a lens is round, but not quite round.
_MOST_BARE = 2
# A lens that sees less to any side (rad) is no fisheye: no ring of ceiling around the robot.
_NARROW = math.radians(55.0)
# More than this share of the views contradicting the rest means that something is wrong with all.
_MOST_DROPPED = 0.4
_SECTORS = ("right", "bottom right", "bottom", "bottom left", "left", "top left", "top", "top right")
# Beyond the outermost corner, or the rim, a lens is believed for so many more radians.
_BEYOND = math.radians(10.0)
_CELLS = 12  # the picture's shorter side is divided into so many for the coverage


@dataclass(frozen=True, slots=True)
class Evidence:
    """What speaks for a fit. Angles in rad, by the sectors right, bottom right ... of the picture: `edges` to which
    the picture reaches, `reached` to which corners were seen, 0 where none. `folded` is a lens that would image two
    rays at one place, for want of corners farther out. The rest as in LensResult."""

    rms: float
    longer: int
    edges: Floats
    reached: Floats
    covered: float
    coverage: float
    edge_sigma: float
    fov: float
    folded: bool

    @property
    def rim(self) -> float:
        """The zenith angle (rad) for which `edge_sigma` holds."""
        return min(RIM, float(self.edges.max()))


def evidence_of(fit: Fit, seen: Observations, size: tuple[int, int], circle: Circle | None) -> Evidence:
    """All that the verdict rests on. Where no circle shows, the picture is image to its corners."""
    radius = math.inf if circle is None else circle[2]
    points = fit.in_camera(seen)
    theta = np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])
    sectors = _sector(seen.corners - fit.lens[2:4])
    reached = np.array([theta[sectors == k].max(initial=0.0) for k in range(8)])
    edges = np.maximum(_edges(fit.lens, size, radius), reached)
    covered, edge = float(theta.max()), float(edges.max())
    used = np.linspace(0.0, max(covered, min(RIM, edge)), 100)
    return Evidence(
        rms=math.sqrt(float((fit.residuals(seen) ** 2).sum(1).mean())),
        longer=max(size),
        edges=edges,
        reached=reached,
        covered=covered,
        coverage=_coverage(fit.lens, seen.corners, size, radius),
        edge_sigma=_sigma(fit, seen, min(RIM, edge)),
        fov=2.0 * min(edge, max(covered, RIM) + _BEYOND),
        folded=bool((lens_model.slope(fit.lens, used) <= 0.0).any()),
    )


def _sector(offsets: Floats) -> NDArray[np.intp]:
    return (np.round(np.arctan2(offsets[:, 1], offsets[:, 0]) / (math.pi / 4.0)).astype(np.intp)) % 8


def _edges(lens: Floats, size: tuple[int, int], radius: float) -> Floats:
    """(8,) zenith angles at which the picture ends in each sector."""
    angles = np.arange(8) * math.pi / 4.0
    across = np.column_stack([np.cos(angles), np.sin(angles)])
    across[np.abs(across) < 1e-9] = 1e-9
    to_border = np.where(across > 0, (np.array(size) - 1.0 - lens[2:4]) / across, -lens[2:4] / across).min(1)
    r = np.clip(to_border, 0.0, radius) / lens[:2].mean()
    theta = lens_model.zenith(lens, r)
    return np.where(np.isnan(theta), np.minimum(r, math.pi), theta)  # folded before: as far as the middle promises


def _coverage(lens: Floats, corners: Floats, size: tuple[int, int], radius: float) -> float:
    """Share of the picture's cells, within the circle, that had a corner in or next to them."""
    side = min(size) / _CELLS
    shape = (math.ceil(size[1] / side), math.ceil(size[0] / side))
    v, u = (np.indices(shape) + 0.5) * side
    within = np.hypot(u - lens[2], v - lens[3]) <= radius
    had = np.zeros((shape[0] + 2, shape[1] + 2), bool)
    cells = np.clip((corners / side).astype(int), 0, np.array(shape[::-1]) - 1)
    for x in (0, 1, 2):
        for y in (0, 1, 2):
            had[cells[:, 1] + y, cells[:, 0] + x] = True
    return float((had[1:-1, 1:-1] & within).sum() / max(within.sum(), 1))


def _sigma(fit: Fit, seen: Observations, rim: float) -> float:
    """Standard deviation (px) of where a ray at zenith angle `rim` is projected, to the side where it is largest.

    The larger of two estimates: from the residuals' spread as if corners erred independently, and from how far each
    view alone would pull the lens (a "sandwich" clustered by view), which also knows of boards that are not flat.
    """
    system = normal_equations(fit, seen, TOLERANCE * fit.spread(seen))
    unknowns = 8 + 6 * len(seen.starts)
    variance = float((fit.residuals(seen) ** 2).sum()) / max(2 * len(seen.corners) - unknowns, 1)
    inverse = np.linalg.pinv(system.reduced)
    views = len(seen.starts)
    by_view = inverse @ (system.scores.T @ system.scores) @ inverse * views / (views - 3.0)
    rays = _ring(rim)
    by_lens = lens_model.derivatives(fit.lens, rays)[0]
    return math.sqrt(
        max(float(np.einsum("nki,ij,nkj->n", by_lens, cov, by_lens).max()) for cov in (variance * inverse, by_view))
    )


def _ring(theta: float) -> Floats:
    """(16, 3) rays at a zenith angle."""
    angles = np.arange(16) * math.pi / 8.0
    across = math.sin(theta)
    return np.column_stack([across * np.cos(angles), across * np.sin(angles), np.full(16, math.cos(theta))])


def too_few(distinct: int, dropped: int) -> str:
    """What to say to so few usable views."""
    besides = f" ({dropped} others could not be used)" if dropped else ""
    return (
        f"Only {distinct} different views of the board{besides}, and {FEWEST_VIEWS} is the least: take 15 to 25, "
        "with the board in the middle, near each edge and in each corner of the picture, leant this way and that"
    )


def judge(evidence: Evidence, used: int, contradicting: int) -> tuple[Verdict, str]:
    """Accepted or rejected, and the sentence for the user: why, and what to do."""
    if objection := _objection(evidence, used, contradicting):
        return Verdict.REJECTED, objection
    good = (
        f"Good to {evidence.edge_sigma:.2g} px at {math.degrees(evidence.rim):.0f} degrees off axis: "
        f"{used} views out to {math.degrees(evidence.covered):.0f} degrees, {evidence.rms:.2f} px rms"
    )
    bare = _bare(evidence)
    return Verdict.ACCEPTED, f"{good}; views near the {_listed(bare)} edge would make it better" if bare else good


def _objection(evidence: Evidence, used: int, contradicting: int) -> str | None:
    """The first thing that is wrong, the most fundamental first."""
    seen, reaches, rim = (
        f"{math.degrees(angle):.0f}" for angle in (evidence.covered, evidence.edges.max(), evidence.rim)
    )
    if contradicting > _MOST_DROPPED * (used + contradicting):
        return (
            f"{contradicting} of {used + contradicting} views contradict the rest: use pictures of one camera at one "
            "size and focus, neither cut nor corrected, and a flat board of squares"
        )
    if not evidence.rms < _MOST_RMS * evidence.longer:
        return (
            f"The corners lie {evidence.rms:.1f} px (rms) off any lens: hold the board still, in focus and in good "
            "light, and glue it to something flat"
        )
    if evidence.edges.max() < _NARROW:
        return (
            f"This lens sees no farther than {reaches} degrees off axis: it is no fisheye. To see the ceiling all "
            "round the robot needs one of 75 degrees or more"
        )
    if evidence.covered < _LEAST_REACH * evidence.rim or evidence.folded:
        return (
            f"The board was seen only as far as {seen} degrees off axis, and the picture reaches {reaches}: hold the "
            f"board nearer the {_listed(_weakest(evidence))} edge"
        )
    if len(bare := _bare(evidence)) > _MOST_BARE:
        return f"The board was hardly seen on one side of the picture: hold it nearer the {_listed(bare)} edge"
    if not evidence.edge_sigma < _MOST_SIGMA * evidence.longer:
        return (
            f"At {rim} degrees off axis the lens is known to {evidence.edge_sigma:.1f} px only: take more views, "
            f"nearer the {_listed(_weakest(evidence))} edge, with the board large in the picture and leant"
        )
    return None


def _bare(evidence: Evidence) -> list[int]:
    """The longest run of neighbouring sectors without corners far off axis; a single one is no gap."""
    bare = (evidence.reached < _SECTOR_REACH * np.minimum(evidence.edges, RIM)).tolist()
    if all(bare):
        return list(range(8))
    runs: list[list[int]] = [[]]
    first = bare.index(False)
    for k in (*range(first, 8), *range(first)):
        if bare[k]:
            runs[-1].append(k)
        elif runs[-1]:
            runs.append([])
    longest = max(runs, key=len)
    return longest if len(longest) > 1 else []


def _weakest(evidence: Evidence) -> list[int]:
    """Sectors to hold the board into: those without corners, else the one where they stay farthest from the edge."""
    shares = evidence.reached / np.maximum(np.minimum(evidence.edges, RIM), 1e-9)
    return _bare(evidence) or [int(np.argmin(shares))]


def _listed(sectors: list[int]) -> str:
    """The edges among these sectors: corners need no mention beside the edges that meet there."""
    edges = [k for k in sectors if k % 2 == 0] or sectors
    if len(edges) == 4:
        return "right, bottom, left and top"
    names = [_SECTORS[k] for k in edges]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
