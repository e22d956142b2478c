import asyncio

import cv2
import numpy as np
import pytest
from camera_pictures import HEIGHT, WIDTH, jpeg, running, until

from omnibotd.config import CameraConfig
from omnibotd.io.camera import END_OF_RECORDING, Camera, CameraError, frames_of


@pytest.fixture
def folder(tmp_path):
    """Three pictures whose order by name is not that of their making; the levels differ."""
    (tmp_path / "0002.jpg").write_bytes(jpeg(250))
    cv2.imwrite(str(tmp_path / "0001.png"), np.full((HEIGHT, WIDTH, 3), (10, 20, 30), np.uint8))
    (tmp_path / "0000.JPG").write_bytes(jpeg(40))
    (tmp_path / "poses.tum").write_text("not a picture")
    return tmp_path


def test_a_folder_gives_its_images_in_order_of_name(folder):
    frames = list(frames_of(folder, fps=4.0))
    assert [frame.stamp for frame in frames] == [0.0, 0.25, 0.5]
    assert (frames[0].data, frames[2].data) == (jpeg(40), jpeg(250))
    assert frames[1].data.shape == (HEIGHT, WIDTH, 3)
    assert tuple(frames[1].data[5, 5]) == (10, 20, 30)


def test_a_recording_plays_at_its_pace_and_ends_for_good(folder):
    async def scenario() -> None:
        async with running(Camera(CameraConfig(source=str(folder), fps=10.0))) as camera:
            frames = [await asyncio.wait_for(camera.wait_newer(0.0), 5.0)]
            for _ in range(2):
                frames.append(await asyncio.wait_for(camera.wait_newer(frames[-1].stamp), 5.0))
            assert frames[2].stamp - frames[0].stamp == pytest.approx(0.2, abs=0.09)
            await until(lambda: camera.reason == END_OF_RECORDING)
            await asyncio.sleep(0.7)  # longer than the first retry
            assert camera.latest is frames[2] and camera.reason == END_OF_RECORDING

    asyncio.run(scenario())


def test_a_picture_that_cant_be_read_is_dropped_and_the_rest_goes_on(folder):
    (folder / "0001.png").write_bytes(b"no picture")
    (folder / "0003.png").write_bytes(b"")

    async def scenario() -> None:
        async with running(Camera(CameraConfig(source=str(folder), fps=100.0))) as camera:
            await until(lambda: camera.reason == END_OF_RECORDING)
            assert (camera.bad_frames, camera.latest.data) == (2, jpeg(250))

    asyncio.run(scenario())


def test_a_video_file_gives_its_frames_at_its_own_rate(tmp_path):
    path = tmp_path / "drive.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (WIDTH, HEIGHT))
    for level in (30, 90, 150, 210):
        writer.write(np.full((HEIGHT, WIDTH, 3), level, np.uint8))
    writer.release()
    frames = list(frames_of(path, fps=3.0))
    assert [frame.stamp for frame in frames] == pytest.approx([0.0, 0.05, 0.10, 0.15])
    assert [float(frame.data.mean()) for frame in frames] == pytest.approx([30, 90, 150, 210], abs=3.0)
    assert frames[0].data.shape == (HEIGHT, WIDTH, 3)


def test_what_is_no_recording_is_told(tmp_path, capfd):
    (tmp_path / "notes.mp4").write_text("not a video")
    for path, reason in (("none", "no such file"), ("notes.mp4", "finds no video"), (".", "no images in this folder")):
        with pytest.raises(CameraError, match=reason):
            list(frames_of(tmp_path / path))
