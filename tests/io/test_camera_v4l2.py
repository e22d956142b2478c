"""V4L2 against a stand-in for the kernel: the machines that run these tests have no /dev/video.

tests/vm drives the same code against a real uvcvideo.
"""

import asyncio
import errno
import os
import threading
import time
from functools import partial

import numpy as np
import pytest
from camera_pictures import jpeg, running
from v4l2_kernel import META, Kernel

from omnibotd.config import CameraConfig
from omnibotd.core.errors import FrameError
from omnibotd.io import camera_v4l2
from omnibotd.io.camera import Camera, CameraError
from omnibotd.io.camera_jpeg import whole
from omnibotd.io.camera_v4l2_modes import Wanted

WIDTH, HEIGHT = 64, 48
WANTED = Wanted(WIDTH, HEIGHT, 15.0)
MODES = {(WIDTH, HEIGHT): [(1, 30), (1, 15)]}
EXPOSURE_AUTO, EXPOSURE_ABSOLUTE, EXPOSURE_PRIORITY = 0x9A0901, 0x9A0902, 0x9A0903
AUTO_WHITE, WHITE = 0x98090C, 0x98091A


class Watched:
    """A camera that is being read, and what it told of itself."""

    def __init__(self, kernel, path, monkeypatch, wanted=WANTED):
        kernel.install(path, monkeypatch)
        self.kernel, self.told = kernel, []
        self.frames = camera_v4l2.v4l2_frames(str(path), wanted, self.told.append)

    def see(self, *pictures, flags=0):
        """The frame that comes of these pictures, exposed one after the other before anybody looks."""
        if not self.told:
            self.kernel.expose_at_start = pictures
        for data, stamp in pictures:
            self.kernel.expose(data, stamp, flags)
        return next(self.frames)


@pytest.fixture
def watch(tmp_path, monkeypatch):
    monkeypatch.setattr(camera_v4l2, "FIRST_FRAME", 0.02)
    monkeypatch.setattr(camera_v4l2, "NEXT_FRAME", 0.02)
    return lambda kernel, wanted=WANTED: Watched(_eager(kernel), tmp_path / "video0", monkeypatch, wanted)


def _eager(kernel):
    """Fills its first buffers as soon as it streams: the reader can't be stopped between."""
    kernel.expose_at_start = ()
    start = kernel._18

    def streaming(data):
        start(data)
        for picture, stamp in kernel.expose_at_start:
            kernel.expose(picture, stamp)

    kernel._18 = streaming
    return kernel


def now() -> float:
    return time.monotonic()


def test_of_what_the_camera_offers_the_jpegs_of_the_wanted_size_and_rate_are_taken(watch):
    camera = watch(Kernel({"YUYV": MODES, "H264": MODES, "MJPG": {(32, 24): [(1, 15)], **MODES}}))
    frame = camera.see((jpeg(250) + b"\0" * 99, now()))
    assert whole(frame.data)[0] == jpeg(250)
    assert camera.kernel.asked_format == ("MJPG", WIDTH, HEIGHT)
    assert camera.kernel.asked_interval == (1, 15)
    (told,) = camera.told
    assert (told.card, str(told.mode), told.warnings) == ("Test Cam", "MJPG 64x48 at 15 Hz", ())


def test_only_the_newest_of_the_waiting_pictures_comes_and_every_buffer_goes_back(watch):
    camera = watch(Kernel({"MJPG": MODES}))
    at = now() - 0.2
    assert camera.see((jpeg(10), at), (jpeg(20), at + 0.05), (jpeg(30), at + 0.1)).data == jpeg(30)
    assert sorted(camera.kernel.queued) == [0, 1, 2]
    assert camera.see((jpeg(40), at + 0.15)).data == jpeg(40)


def test_stamps_are_the_drivers(watch):
    camera = watch(Kernel({"MJPG": MODES}))
    at = now() - 0.123
    assert camera.see((jpeg(), at)).stamp == pytest.approx(at, abs=2e-6)


@pytest.mark.parametrize("stamp", [12.5, None, 1e9])
def test_a_drivers_stamp_that_cant_be_true_is_replaced_by_the_moment_of_arrival(watch, stamp):
    kernel = Kernel({"MJPG": MODES}, clock=0x2000 if stamp else 0x4000)
    before = now()
    assert before <= watch(kernel).see((jpeg(), stamp or 1.0)).stamp <= now()


def test_stamps_never_go_back(watch):
    camera = watch(Kernel({"MJPG": MODES}))
    first = camera.see((jpeg(), now()))
    assert camera.see((jpeg(), first.stamp - 0.3)).stamp > first.stamp


@pytest.mark.parametrize(("fourcc", "step", "offset"), [("GREY", 1, 0), ("YUYV", 2, 0), ("UYVY", 2, 1), ("NV12", 1, 0)])
def test_of_other_formats_the_brightness_is_taken_whatever_pads_the_lines(watch, fourcc, step, offset):
    stride = step * WIDTH + 32
    lines = np.random.default_rng(3).integers(0, 256, (HEIGHT * 3 // 2, stride), np.uint8)
    frame = watch(Kernel({fourcc: MODES}, stride=stride)).see((lines.tobytes(), now()))
    assert frame.data.shape == (HEIGHT, WIDTH)
    for y, x in ((0, 0), (0, 1), (17, 30), (HEIGHT - 1, WIDTH - 1)):
        assert frame.data[y, x] == lines[y, step * x + offset]


def test_a_short_buffer_and_one_that_the_driver_calls_damaged_are_refused_as_pictures(watch):
    camera = watch(Kernel({"YUYV": MODES}))
    with pytest.raises(FrameError):
        whole(camera.see((b"\0" * 100, now())).data)
    with pytest.raises(FrameError):
        whole(camera.see((b"\0" * (2 * WIDTH * HEIGHT), now()), flags=0x40).data)


def test_a_camera_that_falls_silent_is_given_up_and_let_go(watch):
    camera = watch(Kernel({"MJPG": MODES}))
    camera.see((jpeg(), now()))
    assert camera.kernel.streaming
    with pytest.raises(CameraError, match="no more frames"):
        next(camera.frames)
    assert not camera.kernel.streaming


def test_a_camera_that_is_unplugged_says_so(watch):
    camera = watch(Kernel({"MJPG": MODES}))
    camera.see((jpeg(), now()))
    camera.kernel.unplug()
    with pytest.raises(CameraError, match="unplugged"):
        next(camera.frames)


@pytest.mark.parametrize(
    ("kernel", "reason"),
    [
        (Kernel({"MJPG": MODES}, caps=META), "a second device"),
        (Kernel({"H264": MODES}), "offers H264, none we can read"),
        (Kernel({"MJPG": MODES}, refuse={5: errno.EBUSY}), "another program is using it"),
        (Kernel({"MJPG": MODES}, refuse={8: errno.EBUSY}), "another program is using it"),
        (Kernel({"MJPG": MODES}, refuse={18: errno.ENOSPC}), "USB bus has no room"),
        (Kernel({"MJPG": MODES}, settle=("H264", WIDTH, HEIGHT)), "gives H264"),
    ],
)
def test_a_camera_that_cant_be_used_is_told_why_and_closed(watch, kernel, reason):
    files = len(os.listdir("/proc/self/fd"))
    camera = watch(kernel)
    with pytest.raises(CameraError, match=reason):
        next(camera.frames)
    assert len(os.listdir("/proc/self/fd")) == files + 1  # the kernel's own end


def test_a_device_that_cant_be_opened_is_told_why(tmp_path, monkeypatch):
    path = tmp_path / "video0"
    with pytest.raises(CameraError, match="plugged in"):
        next(camera_v4l2.v4l2_frames(str(path), WANTED, print))
    path.touch()
    with pytest.raises(CameraError, match="is no video device"):
        next(camera_v4l2.v4l2_frames(str(path), WANTED, print))

    def refused(*_):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("os.open", refused)
    with pytest.raises(CameraError, match="group `video`"):
        next(camera_v4l2.v4l2_frames(str(path), WANTED, print))


def test_a_link_by_id_leads_to_the_device(watch, tmp_path):
    camera = watch(Kernel({"MJPG": MODES}))
    (tmp_path / "by-id").symlink_to(tmp_path / "video0")
    camera.frames = camera_v4l2.v4l2_frames(str(tmp_path / "by-id"), WANTED, camera.told.append)
    assert camera.see((jpeg(7), now())).data == jpeg(7)


def test_of_ranges_the_nearest_is_taken(watch):
    kernel = Kernel({"GREY": {}}, size_range=(16, 128, 16, 16, 96, 32), interval_range=(1, 60, 1, 5))
    camera = watch(kernel, Wanted(60, 50, 2.0))
    camera.see((b"\0" * (64 * 48), now()))
    assert kernel.asked_format == ("GREY", 64, 48)  # 16 + 3 * 16; 16 + 1 * 32
    assert kernel.asked_interval == (1, 5)  # no slower than that
    assert any("no 60x50" in warning for warning in camera.told[0].warnings)


def test_a_camera_that_lists_no_sizes_is_asked_for_the_wanted_one(watch):
    kernel = Kernel({"MJPG": None}, settle=("MJPG", 32, 24))
    camera = watch(kernel)
    camera.see((jpeg(), now()))
    assert kernel.asked_format == ("MJPG", WIDTH, HEIGHT)
    assert "no 64x48: it gives 32x24" in camera.told[0].warnings[0]


def controls():
    """minimum, maximum, step, default, value; the camera lengthens exposures in the dark, and whitens by itself."""
    return {
        EXPOSURE_AUTO: [0, 3, 1, 3, 3],
        EXPOSURE_ABSOLUTE: [3, 2047, 1, 250, 250],
        EXPOSURE_PRIORITY: [0, 1, 1, 0, 1],
        AUTO_WHITE: [0, 1, 1, 1, 1],
        WHITE: [2800, 6500, 10, 4000, 4000],
    }


def values(kernel):
    return {number: control[4] for number, control in kernel.controls.items()}


def test_exposure_and_white_balance_are_held_where_the_configuration_says_so(watch):
    kernel = Kernel({"MJPG": MODES}, controls=controls())
    camera = watch(kernel, Wanted(WIDTH, HEIGHT, 15.0, exposure=0.012, white_balance=4600))
    camera.see((jpeg(), now()))
    assert values(kernel) == {
        EXPOSURE_AUTO: 1, EXPOSURE_ABSOLUTE: 120, EXPOSURE_PRIORITY: 0, AUTO_WHITE: 0, WHITE: 4600,
    }  # fmt: skip
    assert (camera.told[0].exposure, camera.told[0].white_balance) == (pytest.approx(0.012), 4600)
    assert camera.told[0].warnings == ()


def test_else_they_are_the_cameras_but_never_at_the_cost_of_the_rate(watch):
    kernel = Kernel({"MJPG": MODES}, controls=controls())
    kernel.controls[EXPOSURE_AUTO][4] = 1  # somebody had locked it
    camera = watch(kernel)
    camera.see((jpeg(), now()))
    assert values(kernel)[EXPOSURE_AUTO] == 3
    assert values(kernel)[EXPOSURE_PRIORITY] == 0
    assert values(kernel)[AUTO_WHITE] == 1
    assert (camera.told[0].exposure, camera.told[0].white_balance) == (None, None)


def test_what_the_camera_cant_hold_is_told_and_stops_nothing(watch):
    wanted = Wanted(WIDTH, HEIGHT, 15.0, exposure=0.4, white_balance=1000)
    camera = watch(Kernel({"MJPG": MODES}, controls=controls()), wanted)
    camera.see((jpeg(), now()))
    exposure, white = camera.told[0].warnings
    assert "holds 0.2047 s" in exposure
    assert "holds 2800 K" in white


def test_a_camera_without_controls_gives_pictures_all_the_same(watch):
    camera = watch(Kernel({"MJPG": MODES}), Wanted(WIDTH, HEIGHT, 15.0, exposure=0.01))
    assert camera.see((jpeg(9), now())).data == jpeg(9)
    assert camera.told[0].exposure is None
    assert "camera.exposure is not kept: this camera can't" in camera.told[0].warnings[0]


def test_a_camera_that_freezes_is_opened_anew_and_nobody_waits_for_it(tmp_path, monkeypatch):
    """Frames for a while, none for longer than a picture counts as fresh, then frames again."""
    monkeypatch.setattr(camera_v4l2, "NEXT_FRAME", 0.5)
    kernel = Kernel({"MJPG": MODES})
    path = tmp_path / "video0"
    kernel.install(path, monkeypatch)
    flowing, over = threading.Event(), threading.Event()
    flowing.set()

    def expose():
        while not over.wait(0.03):
            if flowing.is_set() and kernel.streaming:
                kernel.expose(jpeg(), now())

    async def scenario() -> float:
        camera = Camera(CameraConfig(source="/dev/video0"), partial(camera_v4l2.v4l2_frames, str(path), WANTED, print))
        async with running(camera):
            await camera.wait_newer(0.0)
            flowing.clear()
            slowest = await until_and_slowest(lambda: camera.reason)
            assert "no more frames" in camera.reason
            flowing.set()
            return max(slowest, await until_and_slowest(lambda: not camera.reason and camera.ok(now())))

    thread = threading.Thread(target=expose)
    thread.start()
    try:
        assert asyncio.run(scenario()) < 0.4  # what a busy machine makes of 5 ms; a frozen read takes a second
    finally:
        over.set()
        thread.join()


async def until_and_slowest(condition) -> float:
    """Wait for the condition, at most 8 s; the longest that the event loop was away meanwhile."""
    slowest, deadline = 0.0, now() + 8.0
    while not condition():
        assert now() < deadline
        began = now()
        await asyncio.sleep(0.005)
        slowest = max(slowest, now() - began)
    return slowest
