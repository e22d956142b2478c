"""The online SOM: its schedule against the printed equations, and the products trick against the plain loop."""

import math

import numpy as np
import pytest

from omnibotd.core.errors import MapError
from omnibotd.core.thesis import som


def plain(samples: np.ndarray, side: int, epochs: int, seed: int) -> np.ndarray:
    """Spec 02 section 6, step for step."""
    rng = np.random.default_rng(seed)
    weights = rng.uniform(samples.min(0), samples.max(0), (side * side, samples.shape[1]))
    for t in range(epochs):
        reach = side / 2 * math.exp(-10 * t**2 / epochs**2)
        damp = 0.9 * math.exp(-(t**2) / epochs**2)
        for x in samples[rng.permutation(len(samples))]:
            winner = min(range(side * side), key=lambda i: float(((x - weights[i]) ** 2).sum()))
            for i in range(side * side):
                rows, columns = abs(i // side - winner // side), abs(i % side - winner % side)
                apart = math.hypot(min(rows, side - rows), min(columns, side - columns))
                if apart <= reach or i == winner:
                    factor = 1.0 if i == winner else math.exp(-(apart**2) / reach**2)
                    weights[i] += damp * factor * (x - weights[i])
    return weights


@pytest.mark.parametrize(("count", "features"), [(12, 40), (30, 5)])  # fewer samples than features, and more
def test_it_equals_the_plain_loop(count: int, features: int) -> None:
    samples = np.random.default_rng(3).normal(10.0, 3.0, (count, features))
    fast = som.train(samples, side=4, epochs=20, seed=7)
    assert fast == pytest.approx(plain(samples, 4, 20, 7), rel=1e-5, abs=1e-5)


def test_the_schedule_is_the_printed_one() -> None:
    assert som.radius(0) == 5.0  # half of ten
    assert som.radius(500) == pytest.approx(5.0 * math.exp(-10))
    assert som.rates([0.0], 0)[0] == 0.9
    assert som.rates([0.0], 500)[0] == pytest.approx(0.331, abs=5e-4)
    assert som.rates([1.0, 5.0, 5.1], 0) == pytest.approx([0.9 * math.exp(-1 / 25), 0.9 * math.exp(-1), 0.0])


def test_from_epoch_201_only_the_winner_moves() -> None:
    """R_t < 1 from t = 500 sqrt(ln 5 / 10) = 200.6."""
    assert (som.rates([1.0], 200)[0] > 0.0) and som.rates([1.0], 201)[0] == 0.0


def test_the_same_seed_gives_the_same_bits() -> None:
    samples = np.random.default_rng(0).normal(size=(20, 6))
    first, again, other = (som.train(samples, side=3, epochs=10, seed=seed) for seed in (1, 1, 2))
    assert first.tobytes() == again.tobytes()
    assert first.tobytes() != other.tobytes()


def test_neighbours_grow_alike_and_the_edges_wrap() -> None:
    """Colours on a torus: neighbours, and neighbours across the edge, are nearer than units at random."""
    samples = np.random.default_rng(5).uniform(size=(120, 3))
    weights = som.train(samples, side=8, epochs=60, seed=5).reshape(8, 8, 3)
    beside = np.linalg.norm(weights - np.roll(weights, 1, 1), axis=-1)
    random = np.linalg.norm(weights.reshape(-1, 3)[:, None] - weights.reshape(-1, 3), axis=-1).mean()
    assert beside[:, 1:].mean() < 0.6 * random
    assert beside[:, 0].mean() < 0.6 * random


@pytest.mark.parametrize("samples", [np.zeros((0, 4)), np.zeros(4), np.array([[1.0, np.nan]])])
def test_what_cannot_be_learnt_is_refused(samples: np.ndarray) -> None:
    with pytest.raises(MapError, match="expected"):
        som.train(samples)
