"""Training of the self-organising map beside MiniSom and the thesis' schedule, on the spectra of one teaching drive."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from minisom import MiniSom
from numpy.typing import NDArray

from omnibotd.core.mapping.som import Som
from omnibotd.core.thesis import som as thesis_som
from omnibotd.core.thesis.som import SIDE
from omnibotd.core.vision.descriptor import Descriptor
from tools.benchmark import rooms
from tools.benchmark.measuring import Times

Floats = NDArray[np.float32]
Train = Callable[[Floats, int], Floats]  # (samples, seed) -> codebook

EPOCHS, FEW_EPOCHS = 500, 30  # the thesis', and about as many as batch training takes
SEEDS = 3


def measure(samples: int, epochs: int) -> dict[str, Any]:
    """Seconds and both errors of each trainer: the means of three seeds, but one of those that take half a minute.

    MiniSom has no torus. On its plane, neighbours are neighbours on the torus too, so the one topographic error, with
    the torus' neighbours, is never to its disadvantage.
    """
    data = np.asarray(Descriptor.spectrum(rooms.views(rooms.SEED, samples)))
    few = min(FEW_EPOCHS, epochs)
    trainers: dict[str, tuple[Train, int]] = {
        "ours": (lambda x, seed: Som.train(x, SIDE, seed).codebook, SEEDS),
        f"MiniSom as it comes, {few} epochs": (_minisom(few), SEEDS),
        f"MiniSom as it comes, {epochs} epochs": (_minisom(epochs), 1),
        f"MiniSom, radius 5 to 1, rate 0.9 to 0, {epochs} epochs": (_minisom(epochs, **_WIDE), 1),
        f"thesis' schedule, {epochs} epochs": (lambda x, seed: thesis_som.train(x, epochs=epochs, seed=seed), 1),
    }
    rows = {name: _row(train, seeds, data) for name, (train, seeds) in trainers.items()}
    for row in rows.values():
        row["of_ours"] = row["seconds"] / rows["ours"]["seconds"]
    return {"samples": len(data), "features": data.shape[1], "units": SIDE**2, "trainers": rows}


_WIDE = {
    "sigma": SIDE / 2.0,
    "learning_rate": thesis_som.RATE,
    "decay_function": "linear_decay_to_zero",
    "sigma_decay_function": "linear_decay_to_one",
}


def _minisom(epochs: int, **options: Any) -> Train:
    def train(data: Floats, seed: int) -> Floats:
        som = MiniSom(SIDE, SIDE, data.shape[1], random_seed=seed, **options)
        som.random_weights_init(data)
        som.train(data, epochs, random_order=True, use_epochs=True)
        return np.asarray(som.get_weights().reshape(SIDE**2, -1), np.float32)

    return train


def _row(train: Train, seeds: int, data: Floats) -> dict[str, float]:
    times = Times()
    soms = [Som(times.measure("training", lambda seed=seed: train(data, seed))) for seed in range(seeds)]
    return {
        "seconds": times.median("training") / 1e9,
        "quantisation_error": math.fsum(som.quantization_error(data) for som in soms) / seeds,
        "topographic_error": math.fsum(som.topographic_error(data) for som in soms) / seeds,
        "seeds": seeds,
    }
