"""A simulated robot that outlives its host, for tools/runaway: emulated base, wheels and camera in its own process.

Unlike that of tools/sim/serve its wheels turn on when the cable is pulled, as those of a base with a battery do, and a
port that is opened resets a board that is wired so. Over HTTP it is told to strike at its host, and asked what its
wheels did then.
"""

from __future__ import annotations

import argparse
import asyncio
import fcntl
import json
import os
import struct
import termios
import time
import tty
from collections import deque
from pathlib import Path

import cv2

from tools.sim.ceilings import tiles
from tools.sim.emulators import BODIES, TurningDevice, make_device
from tools.sim.mjpeg import MjpegServer
from tools.sim.plant import SimulatedRobot

PERIOD = 0.005  # s, a step of base and wheels, two at a time: what is told of the wheels is half as exact
# Wheels that are slower count as standing: the model's last ticks come ever more slowly, those of a gear box do not.
STANDING, WINDOW = 0.01, 0.05  # m/s, and s over which a speed is taken
FRAME_PERIOD = 0.2  # s; enough for the control loop, and the daemon under test needs the processor
READ_SIZE = 4096
BATTERY = 14_800  # mV
RESET_BY_OPENING = ("arduino_bridge",)  # DTR is wired to their reset
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
    """Wheels, base and cable, and what they did since the last blow. Its clock is the monotonic one, in even steps."""

    def __init__(self, base: str, seed: int, link: Path) -> None:
        self._base = base
        self.world = tiles(seed)
        self._plant = SimulatedRobot(self.world, (0.0, 0.0, 0.0), seed, BODIES[base])
        self._cable = Cable(link)
        self._lives = 0
        self._now = self._struck_at = self._driven_at = self._turned_at = time.monotonic()
        self._rolled = self._late = 0.0
        self._way: deque[tuple[float, float]] = deque([(self._now, 0.0)])  # since WINDOW ago: seconds, metres rolled
        self._renew(self._plant.pose)

    @property
    def pose(self) -> tuple[float, float, float]:
        return self._plant.pose

    async def live(self) -> None:
        """The base and its wheels, for ever."""
        while True:
            await asyncio.sleep(2.0 * PERIOD)
            self._catch_up()

    def wheels(self, body: bytes = b"") -> dict[str, object]:
        """Seconds since the blow, and from it to when motors were on and wheels turned last; metres rolled."""
        self._catch_up()
        began = self._struck_at
        times = {"since": self._now - began, "driven": self._driven_at - began, "turned": self._turned_at - began}
        return {**times, "turning": self._turning, "rolled": self._rolled, "late": self._late}

    def strike(self, body: bytes) -> dict[str, object]:
        """Send the `signal` to the `pids`, or pull the cable where there are none; only while the wheels turn."""
        blow = json.loads(body)
        self._catch_up()
        if not self._turning:
            return {"struck": False}
        for pid in blow["pids"]:
            os.kill(pid, blow["signal"])
        if not blow["pids"]:
            self._cable.pull()
        self._struck_at, self._rolled, self._late = self._now, 0.0, 0.0
        return {"struck": True}

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
    def _turning(self) -> bool:
        return self._way[-1][1] - self._way[0][1] > STANDING * WINDOW

    def _catch_up(self) -> None:
        """Up to now; what a host has written comes last, so that no delay of ours makes the wheels stop sooner."""
        begin, end = self._now, time.monotonic()
        while self._now < end:
            step = min(PERIOD, end - self._now)
            self._now += step
            self._step(step)
        opened, data = self._cable.read()
        if opened and self._base in RESET_BY_OPENING:
            self._lives += 1
            self._device.reset(self._lives)
        if data:
            self._late = max(self._late, end - begin)
            self._device.receive(data, self._now)

    def _step(self, dt: float) -> None:
        if any(self._device.target):
            self._driven_at = self._now
        self._roll(self._turn(dt))
        left, right = self._plant.bumpers
        self._device.set_state(*self._ticks, bumper_left=left, bumper_right=right, charging=False, battery_mv=BATTERY)
        self._device.poll(self._now)
        self._cable.write(self._device.data_to_send())

    def _roll(self, ticks: int) -> None:
        metres = ticks / 2.0 * self._plant.body.metres_per_tick
        self._rolled += metres
        self._way.append((self._now, self._way[-1][1] + metres))
        while self._now - self._way[0][0] > WINDOW:
            self._way.popleft()
        if self._turning:
            self._turned_at = self._now

    def _turn(self, dt: float) -> int:
        """Ticks of both wheels, whichever way."""
        before = self._ticks
        if isinstance(self._device, TurningDevice):
            self._ticks = self._device.turned
            self._plant.roll(self._ticks[0] - before[0], self._ticks[1] - before[1])
        else:
            left, right = self._plant.step(dt, *self._device.target)
            self._ticks = before[0] + left, before[1] + right
        return abs(self._ticks[0] - before[0]) + abs(self._ticks[1] - before[1])


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
    posts = {"/wheels": robot.wheels, "/strike": robot.strike, "/plug": robot.plug, "/renew": robot.renew}
    camera = MjpegServer({("POST", path): call for path, call in posts.items()})
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
