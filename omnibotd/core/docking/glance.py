"""A short look from where the robot stands: is it in this dock already?"""

from __future__ import annotations

import math
from dataclasses import replace

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.docking.looking import Looking
from omnibotd.core.docking.sightings import Sightings, agree
from omnibotd.core.docking.states import Event, State
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Pose2D
from omnibotd.core.safety import danger

# Two sure fixes take a second or two, on an Atom as well; a dock that isn't seen by then won't be.
_PATIENCE = 4.0


class Glance:
    """Ends without an error where the base stands within `distance` m and `yaw` rad of the dock's pose, standing still.

    Its last state is then DOCKED where the base charges there, and nothing is left to do. The report tells the
    dock_from_base that was seen.
    """

    def __init__(self, dock: str, distance: float, yaw: float = math.pi, *, by_touch: bool = False) -> None:
        """`by_touch`: the robot can hardly be elsewhere, so that a closed contact is enough where nothing is seen."""
        self._dock, self._distance, self._yaw, self._by_touch = dock, distance, yaw, by_touch
        self._sightings = Sightings(dock)
        self._looking: Looking | None = None

    def step(self, seen: Observation) -> Decision:
        """One tick."""
        self._sightings.update(seen)
        if self._looking is None:
            self._looking = Looking(self._sightings, seen.stamp, _PATIENCE, None)
        outcome = danger(replace(seen, camera_ok=True))
        if outcome is not None:
            return Decision(State.INITIAL_PERCEPTION, STOP, outcome)
        result = self._looking.step(seen)
        if not isinstance(result, Event):
            return Decision(State.INITIAL_PERCEPTION, STOP, homing=result.homing)
        outcome = self._judged(self._looking, seen)
        docked = outcome.error is None and bool(seen.charging)
        return Decision(State.DOCKED if docked else State.INITIAL_PERCEPTION, STOP, outcome)

    def _judged(self, looking: Looking, seen: Observation) -> Outcome:
        if looking.located is None:
            if self._by_touch and seen.charging:
                return Outcome(None, f"charging, and taken for in dock {self._dock!r}: it was not seen", looking.seen)
            return Outcome(ErrorName.FAILED_TO_DETECT_DOCK, f"dock {self._dock!r} was not seen from here", looking.seen)
        pose = looking.located.dock_from_base
        report = {**looking.seen, **pose_report(pose)}
        if agree(pose, Pose2D(), self._distance, self._yaw):
            return Outcome(None, f"in dock {self._dock!r}", report)
        away = f"{math.hypot(pose.x, pose.y):.2f} m and {abs(math.degrees(pose.yaw)):.0f} degrees"
        return Outcome(ErrorName.NOT_DOCKED, f"the robot stands {away} from where dock {self._dock!r} holds it", report)


def pose_report(dock_from_base: Pose2D) -> dict[str, float]:
    """The pose as an outcome reports it."""
    return {"dock_x": dock_from_base.x, "dock_y": dock_from_base.y, "dock_yaw": dock_from_base.yaw}
