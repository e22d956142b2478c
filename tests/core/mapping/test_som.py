"""The self-organising map: acceptance of the thesis' colour example, torus, errors, determinism."""

from __future__ import annotations

import numpy as np
import pytest

from omnibotd.core.errors import MapError
from omnibotd.core.mapping import som as training
from omnibotd.core.mapping.som import Som, torus_distances

COLOURS = np.random.default_rng(7).uniform(0.0, 1.0, (1000, 3)).astype(np.float32)


@pytest.fixture(scope="module")
def colours() -> Som:
    return Som.train(COLOURS, side=20, seed=1)


def neighbour_distance(som: Som, axis: int) -> np.ndarray:
    grid = som.codebook.reshape(som.side, som.side, -1)
    return np.linalg.norm(grid - np.roll(grid, 1, axis), axis=-1)


def test_neighbours_are_alike(colours: Som) -> None:
    near = np.mean([neighbour_distance(colours, axis).mean() for axis in (0, 1)])
    rng = np.random.default_rng(0)
    a, b = colours.codebook[rng.integers(0, 400, (2, 2000))]
    assert near < 0.5 * np.linalg.norm(a - b, axis=1).mean()


def test_opposite_edges_are_neighbours(colours: Som) -> None:
    steps = neighbour_distance(colours, 1)
    assert steps[:, 0].mean() < 1.5 * steps[:, 1:].mean()


def test_topographic_error_is_far_below_that_of_a_shuffled_map(colours: Som) -> None:
    order = np.random.default_rng(3).permutation(len(colours.codebook))
    shuffled = Som(colours.codebook[order])
    assert colours.topographic_error(COLOURS) < 0.3 * shuffled.topographic_error(COLOURS)
    assert colours.quantization_error(COLOURS) == pytest.approx(shuffled.quantization_error(COLOURS))


def test_quantization_error_and_bmu_by_hand() -> None:
    som = Som(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], np.float32))
    samples = np.array([[0.9, 0.0], [0.0, 0.8], [0.5, 0.0]], np.float32)
    assert som.bmu(samples).tolist() == [1, 2, 0]  # the tie goes to the lowest index
    assert som.quantization_error(samples) == pytest.approx((0.1 + 0.2 + 0.5) / 3)


def test_topographic_error_by_hand() -> None:
    codebook = np.full((25, 1), 100.0, np.float32)
    codebook[0], codebook[12], codebook[4] = 0.0, 1.0, 10.0  # unit 12 is in the middle, 4 across the edge from 0
    assert Som(codebook).topographic_error([[0.1]]) == 1.0
    codebook[12] = 50.0
    assert Som(codebook).topographic_error([[0.1]]) == 0.0


def test_torus_distances() -> None:
    distances = torus_distances(10)
    assert distances[0, 9] == 1.0
    assert distances[0, 99] == pytest.approx(2**0.5)
    assert distances.max() == pytest.approx(50**0.5)
    np.testing.assert_array_equal(distances, distances.T)


def test_same_seed_same_bits() -> None:
    again = [Som.train(COLOURS[:200], side=6, seed=4).codebook for _ in range(2)]
    assert again[0].tobytes() == again[1].tobytes()
    assert Som.train(COLOURS[:200], side=6, seed=5).codebook.tobytes() != again[0].tobytes()


def test_the_best_of_several_attempts_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = [Som.train(COLOURS, side=8, seed=seed).topographic_error(COLOURS) for seed in range(3)]
    monkeypatch.setattr(training, "_ATTEMPTS", 1)
    first = [Som.train(COLOURS, side=8, seed=seed).topographic_error(COLOURS) for seed in range(3)]
    assert all(k <= f for k, f in zip(kept, first, strict=True))
    assert sum(kept) < sum(first)


def test_blocks_change_nothing(colours: Som, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = colours.distances(COLOURS), colours.topographic_error(COLOURS), colours.quantization_error(COLOURS)
    monkeypatch.setattr(training, "_BLOCK", 77)  # of 1000 samples: the last block is not full
    np.testing.assert_allclose(colours.distances(COLOURS), whole[0], atol=2e-3)  # root of what rounding leaves at zero
    assert colours.topographic_error(COLOURS) == pytest.approx(whole[1], abs=2e-3)
    assert colours.quantization_error(COLOURS) == pytest.approx(whole[2], rel=1e-3)
    np.testing.assert_array_equal(colours.bmu(COLOURS), colours.distances(COLOURS).argmin(1))


def test_fewer_samples_than_units() -> None:
    som = Som.train(COLOURS[:7], side=6)
    assert som.codebook.shape == (36, 3)
    assert som.quantization_error(COLOURS[:7]) < 0.1


def test_units_stay_within_the_data(colours: Som) -> None:
    assert colours.codebook.min() >= COLOURS.min() - 1e-6
    assert colours.codebook.max() <= COLOURS.max() + 1e-6


@pytest.mark.parametrize("bad", [np.zeros((0, 3)), np.zeros(3), np.array([[np.nan, 1.0]]), np.array([[np.inf, 1.0]])])
def test_unusable_samples_are_refused(bad: np.ndarray) -> None:
    with pytest.raises(MapError):
        Som.train(bad)


def test_other_features_are_refused(colours: Som) -> None:
    with pytest.raises(MapError, match="4 features"):
        colours.bmu(np.zeros((2, 4)))
