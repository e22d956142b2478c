"""Goes to a node of the action map: localise, search, do the first action, localise again (thesis §6.4.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from omnibotd.core.discrete.action_map import NOTHING, ActionMap, Locator
from omnibotd.core.discrete.actions import Action
from omnibotd.core.errors import MapError
from omnibotd.core.thesis.route import ways_to

MAX_ACTIONS = 200  # [assumed]; the thesis' robot needed 30 to 83


@dataclass(frozen=True, slots=True)
class Step:
    """At `node`: what to do next; None at the target, or where similarity links alone lead there [assumed]."""

    node: int
    action: Action | None


class DiscreteNavigator:
    """One trip to a node, in action steps; ask it only while the robot stands."""

    def __init__(self, made: ActionMap, target: int) -> None:
        """MapError where the map has no such node."""
        if not 0 <= target < len(made):
            raise MapError(f"no node {target}: the map has {len(made)}")
        self._map, self._target, self._locator = made, target, Locator(made)
        # The thesis searches from the robot's node each time: one search from the target holds the same ways.
        self._ways = ways_to(target, made.first, made.second, made.costs, len(made))

    def step(self, perception: ArrayLike) -> Step:
        """What to do where this is perceived. MapError where no way leads to the target."""
        node = self._locator.node(perception)
        if node == self._target:
            return Step(node, None)
        if not np.isfinite(self._ways.cost[node]):
            raise MapError(f"no link leads from node {node} to node {self._target}")
        return Step(node, self._first_action(node))

    def _first_action(self, node: int) -> Action | None:
        """Of the way on, past look-alikes, for which nothing is to be done; None where one of these is the target."""
        at = node
        while at != self._target:
            link = int(self._ways.link[at])
            ahead = int(self._map.first[link]) == at
            if self._map.actions[link] != NOTHING:
                action = Action(int(self._map.actions[link]))
                return action if ahead else action.inverse
            at = int(self._map.second[link] if ahead else self._map.first[link])
        return None
