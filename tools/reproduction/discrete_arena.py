"""The thesis' discrete experiment as a simulation (§6.4): a robot among four floor tiles, taught and sent to a goal."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.discrete.action_map import ActionMap, Explorer, learn
from omnibotd.core.discrete.actions import TURN, Action
from omnibotd.core.discrete.navigator import MAX_ACTIONS, DiscreteNavigator
from omnibotd.core.discrete.tiles import TileTracker
from omnibotd.core.geometry import Pose2D, wrap
from tools.sim.floor_camera import ARENA, FloorCamera

# m between the robot's centre and the arena's edge: all of the thesis' starts and ends lie within.
MARGIN = 0.15
# [assumed] The starts of table 6.1 head within 3 degrees of a multiple of 45, after thousands of turns: its robot must
# have turned to odometry's heading, so that errors do not add up. Standard deviations of a turn's end, of the heading
# after a stride (rad), and of a stride (m).
TURN_ERROR, STRIDE_TURN_ERROR, STRIDE_ERROR = math.radians(1.0), math.radians(0.3), 0.003
# Between two pictures, so that tiles keep their names: m and rad. By hand that is 2 Hz at 0.15 m/s.
STEP, STEP_TURN = 0.08, math.radians(15.0)
PERCEPTIONS, ACTIONS = 1500, 5000


@dataclass(frozen=True, slots=True)
class Trip:
    """Poses where the robot stood, the nodes it took itself to be at, and whether it stopped by itself."""

    poses: list[Pose2D]
    nodes: list[int]
    arrived: bool

    @property
    def actions(self) -> int:
        return len(self.poses) - 1


class Robot:
    """Stands in the middle of the arena; its camera follows the tiles wherever it goes."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng((seed, 62))
        self.pose = Pose2D()
        self._camera = FloorCamera(seed)
        self._tracker = TileTracker(self._camera.centre)
        self._seen = self._tracker.begin(self._camera.render(self.pose))

    @property
    def perception(self) -> NDArray[np.float64]:
        """Of the last picture. RuntimeError where the tiles were lost: in this arena nothing hides them."""
        if self._seen is None:
            raise RuntimeError(f"lost the tiles at {self.pose}")
        return self._seen

    def act(self, action: Action) -> None:
        """As odometry has it, with its errors."""
        move = action.move
        if move.yaw:
            heading = round((self.pose.yaw + move.yaw) / TURN) * TURN + TURN_ERROR * self.rng.standard_normal()
            self.go(Pose2D(self.pose.x, self.pose.y, heading))
        else:
            along, turn = self.rng.standard_normal(2) * (STRIDE_ERROR, STRIDE_TURN_ERROR)
            self.go(self.pose @ Pose2D(move.x + along, 0.0, turn))

    def go(self, end: Pose2D) -> list[NDArray[np.float64]]:
        """Straight there, turning evenly meanwhile; what was perceived on the way, picture by picture."""
        start, turn, seen = self.pose, wrap(end.yaw - self.pose.yaw), []
        pictures = math.ceil(max(start.distance(end) / STEP, abs(turn) / STEP_TURN, 1.0))
        for share in np.linspace(0.0, 1.0, pictures + 1)[1:]:
            x, y = (a + share * (b - a) for a, b in ((start.x, end.x), (start.y, end.y)))
            self.pose = Pose2D(float(x), float(y), wrap(start.yaw + share * turn))
            self._seen = self._tracker.see(self._camera.render(self.pose))
            seen.append(self.perception)
        return seen


def within(x: float, y: float, margin: float = MARGIN) -> bool:
    """Of the arena, so far from its edge."""
    return max(abs(x) - ARENA[0] / 2.0, abs(y) - ARENA[1] / 2.0) <= -margin


def drive(robot: Robot, count: int) -> NDArray[np.float64]:
    """Phase I: perceptions (count, 4) of a drive by hand, from one random place to the next, each after a turn."""
    seen: list[NDArray[np.float64]] = []
    half = np.array(ARENA) / 2.0 - MARGIN
    while len(seen) < count:
        x, y = robot.rng.uniform(-half, half)
        goal = Pose2D(float(x), float(y), robot.pose.yaw + robot.pose.bearing(Pose2D(float(x), float(y))))
        for end in (Pose2D(robot.pose.x, robot.pose.y, goal.yaw), goal):
            seen += robot.go(end)
    return np.array(seen[:count])


def explore(robot: Robot, explorer: Explorer, count: int) -> tuple[ActionMap, list[Pose2D]]:
    """Phase II: so many random actions; the map, and where each node truly is."""
    node, poses, last = explorer.look(robot.perception), [robot.pose], None
    for _ in range(count):
        last = _random_action(robot, last)
        robot.act(last)
        node = explorer.acted(node, last, robot.perception)
        poses.append(robot.pose)
    return explorer.finished(), poses


def _random_action(robot: Robot, last: Action | None) -> Action:
    """That stays in the arena, and does not undo the last one [assumed]: else half of all actions lead nowhere new."""
    while True:
        action = Action(int(robot.rng.integers(len(Action))))
        x, y = robot.pose.transform(action.move.x, 0.0)
        if (last is None or action is not last.inverse) and (action.move.yaw or within(x, y)):
            return action


def taught(seed: int, perceptions: int = PERCEPTIONS, actions: int = ACTIONS) -> tuple[Robot, ActionMap, list[Pose2D]]:
    """A robot that knows the arena, its map, and the true poses of the nodes."""
    robot = Robot(seed)
    codebook = learn(drive(robot, perceptions), seed)
    # Exploring begins with odometry's heading along the arena.
    robot.go(Pose2D(robot.pose.x, robot.pose.y, 0.0))
    made, poses = explore(robot, Explorer(codebook), actions)
    return robot, made, poses


def trip(robot: Robot, made: ActionMap, start: Pose2D, target: int, most: int = MAX_ACTIONS) -> Trip:
    """Carried to the start with the tiles in sight, then on its own for `most` actions at the most."""
    robot.go(Pose2D(start.x, start.y, robot.pose.yaw))
    robot.go(start)
    navigator = DiscreteNavigator(made, target)
    poses, nodes = [robot.pose], []
    for _ in range(most):
        step = navigator.step(robot.perception)
        nodes.append(step.node)
        if step.action is None:
            return Trip(poses, nodes, True)
        robot.act(step.action)
        poses.append(robot.pose)
    return Trip(poses, nodes, False)
