"""Recordings: what was recorded is read back, from a file cut anywhere, by us and by other MCAP readers."""

from __future__ import annotations

import base64
import errno
import json
import math
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from omnibotd.core.geometry import Pose2D, Twist2D
from omnibotd.io import recorder as recorder_module
from omnibotd.io import recording as recording_module
from omnibotd.io.recorder import Recorder
from omnibotd.io.recording import RecordingError, teaching_samples

FRAMES = 12


def jpeg(number: int, size: int = 300) -> bytes:
    return b"\xff\xd8" + np.random.default_rng(number).bytes(size) + b"\xff\xd9"


def pose(number: int) -> Pose2D:
    return Pose2D(0.1 * number, -0.05 * number, math.sin(number))


def drive(recorder: Recorder) -> None:
    """A short teaching drive: frames at 10 Hz, odometry and commands between."""
    for number in range(FRAMES):
        stamp = 1000.0 + 0.1 * number
        recorder.odometry(stamp, pose(number))
        recorder.command(stamp, Twist2D(0.3, -0.1))
        recorder.decision(stamp, "DRIVE", "on the way")
        recorder.pose(stamp, pose(number))
        recorder.frame(stamp + 0.01, pose(number), jpeg(number))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A finished recording."""
    recorder = Recorder(tmp_path / "flat.0001.mcap")
    drive(recorder)
    recorder.close()
    assert recorder.error is None
    return tmp_path / "flat.0001.mcap"


def numbers(path: Path) -> list[int]:
    """Which frames can be read; each must be the one that was recorded."""
    found = []
    for sample in teaching_samples(path):
        number = round((sample.stamp - 1000.01) * 10)
        assert sample.stamp == sample.frame.stamp == 1000.0 + 0.1 * number + 0.01
        assert sample.odom_from_base == pose(number)
        assert sample.frame.data == jpeg(number)
        found.append(number)
    return found


def messages(path: Path) -> Iterator[tuple[str, str, int, dict[str, Any]]]:
    """Topic, schema, log time and content, by the mcap package's own reader."""
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            assert schema is not None
            yield channel.topic, schema.name, message.log_time, json.loads(message.data)


def test_what_was_recorded_is_read_back(path: Path) -> None:
    assert numbers(path) == list(range(FRAMES))


def test_other_readers_find_the_topics_and_schemas(path: Path) -> None:
    found = {(topic, schema) for topic, schema, _, _ in messages(path)}
    assert found == {
        ("/camera", "foxglove.CompressedImage"),
        ("/odom", "foxglove.PoseInFrame"),
        ("/pose", "foxglove.PoseInFrame"),
        ("/cmd_vel", "omnibotd.Twist2D"),
        ("/decision", "foxglove.Log"),
    }
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 5 * FRAMES


def test_messages_hold_what_foxglove_draws(path: Path) -> None:
    first: dict[str, dict[str, Any]] = {}
    for topic, _, _, content in messages(path):
        first.setdefault(topic, content)
    assert base64.b64decode(first["/camera"]["data"]) == jpeg(0)
    assert (first["/camera"]["format"], first["/camera"]["frame_id"]) == ("jpeg", "camera")
    assert (first["/odom"]["frame_id"], first["/pose"]["frame_id"]) == ("odom", "map")
    assert first["/odom"]["pose"]["orientation"] == {"x": 0, "y": 0, "z": 0, "w": 1}
    assert (first["/cmd_vel"]["vx"], first["/cmd_vel"]["wz"]) == (0.3, -0.1)
    assert (first["/decision"]["name"], first["/decision"]["message"]) == ("DRIVE", "on the way")


def test_orientation_is_the_yaws_quaternion(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap")
    recorder.odometry(0.0, Pose2D(1.0, 2.0, math.pi / 2))
    recorder.close()
    [(_, _, _, content)] = messages(tmp_path / "a.mcap")
    half = math.sqrt(0.5)
    assert content["pose"]["position"] == {"x": 1.0, "y": 2.0, "z": 0.0}
    assert content["pose"]["orientation"] == pytest.approx({"x": 0, "y": 0, "z": half, "w": half})


def test_log_time_is_the_wall_clock_and_the_monotonic_stamp_is_kept(tmp_path: Path) -> None:
    before = time.time_ns()
    recorder = Recorder(tmp_path / "a.mcap")
    for stamp in (50.0, 52.5):
        recorder.command(stamp, Twist2D())
    recorder.close()
    (_, _, first, start), (_, _, second, later) = messages(tmp_path / "a.mcap")
    assert before <= first <= time.time_ns()
    assert second - first == 2_500_000_000
    assert (start["stamp"], later["stamp"]) == (50.0, 52.5)
    assert start["timestamp"]["sec"] * 10**9 + start["timestamp"]["nsec"] == first


def test_a_file_cut_anywhere_gives_every_whole_record_before_the_cut(path: Path, tmp_path: Path) -> None:
    data = path.read_bytes()
    ends = [data.index(b"}}", data.index(base64.b64encode(jpeg(number)))) + 2 for number in range(FRAMES)]
    cut = tmp_path / "cut.mcap"
    for length in [*range(200), *range(200, len(data), 97), *(end + near for end in ends for near in range(-9, 3))]:
        cut.write_bytes(data[:length])
        assert numbers(cut) == list(range(sum(end <= length for end in ends)))


def test_frames_are_on_the_disk_while_recording_goes_on(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap")
    for number in range(FRAMES):
        recorder.frame(1000.0 + 0.1 * number + 0.01, pose(number), jpeg(number, 20_000))
    deadline = time.monotonic() + 5
    found: list[Pose2D] = []
    while len(found) < FRAMES and time.monotonic() < deadline:
        time.sleep(0.05)
        found = [sample.odom_from_base for sample in teaching_samples(tmp_path / "a.mcap")]
    recorder.close()
    assert found == [pose(number) for number in range(FRAMES)]


def test_damage_in_the_middle_costs_its_chunk_only(path: Path) -> None:
    recorder = Recorder(path.with_name("b.mcap"))
    for number in range(FRAMES):
        recorder.frame(1000.0 + 0.1 * number + 0.01, pose(number), jpeg(number, 20_000))
    recorder.close()
    data = bytearray(path.with_name("b.mcap").read_bytes())
    data[data.index(base64.b64encode(jpeg(5, 20_000))) + 100] ^= 1
    path.with_name("b.mcap").write_bytes(data)
    found = [sample.odom_from_base for sample in teaching_samples(path.with_name("b.mcap"))]
    assert found == [pose(number) for number in range(FRAMES) if number != 5]


def test_flipped_bytes_raise_nothing_but_recording_errors(path: Path, tmp_path: Path) -> None:
    data = path.read_bytes()
    rng = np.random.default_rng(3)
    for position in [*range(60), *rng.integers(0, len(data), 200).tolist()]:
        damaged = bytearray(data)
        damaged[position] ^= int(rng.integers(1, 256))
        (tmp_path / "damaged.mcap").write_bytes(damaged)
        try:
            found = numbers(tmp_path / "damaged.mcap")
        except RecordingError:
            continue
        assert found == sorted(set(found))


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_recording_repaired_with_compression_is_read(
    path: Path, tmp_path: Path, compression: CompressionType
) -> None:
    with path.open("rb") as stream, (tmp_path / "repaired.mcap").open("wb") as output:
        writer: Any = Writer(output, compression=compression)
        writer.start()
        ids: dict[str, int] = {}
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            if channel.topic not in ids:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.topic] = writer.register_channel(channel.topic, "json", schema_id)
            writer.add_message(ids[channel.topic], message.log_time, message.data, message.publish_time)
        writer.finish()
    assert numbers(tmp_path / "repaired.mcap") == list(range(FRAMES))


@pytest.mark.parametrize("content", [b"not an MCAP file", b"PK\x03\x04", b"\x89PNG\r\n\x1a\n" + bytes(50)])
def test_a_foreign_file_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.mcap").write_bytes(content)
    with pytest.raises(RecordingError, match=r"a\.mcap: this is no MCAP file"):
        list(teaching_samples(tmp_path / "a.mcap"))


def test_somebody_elses_mcap_is_refused_with_its_topics(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as output:
        writer: Any = Writer(output)
        writer.start()
        channel = writer.register_channel("/scan", "json", writer.register_schema("s", "jsonschema", b"{}"))
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(RecordingError, match=r"no topic /camera.*/scan"):
        list(teaching_samples(tmp_path / "a.mcap"))


def test_a_missing_recording_is_told(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="No such file"):
        list(teaching_samples(tmp_path / "a.mcap"))


def test_an_existing_recording_is_never_written_over(path: Path) -> None:
    data = path.read_bytes()
    with pytest.raises(FileExistsError):
        Recorder(path)
    assert path.read_bytes() == data


def test_a_full_disk_stops_the_recording_and_keeps_what_was_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    room = 100_000
    real_write = os.write

    def write(descriptor: int, data: memoryview) -> int:
        nonlocal room
        if threading.current_thread() is threading.main_thread():
            return real_write(descriptor, data)
        if not room:
            raise OSError(errno.ENOSPC, "No space left on device")
        written = real_write(descriptor, data[:room])
        room -= written
        return written

    monkeypatch.setattr(os, "write", write)
    recorder = Recorder(tmp_path / "a.mcap")
    for number in range(FRAMES):
        recorder.frame(1000.0 + 0.1 * number + 0.01, pose(number), jpeg(number, 20_000))
    recorder.close()
    assert recorder.error is not None
    assert "No space left" in recorder.error
    assert (tmp_path / "a.mcap").stat().st_size == recorder.bytes_written
    found = [sample.odom_from_base for sample in teaching_samples(tmp_path / "a.mcap")]
    assert found == [pose(number) for number in range(3)]  # 27 kB each in base64


def test_after_an_error_nothing_is_kept_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> int:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "write", broken)
    recorder = Recorder(tmp_path / "a.mcap")
    recorder.close()
    monkeypatch.undo()
    recorder.frame(1.0, pose(0), jpeg(0))
    assert (recorder.frames, recorder.dropped) == (0, 1)


def test_a_slow_disk_costs_frames_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk_awake = threading.Event()
    real_write = os.write

    def write(descriptor: int, data: memoryview) -> int:
        disk_awake.wait(10)
        return real_write(descriptor, data)

    monkeypatch.setattr(os, "write", write)
    monkeypatch.setattr(recorder_module, "_FRAMES_UNTIL", 10)
    monkeypatch.setattr(recorder_module, "_RECORDS_UNTIL", 30)
    recorder = Recorder(tmp_path / "a.mcap")
    for number in range(100):
        recorder.frame(1000.0 + 0.1 * number, pose(number), jpeg(number))
        recorder.odometry(1000.0 + 0.1 * number, pose(number))
    disk_awake.set()
    recorder.close()
    topics = [topic for topic, _, _, _ in messages(tmp_path / "a.mcap")]
    assert recorder.frames + recorder.dropped == 100
    assert topics.count("/camera") == recorder.frames < 12
    assert topics.count("/odom") > recorder.frames


def test_a_record_longer_than_any_of_ours_ends_the_reading(
    path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording_module, "_MAX_RECORD", 100)
    assert numbers(path) == []
    assert "damaged before byte" in caplog.text
