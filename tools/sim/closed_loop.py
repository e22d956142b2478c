"""Teaches a simulated robot its room, sends it home and docks it, in virtual time (launcher: tools/sim/closed_loop)."""

from __future__ import annotations

import argparse
import sys
import time

import cv2

from omnibotd.control_protocol import RpcError
from omnibotd.core.geometry import Pose2D
from tools.sim import virtual_time
from tools.sim.teacher import NEAR_DOCK, Area, NoWay, Teacher, save_dock, teach
from tools.sim.virtual_robot import VirtualRobot, virtual_robot
from tools.sim.world_plugin import World, WorldError, load_world

ROOM, DOCK = "room", "dock"


async def scenario(world: World, seed: int, seconds: float, base: str = "omnibot") -> VirtualRobot:
    """Record, train, save the dock, go home, dock again; prints each step's outcome. Raises RpcError."""
    dock = Pose2D(*world.dock)
    home = dock @ Pose2D(-1.0, 0.0)
    async with virtual_robot(world, seed, home, base=base) as robot:
        area = Area.to_teach(world, (home.x, home.y), side=2.0, margin=NEAR_DOCK)
        teacher = Teacher(robot, area, seed)
        await teach(robot, teacher, ROOM, seconds, park=dock)
        _say(robot, f"recorded {seconds:.0f} s, trained {len(robot.store.load(ROOM))} nodes")
        saved = await save_dock(robot, teacher, DOCK, dock)
        _say(robot, f"dock saved at {saved['pose']}")
        await robot.call("goto", at=[0.0, 0.0, 0.0])  # the map begins where the recording began
        _say(robot, f"went home, {robot.pose.distance(home) * 100:.1f} cm from where it began")
        await robot.call("dock", name=DOCK)
        _say(robot, f"docked, {robot.pose.distance(dock) * 100:.1f} cm from the dock")
        return robot


def main(arguments: list[str] | None = None) -> int:
    """Exit status 1 where the world is none, or a job failed."""
    parser = argparse.ArgumentParser(prog="closed_loop", description=__doc__)
    parser.add_argument("--world", default="tools.sim.ceilings:tiles", metavar="MODULE:FACTORY")
    parser.add_argument("--base", choices=("omnibot", "create2", "arduino_bridge"), default="omnibot")
    parser.add_argument("--seed", type=int, default=1, metavar="N")
    parser.add_argument("--teach", type=float, default=120.0, metavar="SECONDS")
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    began = time.perf_counter()
    try:
        world = load_world(options.world, options.seed)
        robot = virtual_time.run(scenario(world, options.seed, options.teach, options.base))
    except (WorldError, NoWay, RpcError) as error:
        print(f"closed_loop: {error}", file=sys.stderr)
        return 1
    wall = time.perf_counter() - began
    print(f"{robot.seconds:.0f} s in {wall:.1f} s: {robot.seconds / wall:.1f} times real time, {robot.frames} frames")
    return 0


def _say(robot: VirtualRobot, what: str) -> None:
    print(f"{robot.seconds:7.1f} s  {what}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
