"""From a few centimetres to millimetres, and how sure: pose and walls together, on finer and finer layers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from omnibotd.core.docking.ceiling_view import FINE, MIDDLE, CeilingView, Layer
from omnibotd.core.docking.matching import Floats, Poses, Residuals, Sample, bounded, residuals, shifted
from omnibotd.core.docking.walls import NO_WALLS, Doubles, Walls, WallSearch

# Cells a side from which one point each is sampled.
_MIDDLE_CELLS, _FINE_CELLS = 32, 60
_ITERATIONS = 6
# Steps below this many pixels change nothing.
_ENOUGH = {MIDDLE: 0.02, FINE: 0.01}
# Neighbouring points err alike: one in fourteen says something new.
_ALIKE = 14.0
# Ceiling heights from the target from which on walls show; the misfit that needs no wall, and what one must take off.
_PARALLAX, _EXPLAINED, _WALL_GAIN = 0.01, 0.15, 0.02
# Tracked frames from one look for walls to the next.
_LOOK_EVERY = 3
# Walls not known of make the target seem farther away than it is.
_NEARER = (1.0, 0.6)
# Correlation from which walls are believed and remembered, and how much of what is known each frame forgets.
_BELIEVED, _FADED = 0.35, 0.9
# Walls turn into one another or run away where the view doesn't hold them: a step is at most this share of one.
_WALL_STEP, _WALL_RIDGE = 0.2, 0.05


@dataclass(frozen=True, slots=True)
class Refined:
    """`pose` (3,), its covariance as far as the picture tells, the misfit, and the correlation of the views."""

    pose: Poses
    covariance: Doubles
    walls: Walls
    misfit: float
    correlation: float


class Refinement:
    """Refines poses against one target view. Learns the walls it was taken at from the frames that they explain."""

    def __init__(self, target: CeilingView) -> None:
        self._samples = {
            MIDDLE: Sample.of(target.layer(MIDDLE), _MIDDLE_CELLS),
            FINE: Sample.of(target.layer(FINE), _FINE_CELLS),
        }
        self._search = WallSearch(self._samples[MIDDLE])
        self.walls = NO_WALLS
        self._tracked = 0

    def refine(self, view: CeilingView, start: Poses, spread: tuple[float, float] | None) -> Refined:
        """From `start` (3,), right to `spread` (rad, ceiling heights; 1 sigma) where anything is known of it."""
        known = np.zeros(3) if spread is None else np.array([spread[0], spread[1], spread[1]]) ** -2.0
        prior = (start, np.diag(known))
        layer = view.layer(MIDDLE)
        middle = self._solved(layer, start, self.walls, prior)
        if shifted(start) > _PARALLAX and middle.misfit > _EXPLAINED:
            for walls, nearer in self._guesses(every=spread is None):
                middle = self._walled(layer, start * (1.0, nearer, nearer), walls, prior, middle)
        fine = self._solved(view.layer(FINE), middle.pose, middle.walls, prior)
        if fine.correlation > _BELIEVED:
            self.walls = fine.walls
        return fine

    def _guesses(self, every: bool) -> list[tuple[Walls, float]]:
        """What to try: the walls known or none of them, the target as far away as it seems or nearer.

        Each takes a third of a tracking estimate: while tracking one in turn, every third frame.
        """
        known = [self.walls] if len(self.walls) == 0 else [self.walls, NO_WALLS]
        guesses = [(walls, nearer) for walls in known for nearer in _NEARER]
        if every:
            return guesses
        turn, resting = divmod(self._tracked, _LOOK_EVERY)
        self._tracked += 1
        return [] if resting else [guesses[turn % len(guesses)]]

    def _walled(self, layer: Layer, start: Poses, known: Walls, prior: tuple[Poses, Doubles], best: Refined) -> Refined:
        """The best so far, or with more walls than those known if that explains the view better."""
        walls = self._search.more(layer, start, known)
        if len(walls) == len(known):
            return best
        walled = self._solved(layer, start, walls, prior)
        return walled if walled.misfit < best.misfit - _WALL_GAIN * (len(walls) - len(known)) else best

    def _solved(self, layer: Layer, pose: Poses, walls: Walls, prior: tuple[Poses, Doubles]) -> Refined:
        """Gauss-Newton on pose and walls; `prior` is a pose and the information on it."""
        sample, first = self._samples[layer.size], walls
        for _ in range(_ITERATIONS):
            found = residuals(sample, layer, pose[None], walls.nearness(sample.at))
            normal, pull, noise = _normal(sample, found, pose, walls)
            system, moved = normal.copy(), pull.copy()
            system[:3, :3] += noise * prior[1]
            moved[:3] += noise * prior[1] @ (pose - prior[0])
            system[3:, 3:] += first.information + _WALL_RIDGE * np.eye(2 * len(walls))
            moved[3:] += first.information @ (walls.towards - first.towards).ravel()
            step = np.asarray(-np.linalg.solve(system, moved), np.float64)
            pose = np.add(pose, bounded(step[None, :3], layer.focal)[0])
            walls = walls.moved(walls.towards + _bounded(step[3:].reshape(-1, 2), walls.towards))
            if np.abs(step[:3]).max() * layer.focal < _ENOUGH[layer.size]:
                break
        known = replace(walls, information=_FADED * first.information + _marginal(normal))
        covariance = np.asarray(noise * np.linalg.inv(system)[:3, :3], np.float64)
        return Refined(pose, covariance, known, float(found.misfit(sample.chance)[0]), float(found.correlation()[0]))


def _normal(sample: Sample, found: Residuals, pose: Poses, walls: Walls) -> tuple[Doubles, Doubles, float]:
    """Normal matrix and gradient over pose and walls (3 + 2m), and the noise that a unit of information has."""
    rows, difference = [found.jacobian()[0]], found.difference[0]
    weight = found.weight[0] * found.alikeness()[0]
    if len(walls):
        along = -np.einsum("an,a->n", found.slope[:, 0], pose[1:].astype(np.float32))
        met = walls.met(sample.at)
        rows += [along * (met == k + 1) * sample.at for k in range(len(walls))]
    jacobian: Floats = np.concatenate(rows)
    weighted = jacobian * weight
    normal = (weighted @ jacobian.T).astype(np.float64)
    normal[:3, :3] += 0.1 * np.eye(3)
    noise = _ALIKE * float((weight * difference**2).sum() / max(float(weight.sum()), 1.0))
    return normal, (weighted @ difference).astype(np.float64), noise


def _marginal(normal: Doubles) -> Doubles:
    """What a normal matrix says about the walls, whatever the pose is."""
    return np.asarray(normal[3:, 3:] - normal[3:, :3] @ np.linalg.solve(normal[:3, :3], normal[:3, 3:]), np.float64)


def _bounded(steps: Doubles, towards: Doubles) -> Doubles:
    most = _WALL_STEP * np.hypot(*towards.T)[:, None] + 0.05
    return np.asarray(steps * np.minimum(1.0, most / np.maximum(np.hypot(*steps.T)[:, None], 1e-9)), np.float64)
