"""Writes what the robot sees and does to an MCAP file that a power cut can't spoil, from a thread of its own."""

from __future__ import annotations

import contextlib
import logging
import os
import queue
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import IO, Any, NamedTuple, cast

from mcap.writer import CompressionType, Writer

from omnibotd.core.geometry import Pose2D, Twist2D
from omnibotd.io import recording_schema as schema

log = logging.getLogger(__name__)

_CHUNK = 8 * 1024  # bytes; every frame closes a chunk, and without frames odometry and commands do within 2 s
_SYNC = 1.0  # s between fsyncs: what a power cut may cost
_FRAMES_UNTIL = 256  # waiting records beyond which frames are dropped: 3 s of everything, up to 25 MB
_RECORDS_UNTIL = 4096  # beyond which anything is: a minute of the small records, 1 MB


class _Record(NamedTuple):
    topic: str
    stamp: float
    content: Callable[[], dict[str, Any]]  # made in the writer's thread: base64 is not the control loop's business


class Recorder:
    """Appends to a new file at `path` (OSError where that can't be); no call but `close` waits for the disk.

    `stamp` is monotonic seconds. `error` is a sentence once the disk has failed: recording has stopped then, and what
    was written before stays readable. `dropped` counts frames a slow disk has cost.
    """

    def __init__(self, path: Path) -> None:
        self.frames = 0
        self.dropped = 0
        self.error: str | None = None
        self._path = path
        self._file = _SyncedFile(path)
        self._waiting: queue.Queue[_Record] = queue.Queue(_RECORDS_UNTIL)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"recorder {path.name}", daemon=True)
        self._thread.start()

    @property
    def bytes_written(self) -> int:
        return self._file.size

    def frame(self, stamp: float, odom_from_base: Pose2D, jpeg: bytes) -> None:
        """A camera frame and the odometry at its stamp."""
        record = _Record(schema.CAMERA, stamp, partial(schema.image, odom_from_base, jpeg))
        if self._waiting.qsize() < _FRAMES_UNTIL and self._put(record):
            self.frames += 1
        else:
            self.dropped += 1

    def odometry(self, stamp: float, odom_from_base: Pose2D) -> None:
        self._put(_Record(schema.ODOM, stamp, partial(schema.pose_in_frame, "odom", odom_from_base)))

    def pose(self, stamp: float, map_from_base: Pose2D) -> None:
        self._put(_Record(schema.POSE, stamp, partial(schema.pose_in_frame, "map", map_from_base)))

    def command(self, stamp: float, twist: Twist2D) -> None:
        self._put(_Record(schema.CMD_VEL, stamp, partial(schema.twist, twist)))

    def decision(self, stamp: float, state: str, text: str) -> None:
        self._put(_Record(schema.DECISION, stamp, partial(schema.log_line, state, text)))

    def close(self) -> None:
        """Write what waits, index the file and sync it. Waits for the disk; records after it are ignored."""
        self._closing.set()
        self._thread.join()

    def _put(self, record: _Record) -> bool:
        if self.error is not None or self._closing.is_set():
            return False
        try:
            self._waiting.put_nowait(record)
        except queue.Full:
            return False
        return True

    def _run(self) -> None:
        try:
            self._write_all()
        except OSError as error:
            self.error = f"recording stopped: {self._path}: {error.strerror or error}"
            log.error("%s", self.error)
        except Exception as error:
            self.error = f"recording stopped by a mistake of ours: {error!r}"
            log.exception("%s", self.error)
        finally:
            self._file.close()

    def _write_all(self) -> None:
        sink = _Sink(self._file)
        synced = time.monotonic()
        while not (self._closing.is_set() and self._waiting.empty()):
            with contextlib.suppress(queue.Empty):
                sink.write(self._waiting.get(timeout=0.1))
            if time.monotonic() - synced >= _SYNC:
                self._file.sync()
                synced = time.monotonic()
        sink.finish()
        self._file.sync()


class _Sink:
    """Records as MCAP: the wall clock is read once, so that a clock set while recording makes no jump."""

    def __init__(self, file: _SyncedFile) -> None:
        stream = cast("IO[bytes]", file)  # `write` and `tell` are all that Writer uses
        # Uncompressed: JPEG does not shrink, and a chunk cut short can still be read up to the cut.
        self._writer: Any = Writer(stream, chunk_size=_CHUNK, compression=CompressionType.NONE)
        self._writer.start(profile="omnibotd")
        self._channels = {topic: self._channel(topic, *named) for topic, named in schema.schemas().items()}
        self._epoch: tuple[float, int] | None = None

    def _channel(self, topic: str, name: str, text: bytes) -> int:
        schema_id = self._writer.register_schema(name, "jsonschema", text)
        channel: int = self._writer.register_channel(topic, "json", schema_id)
        return channel

    def write(self, record: _Record) -> None:
        if self._epoch is None:
            self._epoch = (record.stamp, time.time_ns())
        start, wall_ns = self._epoch
        log_time = max(0, wall_ns + round((record.stamp - start) * 1e9))
        data = schema.message(record.stamp, log_time, record.content())
        self._writer.add_message(self._channels[record.topic], log_time, data, log_time)

    def finish(self) -> None:
        self._writer.finish()


class _SyncedFile:
    """A new file that ends with a whole write, even when the disk is full; `size` is what it holds."""

    def __init__(self, path: Path) -> None:
        self.size = 0
        self._path = path
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self._named = False

    def tell(self) -> int:
        return self.size

    def write(self, data: bytes) -> int:
        """All of `data`, or none and OSError: MCAP is handed over in whole records."""
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[os.write(self._descriptor, rest) :]
        except OSError:
            os.ftruncate(self._descriptor, self.size)
            raise
        self.size += len(data)
        return len(data)

    def sync(self) -> None:
        """On the disk, with its name from the first time on."""
        os.fsync(self._descriptor)
        if not self._named:
            directory = os.open(self._path.parent, os.O_RDONLY | os.O_DIRECTORY)
            try:
                os.fsync(directory)
            finally:
                os.close(directory)
            self._named = True

    def close(self) -> None:
        os.close(self._descriptor)
