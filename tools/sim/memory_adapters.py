"""What a daemon in virtual time has instead of a serial port, a camera and a disk that keeps up."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from typing import Any

from firmware_bridge.emulator import Device
from omnibotd.core.vision.frame import Frame
from omnibotd.io.recorder import Recorder

FRAME_PERIOD = 0.1  # s; what the control tick can use
EXPOSURE_TO_ARRIVAL = 0.03  # s; a webcam's MJPEG frame over USB 2, and the daemon stamps arrivals
LINE_BUFFER = 4096  # bytes, as a pty holds; nobody reads while the daemon reconnects
RECORDS_WAITING = 32  # enough to keep the recorder's thread busy, too few to make it drop a frame


class MemoryLink:
    """A serial line to a device role in the same process; `cut` loses all bytes both ways."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._arrived = bytearray()
        self._news = asyncio.Event()
        self.cut = False

    async def read(self) -> bytes:
        await self._news.wait()
        data = bytes(self._arrived)
        self._arrived.clear()
        self._news.clear()
        return data

    def write(self, data: bytes) -> None:
        if not self.cut:
            self._device.receive(data, asyncio.get_running_loop().time())

    def close(self) -> None:
        """Nothing to let go of: the device lives on."""

    def deliver(self, data: bytes) -> None:
        if data and not self.cut:
            self._arrived += data
            del self._arrived[:-LINE_BUFFER]
            self._news.set()


class MemoryCamera:
    """Offers what `omnibotd.io.camera.Camera` offers; pictures are taken by `expose(now)` when due."""

    rate_hz = 1.0 / FRAME_PERIOD
    reason = ""
    stream = None  # no V4L2 camera

    def __init__(self, expose: Callable[[float], bytes], size: tuple[int, int]) -> None:
        self._expose = expose
        self.size = size
        self.latest: Frame | None = None
        self._news = asyncio.Event()

    def age(self, now: float) -> float:
        return math.inf if self.latest is None else now - self.latest.stamp

    def ok(self, now: float) -> bool:
        return self.age(now) < 1.0

    async def wait_newer(self, stamp: float) -> Frame:
        while self.latest is None or self.latest.stamp <= stamp:
            self._news.clear()
            await self._news.wait()
        return self.latest

    async def run(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            data = self._expose(loop.time())
            await asyncio.sleep(EXPOSURE_TO_ARRIVAL)
            self.latest = Frame(loop.time(), data)
            self._news.set()
            await asyncio.sleep(FRAME_PERIOD - EXPOSURE_TO_ARRIVAL)


class PatientRecorder(Recorder):
    """Waits for its own thread where the real one would drop frames: virtual seconds are shorter than the disk's."""

    def _put(self, record: Any) -> bool:
        while self._waiting.qsize() >= RECORDS_WAITING and self.error is None:
            time.sleep(0.001)
        return super()._put(record)
