"""The map of actions (thesis §6.4.4): a node before and after each, links that say what to do, look-alikes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnibotd.core.discrete.actions import Action
from omnibotd.core.errors import MapError
from omnibotd.core.thesis import som
from omnibotd.core.thesis.links import similar_pairs
from omnibotd.core.thesis.responses import Buckets, Classifier, Floats

SIDE = 7  # of the SOM
ACTION_COST, SIMILARITY_COST = 1.0, 3.0
# Similarity links a node has on average, [assumed]: the thesis does not print the threshold; this makes "a few".
LOOKALIKES = 4
# What a similarity link tells to do: nothing.
NOTHING = -1


def learn(perceptions: ArrayLike, seed: int = 0) -> Floats:
    """Phase I: the SOM's weights (49, q) of perceptions (n, q). MapError on empty or non-finite data."""
    return som.train(perceptions, side=SIDE, seed=seed)


@dataclass(frozen=True)
class ActionMap:
    """N nodes: `responses` (N, 49) to the SOM. Links from `first` to `second` (M,), to be taken either way.

    `actions` (M,) lead from the first to the second, their inverse back; NOTHING on similarity links. `costs` (M,);
    `threshold` is the difference of responses below which two nodes of one unit look alike.
    """

    codebook: Floats
    responses: Floats
    first: NDArray[np.int32]
    second: NDArray[np.int32]
    actions: NDArray[np.int8]
    costs: NDArray[np.float64]
    threshold: float

    def __len__(self) -> int:
        return len(self.responses)


class Explorer:
    """Phase II: files what is perceived before and after each action."""

    def __init__(self, codebook: Floats) -> None:
        self._codebook, self._classify = codebook, Classifier(codebook)
        self._responses: list[Floats] = []
        self._links: list[tuple[int, int, Action]] = []

    def look(self, perception: ArrayLike) -> int:
        """A node by itself; its number."""
        self._responses.append(self._classify(perception))
        return len(self._responses) - 1

    def acted(self, before: int, action: Action, perception: ArrayLike) -> int:
        """The node after an action from the node `before`; its number."""
        after = self.look(perception)
        self._links.append((before, after, action))
        return after

    def finished(self) -> ActionMap:
        """The map with similarity links. MapError where nothing was perceived."""
        if not self._responses:
            raise MapError("nothing was perceived while exploring: are all four tiles in sight?")
        responses = np.array(self._responses, np.float32)
        units = responses.argmin(1)
        threshold = _threshold(responses, units)
        alike = similar_pairs(responses, units, threshold)
        apart = np.linalg.norm(responses[alike[:, 0]] - responses[alike[:, 1]], axis=1)
        before, after, actions = np.array(self._links, np.int32).reshape(-1, 3).T
        return ActionMap(
            self._codebook,
            responses,
            np.concatenate([before, alike[:, 0]]),
            np.concatenate([after, alike[:, 1]]),
            np.concatenate([actions, np.full(len(alike), NOTHING)]).astype(np.int8),
            np.concatenate([np.full(len(actions), ACTION_COST), SIMILARITY_COST + apart]),
            threshold,
        )


class Locator:
    """Finds the node of a perception: in the winner's bucket and the eight round it (§6.4.5)."""

    def __init__(self, made: ActionMap) -> None:
        self._responses, self._classify = made.responses, Classifier(made.codebook)
        self._buckets = Buckets(made.responses.argmin(1), SIDE)

    def node(self, perception: ArrayLike) -> int:
        """The most alike; of equals the lowest."""
        response = self._classify(perception)
        nodes = self._buckets.near(int(response.argmin()), 1)
        return int(nodes[np.linalg.norm(self._responses[nodes] - response, axis=1).argmin()])


def _threshold(responses: Floats, units: NDArray[np.integer]) -> float:
    """Such that nodes have `LOOKALIKES` others of their unit below it, on average."""
    apart = np.sort(np.concatenate([np.zeros(0), *_within_units(responses, units)]))
    return float(apart[min(LOOKALIKES * len(responses) // 2, len(apart) - 1)]) if len(apart) else 0.0


def _within_units(responses: Floats, units: NDArray[np.integer]) -> Iterator[NDArray[np.floating]]:
    """Differences between the responses of each unit's nodes, each pair once."""
    order = np.argsort(units, kind="stable")
    for begin, end in pairwise(np.searchsorted(units[order], np.arange(SIDE * SIDE + 1))):
        some = responses[order[begin:end]]
        for k in range(1, len(some)):
            yield np.linalg.norm(some[k:] - some[k - 1], axis=1)
