"""The camera on sources that block, break, lie and end; and its calibration file."""

import asyncio
import logging
import threading
import time
from collections.abc import Iterator

import pytest
from camera_pictures import jpeg, running, until

from omnibotd.config import CameraConfig
from omnibotd.core.vision.camera_model import CameraModelError
from omnibotd.core.vision.frame import Frame
from omnibotd.io import camera as camera_module
from omnibotd.io.camera import Camera, CameraError, load_calibration


def injected(source) -> Camera:
    return Camera(CameraConfig(source="/dev/video0"), source)


def test_a_source_that_blocks_for_ever_stops_neither_the_loop_nor_the_end_and_its_late_frame_is_ignored(caplog):
    release = threading.Event()
    opened: list[int] = []

    def source() -> Iterator[Frame]:
        opened.append(len(opened))
        if opened[-1] == 0:
            yield Frame(time.monotonic(), jpeg(40))
            release.wait(20.0)  # as V4L2 does when a camera freezes
            yield Frame(time.monotonic(), jpeg(120))
        while True:
            time.sleep(0.01)
            yield Frame(time.monotonic(), jpeg(250))

    async def scenario() -> float:
        late: list[bytes] = []
        async with running(injected(source)) as camera:
            frame = await asyncio.wait_for(camera.wait_newer(0.0), 5.0)
            turns = 0
            while camera.reason == "":
                await asyncio.sleep(0.01)
                turns += 1
            assert turns > 40  # the loop ran on through the second of silence
            assert asyncio.get_running_loop().time() - frame.stamp < 1.5
            await until(lambda: camera.reason == "")
            release.set()
            for _ in range(20):
                frame = await asyncio.wait_for(camera.wait_newer(frame.stamp), 5.0)
                late.append(frame.data)
            return late.count(jpeg(120))

    with caplog.at_level(logging.INFO, "omnibotd.io"):
        assert asyncio.run(scenario()) == 0
    assert opened == [0, 1]
    pictures = "camera: pictures from /dev/video0"
    assert caplog.messages == [pictures, "camera lost: /dev/video0: no picture for 1 s", pictures]


def test_shutdown_does_not_wait_for_a_reader_that_hangs():
    release = threading.Event()

    def source() -> Iterator[Frame]:
        release.wait(20.0)
        yield from ()

    async def scenario() -> float:
        async with running(injected(source)):
            await asyncio.sleep(0.05)
            started = time.monotonic()
        return time.monotonic() - started

    try:
        assert asyncio.run(scenario()) < 0.2
    finally:
        release.set()


def test_retries_slow_down_and_a_success_starts_them_anew(monkeypatch):
    naps: list[float] = []
    sleep = asyncio.sleep

    async def nap(seconds: float) -> None:
        naps.append(seconds)
        await sleep(0)

    class Loopback:  # asyncio as the camera sees it, but for its naps
        def __getattr__(self, name: str) -> object:
            return nap if name == "sleep" else getattr(asyncio, name)

    attempts = iter(range(10**6))

    def source() -> Iterator[Frame]:
        if next(attempts) == 7:
            yield Frame(time.monotonic(), jpeg())
        raise CameraError("unplugged")

    async def scenario() -> None:
        async with running(injected(source)) as camera:
            started = time.monotonic()
            while len(naps) < 9:
                assert time.monotonic() - started < 5.0
                await sleep(0.005)
            assert camera.reason == "unplugged"

    monkeypatch.setattr(camera_module, "asyncio", Loopback())
    asyncio.run(scenario())
    assert naps[:9] == [0.5, 1.0, 2.0, 4.0, 8.0, 10.0, 10.0, 0.5, 1.0]


def test_no_more_readers_are_started_than_may_hang(monkeypatch):
    monkeypatch.setattr(camera_module, "OPENING", 0.01)
    monkeypatch.setattr(camera_module, "FIRST_RETRY", 0.01)
    monkeypatch.setattr(camera_module, "LAST_RETRY", 0.02)
    release, opened = threading.Event(), []

    def source() -> Iterator[Frame]:
        opened.append(1)
        release.wait(20.0)
        yield from ()

    async def scenario() -> None:
        async with running(injected(source)) as camera:
            await until(lambda: "3 readers hang" in camera.reason)
            await asyncio.sleep(0.1)

    try:
        asyncio.run(scenario())
        assert len(opened) == 3
    finally:
        release.set()


def test_a_fault_of_ours_in_the_reader_is_not_taken_for_the_cameras():
    def source() -> Iterator[Frame]:
        raise ZeroDivisionError("ours")
        yield

    async def scenario() -> None:
        await asyncio.wait_for(injected(source).run(), 5.0)

    with pytest.raises(ZeroDivisionError):
        asyncio.run(scenario())


def test_frames_that_are_all_damaged_are_as_good_as_none(monkeypatch):
    monkeypatch.setattr(camera_module, "OPENING", 0.2)

    def source() -> Iterator[Frame]:
        while True:
            time.sleep(0.01)
            yield Frame(time.monotonic(), jpeg()[:100])

    async def scenario() -> None:
        async with running(injected(source)) as camera:
            await until(lambda: "damaged" in camera.reason)
            assert camera.latest is None and not camera.ok(time.monotonic()) and camera.bad_frames > 2

    asyncio.run(scenario())


CAMERA_INFO = """
image_width: 640
image_height: 480
camera_name: ceiling
camera_matrix: {rows: 3, cols: 3, data: [150.5, 0, 321.0, 0, 151.5, 241.0, 0, 0, 1]}
distortion_model: equidistant
distortion_coefficients: {rows: 1, cols: 4, data: [0.01, -0.002, 0.0003, 0]}
"""


def test_a_calibration_in_the_camera_info_layout_becomes_a_lens(tmp_path):
    (tmp_path / "camera.yaml").write_text(CAMERA_INFO)
    model = load_calibration(tmp_path / "camera.yaml", fov=3.0)
    assert (model.width, model.height, model.fx, model.fy, model.cx, model.cy) == (640, 480, 150.5, 151.5, 321.0, 241.0)
    assert (model.distortion, model.fov) == ((0.01, -0.002, 0.0003, 0.0), 3.0)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (("camera_matrix:", "matrix:"), "camera_matrix"),
        (("equidistant", "plumb_bob"), "plumb_bob"),
        (("150.5", "-1"), "focal lengths > 0"),
        (("150.5", ".nan"), "finite"),
        (("321.0", "900"), "centre in the image"),
        (("150.5", "wide"), "wide"),
        (("camera_name:", "camera_name: ["), "expected"),
        ((CAMERA_INFO, "- 1"), "camera_info layout"),
    ],
)
def test_a_calibration_that_describes_no_lens_is_told_by_file_and_fault(tmp_path, change, reason):
    path = tmp_path / "camera.yaml"
    path.write_text(CAMERA_INFO.replace(*change))
    with pytest.raises(CameraModelError, match=reason) as caught:
        load_calibration(path)
    assert str(path) in str(caught.value)


def test_a_calibration_that_is_not_there_is_told(tmp_path):
    with pytest.raises(CameraModelError, match="No such file"):
        load_calibration(tmp_path / "camera.yaml")
