"""The camera as the daemon sees it: the latest good frame of a source that may stall, break or vanish."""

from __future__ import annotations

import asyncio
import logging
import math
import threading
from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future
from contextlib import closing
from functools import partial
from pathlib import Path

import cv2
import yaml

from omnibotd.config import CameraConfig
from omnibotd.core.errors import CoreError, FrameError
from omnibotd.core.vision.camera_model import CameraModel, CameraModelError
from omnibotd.core.vision.frame import Frame
from omnibotd.io.camera_errors import CameraError
from omnibotd.io.camera_http import http_frames
from omnibotd.io.camera_jpeg import whole
from omnibotd.io.camera_replay import frames_of, paced
from omnibotd.io.camera_v4l2 import v4l2_frames
from omnibotd.io.camera_v4l2_modes import Stream, Wanted

__all__ = ["Camera", "CameraError", "FrameSource", "frame_source", "frames_of", "load_calibration", "wanted_of"]

log = logging.getLogger(__name__)

FrameSource = Callable[[], Generator[Frame]]
"""Opens a source when first asked for a frame; ends with a recording, by CameraError where a camera fails."""

FRESH = 1.0  # seconds for which a frame counts as the present; at 1 m/s and 15 frames/s, 15 frames missed
OPENING = 5.0  # seconds to the first frame: a webcam takes 1-3 s to start its stream
FIRST_RETRY, LAST_RETRY = 0.5, 10.0
# Readers that hang in a driver can't be ended, only left behind. V4L2 returns after seconds; should a driver
# never return, more readers would not help either.
MAX_HANGING = 3
END_OF_RECORDING = "end of recording"
_RATE_WINDOW = 30  # frames over which the rate is measured: 2 s at 15 frames/s


def frame_source(config: CameraConfig, tell: Callable[[Stream], None]) -> FrameSource:
    """What `camera.source` names: a device, a stream, a video file or a folder; a device tells what it settled on."""
    source = config.source
    if source.startswith("http://"):
        return partial(http_frames, source)
    if source.startswith("/dev/"):
        return partial(v4l2_frames, source, wanted_of(config), tell)
    return partial(paced, Path(source), config.fps)


def wanted_of(config: CameraConfig) -> Wanted:
    """What a V4L2 camera is asked for."""
    return Wanted(config.width, config.height, config.fps, config.exposure, config.white_balance)


def load_calibration(path: Path, fov: float = math.radians(190.0)) -> CameraModel:
    """The lens described by a ROS camera_info file; raises CameraModelError with the file's name."""
    try:
        info = yaml.safe_load(path.read_text("utf-8"))
        if not isinstance(info, dict):
            raise CameraModelError("not in the camera_info layout, `key: value` lines")
        model = CameraModel.from_camera_info(info, fov)
        if not _is_lens(model):
            raise CameraModelError("camera_matrix needs finite values, focal lengths > 0 and a centre in the image")
    except OSError as error:
        raise CameraModelError(f"{path}: can't be read: {error.strerror}") from error
    except (CoreError, yaml.YAMLError, UnicodeDecodeError) as error:
        raise CameraModelError(f"{path}: {error}; calibrate the camera anew") from error
    return model


def _is_lens(model: CameraModel) -> bool:
    finite = all(map(math.isfinite, (model.fx, model.fy, model.cx, model.cy, *model.distortion)))
    inside = 0.0 <= model.cx < model.width and 0.0 <= model.cy < model.height
    return finite and inside and model.fx > 0.0 and model.fy > 0.0


class Camera:
    """Keeps the source open and the latest frame at hand while `run` runs. Stamps are the event loop's."""

    def __init__(self, config: CameraConfig, frames: FrameSource | None = None) -> None:
        self.source = config.source
        self.reason = "not started"  # why there is no picture; empty while there is one
        self.stream: Stream | None = None  # what a V4L2 camera settled on when it was last opened
        self._frames = frames or frame_source(config, self._settled)
        self._latest: Frame | None = None
        self._arrival = asyncio.Event()  # set, and replaced, with each frame
        self._reader: _Reader | None = None
        self._bad_before = 0
        self._hanging: list[threading.Thread] = []

    @property
    def latest(self) -> Frame | None:
        """The newest good frame, however old."""
        return self._latest

    @property
    def size(self) -> tuple[int, int] | None:
        """(width, height) of the frames of this source, None before the first."""
        return self._reader.size if self._reader else None

    @property
    def rate_hz(self) -> float:
        """Good frames a second just now, 0 while there are none."""
        return self._reader.rate_hz if self._reader and not self.reason else 0.0

    @property
    def bad_frames(self) -> int:
        """Frames dropped because they were no whole picture."""
        return self._bad_before + (self._reader.bad_frames if self._reader else 0)

    def age(self, now: float) -> float:
        """Seconds since the latest frame came, infinite before the first."""
        return math.inf if self._latest is None else now - self._latest.stamp

    def ok(self, now: float) -> bool:
        """Whether a frame came within the last second."""
        return self.age(now) <= FRESH

    async def wait_newer(self, stamp: float) -> Frame:
        """The first frame seen with a stamp after `stamp`."""
        while self._latest is None or self._latest.stamp <= stamp:
            await self._arrival.wait()
        return self._latest

    async def run(self) -> None:
        """Read the source until cancelled; one that fails is opened again, a recording's end is final."""
        retry = FIRST_RETRY
        self.reason = f"opening {self.source}"
        while self.reason != END_OF_RECORDING:
            if await self._read_once():
                retry = FIRST_RETRY
            await asyncio.sleep(retry)
            retry = min(2.0 * retry, LAST_RETRY)
        await asyncio.Event().wait()

    async def _read_once(self) -> bool:
        """One opening of the source up to its failure, told in `reason`; True if a good frame came of it."""
        self._hanging = [thread for thread in self._hanging if thread.is_alive()]
        if len(self._hanging) >= MAX_HANGING:
            self.reason = f"{self.source}: {MAX_HANGING} readers hang in the driver; replug the camera"
            return False
        news = asyncio.Event()
        reader = _Reader(self._frames, partial(asyncio.get_running_loop().call_soon_threadsafe, news.set))
        self._bad_before, self._reader = self.bad_frames, reader
        try:
            reason = await self._follow(reader, news)
        finally:
            reader.abandon()
            self._hanging.append(reader.thread)
        if not self.reason:
            log.warning("camera lost: %s", reason)
        self.reason = reason
        return reader.newest is not None

    async def _follow(self, reader: _Reader, news: asyncio.Event) -> str:
        """Take the reader's frames until it ends or stalls; why it did."""
        deadline = asyncio.get_running_loop().time() + OPENING
        while not reader.outcome.done():
            try:
                async with asyncio.timeout_at(deadline):
                    await news.wait()
            except TimeoutError:
                if reader.newest is None or reader.newest is self._latest:
                    return self._silence(reader)
            news.clear()
            reader.told = False
            if reader.newest is not None and reader.newest is not self._latest:
                deadline = reader.newest.stamp + FRESH
                self._publish(reader.newest)
        return reader.outcome.result()

    def _settled(self, stream: Stream) -> None:
        """Called by a reader's thread, once an opening."""
        if stream != self.stream:
            log.info("camera %s: %s", stream.card, stream.mode)
            for warning in stream.warnings:
                log.warning("%s", warning)
        self.stream = stream

    def _publish(self, frame: Frame) -> None:
        if self.reason:
            log.info("camera: pictures from %s", self.source)
        self._latest, self.reason = frame, ""
        self._arrival.set()
        self._arrival = asyncio.Event()

    def _silence(self, reader: _Reader) -> str:
        bad = f", {reader.bad_frames} damaged ones" if reader.bad_frames else ""
        return f"{self.source}: no picture for {OPENING if reader.newest is None else FRESH:g} s{bad}"


class _Reader:
    """A thread that reads one opening of a source. Left behind, its frames reach nobody; it ends when it can.

    `outcome` becomes the reason for which the source ended, or the exception where the fault is our own.
    """

    def __init__(self, frames: FrameSource, wake: Callable[[], object]) -> None:
        self.newest: Frame | None = None
        self.size: tuple[int, int] | None = None
        self.bad_frames = 0
        self.outcome: Future[str] = Future()
        self.told = False  # wake-ups don't pile up while the event loop is busy; it takes this back before it looks
        self._frames = frames
        self._wake: Callable[[], object] | None = wake
        self._lock = threading.Lock()  # for _wake: after `abandon`, the event loop may be gone
        self._stamps: deque[float] = deque(maxlen=_RATE_WINDOW)
        self.thread = threading.Thread(target=self._work, name="camera", daemon=True)
        self.thread.start()

    @property
    def rate_hz(self) -> float:
        stamps = self._stamps.copy()
        span = stamps[-1] - stamps[0] if stamps else 0.0  # 0 for frames that came in one packet
        return (len(stamps) - 1) / span if span > 0.0 else 0.0

    def abandon(self) -> None:
        with self._lock:
            self._wake = None

    def _work(self) -> None:
        try:
            with closing(self._frames()) as frames:
                self._pass_on(frames)
            self.outcome.set_result(END_OF_RECORDING)
        except (CameraError, OSError, cv2.error) as error:
            self.outcome.set_result(str(error))
        except BaseException as error:  # a fault of ours: to be raised by `run`, not lost with the thread
            self.outcome.set_exception(error)
        self._notify()

    def _pass_on(self, frames: Generator[Frame]) -> None:
        for frame in frames:
            try:
                self.newest, self.size = _checked(frame)
                self._stamps.append(frame.stamp)
            except FrameError:
                self.bad_frames += 1
            if not self._notify():
                return

    def _notify(self) -> bool:
        """Wake the event loop; False when nobody listens any more."""
        with self._lock:
            if self._wake is not None and not self.told:
                self.told = True
                self._wake()
            return self._wake is not None


def _checked(frame: Frame) -> tuple[Frame, tuple[int, int]]:
    """The frame without what trails its picture, and its (width, height); FrameError for a damaged JPEG."""
    if isinstance(frame.data, bytes):
        data, size = whole(frame.data)
        return (frame if data is frame.data else Frame(frame.stamp, data)), size
    return frame, (frame.data.shape[1], frame.data.shape[0])
