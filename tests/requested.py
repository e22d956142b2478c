"""What requests to a whole daemon with a simulated robot answer."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from omnibotd.control_protocol import RpcError
from omnibotd.core.geometry import Pose2D
from tests.empty_hall import EmptyHall
from tools.sim import virtual_time
from tools.sim.virtual_robot import VirtualRobot, virtual_robot

Story = Callable[[VirtualRobot], Awaitable[Any]]


def told(story: Story, directory: Path, start: Pose2D | None = None) -> Any:
    async def main() -> Any:
        async with virtual_robot(EmptyHall(), 1, start or Pose2D(), directory=directory) as robot:
            return await story(robot)

    return virtual_time.run(main())


async def refusal(work: Awaitable[Any]) -> RpcError:
    with pytest.raises(RpcError) as refused:
        await work
    return refused.value
