"""Where does the base stand to the dock? Fixes at rest, from nothing or from where it is expected, until they agree."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

from omnibotd.core.decision import Observation
from omnibotd.core.docking.sightings import Sightings, agree, dock_from_odom
from omnibotd.core.docking.states import Action, Event
from omnibotd.core.geometry import Pose2D
from omnibotd.core.percept import HomingEstimate, Verdict

# Independent fixes at rest agree within this before the robot moves (m, rad).
_AGREEMENT, _AGREEMENT_YAW = 0.05, math.radians(5.0)
# Two sure fixes that agree are enough, or four of which none is.
_VOTES: Mapping[Verdict, int] = {Verdict.ACCEPTED: 2, Verdict.AMBIGUOUS: 1, Verdict.REJECTED: 0}
_VOTES_NEEDED = 4
# Share of the patience for which a sure map is taken at its word: in the dark a fix from nothing finds another beam
# ten times as often as one from the pose expected.
_BY_THE_MAP = 0.5
# Twice the votes needed: older fixes say nothing new.
_REMEMBERED_FIXES = 8
# A map that is sure of its pose is right within a fraction of this (m, rad); the next tile of a ceiling is farther.
_EXPECTED, _EXPECTED_YAW = 0.45, math.radians(30.0)
# With the contact closed, nearer than this (m, rad) to the dock's pose is that dock.
_CONTACT, _CONTACT_YAW = 0.1, math.radians(10.0)
# Contacts meet askew, too; this near (m, rad) the base sits in its dock as it should.
_SEATED, _SEATED_YAW = 0.01, math.radians(0.75)


def as_expected(dock_from_base: Pose2D, expected: Pose2D | None) -> bool:
    """Whether a fix can be true where the map expects the base at `expected`; anything can without a map."""
    return expected is None or agree(dock_from_base, expected, _EXPECTED, _EXPECTED_YAW)


def at_contact(observation: Observation, dock_from_base: Pose2D) -> bool:
    """Whether the base charges, and at this dock."""
    return bool(observation.charging) and agree(dock_from_base, Pose2D(), _CONTACT, _CONTACT_YAW)


def seated(dock_from_base: Pose2D) -> bool:
    """Whether there is nothing left to align for a base on its contact."""
    return agree(dock_from_base, Pose2D(), _SEATED, _SEATED_YAW)


class Looking:
    """One look; `step` until it returns an event. `located` is then the fix that decided, None where none did."""

    def __init__(self, sightings: Sightings, began: float, patience: float, map_says: Pose2D | None) -> None:
        """`patience` in seconds from `began`; `map_says` is the dock_from_odom that a sure map expects.

        Fixes that contradict a sure map are aliases of the true one. One that agrees with it need not be sure itself.
        At first it looks where the map expects the dock, each time from where it was seen last; then from nothing.
        """
        self._sightings, self._end, self._map_says = sightings, began + patience, map_says
        self._from_nothing = began if map_says is None else began + _BY_THE_MAP * patience
        self._expected = map_says
        self._fixes: deque[HomingEstimate] = deque(maxlen=_REMEMBERED_FIXES)
        self.located: HomingEstimate | None = None
        self.contradicted = False  # by a fix that is sure, so that the map's word is not to be driven by
        self.seen: dict[str, float] = {"fixes": 0.0, "ambiguous": 0.0, "contradict_map": 0.0}

    def step(self, observation: Observation) -> Event | Action:
        """LOCATED, UNSEEN, CHARGING (LOCATED in the dock, on its contact), or what to ask next."""
        fix = self._sightings.take_at_rest(observation)
        if fix is not None and self._counts(fix) and self._votes(fix) >= _VOTES_NEEDED:
            self.located = fix
            return Event.CHARGING if at_contact(observation, fix.dock_from_base) else Event.LOCATED
        if observation.stamp > self._end:
            return Event.UNSEEN
        if self._expected is not None and observation.stamp > self._from_nothing:
            self._expected = None
            self._fixes.clear()
        return Action(homing=self._sightings.ask(self._expected))

    def _counts(self, fix: HomingEstimate) -> bool:
        """Keeps a fix that may be true, and counts what came."""
        expected = None if self._map_says is None else self._map_says @ fix.odom_from_base
        alias = not as_expected(fix.dock_from_base, expected)
        self.contradicted |= alias and fix.verdict is Verdict.ACCEPTED
        self.seen["fixes"] += 1.0
        self.seen["ambiguous"] += fix.verdict is Verdict.AMBIGUOUS
        self.seen["contradict_map"] += alias and fix.verdict is not Verdict.REJECTED
        self.seen["score"], self.seen["margin"] = fix.score, fix.margin
        if alias or fix.verdict is Verdict.REJECTED:
            return False
        self._fixes.append(fix)
        if self._expected is not None:
            self._expected = dock_from_odom(fix)
        return True

    def _votes(self, fix: HomingEstimate) -> int:
        pose = fix.dock_from_base
        alike = [f for f in self._fixes if agree(f.dock_from_base, pose, _AGREEMENT, _AGREEMENT_YAW)]
        if self._expected is not None:
            return len(alike)
        return sum(_VOTES[f.verdict] if self._map_says is None else _VOTES[Verdict.ACCEPTED] for f in alike)
