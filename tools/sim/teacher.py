"""The person who teaches the robot its room: sees where it truly is and steers it by `drive` requests."""

from __future__ import annotations

import asyncio
import math
import random
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from omnibotd.control_protocol import RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import STOP, Pose2D, Twist2D, wrap
from tools.sim.world_plugin import World

SPEED = 0.3  # m/s: a careful walk behind the robot, and what the map's spacing of nodes was chosen for
TURN_RATE = 1.0  # rad/s
ARRIVED = 0.1  # m: a way-point is a wish, not a goal
TURN_ON_THE_SPOT = 0.5  # rad
PERIOD = 0.1  # s between requests, well under base.cmd_vel_timeout
NEAR_DOCK = 0.3  # m from the walls, which docks stand at: the floor round them must be in the map
CLEARANCE = 0.25  # m between the robot's centre and whatever is not free
RUN_UP = 0.5  # m driven straight before parking
LEG_LIMIT = 60.0  # s; a robot that something holds doesn't push against it for ever
SAVE_TRIES = 3  # times driven into the dock until the robot knows where it stands
TRIES = 1000  # random points before a place counts as having no way out


class Drivable(Protocol):
    """What the teacher needs of a simulated robot."""

    world: World

    @property
    def pose(self) -> Pose2D: ...

    async def drive(self, twist: Twist2D) -> None: ...

    def teleport(self, pose: Pose2D) -> None: ...

    async def call(self, method: str, **params: Any) -> dict[str, Any]: ...


class NoWay(Exception):
    """The world leaves the robot nowhere to go."""


@dataclass(frozen=True, slots=True)
class Area:
    """A rectangle of floor, in metres."""

    xmin: float
    ymin: float
    xmax: float
    ymax: float

    @classmethod
    def to_teach(
        cls,
        world: World,
        centre: tuple[float, float] | None = None,
        side: float = 4.0,
        margin: float = 0.5,
    ) -> Area:
        """`side` x `side` m round `centre` (default: the world's), no nearer than `margin` m to its bounds."""
        xmin, ymin, xmax, ymax = world.bounds
        cx, cy = centre or ((xmin + xmax) / 2.0, (ymin + ymax) / 2.0)
        half = side / 2.0
        low = max(cx - half, xmin + margin), max(cy - half, ymin + margin)
        high = min(cx + half, xmax - margin), min(cy + half, ymax - margin)
        if low[0] >= high[0] or low[1] >= high[1]:
            raise NoWay(f"bounds {world.bounds} leave no floor {margin} m from the walls to teach")
        return cls(*low, *high)

    def half(self) -> Area:
        """The lower half of the longer side, so that the other is left unknown."""
        if self.xmax - self.xmin >= self.ymax - self.ymin:
            return replace(self, xmax=(self.xmin + self.xmax) / 2.0)
        return replace(self, ymax=(self.ymin + self.ymax) / 2.0)

    def sample(self, rng: random.Random) -> tuple[float, float]:
        return rng.uniform(self.xmin, self.xmax), rng.uniform(self.ymin, self.ymax)


def free_point(world: World, area: Area, rng: random.Random) -> tuple[float, float]:
    """A random point of the area where the robot has room."""
    for _ in range(TRIES):
        point = area.sample(rng)
        if world.free(*point, CLEARANCE):
            return point
    raise NoWay(f"no free floor found in {area} in {TRIES} tries")


def clear_way(world: World, start: tuple[float, float], end: tuple[float, float]) -> bool:
    """Whether the straight line is free, looked at every 5 cm."""
    steps = max(1, math.ceil(math.dist(start, end) / 0.05))
    shares = (step / steps for step in range(1, steps + 1))
    return all(
        world.free(start[0] + s * (end[0] - start[0]), start[1] + s * (end[1] - start[1]), CLEARANCE) for s in shares
    )


class Teacher:
    """Drives to random way-points of an area, straight and unhurried; the same seed drives the same way."""

    def __init__(self, robot: Drivable, area: Area, seed: int, speed: float = SPEED) -> None:
        self._robot = robot
        self._area = area
        self._rng = random.Random(seed)
        self._speed = speed

    async def wander(self, seconds: float) -> None:
        """Drive about until the time is over, then stop."""
        end = asyncio.get_running_loop().time() + seconds
        while asyncio.get_running_loop().time() < end:
            await self.drive_to(self._next_waypoint(), ARRIVED, end)
        await self.stand()

    async def park(self, pose: Pose2D) -> None:
        """Drive to `pose` over a point straight behind it, then push the robot into place by hand."""
        behind = pose @ Pose2D(-RUN_UP, 0.0)
        for _ in range(TRIES):
            if clear_way(self._robot.world, self._here, (behind.x, behind.y)):
                break
            await self.drive_to(self._next_waypoint(), ARRIVED)
        await self.drive_to((behind.x, behind.y), 0.03)
        await self.drive_to((pose.x, pose.y), 0.03)
        await self._turn_to(pose.yaw)
        await self.stand()
        self._robot.teleport(pose)

    @property
    def _here(self) -> tuple[float, float]:
        return self._robot.pose.x, self._robot.pose.y

    async def drive_to(self, point: tuple[float, float], near: float = ARRIVED, end: float = math.inf) -> None:
        """Drive straight to the point, or until the time `end`."""
        loop = asyncio.get_running_loop()
        end = min(end, loop.time() + LEG_LIMIT)
        while loop.time() < end and math.dist(self._here, point) > near:
            await self._robot.drive(towards(self._robot.pose, point, self._speed))
            await asyncio.sleep(PERIOD)

    async def _turn_to(self, yaw: float) -> None:
        end = asyncio.get_running_loop().time() + LEG_LIMIT
        while asyncio.get_running_loop().time() < end and abs(wrap(yaw - self._robot.pose.yaw)) > 0.05:
            await self._robot.drive(Twist2D(0.0, 1.5 * wrap(yaw - self._robot.pose.yaw)))
            await asyncio.sleep(PERIOD)

    async def stand(self) -> None:
        """Stop, and wait until the wheels have."""
        await self._robot.drive(STOP)
        await asyncio.sleep(1.0)

    def _next_waypoint(self) -> tuple[float, float]:
        for _ in range(TRIES):
            point = self._area.sample(self._rng)
            if clear_way(self._robot.world, self._here, point):
                return point
        raise NoWay(f"no free straight way out of {self._here} found in {TRIES} tries")


def towards(pose: Pose2D, point: tuple[float, float], speed: float = SPEED) -> Twist2D:
    """Turn to the point on the spot, then drive there on a curve."""
    target = Pose2D(*point)
    bearing = pose.bearing(target)
    turn = max(-TURN_RATE, min(TURN_RATE, 1.5 * bearing))
    if abs(bearing) > TURN_ON_THE_SPOT:
        return Twist2D(0.0, turn)
    return Twist2D(min(speed, 0.9 * pose.distance(target)), turn)


async def record(robot: Drivable, teacher: Teacher, name: str, seconds: float, park: Pose2D | None = None) -> Path:
    """Record a drive round the teacher's area; returns the recording.

    With `park` the drive ends there, as one that ends in the dock does. Raises RpcError.
    """
    started = await robot.call("record.start", map=name)
    await teacher.wander(seconds)
    if park is not None:
        await teacher.park(park)
    await robot.call("record.stop")
    return Path(started["path"])


async def teach(robot: Drivable, teacher: Teacher, name: str, seconds: float, park: Pose2D | None = None) -> Path:
    """`record`, then make a map of it and use it. Raises RpcError."""
    recording = await record(robot, teacher, name, seconds, park)
    await robot.call("train", map=name)
    await robot.call("map.use", map=name)
    return recording


async def save_dock(robot: Drivable, teacher: Teacher, name: str, pose: Pose2D) -> dict[str, Any]:
    """Save the dock that the robot stands in at `pose`; while it is not sure where that is, drive out and in again.

    Raises RpcError as soon as the robot refuses for another reason, or stays unsure.
    """
    tries = 1
    while True:
        await asyncio.sleep(1.0)
        try:
            return await robot.call("dock.save", name=name)
        except RpcError as error:
            if error.name is not ErrorName.LOST or tries == SAVE_TRIES:
                raise
        await teacher.park(pose)
        tries += 1
