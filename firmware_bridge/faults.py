"""A line that loses, delays and corrupts, the same way each time for one seed."""

from __future__ import annotations

import random
from collections import deque

# Two seconds of a full 115200 baud line; older bytes are lost, as in any real buffer.
MAX_CHUNKS = 1024
MAX_GARBAGE = 80  # bytes in one burst: longer than any frame


class HostileLine:
    """One direction of a serial line. The faults are plain attributes; at first all is well.

    `loss` is the chance that a write is lost, `garbage` that random bytes come before it, `flips` that a byte
    has one bit turned; `delay` is in seconds; `split` hands the bytes over one by one. Order is always kept.
    """

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self._chunks: deque[tuple[float, bytes]] = deque(maxlen=MAX_CHUNKS)
        self._last_due = float("-inf")
        self.loss = 0.0
        self.delay = 0.0
        self.garbage = 0.0
        self.flips = 0.0
        self.split = False

    def push(self, data: bytes, now: float) -> None:
        """One write by the sender."""
        if not data:
            return
        noise = self._noise()
        if self._random.random() < self.loss:
            data = b""
        chunk = noise + bytes(map(self._flip, data))
        if chunk:
            # A delay that shrinks must not let bytes overtake those on their way.
            self._last_due = max(self._last_due, now + self.delay)
            self._chunks.append((self._last_due, chunk))

    def pull(self, now: float) -> list[bytes]:
        """What has arrived by `now`, in the pieces the receiver gets to see."""
        arrived = []
        while self._chunks and self._chunks[0][0] <= now:
            arrived.append(self._chunks.popleft()[1])
        if self.split:
            return [bytes((byte,)) for chunk in arrived for byte in chunk]
        return arrived

    def clear(self) -> None:
        """Lose what is on its way."""
        self._chunks.clear()

    def _noise(self) -> bytes:
        if self._random.random() >= self.garbage:
            return b""
        return self._random.randbytes(self._random.randint(1, MAX_GARBAGE))

    def _flip(self, byte: int) -> int:
        return byte ^ 1 << self._random.randrange(8) if self._random.random() < self.flips else byte
