"""A simulated robot that outlives its host, for tools/runaway: emulated base, wheels and camera in its own process.

Unlike that of tools/sim/serve its wheels turn on when the cable is pulled, as those of a base with a battery do, and a
port that is opened resets a board that is wired so. It tells over HTTP what its wheels did: `GET /wheels`.
"""

from __future__ import annotations

import argparse
import asyncio
import fcntl
import json
import math
import os
import struct
import termios
import time
import tty
from pathlib import Path

import cv2

from tools.sim.ceilings import tiles
from tools.sim.emulators import BODIES, TurningDevice, make_device
from tools.sim.mjpeg import MjpegServer
from tools.sim.plant import SimulatedRobot

PERIOD = 0.005  # s between steps: what is told of the wheels is as exact
MAX_STEP = 0.05  # s; a process that was held up must not let the wheels jump
FRAME_PERIOD = 0.12  # s; enough for the control loop, and the daemon under test needs the processor
READ_SIZE = 4096
BATTERY = 14_800  # mV
RESET_BY_OPENING = ("arduino_bridge",)  # DTR is wired to their reset
COASTING = 100.0  # ticks/s; a board that does not tell whether its motors are on is said to drive above this
_FLUSHED = 1  # TIOCPKT_FLUSHREAD of asm-generic/ioctls.h: opening a serial port discards what it had received


class Cable:
    """A pty behind a symbolic link of fixed name; pulled and put back it is another pty."""

    def __init__(self, link: Path) -> None:
        self._link = link
        self._ends: tuple[int, int] | None = None

    def plug(self) -> None:
        self.pull()
        # The slave stays open here: else the master fails whenever no host has the port open.
        master, slave = self._ends = os.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        fcntl.ioctl(master, termios.TIOCPKT, struct.pack("i", 1))
        fresh = self._link.with_suffix(".fresh")
        fresh.symlink_to(os.ttyname(slave))
        fresh.replace(self._link)

    def pull(self) -> None:
        if self._ends is not None:
            for end in self._ends:
                os.close(end)
            self._ends = None
            self._link.unlink()

    def read(self) -> tuple[bool, bytes]:
        """Whether a host has opened the port since, and what hosts have written."""
        opened, received = False, b""
        while self._ends is not None:
            try:
                packet = os.read(self._ends[0], READ_SIZE)
            except BlockingIOError:
                break
            if packet[0]:
                opened = opened or bool(packet[0] & _FLUSHED)
            else:
                received += packet[1:]
        return opened, received

    def write(self, data: bytes) -> None:
        if self._ends is None or not data:
            return
        try:
            os.write(self._ends[0], data)
        except BlockingIOError:
            return  # nobody reads the port: a UART would lose the bytes as well


class Robot:
    """Wheels, base and cable, and what they did."""

    def __init__(self, base: str, seed: int, link: Path) -> None:
        self._base = base
        self.world = tiles(seed)
        self._plant = SimulatedRobot(self.world, (0.0, 0.0, 0.0), seed, BODIES[base])
        self._cable = Cable(link)
        self._lives = 0
        self._rolled = 0.0
        self._driven_until = -math.inf
        self._renew(self._plant.pose)

    @property
    def pose(self) -> tuple[float, float, float]:
        return self._plant.pose

    async def live(self) -> None:
        """The base and its wheels, for ever."""
        before = time.monotonic()
        while True:
            await asyncio.sleep(PERIOD)
            now = time.monotonic()
            self._step(now, min(now - before, MAX_STEP))
            before = now

    def wheels(self, body: bytes = b"") -> dict[str, object]:
        """Monotonic seconds of now and of the last moment at which the motors were on; metres rolled, pose."""
        told = {"now": time.monotonic(), "driven": self._driven, "driven_until": self._driven_until}
        return {**told, "rolled": self._rolled, "pose": self._plant.pose}

    def pull(self, body: bytes) -> dict[str, object]:
        self._cable.pull()
        return {"now": time.monotonic()}

    def plug(self, body: bytes) -> dict[str, object]:
        self._cable.plug()
        return {}

    def renew(self, body: bytes) -> dict[str, object]:
        """A person switches the base off and on, carries the robot to the pose [x, y, yaw] and plugs the cable in."""
        self._renew(tuple(json.loads(body)))
        return {}

    def _renew(self, pose: tuple[float, float, float]) -> None:
        self._plant.teleport(pose)
        self._lives += 1
        self._device = make_device(self._base, self._lives)
        self._ticks = (0, 0)
        self._cable.plug()

    @property
    def _driven(self) -> bool:
        return max(map(abs, self._device.target)) > (COASTING if isinstance(self._device, TurningDevice) else 0.0)

    def _turn(self, dt: float) -> None:
        before = self._ticks
        if isinstance(self._device, TurningDevice):
            self._ticks = self._device.turned
            self._plant.roll(self._ticks[0] - before[0], self._ticks[1] - before[1])
        else:
            left, right = self._plant.step(dt, *self._device.target)
            self._ticks = before[0] + left, before[1] + right
        ticks = abs(self._ticks[0] - before[0]) + abs(self._ticks[1] - before[1])
        self._rolled += ticks / 2.0 * self._plant.body.metres_per_tick

    def _step(self, now: float, dt: float) -> None:
        opened, data = self._cable.read()
        if opened and self._base in RESET_BY_OPENING:
            self._lives += 1
            self._device.reset(self._lives)
        if data:
            self._device.receive(data, now)
        if self._driven:
            self._driven_until = now
        self._turn(dt)
        left, right = self._plant.bumpers
        self._device.set_state(*self._ticks, bumper_left=left, bumper_right=right, charging=False, battery_mv=BATTERY)
        self._device.poll(now)
        self._cable.write(self._device.data_to_send())


async def show(robot: Robot, camera: MjpegServer) -> None:
    """Its pictures, for ever."""

    def photograph() -> bytes:
        image = robot.world.render(*robot.pose, time.monotonic())
        return bytes(cv2.imencode(".jpg", image)[1].tobytes())

    while True:
        await camera.publish(await asyncio.to_thread(photograph))
        await asyncio.sleep(FRAME_PERIOD)


async def serve(robot: Robot) -> None:
    """For ever; prints the camera's address when it answers."""
    posts = {"/pull": robot.pull, "/plug": robot.plug, "/renew": robot.renew}
    resources = {("GET", "/wheels"): robot.wheels, **{("POST", path): call for path, call in posts.items()}}
    camera = MjpegServer(resources)
    await camera.start()
    print(json.dumps({"camera": camera.url}), flush=True)
    async with asyncio.TaskGroup() as group:
        group.create_task(robot.live())
        group.create_task(show(robot, camera))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--base", required=True, choices=BODIES)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--link", type=Path, required=True, help="where the symbolic link to the pty is to be")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    asyncio.run(serve(Robot(options.base, options.seed, options.link)))


if __name__ == "__main__":
    main()
