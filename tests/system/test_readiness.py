"""When systemd hears READY: with camera and base if they answer soon, without them after a while."""

import asyncio
from collections.abc import Callable
from pathlib import Path

import pytest

from omnibotd import daemon
from omnibotd.core.geometry import Pose2D
from omnibotd.io.systemd_notify import Notifier
from tools.sim import ceilings, virtual_time
from tools.sim.virtual_robot import VirtualRobot

PATIENCE = 3.0  # s; the daemon's own would be 20 s of pictures to render


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    assert daemon.PATIENCE > 2.0 * PATIENCE
    monkeypatch.setattr(daemon, "PATIENCE", PATIENCE)


class Manager(Notifier):
    """Hears what systemd would, and when (seconds since the start)."""

    def __init__(self) -> None:
        super().__init__({})
        self.began = asyncio.get_running_loop().time()
        self.ready_at: list[float] = []
        self.statuses: list[str] = []

    def ready(self) -> None:
        self.ready_at.append(asyncio.get_running_loop().time() - self.began)

    def status(self, text: str) -> None:
        self.statuses.append(text)


def started(directory: Path, seconds: float, trouble: Callable[[VirtualRobot], object]) -> Manager:
    """What the service manager has heard of a daemon's first seconds."""

    async def main() -> Manager:
        robot = VirtualRobot(ceilings.plain(3), 3, Pose2D(), directory)
        robot.daemon._adapters.notifier = manager = Manager()
        trouble(robot)
        tasks = [asyncio.create_task(work) for work in (robot.live(), robot.daemon.run())]
        await asyncio.sleep(seconds)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        return manager

    return virtual_time.run(main())


def no_camera(robot: VirtualRobot) -> None:
    robot.camera.ok = lambda now: False  # type: ignore[method-assign]
    robot.camera.reason = "/dev/video0: no such device"


def no_base(robot: VirtualRobot) -> None:
    robot.link.cut = True


def test_ready_comes_with_camera_and_base(tmp_path: Path) -> None:
    manager = started(tmp_path, 2.0, lambda robot: None)
    assert len(manager.ready_at) == 1
    assert manager.ready_at[0] < 2.0
    assert manager.statuses[-1] == "idle, camera and base answer"


@pytest.mark.parametrize(
    ("trouble", "named"), [(no_camera, "camera: /dev/video0: no such device"), (no_base, "base: ")]
)
def test_ready_comes_late_without_one_of_them_and_the_status_names_it(
    tmp_path: Path, trouble: Callable[[VirtualRobot], object], named: str
) -> None:
    manager = started(tmp_path, PATIENCE + 1.0, trouble)
    assert len(manager.ready_at) == 1
    assert PATIENCE <= manager.ready_at[0] < PATIENCE + 1.0
    assert named in manager.statuses[-1]
    assert ";" not in manager.statuses[-1]  # the other one answers


def test_a_cable_plugged_in_meanwhile_makes_it_ready_at_once(tmp_path: Path) -> None:
    def plugged_in_later(robot: VirtualRobot) -> None:
        no_base(robot)
        asyncio.get_running_loop().call_later(1.2, lambda: setattr(robot.link, "cut", False))

    manager = started(tmp_path, 2.9, plugged_in_later)
    assert len(manager.ready_at) == 1
    assert 1.2 < manager.ready_at[0] < 2.5
