"""The thesis preset from end to end: the whole daemon is taught two by two metres under tiles, and sent to places."""

import random

import pytest

from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.thesis.training import node_samples
from omnibotd.io.recording import teaching_samples
from tests.core.thesis.rooms import room_with_tiles
from tools.sim import virtual_time
from tools.sim.teacher import Area, Teacher, teach
from tools.sim.virtual_robot import VirtualRobot, virtual_robot

TEACH = 120.0  # s
GOALS = 3


async def trips(robot: VirtualRobot) -> tuple[TopoMap, list[tuple[float, float]]]:
    """The map, and how far from each goal's true place the robot began and ended."""
    teacher = Teacher(robot, Area.to_teach(robot.world, side=2.0), seed=4)
    recording = await teach(robot, teacher, "room", TEACH)
    topo_map = robot.store.load("room")
    track = robot.track()
    taught = [track.at(sample.stamp) for sample in node_samples(teaching_samples(recording))]
    assert len(taught) == len(topo_map)
    distances, rng = [], random.Random(4)
    for _ in range(GOALS):
        far = [node for node in range(len(taught)) if taught[node].distance(robot.pose) > 0.7]
        node = rng.choice(far)
        start, goal = robot.pose, topo_map.pose(node)
        await robot.call("goto", at=[goal.x, goal.y, goal.yaw])
        distances.append((start.distance(taught[node]), robot.pose.distance(taught[node])))
    return topo_map, distances


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_taught_two_minutes_it_gets_nearer_to_every_goal() -> None:
    async def scenario() -> tuple[TopoMap, list[tuple[float, float]]]:
        async with virtual_robot(room_with_tiles(), 4, Pose2D(), preset="thesis") as robot:
            return await trips(robot)

    topo_map, distances = virtual_time.run(scenario())
    assert topo_map.method == "thesis"
    assert len(topo_map) == pytest.approx(TEACH, abs=3)
    for start, end in distances:
        assert end < 0.6 < start
