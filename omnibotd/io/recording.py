"""Reads recordings, whole or cut short: every whole record before the cut counts."""

from __future__ import annotations

import logging
import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message
from mcap.stream_reader import get_chunk_data_stream

from omnibotd.core.mapping.drive import TeachingSample
from omnibotd.core.vision.frame import Frame
from omnibotd.io.recording_schema import CAMERA, teaching_frame

log = logging.getLogger(__name__)

_MAGIC = b"\x89MCAP0\r\n"
_HEADER = struct.Struct("<BQ")  # opcode, length of what follows
_CHUNK_START = struct.Struct("<QQQII")  # first time, last time, size, crc, length of the compression's name
_MAX_RECORD = 256 * 1024 * 1024  # bytes; ours are below 1 MB, `mcap recover` makes chunks of a few
_BROKEN = (McapError, ValueError, KeyError, TypeError, struct.error)


class RecordingError(Exception):
    """The file is no recording we can teach from; the message names it and says why."""


def teaching_samples(path: Path) -> Iterator[TeachingSample]:
    """Every frame of a recording with its odometry, in the order recorded; damaged parts are skipped and logged.

    Raises RecordingError where the file can't be read or is no recording of ours.
    """
    try:
        with path.open("rb") as stream:
            yield from _samples(path, stream)
    except OSError as error:
        raise RecordingError(f"recording {path}: {error.strerror or error}") from error


def _samples(path: Path, stream: BinaryIO) -> Iterator[TeachingSample]:
    magic = stream.read(len(_MAGIC))
    if not _MAGIC.startswith(magic):
        raise RecordingError(f"recording {path}: this is no MCAP file")
    topics: dict[int, str] = {}
    for opcode, content in _records(path, stream):
        if opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(content)))
            topics[channel.id] = channel.topic
        elif opcode == Opcode.MESSAGE:
            message = Message.read(ReadDataStream(BytesIO(content)), len(content))
            if topics.get(message.channel_id) == CAMERA:
                yield from _sample(path, message)
    if topics and CAMERA not in topics.values():
        known = ", ".join(sorted(topics.values()))
        raise RecordingError(f"recording {path}: no topic {CAMERA}, so not recorded by omnibotd; topics: {known}")


def _sample(path: Path, message: Message) -> Iterator[TeachingSample]:
    try:
        stamp, odom_from_base, jpeg = teaching_frame(message.data)
    except _BROKEN as error:
        log.warning("recording %s: a frame without picture or odometry is left out (%r)", path, error)
        return
    yield TeachingSample(stamp, odom_from_base, Frame(stamp, jpeg))


def _records(path: Path, stream: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Whole channel and message records, in chunks or not, up to the cut."""
    while len(header := stream.read(_HEADER.size)) == _HEADER.size:
        opcode, length = _HEADER.unpack(header)
        if length > _MAX_RECORD:
            log.warning("recording %s: damaged before byte %d, the rest is left out", path, stream.tell())
            return
        content = stream.read(length)
        if opcode == Opcode.CHUNK:
            yield from _inside(path, content, whole=len(content) == length)
        elif len(content) == length:
            yield opcode, content
        if opcode == Opcode.DATA_END:  # behind it is only the index
            return


def _inside(path: Path, content: bytes, *, whole: bool) -> Iterator[tuple[int, bytes]]:
    """Records of a chunk: of one cut short those before the cut, of a damaged one none."""
    try:
        data = _inflated(content) if whole else _cut(content)
    except _BROKEN as error:
        log.warning("recording %s: a damaged chunk is left out (%s)", path, error)
        return
    position = 0
    while position + _HEADER.size <= len(data):
        opcode, length = _HEADER.unpack_from(data, position)
        position += _HEADER.size
        if position + length > len(data):
            return
        yield opcode, data[position : position + length]
        position += length


def _inflated(content: bytes) -> bytes:
    chunk = Chunk.read(ReadDataStream(BytesIO(content)))
    if chunk.uncompressed_size > _MAX_RECORD:
        raise ValueError(f"it claims {chunk.uncompressed_size} bytes")
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    return stream.read(length)


def _cut(content: bytes) -> bytes:
    """What there is of an uncompressed chunk; of a compressed one nothing can be had."""
    if len(content) < _CHUNK_START.size:
        return b""
    compression = _CHUNK_START.unpack_from(content)[-1]
    return b"" if compression else content[_CHUNK_START.size + 8 :]
