"""One picture of the camera with the moment it arrived."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from omnibotd.core.errors import FrameError

Image = NDArray[np.uint8]
FloatImage = NDArray[np.float32]

_REDUCED_GREY = {
    1: cv2.IMREAD_GRAYSCALE,
    2: cv2.IMREAD_REDUCED_GRAYSCALE_2,
    4: cv2.IMREAD_REDUCED_GRAYSCALE_4,
    8: cv2.IMREAD_REDUCED_GRAYSCALE_8,
}


@dataclass(frozen=True, slots=True)
class Frame:
    """A camera image as it came: JPEG bytes, or pixels (H, W) grey or (H, W, 3) BGR; `stamp` in monotonic seconds.

    `dirty` are the cells (RINGS, SECTORS) of its view where the lens is known to be dirty, if that is known.
    """

    stamp: float
    data: bytes | Image
    dirty: NDArray[np.bool_] | None = None

    def grey(self, reduction: int = 1) -> Image:
        """Grey image (H/reduction, W/reduction), reduction in {1, 2, 4, 8}; a JPEG is decoded just that large.

        Raises FrameError where the bytes are no picture.
        """
        if isinstance(self.data, bytes):
            try:
                image = cv2.imdecode(np.frombuffer(self.data, np.uint8), _REDUCED_GREY[reduction])
            except cv2.error as error:
                raise FrameError(f"frame can't be decoded: {error}") from error
            if image is None:
                raise FrameError(f"frame of {len(self.data)} bytes is no picture that OpenCV can decode")
            return np.asarray(image, np.uint8)
        grey = self.data if self.data.ndim == 2 else cv2.cvtColor(self.data, cv2.COLOR_BGR2GRAY)
        if reduction == 1:
            return np.asarray(grey, np.uint8)
        height, width = grey.shape
        size = (-(-width // reduction), -(-height // reduction))
        return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)

    def jpeg(self, quality: int = 90) -> bytes:
        """The picture as JPEG bytes: as it came where it came so, else encoded."""
        if isinstance(self.data, bytes):
            return self.data
        return bytes(cv2.imencode(".jpg", self.data, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes())


def mean_of(frames: Sequence[Frame]) -> Frame:
    """Frames from one place as one with less noise, grey, with the stamp of the last; FrameError as of `Frame.grey`."""
    total = np.sum([frame.grey() for frame in frames], axis=0, dtype=np.float32)
    return replace(frames[-1], data=np.asarray(np.round(total / len(frames)), np.uint8))
