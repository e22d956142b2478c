"""A simulated robot in real time (launcher: tools/sim/serve): a base on a pty and its camera as an MJPEG stream.

`GET /truth` on the camera's port tells where the robot is, `POST /teleport` with {"x", "y", "yaw"} carries it.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

import cv2

from firmware_bridge.emulator import Emulator, Senses
from tools.sim.emulators import BODIES, BaseUnavailable, TurningDevice, make_device
from tools.sim.mjpeg import MjpegServer
from tools.sim.panorama import PanoramaError
from tools.sim.plant import Pose, SimulatedRobot
from tools.sim.world_plugin import World, WorldError, load_world

JPEG_QUALITY = 85
TRUTH_PERIOD = 0.1  # s
BATTERY_FULL, BATTERY_CHARGING = 12_400, 13_600  # mV, a three-cell pack


class RobotServer:
    """One robot in one world: its body behind an emulated base, its camera and its truth behind HTTP."""

    def __init__(
        self, world: World, pose: Pose, seed: int, fps: float, base: str = "omnibot", *, range_sensor: bool = False
    ) -> None:
        """Opens the pty. Raises ValueError where there is no room for the robot at `pose`."""
        self._world = world
        self._period = 1.0 / fps
        self._plant = SimulatedRobot(world, pose, seed, BODIES[base], range_sensor=range_sensor)
        self._ticks = (0, 0)
        self._device = make_device(base, int.from_bytes(os.urandom(4), "big"))
        self.emulator = Emulator(self._device, self, self._senses, seed=seed)
        self.camera = MjpegServer({("GET", "/truth"): lambda _: self.truth(), ("POST", "/teleport"): self._teleport})

    def step(self, dt: float, left_target: float, right_target: float) -> tuple[int, int]:
        """The emulator's wheels: ticks (left, right) since the start."""
        left, right = self._ticks
        if isinstance(self._device, TurningDevice):
            self._ticks = self._device.turned
            self._plant.roll(self._ticks[0] - left, self._ticks[1] - right)
        else:
            new_left, new_right = self._plant.step(dt, left_target, right_target)
            self._ticks = (left + new_left, right + new_right)
        return self._ticks

    def where(self) -> dict[str, object]:
        """What a user of this robot needs to know: base, camera, and the dock's true pose."""
        return {"port": self.emulator.port, "camera": self.camera.url, "dock": self._world.dock}

    def truth(self) -> dict[str, object]:
        """Where the robot is at this moment (metres, radians, monotonic seconds) and what it touches."""
        x, y, yaw = self._plant.pose
        left, right = self._plant.bumpers
        touch = {"bumper_left": left, "bumper_right": right, "at_dock": self._plant.at_dock()}
        return {"stamp": time.monotonic(), "x": x, "y": y, "yaw": yaw, **touch}

    async def show(self) -> None:
        """Renders and publishes frames for ever; drops those that the machine is too slow for."""
        due = time.monotonic()
        while True:
            await self.camera.publish(await asyncio.to_thread(self._photograph, self._plant.pose, due))
            due = max(due + self._period, time.monotonic())
            await asyncio.sleep(due - time.monotonic())

    async def log_truth(self, file: TextIO) -> None:
        """Appends a line of JSON ten times a second, for ever."""
        while True:
            file.write(json.dumps(self.truth()) + "\n")
            await asyncio.sleep(TRUTH_PERIOD)

    def _photograph(self, pose: Pose, t: float) -> bytes:
        image = self._world.render(*pose, t)
        return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes())

    def _senses(self) -> Senses:
        left, right = self._plant.bumpers
        charging = self._plant.at_dock()
        volts = BATTERY_CHARGING if charging else BATTERY_FULL
        return Senses(
            bumper_left=left,
            bumper_right=right,
            charging=charging,
            battery_mv=volts,
            range_ahead=self._plant.range_ahead,
        )

    def _teleport(self, body: bytes) -> dict[str, object]:
        try:
            wanted = json.loads(body)
            pose = tuple(float(wanted[key]) for key in ("x", "y", "yaw"))
        except (ValueError, TypeError, KeyError, UnicodeDecodeError) as error:
            raise ValueError(f'expected {{"x": metres, "y": metres, "yaw": radians}}: {error!r}') from error
        self._plant.teleport(_finite(pose))
        return self.truth()


def _finite(values: tuple[float, ...]) -> Pose:
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise ValueError(f"a pose is three finite numbers X,Y,YAW, not {values}")
    return values[0], values[1], values[2]


@contextmanager
def _linked(link: Path | None, port: str) -> Iterator[None]:
    """A symbolic link to the pty for as long as it lives. Raises OSError where something else is in the way."""
    if link is None:
        yield
        return
    if link.exists() and not link.is_symlink():
        raise FileExistsError(f"{link} exists and is no symbolic link: choose another --link")
    fresh = link.with_name(f"{link.name}.{os.getpid()}")
    fresh.symlink_to(port)
    fresh.replace(link)
    try:
        yield
    finally:
        if link.is_symlink() and os.readlink(link) == port:
            link.unlink()


@contextmanager
def _appended(path: Path | None) -> Iterator[TextIO | None]:
    """The file open for whole lines, or None without a path. Raises OSError."""
    if path is None:
        yield None
        return
    with path.open("a", buffering=1) as file:
        yield file


async def serve(robot: RobotServer, options: argparse.Namespace) -> None:
    """Runs until SIGINT or SIGTERM; prints where base and camera are as soon as both answer."""
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    await robot.camera.start(options.port)
    try:
        with _linked(options.link, robot.emulator.port), _appended(options.truth) as truth:
            async with asyncio.TaskGroup() as group:
                tasks = [group.create_task(robot.emulator.run()), group.create_task(robot.show())]
                if truth is not None:
                    tasks.append(group.create_task(robot.log_truth(truth)))
                print(json.dumps(robot.where()), flush=True)
                await stop.wait()
                for task in tasks:
                    task.cancel()
    finally:
        await robot.camera.close()


def _pose(text: str) -> Pose:
    try:
        return _finite(tuple(float(part) for part in text.split(",")))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r}: expected X,Y,YAW in metres and radians") from error


def _rate(text: str) -> float:
    rate = float(text)
    if not 0.1 <= rate <= 60.0:
        raise argparse.ArgumentTypeError(f"{text} frames a second: expected 0.1 to 60")
    return rate


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="tools/sim/serve", description=__doc__)
    parser.add_argument("--world", default="tools.sim.ceilings:tiles", metavar="MODULE:FACTORY")
    parser.add_argument("--base", choices=sorted(BODIES), default="omnibot", help="whose protocol the pty speaks")
    parser.add_argument("--range-sensor", action="store_true", help="it looks ahead and tells, where its protocol can")
    parser.add_argument("--seed", type=int, default=0, help="of the room's details and the robot's errors")
    parser.add_argument("--pose", type=_pose, default=(0.0, 0.0, 0.0), metavar="X,Y,YAW")
    parser.add_argument("--port", type=int, default=0, help="of the camera on 127.0.0.1; 0 takes a free one")
    parser.add_argument("--fps", type=_rate, default=15.0)
    parser.add_argument("--truth", type=Path, metavar="FILE", help="append the true pose as JSON lines, 10 Hz")
    parser.add_argument("--link", type=Path, metavar="PATH", help="make this a symbolic link to the pty")
    return parser


def main() -> int:
    """Exit code: 0 after SIGINT or SIGTERM, 1 where something needed is missing (said on stderr)."""
    options = _parser().parse_args()
    cv2.setNumThreads(1)  # frames are small; the daemon under test needs the other cores
    try:
        world = load_world(options.world, options.seed)
        robot = RobotServer(
            world, options.pose, options.seed, options.fps, options.base, range_sensor=options.range_sensor
        )
        asyncio.run(serve(robot, options))
    except* (WorldError, PanoramaError, BaseUnavailable, ValueError, OSError) as group:
        print("\n".join(f"tools/sim/serve: {error}" for error in group.exceptions), file=sys.stderr)
        return_code = 1
    else:
        return_code = 0
    return return_code


if __name__ == "__main__":
    sys.exit(main())
