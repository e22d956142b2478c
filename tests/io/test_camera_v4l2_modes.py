"""Which of a camera's modes is taken."""

from fractions import Fraction

import pytest

from omnibotd.io.camera_v4l2_modes import Mode, Wanted, best, differences


def mode(fourcc: str, width: int, height: int, fps: int) -> Mode:
    return Mode(fourcc, width, height, Fraction(1, fps))


# As a common webcam lists them.
WEBCAM = [
    mode(fourcc, width, height, fps)
    for fourcc, width, height, rates in (
        ("YUYV", 640, 480, (30, 15, 10)),
        ("YUYV", 1280, 720, (10, 5)),
        ("MJPG", 640, 480, (60, 30, 20)),
        ("MJPG", 1280, 720, (30,)),
        ("H264", 640, 480, (30,)),
    )
    for fps in rates
]


@pytest.mark.parametrize(
    ("wanted", "taken"),
    [
        (Wanted(640, 480, 15.0), mode("MJPG", 640, 480, 20)),  # the slowest that is fast enough
        (Wanted(640, 480, 30.0), mode("MJPG", 640, 480, 30)),
        (Wanted(640, 480, 100.0), mode("MJPG", 640, 480, 60)),  # the fastest, where none is
        (Wanted(1280, 720, 15.0), mode("MJPG", 1280, 720, 30)),
        (Wanted(1200, 700, 5.0), mode("MJPG", 1280, 720, 30)),  # the nearest size
    ],
)
def test_of_a_webcam(wanted, taken):
    assert best(WEBCAM, wanted) == taken


def test_size_then_rate_then_format_decides():
    small_jpeg, slow_jpeg, grey = mode("MJPG", 320, 240, 30), mode("MJPG", 640, 480, 5), mode("GREY", 640, 480, 15)
    assert best([small_jpeg, slow_jpeg, grey], Wanted(640, 480, 15.0)) == grey
    assert best([small_jpeg, slow_jpeg], Wanted(640, 480, 15.0)) == slow_jpeg


def test_formats_that_we_cant_read_are_none():
    assert best([mode("H264", 640, 480, 30)], Wanted(640, 480, 15.0)) is None


def test_what_differs_is_told_with_what_to_do():
    size, rate = differences(mode("MJPG", 1280, 720, 10), Wanted(640, 480, 15.0))
    assert "1280x720" in size
    assert "calibrate" in size
    assert "10 frames a second at this size, not 15" in rate
    assert differences(mode("MJPG", 640, 480, 30), Wanted(640, 480, 15.0)) == ()
