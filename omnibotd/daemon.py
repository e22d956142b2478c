"""omnibotd: builds the parts, runs them in one asyncio process, and shuts them down. No logic of its own."""

from __future__ import annotations

import argparse
import asyncio
import gc
import logging
import signal
import sys
from collections.abc import Awaitable, Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from firmware_bridge.bases import make_driver
from firmware_bridge.events import Driver
from omnibotd import __version__, calibrations
from omnibotd.config import BaseConfig, Config, ConfigError, load
from omnibotd.control import ControlLoop, Feedback
from omnibotd.core.errors import CoreError
from omnibotd.io import library_pages
from omnibotd.io.camera import Camera
from omnibotd.io.control_server import ControlServer
from omnibotd.io.control_socket import ControlSocketError
from omnibotd.io.map_store import MapStore, MapStoreError
from omnibotd.io.motor_base import MotorBase
from omnibotd.io.recorder import Recorder
from omnibotd.io.serial_link import SerialLink, SerialPort
from omnibotd.io.stop_guard import StopGuard
from omnibotd.io.systemd_notify import Notifier
from omnibotd.io.wake_line import waking
from omnibotd.perception import OffLoop, Perception
from omnibotd.pruning_process import prune_in_child
from omnibotd.recognition import Recogniser
from omnibotd.requests import Requests
from omnibotd.requests.maps import Pruner
from omnibotd.requests.robot import Robot
from omnibotd.requests.teaching import Trainer
from omnibotd.training_process import train_in_child

log = logging.getLogger(__name__)

# Seconds until systemd hears READY without camera or base: twice what a slow webcam and a board that boots take. A
# start that waited for a cable would hold up the boot, and the watchdog, which only begins with READY.
PATIENCE = 20.0


@dataclass
class Adapters:
    """Everything that touches the world; a simulation under virtual time passes its own."""

    camera: Camera
    base: MotorBase
    store: MapStore
    notifier: Notifier
    off_loop: OffLoop
    trainer: Trainer = train_in_child
    open_recorder: Callable[[Path], Recorder] = Recorder
    pruner: Pruner = prune_in_child


class Daemon:
    """The parts, wired; must be made inside a running event loop."""

    def __init__(self, configured: Config, adapters: Adapters) -> None:
        directory = configured.storage.directory
        config, stored = calibrations.apply(configured, directory)
        self._adapters = adapters
        self.control = ControlLoop(config, adapters.base, adapters.camera, adapters.notifier)
        self.perception = Perception(config, self.control, adapters.camera, adapters.off_loop)
        self.recogniser = Recogniser(
            self.control,
            self.perception,
            adapters.camera,
            adapters.store,
            adapters.off_loop,
        )
        robot = Robot(
            config,
            self.control,
            self.perception,
            self.recogniser,
            adapters.base,
            adapters.camera,
            adapters.store,
            adapters.off_loop,
            calibrations.Calibrations(configured, directory, stored),
        )
        self.requests = Requests(robot, adapters.trainer, adapters.pruner, adapters.open_recorder)

    async def call(
        self, method: str, params: dict[str, Any] | None = None, feedback: Feedback | None = None
    ) -> dict[str, Any]:
        """One request without a socket. Raises RpcError."""
        return await self.requests.dispatch(None, method, params or {}, feedback or (lambda values: None))

    async def run(self) -> None:
        """Until cancelled; whatever ends it, the wheels stop and a running recording is closed whole."""
        await self._load_active_map()
        try:
            async with asyncio.TaskGroup() as tasks:
                for work in self._work():
                    tasks.create_task(work())
        finally:
            self._adapters.notifier.stopping()
            self.control.halt("the daemon is stopping")
            await self.requests.teaching.close()

    def _work(self) -> list[Callable[[], Coroutine[Any, Any, None]]]:
        adapters = self._adapters
        return [
            adapters.base.run,
            adapters.camera.run,
            self.control.run,
            self.perception.run,
            self.recogniser.run,
            self.requests.teaching.watch_recording,
            self.requests.trail.watch,
            self.requests.dock_watch.watch,
            self._report_readiness,
        ]

    async def _load_active_map(self) -> None:
        name = self._adapters.store.active()
        if name is None:
            return
        try:
            await self.perception.use(await self._adapters.off_loop(self._adapters.store.load, name))
            log.info("map %s in use", name)
        except (MapStoreError, CoreError) as error:
            log.error("map %s can't be used, going on without one: %s", name, error)

    async def _report_readiness(self) -> None:
        """READY once camera and base answer, but after PATIENCE without them, too; STATUS says what is missing."""
        loop = asyncio.get_running_loop()
        notifier, ready, told = self._adapters.notifier, False, ""
        patience_ends = loop.time() + PATIENCE
        while True:
            missing = self._missing(loop.time())
            status = "; ".join(missing) or f"{self.control.state.lower()}, camera and base answer"
            if status != told:
                notifier.status(status)
                told = status
            if not ready and (not missing or loop.time() >= patience_ends):
                notifier.ready()
                ready = True
            await asyncio.sleep(0.5)

    def _missing(self, now: float) -> list[str]:
        """What does not answer, and why."""
        base, camera = self._adapters.base, self._adapters.camera
        silent = [] if base.connected else [f"base: {base.reason}"]
        return silent if camera.ok(now) else [*silent, f"camera: {camera.reason}"]


def base_driver(base: BaseConfig) -> Driver:
    """The driver the configuration names, told what only the configuration knows."""
    fastest = base.max_linear_velocity + base.max_angular_velocity * base.wheel_separation / 2.0
    return make_driver(base.driver, base.ticks_per_rev, fastest / base.wheel_radius)


def motor_base(base: BaseConfig) -> MotorBase:
    """The base on its port, with a guard where it needs one."""
    open_port: Callable[[], Awaitable[SerialLink]] = SerialPort(base.port, base.baudrate).open
    if base.driver == "create2":
        open_port = waking(open_port)
    return MotorBase(base_driver(base), open_port, StopGuard.start)


async def serve(config: Config) -> None:
    """Run on the real machine until SIGTERM or SIGINT."""
    loop = asyncio.get_running_loop()
    # One worker: perception has one frame in flight, and the robot's PC has one core.
    with ThreadPoolExecutor(1, thread_name_prefix="perception") as worker:

        async def off_loop(function: Callable[..., Any], *arguments: Any) -> Any:
            return await loop.run_in_executor(worker, function, *arguments)

        base = motor_base(config.base)
        store = MapStore(config.storage.directory)
        daemon = Daemon(config, Adapters(Camera(config.camera), base, store, Notifier(), off_loop))
        server = ControlServer(config.control.socket, config.control.group, daemon.requests.dispatch)
        daemon.control.events = server.broadcast
        await server.start()
        _settle_memory()
        try:
            await _until_signalled(daemon)
        finally:
            await server.close()


def _settle_memory() -> None:
    """Take all that the start has made out of the garbage collector's rounds: modules live as long as the process.

    Without this a full round of 60,000 objects takes 200 ms on an Atom-class PC, in the middle of a drive. What the
    loading of libraries alone has touched is given back.
    """
    gc.collect()
    gc.freeze()
    library_pages.give_back()


async def _until_signalled(daemon: Daemon) -> None:
    running = asyncio.create_task(daemon.run())
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, running.cancel)
    try:
        await running
    except asyncio.CancelledError:
        log.info("stopped")


def describe(config: Config) -> str:
    """What `--check` prints: the hardware that would be opened."""
    base, camera = config.base, config.camera
    lens = camera.calibration or f"{camera.fov_deg:g} deg equidistant, image circle from the frames"
    _, stored = calibrations.apply(config, config.storage.directory)
    return "\n".join(
        [
            "configuration is good; omnibotd would open",
            f"  camera   {camera.source} at {camera.width}x{camera.height}, {camera.fps:g} fps, lens: {lens}",
            f"  base     {base.driver} on {base.port} at {base.baudrate} baud",
            f"  maps     {config.storage.directory}",
            f"  socket   {config.control.socket}",
            *(f"  {s.name:8} calibration of {s.date}{f', IGNORED: {s.reason}' if s.reason else ''}" for s in stored),
        ]
    )


def main(arguments: list[str] | None = None) -> int:
    """Entry point; exit status 2 for a wrong configuration, 1 where the daemon can't start."""
    parser = argparse.ArgumentParser(prog="omnibotd", description=__doc__)
    parser.add_argument("--config", type=Path, default=Path("/etc/omnibotd/omnibotd.yaml"), metavar="FILE")
    parser.add_argument("--check", action="store_true", help="check the configuration, say what would be opened, exit")
    parser.add_argument("--version", action="version", version=__version__)
    options = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s", stream=sys.stderr)
    try:
        config = load(options.config)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    if options.check:
        print(describe(config))
        return 0
    cv2.setNumThreads(1)  # the control loop must not compete with OpenCV's own threads
    try:
        asyncio.run(serve(config))
    except (ControlSocketError, MapStoreError) as error:
        print(f"omnibotd: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
