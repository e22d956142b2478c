"""A simulated robot and the whole daemon that drives it, in one process and in virtual time.

What stands in for hardware is the far side of two adapters: bytes of the base's protocol, and camera frames.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import yaml

from omnibotd.config import load
from omnibotd.core.geometry import Pose2D, Twist2D
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.percept import PlaceEstimate
from omnibotd.daemon import Adapters, Daemon, base_driver
from omnibotd.io.map_store import MapStore
from omnibotd.io.motor_base import MotorBase
from omnibotd.io.systemd_notify import Notifier
from omnibotd.pruning_process import prune_and_save
from omnibotd.training_process import train_and_save
from tools.sim.emulators import BODIES, make_device
from tools.sim.memory_adapters import EXPOSURE_TO_ARRIVAL, MemoryCamera, MemoryLink, PatientRecorder
from tools.sim.plant import ROBOT_RADIUS, SimulatedRobot
from tools.sim.track import Track
from tools.sim.world_plugin import World, WorldError

JPEG_QUALITY = 90
STEP = 0.02  # s of the robot's body: the period of the base's telemetry; the plant makes its own smaller steps
READY_LIMIT = 10.0  # s until base and camera must have answered
STORAGE = "storage"  # folder of maps and recordings, beside the configuration
TRUTH_LIMIT = 100_000  # frames whose true pose is remembered: twice the 75 minutes the thesis taught


class VirtualRobot:
    """A robot in a world, and the daemon that drives it; make it inside `virtual_robot`."""

    def __init__(
        self,
        world: World,
        seed: int,
        start: Pose2D,
        directory: Path,
        *,
        preset: str = "default",
        wheel_error: float = 0.0,
        base: str = "omnibot",
        range_sensor: bool = False,
        heading: str = "wheels",
    ) -> None:
        """Configuration and storage go to `directory`; wheels are by the share `wheel_error` larger than it says."""
        self.world = world
        pose = (start.x, start.y, start.yaw)
        with _room_for_robot():
            self.plant = SimulatedRobot(world, pose, seed, BODIES[base], range_sensor=range_sensor)
        self.device = make_device(base, nonce=seed % 2**32)
        self.link = MemoryLink(self.device)
        self.frames = 0
        self.seconds = 0.0  # lived
        self._truth: deque[tuple[float, Pose2D]] = deque(maxlen=TRUTH_LIMIT)
        self._ticks = [0, 0]
        config = load(_write_config(world, self.plant, directory, preset, wheel_error, base, heading))
        height, width = world.render(*self.plant.pose, 0.0).shape[:2]
        self.camera = MemoryCamera(self._photograph, (width, height))
        self.store = MapStore(config.storage.directory)
        adapters = Adapters(
            self.camera,
            MotorBase(base_driver(config.base), self._open_link),
            self.store,
            Notifier(),
            _in_place,
            _train_in_place,
            PatientRecorder,
            _prune_in_place,
        )
        self.daemon = Daemon(config, adapters)

    @property
    def pose(self) -> Pose2D:
        """Where the robot truly is."""
        return Pose2D(*self.plant.pose)

    def teleport(self, pose: Pose2D) -> None:
        """Carry the robot; neither wheels nor daemon are told. WorldError where it doesn't fit."""
        with _room_for_robot():
            self.plant.teleport((pose.x, pose.y, pose.yaw))

    def track(self) -> Track:
        """Where the frames were taken, by their stamps."""
        return Track.of(self._truth)

    def true_pose_at(self, stamp: float) -> Pose2D:
        """Where the frame with this stamp, one of the last few, was taken."""
        return min(islice(reversed(self._truth), 10), key=lambda entry: abs(entry[0] - stamp))[1]

    def overhear(self, listener: Callable[[PlaceEstimate], None]) -> None:
        """Tell the listener of every place estimate as soon as the control loop has it."""
        note = self.daemon.control.note_place

        def heard(place: PlaceEstimate) -> None:
            note(place)
            listener(place)

        self.daemon.control.note_place = heard

    async def call(self, method: str, **params: Any) -> dict[str, Any]:
        """A request as from the control socket. Raises RpcError."""
        return await self.daemon.call(method, params)

    async def drive(self, twist: Twist2D) -> None:
        await self.call("drive", vx=twist.vx, wz=twist.wz)

    async def live(self) -> None:
        """The robot's body, for ever: wheels, senses, and bytes from the base."""
        loop = asyncio.get_running_loop()
        # Between the camera's and the control loop's instants: which of two comes first would be left to rounding.
        await asyncio.sleep(STEP / 2.0)
        while True:
            await asyncio.sleep(STEP)
            self.seconds += STEP
            left, right = self.plant.step(STEP, *self.device.target)
            self._ticks[0] += left
            self._ticks[1] += right
            self.device.poll(loop.time())
            self._sense()
            self.link.deliver(self.device.data_to_send())

    async def ready(self) -> None:
        """Wait until the daemon has its base and its camera's lens. Raises TimeoutError with the reasons."""
        try:
            async with asyncio.timeout(READY_LIMIT):
                await self.daemon.perception.lens_known.wait()
                while not (await self.call("status"))["base"]["connected"]:  # noqa: ASYNC110 - nothing tells
                    await asyncio.sleep(0.1)
        except TimeoutError:
            status = await self.call("status")
            raise TimeoutError(f"not ready: base {status['base']}, camera {status['camera']}") from None

    def _sense(self) -> None:
        left, right = self.plant.bumpers
        self.device.set_state(
            self._ticks[0],
            self._ticks[1],
            bumper_left=left,
            bumper_right=right,
            charging=self.plant.at_dock(),
            range_ahead=self.plant.range_ahead,
        )

    def _photograph(self, now: float) -> bytes:
        self.frames += 1
        self._truth.append((now + EXPOSURE_TO_ARRIVAL, self.pose))
        image = self.world.render(*self.plant.pose, now)
        return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes())

    async def _open_link(self) -> MemoryLink:
        return self.link


@asynccontextmanager
async def virtual_robot(
    world: World,
    seed: int,
    start: Pose2D | None = None,
    *,
    preset: str = "default",
    wheel_error: float = 0.0,
    directory: Path | None = None,
    base: str = "omnibot",
    range_sensor: bool = False,
    heading: str = "wheels",
) -> AsyncIterator[VirtualRobot]:
    """A robot that lives, daemon and all, inside this block; it stands at `start`, default somewhere free.

    `directory` keeps configuration and storage, default one that vanishes at the end. Raises what ended the daemon or
    the body, should one of them fail.
    """
    with TemporaryDirectory(prefix="omnibot-") as passing, _unwrapped():
        place = start or somewhere(world)
        robot = VirtualRobot(
            world,
            seed,
            place,
            directory or Path(passing),
            preset=preset,
            wheel_error=wheel_error,
            base=base,
            range_sensor=range_sensor,
            heading=heading,
        )
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(robot.live()), group.create_task(robot.daemon.run())]
            await robot.ready()
            yield robot
            for task in tasks:
                task.cancel()


def somewhere(world: World) -> Pose2D:
    """The free spot nearest to the middle of the world, to 10 cm. Raises WorldError where there is none."""
    xmin, ymin, xmax, ymax = world.bounds
    grid = np.stack(np.meshgrid(np.arange(xmin, xmax, 0.1), np.arange(ymin, ymax, 0.1)), -1).reshape(-1, 2)
    away = np.hypot(*(grid - [(xmin + xmax) / 2.0, (ymin + ymax) / 2.0]).T)
    for x, y in grid[np.argsort(away, kind="stable")]:
        if world.free(float(x), float(y), ROBOT_RADIUS):
            return Pose2D(float(x), float(y))
    raise WorldError(f"no free spot for a robot of radius {ROBOT_RADIUS} m in {world.bounds}")


@contextmanager
def _room_for_robot() -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise WorldError(str(error)) from error


@contextmanager
def _unwrapped() -> Iterator[None]:
    """Of groups of one exception, the exception."""
    try:
        yield
    except BaseExceptionGroup as group:
        error: BaseException = group
        while isinstance(error, BaseExceptionGroup) and len(error.exceptions) == 1:
            error = error.exceptions[0]
        raise error from None


async def _in_place(function: Callable[..., Any], *arguments: Any) -> Any:
    return function(*arguments)


async def _train_in_place(*arguments: Any) -> TopoMap:
    return train_and_save(*arguments)


async def _prune_in_place(name: str, nodes: int, store: MapStore) -> TopoMap:
    return prune_and_save(name, nodes, store)


def _write_config(
    world: World, plant: SimulatedRobot, directory: Path, preset: str, wheel_error: float, base: str, heading: str
) -> Path:
    """A configuration file as a user would write it for this robot."""
    camera: dict[str, Any] = {"source": "http://simulated/", "fov_deg": float(world.fov_deg)}
    info = getattr(world, "camera_info", None)
    if isinstance(info, Mapping):
        camera["calibration"] = "camera.yaml"
        (directory / "camera.yaml").write_text(yaml.safe_dump(dict(info)), "utf-8")
    wheels = {
        "driver": base,
        "port": "/dev/simulated",
        "ticks_per_rev": plant.body.ticks_per_rev,
        "wheel_radius": plant.body.wheel_radius / (1.0 + wheel_error),
        "wheel_separation": plant.body.wheel_separation,
        "robot_radius": ROBOT_RADIUS,
    }
    navigation = {"preset": preset}
    odometry = {"heading": heading}
    storage = {"directory": STORAGE}
    config = {"camera": camera, "base": wheels, "odometry": odometry, "navigation": navigation, "storage": storage}
    path = directory / "omnibotd.yaml"
    path.write_text(yaml.safe_dump(config), "utf-8")
    return path
