"""Gives back the pages of libraries that only loading touched.

Debian's OpenCV hangs on four hundred libraries, GDAL, VTK and Qt among them, of which the daemon needs a tenth. The
loader touches a few pages of each, and the kernel maps sixteen for every one touched: 80 MB that stay resident.
"""

from __future__ import annotations

import ctypes
import logging
import mmap
import os
import re
from collections.abc import Iterator
from pathlib import Path

log = logging.getLogger(__name__)

SMAPS = Path("/proc/self/smaps")
# Start, end, rights and inode of a mapping; then, of the lines about it, those that tell of pages that are no file's.
_LINE = re.compile(r"^([0-9a-f]+)-([0-9a-f]+) (\S{4}) \S+ \S+ (\d+)|^(?:Anonymous|Swap): +(\d+) kB", re.MULTILINE)


def give_back() -> None:
    """Let go of every page that the file still has as it was; one that is used again comes from the page cache.

    To be called when all is loaded and no other thread loads anything. Does nothing where the kernel has no such list.
    """
    try:
        listed = SMAPS.read_text()
    except OSError as error:
        log.debug("pages of libraries stay: %s", error)
        return
    madvise = ctypes.CDLL(None, use_errno=True).madvise
    madvise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    for start, end in untouched(listed):
        if madvise(start, end - start, mmap.MADV_DONTNEED) != 0:
            log.debug("pages at %x stay: %s", start, os.strerror(ctypes.get_errno()))


def untouched(listed: str) -> Iterator[tuple[int, int]]:
    """(start, end) of the mappings in the text of smaps that hold nothing but what stands in their files.

    Not those that may be written, and none with a page of its own: what the loader has relocated exists nowhere else.
    """
    candidate: tuple[int, int] | None = None
    for found in _LINE.finditer(listed):
        start, end, rights, inode, own = found.groups()
        if own is None:
            if candidate is not None:
                yield candidate
            clean = inode != "0" and rights[1] != "w" and rights[3] == "p"
            candidate = (int(start, 16), int(end, 16)) if clean else None
        elif own != "0":
            candidate = None
    if candidate is not None:
        yield candidate
