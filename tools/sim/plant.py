"""The simulated robot's body: motors, wheels on a floor, encoders, bumpers and the charging contact."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

Pose = tuple[float, float, float]

SUBSTEP = 0.01  # s; a tenth of what the motors take, and 5 mm at full speed
MOTOR_LAG = 0.08  # s, first order, from a wheel's commanded to its actual speed
ROBOT_RADIUS = 0.17  # m
TOUCH = 0.002  # m, the travel of the bumper's spring
DOCK_ANGLE = math.radians(5.0)  # beyond this the charging contacts miss each other
RANGE_REACH = 1.5  # m, of a small time-of-flight sensor
_BEAM = 0.02  # m, the thinnest obstacle that its cone is sure to meet
_PROBES = 32  # directions in which the bumper feels
_BISECTIONS = 8  # of a substep's 5 mm: the robot stops 0.02 mm from what it hits


class Floor(Protocol):
    """What the robot needs of a world."""

    @property
    def dock(self) -> Pose: ...

    def free(self, x: float, y: float, radius: float) -> bool: ...


@dataclass(frozen=True, slots=True)
class Body:
    """Nominal dimensions (m), and real errors: of both wheels' size and between the two (relative, one standard
    deviation; 0.2 % turns the robot by half a degree a metre), slip of each (m per square root of m)."""

    wheel_radius: float = 0.035
    wheel_separation: float = 0.23
    ticks_per_rev: float = 1440
    scale_error: float = 0.01
    wheel_difference: float = 0.002
    slip: float = 0.004

    @property
    def metres_per_tick(self) -> float:
        return 2.0 * math.pi * self.wheel_radius / self.ticks_per_rev


class SimulatedRobot:
    """A differential drive whose truth only the simulator knows; the same seed and commands, the same run.

    Each wheel differs from its nominal size by a run's constant error and slips at random; walls stop the
    body while the wheels turn on.
    """

    def __init__(
        self, world: Floor, pose: Pose, seed: int, body: Body | None = None, *, range_sensor: bool = False
    ) -> None:
        """Raises ValueError where `pose` (x, y, yaw; metres, radians) leaves no room for the robot."""
        self.body = body or Body()
        self._range_sensor = range_sensor
        self._world = world
        self._rng = np.random.default_rng((seed, 7401))
        self._metres_per_tick = self.body.metres_per_tick * self._wheel_sizes()
        self._speed = np.zeros(2)  # ticks/s, left and right
        self._turned = np.zeros(2)  # ticks
        self._counted = np.zeros(2, np.int64)
        self.teleport(pose)

    @property
    def pose(self) -> Pose:
        """The true (x, y, yaw), yaw in [-pi, pi]."""
        return self._pose

    @property
    def bumpers(self) -> tuple[bool, bool]:
        """(left, right) pressed: something within the spring's travel of that half of the front."""
        bearings = self._contacts()
        left = any(-0.25 <= b <= 1.6 for b in bearings)
        right = any(-1.6 <= b <= 0.25 for b in bearings)
        return left, right

    @property
    def range_ahead(self) -> float | None:
        """Metres from the front edge to what is straight ahead, infinite beyond the reach; None without a sensor."""
        if not self._range_sensor:
            return None
        x, y, yaw = self._pose
        c, s = math.cos(yaw), math.sin(yaw)
        for k in range(round(RANGE_REACH / _BEAM) + 1):
            away = ROBOT_RADIUS + k * _BEAM
            # A disc that stands `away` from the centre touches what is half its size nearer.
            if not self._world.free(x + away * c, y + away * s, _BEAM / 2.0):
                return max(0.0, (k - 0.5) * _BEAM)
        return math.inf

    def teleport(self, pose: Pose) -> None:
        """Carries the robot elsewhere; wheels and encoders don't notice. ValueError where it doesn't fit."""
        x, y, yaw = (float(value) for value in pose)
        if not self._world.free(x, y, ROBOT_RADIUS):
            raise ValueError(f"no room for a robot of radius {ROBOT_RADIUS} m at x={x:.3f} y={y:.3f}")
        self._pose: Pose = (x, y, math.remainder(yaw, 2.0 * math.pi))

    def step(self, dt: float, left_target: float, right_target: float) -> tuple[int, int]:
        """Drives for `dt` s towards wheel speeds in ticks/s; returns the new ticks (left, right)."""
        substeps = max(1, math.ceil(dt / SUBSTEP - 1e-9))
        for _ in range(substeps):
            self._substep(dt / substeps, np.array([left_target, right_target]))
        before, self._counted = self._counted, np.floor(self._turned).astype(np.int64)
        left, right = (self._counted - before).tolist()
        return left, right

    def roll(self, left: int, right: int) -> None:
        """Moves as wheels do that motors of somebody else's turned by so many ticks within a few milliseconds."""
        self._turn(np.array([left, right], float))

    def at_dock(self, tolerance: float = 0.03) -> bool:
        """Whether the charging contacts meet: within `tolerance` m and 5 degrees of the world's dock."""
        x, y, yaw = self._pose
        dock_x, dock_y, dock_yaw = self._world.dock
        askew = abs(math.remainder(yaw - dock_yaw, 2.0 * math.pi))
        return math.hypot(x - dock_x, y - dock_y) <= tolerance and askew <= DOCK_ANGLE

    def _wheel_sizes(self) -> np.ndarray:
        """True over nominal size (left, right) of this run's wheels."""
        both, difference = self._rng.standard_normal(2)
        return (
            1.0 + self.body.scale_error * both + self.body.wheel_difference / 2.0 * np.array([-1.0, 1.0]) * difference
        )

    def _substep(self, dt: float, target: np.ndarray) -> None:
        self._speed += (target - self._speed) * -math.expm1(-dt / MOTOR_LAG)
        self._turn(self._speed * dt)

    def _turn(self, ticks: np.ndarray) -> None:
        self._turned += ticks
        rolled = ticks * self._metres_per_tick
        # A random walk in distance: its variance grows with the way gone, whatever the length of a step.
        left, right = rolled + self.body.slip * np.sqrt(np.abs(rolled)) * self._rng.standard_normal(2)
        x, y, yaw = self._pose
        turn = (right - left) / self.body.wheel_separation
        ahead = (left + right) / 2.0
        x, y = self._stopped_by_walls(ahead * math.cos(yaw + turn / 2.0), ahead * math.sin(yaw + turn / 2.0))
        self._pose = (x, y, math.remainder(yaw + turn, 2.0 * math.pi))

    def _stopped_by_walls(self, dx: float, dy: float) -> tuple[float, float]:
        """Where the move (dx, dy) ends: as near as it comes to a wall, and then along it."""
        x, y, _ = self._pose
        part = self._free_part(x, y, dx, dy)
        x, y, dx, dy = x + part * dx, y + part * dy, (1.0 - part) * dx, (1.0 - part) * dy
        if part < 1.0:
            x += self._free_part(x, y, dx, 0.0) * dx
            y += self._free_part(x, y, 0.0, dy) * dy
        return x, y

    def _free_part(self, x: float, y: float, dx: float, dy: float) -> float:
        """The share of a move that can be made, in [0, 1]."""
        if self._world.free(x + dx, y + dy, ROBOT_RADIUS):
            return 1.0
        free, blocked = 0.0, 1.0
        for _ in range(_BISECTIONS):
            middle = (free + blocked) / 2.0
            if self._world.free(x + middle * dx, y + middle * dy, ROBOT_RADIUS):
                free = middle
            else:
                blocked = middle
        return free

    def _contacts(self) -> list[float]:
        """Bearings from the robot's front of the obstacles it touches."""
        x, y, yaw = self._pose
        if self._world.free(x, y, ROBOT_RADIUS + TOUCH):
            return []
        probes = (2.0 * math.pi * i / _PROBES for i in range(_PROBES))
        blocked = [
            angle
            for angle in probes
            if not self._world.free(x + TOUCH * math.cos(angle), y + TOUCH * math.sin(angle), ROBOT_RADIUS)
        ]
        return [math.remainder(angle - yaw, 2.0 * math.pi) for angle in _middles(blocked)]


def _middles(blocked: list[float]) -> list[float]:
    """One direction for each run of neighbouring blocked probes: the wall's normal lies in its middle."""
    width = 2.0 * math.pi / _PROBES
    runs: list[list[float]] = []
    for angle in blocked:
        if runs and angle - runs[-1][-1] < 1.5 * width:
            runs[-1].append(angle)
        else:
            runs.append([angle])
    if len(runs) > 1 and runs[0][0] + 2.0 * math.pi - runs[-1][-1] < 1.5 * width:
        runs[0] = [angle - 2.0 * math.pi for angle in runs.pop()] + runs[0]
    return [(run[0] + run[-1]) / 2.0 for run in runs]
