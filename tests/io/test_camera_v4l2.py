"""V4L2: the buffers as the releases of OpenCV hand them out, from a stand-in for cv2.VideoCapture.

The machines that run the tests have no /dev/video.
"""

import cv2
import numpy as np
import pytest
from camera_pictures import HEIGHT, WIDTH, jpeg

from omnibotd.core.errors import FrameError
from omnibotd.core.vision.frame import Frame
from omnibotd.io import camera_v4l2
from omnibotd.io.camera import CameraError
from omnibotd.io.camera_jpeg import whole


class FakeCapture:
    """Stands in for cv2.VideoCapture on a camera that speaks only `fourcc`; gives `raws` when not asked to convert."""

    def __init__(self, fourcc: str, raws: list[np.ndarray], opens: bool = True) -> None:
        self.properties = {cv2.CAP_PROP_FOURCC: float(cv2.VideoWriter.fourcc(*fourcc))}
        self._raws, self._opens, self.released, self.count = list(raws), opens, False, len(raws)

    def __call__(self, path: str, backend: int) -> "FakeCapture":
        self.path, self.backend = path, backend
        return self

    def isOpened(self) -> bool:
        return self._opens

    def set(self, name: int, value: float) -> bool:
        if name == cv2.CAP_PROP_FOURCC:
            return value == self.properties[name]
        self.properties[name] = value
        return True

    def get(self, name: int) -> float:
        return self.properties[name]

    def grab(self) -> bool:
        return bool(self._raws)

    def retrieve(self) -> tuple[bool, np.ndarray]:
        return True, self._raws.pop(0)

    def release(self) -> None:
        self.released = True


@pytest.fixture
def device(tmp_path, monkeypatch):
    """A file for a device, by a link as under /dev/v4l/by-id, and a function that gives the frames read from it."""
    (tmp_path / "video3").touch()
    (tmp_path / "by-id").symlink_to(tmp_path / "video3")

    def read(capture: FakeCapture) -> list[Frame]:
        monkeypatch.setattr(cv2, "VideoCapture", capture)
        source = camera_v4l2.v4l2_frames(str(tmp_path / "by-id"), WIDTH, HEIGHT, 15.0)
        frames = [next(source) for _ in range(capture.count)]
        with pytest.raises(CameraError, match="no more frames"):
            next(source)
        assert capture.released
        assert (capture.path, capture.backend) == (str(tmp_path / "video3"), cv2.CAP_V4L2)
        return frames

    return read


@pytest.mark.parametrize("shape", [(1, -1), (-1, 1), (-1,)])
def test_mjpg_buffers_of_any_shape_with_the_rest_of_the_buffer_behind_come_as_jpeg(device, shape):
    stale = np.frombuffer(jpeg(250) + jpeg(7)[300:], np.uint8)
    capture = FakeCapture("MJPG", [stale.reshape(shape)])
    (frame,) = device(capture)
    assert isinstance(frame.data, bytes)
    assert whole(frame.data)[0] == jpeg(250)
    wanted = {cv2.CAP_PROP_FRAME_WIDTH: WIDTH, cv2.CAP_PROP_FRAME_HEIGHT: HEIGHT, cv2.CAP_PROP_FPS: 15.0}
    assert wanted.items() <= capture.properties.items()
    assert capture.properties[cv2.CAP_PROP_CONVERT_RGB] == 0


@pytest.mark.parametrize("flat", [False, True])
def test_of_yuyv_the_brightness_is_taken(device, flat):
    raw = np.random.default_rng(3).integers(0, 256, (HEIGHT, WIDTH, 2), np.uint8)
    (frame,) = device(FakeCapture("YUYV", [raw.reshape(1, -1) if flat else raw]))
    assert frame.data.shape == (HEIGHT, WIDTH)
    assert all(frame.data[y, x] == raw[y, x, 0] for y, x in ((0, 0), (0, 1), (17, 30), (HEIGHT - 1, WIDTH - 1)))
    raw[:] = 0
    assert frame.data.any()  # the frame is no view of the camera's buffer, which the next one overwrites


def test_a_grey_camera_gives_grey_and_any_other_is_converted_by_opencv(device):
    grey = np.random.default_rng(4).integers(0, 256, (HEIGHT, WIDTH), np.uint8)
    assert np.array_equal(device(FakeCapture("GREY", [grey]))[0].data, grey)
    colour = np.random.default_rng(5).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    capture = FakeCapture("NV12", [colour])
    assert np.array_equal(device(capture)[0].data, colour)
    assert capture.properties[cv2.CAP_PROP_CONVERT_RGB] == 1


def test_a_short_yuyv_buffer_is_a_damaged_frame_not_a_crash(device):
    (frame,) = device(FakeCapture("YUYV", [np.zeros((1, 100), np.uint8)]))
    with pytest.raises(FrameError):
        whole(frame.data)


def test_a_device_that_cant_be_used_is_told_why(tmp_path, monkeypatch):
    with pytest.raises(CameraError, match="plugged in"):
        next(camera_v4l2.v4l2_frames(str(tmp_path / "video0"), WIDTH, HEIGHT, 15.0))
    (tmp_path / "video0").touch()
    monkeypatch.setattr(cv2, "VideoCapture", FakeCapture("MJPG", [], opens=False))
    with pytest.raises(CameraError, match="another program may be using it"):
        next(camera_v4l2.v4l2_frames(str(tmp_path / "video0"), WIDTH, HEIGHT, 15.0))
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(CameraError, match="group `video`"):
        next(camera_v4l2.v4l2_frames(str(tmp_path / "video0"), WIDTH, HEIGHT, 15.0))
