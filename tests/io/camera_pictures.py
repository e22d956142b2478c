"""Pictures and patience for the tests of the camera."""

import asyncio
import contextlib
import time
from collections.abc import Callable

import cv2
import numpy as np

from omnibotd.io.camera import Camera

WIDTH, HEIGHT = 64, 48


def jpeg(level: int = 128, **options: int) -> bytes:
    """A JPEG of one grey level with some texture, so that its scan holds stuffed bytes."""
    pixels = np.random.default_rng(level).integers(0, 60, (HEIGHT, WIDTH), np.uint8) + np.uint8(level // 2)
    parameters = []
    for name, value in options.items():
        parameters += [getattr(cv2, f"IMWRITE_JPEG_{name.upper()}"), value]
    return cv2.imencode(".jpg", pixels, parameters)[1].tobytes()


async def until(condition: Callable[[], object], seconds: float = 5.0) -> float:
    """Seconds until the condition held; fails the test after `seconds`."""
    start = time.monotonic()
    while not condition():
        assert time.monotonic() - start < seconds, "the condition never held"
        await asyncio.sleep(0.005)
    return time.monotonic() - start


@contextlib.asynccontextmanager
async def running(camera: Camera):
    task = asyncio.create_task(camera.run())
    try:
        yield camera
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task
