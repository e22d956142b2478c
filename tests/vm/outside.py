"""What is outside the guest: the robot's body, its camera, the world, and a person who sees the truth and drives."""

from __future__ import annotations

import asyncio
import json
import math
import threading
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from omnibotd.core.geometry import Pose2D
from tools.sim.lockstep import STEP, LockstepRobot
from tools.sim.plant import Pose
from tools.sim.usb_redir import RedirSession
from tools.sim.uvc_camera import UvcCamera
from tools.sim.world_plugin import World

T = TypeVar("T")
POLL_PERIOD = 0.02  # s of the host
# The guest's own time, for any observer: the counter of its ACPI timer. No read of it changes anything.
CLOCK_PORT, CLOCK_HZ, CLOCK_BITS = 0x608, 3579545.0, 24
LULL = 0.14  # s of the guest without a set-point, where every tick of 0.1 s brings one: half of what is silence
ANSWER_LIMIT = 120.0  # s of the host; a daemon that is down does not answer at all
REACH = 0.15  # m, how near to a corner of the way is there
TOP_SPEED, TOP_TURN = 0.4, 1.2  # m/s, rad/s


class Lull:
    """For how long the world must live on by the guest's clock, as no set-point lets it."""

    def __init__(self, count: int) -> None:
        self._count, self._quiet, self._owed = count, 0.0, 0.0

    def guided(self) -> None:
        """A set-point has come: it tells the time up to now."""
        self._quiet = self._owed = 0.0

    def tell(self, count: int) -> None:
        """What the guest's clock shows now."""
        passed = (count - self._count) % 2**CLOCK_BITS / CLOCK_HZ
        self._count = count
        self._quiet += passed
        self._owed += passed

    def take(self, step: float) -> float:
        """Whole steps that are due; none before it is certain that no set-point is on its way."""
        due = self._owed // step * step if self._quiet > LULL else 0.0
        self._owed -= due
        return due


class Outside:
    """Runs in a thread of its own from `start` to `close`; the sockets are QEMU's."""

    def __init__(self, folder: Path, world: World, pose: Pose, seed: int) -> None:
        self._folder = folder
        self.camera = UvcCamera(640, 480)
        self.robot = LockstepRobot(world, pose, seed, self.camera.show)
        self.robot.on_tick = self._tick
        self._ticked = asyncio.Event()
        self._guided = False  # a set-point has come since the guest's clock was read last
        self._base: asyncio.StreamWriter | None = None
        self._base_plugged = False
        self._camera_plugged = asyncio.Event()
        self._camera_line: asyncio.StreamWriter | None = None
        self._hand: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        self._requests = 0
        self._loop = asyncio.new_event_loop()
        self._works: list[Future[None]] = []
        self._lines: list[asyncio.StreamWriter] = []
        self._thread = threading.Thread(target=self._loop.run_forever, name="outside", daemon=True)

    def start(self) -> None:
        self._thread.start()
        for work in (self._live(), self._be_base(), self._be_camera()):
            self._works.append(asyncio.run_coroutine_threadsafe(work, self._loop))

    def close(self) -> None:
        """Raises RuntimeError where a part of the world had ended before: what came after stood still."""
        ended = [work for work in self._works if work.done()]
        self.do(self._end(), 10.0)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()
        for work in ended:
            raise RuntimeError("a part of the world had ended") from work.exception()

    async def _end(self) -> None:
        works = asyncio.all_tasks() - {asyncio.current_task()}
        for work in works:
            work.cancel()
        await asyncio.gather(*works, return_exceptions=True)
        for line in self._lines:
            line.close()

    def do(self, work: Coroutine[Any, Any, T], patience: float = 1800.0) -> T:
        """Wait for something that happens outside."""
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(patience)

    def set(self, change: Callable[[], None]) -> None:
        """Do it between two things that happen outside."""

        async def now() -> None:
            change()

        self.do(now(), 60.0)

    # ---- plugs

    def plug_camera(self) -> None:
        self._loop.call_soon_threadsafe(self._camera_plugged.set)

    def unplug_camera(self) -> None:
        def pull() -> None:
            self._camera_plugged.clear()
            if self.camera.session is not None and self._camera_line is not None:
                self.camera.session.unplug()
                self._camera_line.write(self.camera.session.data_to_send())

        self.set(pull)

    def base_is_plugged(self, plugged: bool) -> None:
        """What is said while nothing is plugged in must not wait on the line."""
        self.set(lambda: setattr(self, "_base_plugged", plugged))

    async def _be_base(self) -> None:
        reader, self._base = await self._connected("base")
        while data := await reader.read(4096):
            self._say(self.robot.receive(data))
        self._base = None

    def _say(self, data: bytes) -> None:
        if self._base is not None and self._base_plugged:
            self._base.write(data)

    def _tick(self) -> None:
        self._guided = True
        self._lived()

    def _lived(self) -> None:
        self._flush_camera()
        self._ticked.set()
        self._ticked = asyncio.Event()

    async def _live(self) -> None:
        """The world's clock while no set-point tells the time: the guest's own, through QEMU's monitor."""
        reader, monitor = await self._connected("clock")
        await self._command(reader, monitor, "qmp_capabilities")
        lull = Lull(await self._clock(reader, monitor))
        while True:
            await asyncio.sleep(POLL_PERIOD)
            lull.tell(await self._clock(reader, monitor))
            if self._guided:
                lull.guided()
                self._guided = False
            if due := lull.take(STEP):
                self._say(self.robot.idle(due))
                self._lived()

    async def _clock(self, reader: asyncio.StreamReader, monitor: asyncio.StreamWriter) -> int:
        """The count of the guest's ACPI timer."""
        read = {"command-line": f"i /w {CLOCK_PORT:#x}"}
        said = await self._command(reader, monitor, "human-monitor-command", **read)
        return int(said.rpartition("=")[2], 16)

    @staticmethod
    async def _command(reader: asyncio.StreamReader, monitor: asyncio.StreamWriter, name: str, **arguments: str) -> Any:
        """What QEMU's monitor returns; its events and its greeting are passed over."""
        monitor.write(json.dumps({"execute": name, "arguments": arguments}).encode() + b"\n")
        while True:
            answer = json.loads(await reader.readline())
            if "return" in answer:
                return answer["return"]

    async def _be_camera(self) -> None:
        while True:
            await self._camera_plugged.wait()
            reader, line = await self._connected("camera")
            self._camera_line = line
            self.camera.session = session = RedirSession(self.camera)
            self._flush_camera()
            while self._camera_plugged.is_set():
                with suppress(TimeoutError):
                    async with asyncio.timeout(0.2):
                        data = await reader.read(65536)
                        if not data:
                            break
                        session.receive(data)
                        self.camera.pump()
                        self._flush_camera()
            self.camera.session = None
            await asyncio.sleep(0.5)  # its last words are read before the line is cut
            line.close()

    def _flush_camera(self) -> None:
        if self._camera_line is not None and self.camera.session is not None:
            self._camera_line.write(self.camera.session.data_to_send())

    async def _connected(self, name: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        while True:
            with suppress(OSError):
                reader, line = await asyncio.open_unix_connection(str(self._folder / name))
                self._lines.append(line)
                return reader, line
            await asyncio.sleep(0.1)

    # ---- the person

    async def ask(self, method: str, **params: Any) -> dict[str, Any]:
        """A request to the daemon's own socket, to which a line leads. Raises RuntimeError, TimeoutError."""
        if self._hand is None:
            self._hand = await self._connected("control")
        reader, writer = self._hand
        self._requests += 1
        request = {"jsonrpc": "2.0", "id": self._requests, "method": method, "params": params}
        writer.write(json.dumps(request).encode() + b"\n")
        async with asyncio.timeout(ANSWER_LIMIT):
            answer = await self._answer(reader)
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']['message']}")
        return dict(answer["result"])

    async def _answer(self, reader: asyncio.StreamReader) -> dict[str, Any]:
        """The line that answers the latest request; half lines of a daemon that fell are nobody's."""
        while True:
            with suppress(json.JSONDecodeError):
                answer: dict[str, Any] = json.loads(await reader.readline())
                if answer.get("id") == self._requests:
                    return answer

    async def drive(self, v: float, w: float) -> None:
        await self.ask("drive", vx=v, wz=w)
        await self._ticked.wait()

    async def drive_to(self, points: list[tuple[float, float]]) -> None:
        """Turn to each and drive there, in a curve where that does."""
        for point in points:
            target = Pose2D(*point)
            while (here := Pose2D(*self.robot.pose)).distance(target) > REACH:
                bearing = here.bearing(target)
                ahead = TOP_SPEED * max(0.0, 1.0 - abs(bearing) / 0.8)
                await self.drive(ahead, max(-TOP_TURN, min(TOP_TURN, 2.0 * bearing)))
        await self.drive(0.0, 0.0)

    async def face(self, yaw: float) -> None:
        while abs(error := math.remainder(yaw - self.robot.pose[2], 2.0 * math.pi)) > 0.03:
            await self.drive(0.0, max(-TOP_TURN, min(TOP_TURN, 1.5 * error)))
        await self.drive(0.0, 0.0)

    async def park(self, dock: Pose2D, run_up: float = 0.6) -> None:
        """Straight ahead into the dock from `run_up` metres before it."""
        start = dock.transform(-run_up, 0.0)
        await self.drive_to([start])
        await self.face(Pose2D(*self.robot.pose).bearing(dock) + self.robot.pose[2])
        while (offset := dock.inverse() @ Pose2D(*self.robot.pose)).x < -0.005:
            await self.drive(min(0.15, 0.02 - offset.x), -3.0 * offset.y - 1.5 * offset.yaw)
        await self.drive(0.0, 0.0)

    async def until(self, good: Callable[[], object], seconds: float = 120.0) -> float:
        """Seconds of the world until so. Raises TimeoutError."""
        began = self.robot.seconds
        while not good():
            if self.robot.seconds - began > seconds:
                raise TimeoutError(f"not so after {seconds:.0f} s of the world")
            await self._ticked.wait()
        return self.robot.seconds - began
