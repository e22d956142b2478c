import pytest
from camera_pictures import HEIGHT, WIDTH, jpeg

from omnibotd.core.errors import FrameError
from omnibotd.io.camera_jpeg import whole


@pytest.mark.parametrize("options", [{}, {"progressive": 1}, {"rst_interval": 2}, {"quality": 100}, {"quality": 5}])
def test_a_jpeg_is_freed_of_what_trails_it_and_tells_its_size(options):
    picture = jpeg(**options)
    assert whole(picture) == (picture, (WIDTH, HEIGHT))
    for trailing in (bytes(1000), b"\xff\xd9", jpeg(7)[40:]):  # zeros, or the end of a longer picture before
        assert whole(picture + trailing) == (picture, (WIDTH, HEIGHT))


def test_a_jpeg_with_a_thumbnail_ends_where_the_picture_ends():
    picture, thumbnail = jpeg(10), jpeg(200)
    segment = b"\xff\xe1" + (len(thumbnail) + 2).to_bytes(2) + thumbnail
    assert whole(picture[:2] + segment + picture[2:] + b"junk")[0] == picture[:2] + segment + picture[2:]


def test_a_jpeg_cut_anywhere_is_refused():
    picture = jpeg()
    for length in range(len(picture)):
        with pytest.raises(FrameError):
            whole(picture[:length])


def test_a_jpeg_cut_in_its_scan_is_not_completed_by_the_next_one():
    picture = jpeg()
    scan = picture.index(b"\xff\xda") + 10  # marker, length, and the 6 bytes of a header with one component
    for length in range(scan, len(picture)):
        with pytest.raises(FrameError):
            whole(picture[:length] + jpeg(7))
