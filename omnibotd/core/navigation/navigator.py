"""Goes to one pose of the map: find yourself, follow the route, arrive, face the goal's heading.

LOCALISING ──sure──► FOLLOWING ──near──► ARRIVING ──held──► (done)
    ▲  └─not found─► (LOST)  │ ▲            │
    └───────unsure───────────┘ └──drifted───┘
                          BACKING_OFF ◄─bumper─ FOLLOWING, ARRIVING
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from omnibotd.core.decision import Decision, Observation, Outcome
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Pose2D, Twist2D, wrap
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation.dynamic_window import DynamicWindow, pursuit, turn
from omnibotd.core.navigation.floor import DrivenFloor
from omnibotd.core.navigation.goal_filter import GoalFilter
from omnibotd.core.navigation.planning import Route
from omnibotd.core.safety import Limits

SURE = 0.6  # confidence from which a place estimate steers
UNSURE_DISTANCE = 1.5  # m driven without a sure estimate before the robot stops and looks around
UNSURE_TIME = 4.0  # s the same, for a robot that stands or creeps
SEARCH_TURN = 0.6  # rad/s while looking around; slow enough for a sharp picture
SEARCH_TURNS = 2 * math.tau  # rad turned before giving up
HOLD = 0.5  # s within the tolerance before it counts: the filter has then settled on a standing robot's view
HYSTERESIS = 2.0  # times the tolerance that the robot may be pushed off while it turns to the goal's heading
BACK_OFF = 0.15  # m straight back after a bump
BACK_OFF_SPEED = 0.1  # m/s
BACK_OFF_TIME = 3.0  # s; twice what it takes: something stands behind as well
MAX_RECOVERIES = 6
BUMP_SIDE = math.radians(35)  # to the side from straight ahead, where one bumper alone was pressed
PATIENCE = 60.0  # s, and as much again for each metre of the route at a twentieth of a metre a second
SLOWEST = 0.05  # m/s


class NavigatorState(StrEnum):
    LOCALISING = "LOCALISING"
    FOLLOWING = "FOLLOWING"
    ARRIVING = "ARRIVING"
    BACKING_OFF = "BACKING_OFF"


@dataclass(frozen=True, slots=True)
class Tolerance:
    """When a goal counts as reached: metres and radians."""

    xy: float
    yaw: float


class Navigator:
    """One trip; `step` is called at a fixed rate and never blocks. `goal_filter` outlives it and keeps the pose."""

    def __init__(
        self,
        topo_map: TopoMap,
        goal: Pose2D,
        goal_filter: GoalFilter,
        limits: Limits,
        tolerance: Tolerance,
        robot_radius: float,
        period: float,
    ) -> None:
        self._goal = goal
        self._filter = goal_filter
        self._limits = limits
        self._tolerance = tolerance
        self._radius = robot_radius
        self._window = DynamicWindow(limits, period)
        self._floor = DrivenFloor(topo_map.poses[:, :2])
        self._map = topo_map
        self._route = Route(topo_map, goal, self._floor)
        self.state = NavigatorState.LOCALISING
        self._recoveries = 0
        self._last_twist = STOP
        self._started: float | None = None
        self._deadline = math.inf
        self._sure_at: tuple[float, Pose2D] | None = None
        self._within_since: float | None = None
        self._turned = 0.0
        self._last_odom: Pose2D | None = None
        self._back_from = (0.0, Pose2D())

    def step(self, seen: Observation) -> Decision:
        """What to do now. The filter has already taken in this observation's odometry and place estimate."""
        if self._started is None:
            self._started = seen.stamp
            self._deadline = seen.stamp + PATIENCE
        outcome = self._abort(seen)
        if outcome is not None:
            return self._decide(STOP, outcome)
        self._note_certainty(seen)
        here = self._filter.map_from_base
        if self.state is NavigatorState.BACKING_OFF:
            return self._back_off(seen)
        if here is None or not self._sure(seen):
            return self._look_around(seen)
        if self.state is NavigatorState.LOCALISING:
            return self._set_out(seen, here)
        if seen.bumper_left or seen.bumper_right or seen.cliff:
            return self._bumped(seen, here)
        if self.state is NavigatorState.ARRIVING:
            return self._arrive(seen, here)
        return self._follow(seen, here)

    def _abort(self, seen: Observation) -> Outcome | None:
        """Conditions that end the job in any state, worst first."""
        if seen.emergency_stop:
            return Outcome(ErrorName.EMERGENCY_STOP, "the emergency stop is pressed; release it and start again")
        if not seen.base_ok:
            return Outcome(ErrorName.BASE_LINK_DOWN, "the base stopped answering; check its cable and power")
        if not seen.camera_ok:
            return Outcome(ErrorName.CAMERA_DOWN, "no picture from the camera for a second; check its cable")
        if seen.wheel_drop:
            return Outcome(ErrorName.BLOCKED, "a wheel hangs in the air; put the robot on the floor and start again")
        if seen.stamp > self._deadline:
            return Outcome(ErrorName.TIMEOUT, f"not there after {seen.stamp - (self._started or 0.0):.0f} s")
        return None

    def _note_certainty(self, seen: Observation) -> None:
        if self._last_odom is not None:
            self._turned += abs(wrap(seen.odom_from_base.yaw - self._last_odom.yaw))
        self._last_odom = seen.odom_from_base
        if seen.place is not None and seen.place.confidence >= SURE and self._filter.map_from_base is not None:
            self._sure_at = (seen.place.stamp, seen.odom_from_base)

    def _sure(self, seen: Observation) -> bool:
        """Whether the last sure estimate is recent enough, in metres or in seconds."""
        if self._sure_at is None:
            return False
        stamp, odom = self._sure_at
        return seen.stamp - stamp < UNSURE_TIME and odom.distance(seen.odom_from_base) < UNSURE_DISTANCE

    def _look_around(self, seen: Observation) -> Decision:
        if self.state is not NavigatorState.LOCALISING:
            self.state, self._turned, self._recoveries = NavigatorState.LOCALISING, 0.0, self._recoveries + 1
        if self._turned > SEARCH_TURNS or self._recoveries > MAX_RECOVERIES:
            confidence = f"confidence {self._filter.confidence:.2f}"
            message = f"this view fits no place of map {self._map.name!r} surely ({confidence})"
            return self._decide(STOP, Outcome(ErrorName.LOST, message))
        return self._decide(Twist2D(0.0, SEARCH_TURN))

    def _set_out(self, seen: Observation, here: Pose2D) -> Decision:
        distance = self._route.distance(here)
        if not math.isfinite(distance):
            return self._decide(STOP, Outcome(ErrorName.NO_ROUTE, "no driven way leads from here to the goal"))
        self._deadline = seen.stamp + PATIENCE + distance / SLOWEST
        self.state, self._turned = NavigatorState.FOLLOWING, 0.0
        return self._follow(seen, here)

    def _follow(self, seen: Observation, here: Pose2D) -> Decision:
        distance = here.distance(self._goal)
        if distance < self._tolerance.xy / 2.0:
            self.state, self._within_since = NavigatorState.ARRIVING, None
            return self._arrive(seen, here)
        carrot = self._route.carrot(here)
        if carrot is None:
            return self._decide(STOP, Outcome(ErrorName.NO_ROUTE, "no driven way leads from here to the goal"))
        wanted = pursuit(here.bearing(carrot), max(here.distance(carrot), self._tolerance.xy / 2.0), self._limits)
        return self._decide(self._steer(wanted, here))

    def _steer(self, wanted: Twist2D, here: Pose2D) -> Twist2D:
        """Keep to free floor, unless the robot stands beside it already: then the straight way back is best."""
        if not self._floor.contains(np.array([here.x, here.y])):
            return wanted
        return self._window.choose(wanted, self._last_twist, here, self._floor)

    def _arrive(self, seen: Observation, here: Pose2D) -> Decision:
        """At the spot: turn to the goal's heading, then stand until the pose has held."""
        if here.distance(self._goal) > self._tolerance.xy * HYSTERESIS / 2.0:
            self.state = NavigatorState.FOLLOWING
            return self._follow(seen, here)
        error = wrap(self._goal.yaw - here.yaw)
        if abs(error) > self._tolerance.yaw / 2.0:
            self._within_since = None
            return self._decide(turn(error, self._limits))
        if self._within_since is None:
            self._within_since = seen.stamp
        if seen.stamp - self._within_since < HOLD or not self._confirmed(seen):
            return self._decide(STOP)
        return self._decide(
            STOP, Outcome(None, f"arrived, {here.distance(self._goal) * 100:.0f} cm by its own estimate")
        )

    def _confirmed(self, seen: Observation) -> bool:
        """Never say arrived on dead reckoning: a sure estimate must have come since the robot stood still."""
        return self._sure_at is not None and self._sure_at[0] >= (self._within_since or seen.stamp)

    def _bumped(self, seen: Observation, here: Pose2D) -> Decision:
        self._recoveries += 1
        if self._recoveries > MAX_RECOVERIES:
            message = f"something is in the way; gave up after {MAX_RECOVERIES} tries round it"
            return self._decide(STOP, Outcome(ErrorName.BLOCKED, message))
        touched = here @ Pose2D(yaw=BUMP_SIDE * (int(seen.bumper_left) - int(seen.bumper_right)))
        # Of what stands there only the edge is known: a disc as large as the robot, beyond the point of touch.
        self._floor.block(*touched.transform(1.75 * self._radius, 0.0), 1.2 * self._radius)
        self._route = Route(self._map, self._goal, self._floor)
        self.state, self._back_from = NavigatorState.BACKING_OFF, (seen.stamp, seen.odom_from_base)
        return self._decide(Twist2D(-BACK_OFF_SPEED, 0.0))

    def _back_off(self, seen: Observation) -> Decision:
        since, start = self._back_from
        if start.distance(seen.odom_from_base) >= BACK_OFF or seen.stamp - since > BACK_OFF_TIME:
            self.state = NavigatorState.FOLLOWING
        return self._decide(Twist2D(-BACK_OFF_SPEED, 0.0))

    def _decide(self, twist: Twist2D, outcome: Outcome | None = None) -> Decision:
        self._last_twist = twist
        here = self._filter.map_from_base
        remaining = None if here is None else here.distance(self._goal)
        return Decision(self.state, twist, outcome, distance_remaining=remaining, recoveries=self._recoveries)
