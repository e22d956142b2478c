"""Wakes a sleeping Roomba through its BRC wire, where the cable ties that to the adapter's RTS."""

from __future__ import annotations

import array
import asyncio
import fcntl
import termios
from collections.abc import Awaitable, Callable

from omnibotd.io.serial_link import SerialLink

# Low for a second, as the Open Interface advises: three pulses below half a second would change the baud rate.
PULSE = 1.0  # s
_RTS = array.array("i", [termios.TIOCM_RTS]).tobytes()


def waking(open_link: Callable[[], Awaitable[SerialLink]]) -> Callable[[], Awaitable[SerialLink]]:
    """The same opener; each link it opens has given its pulse, and its RTS then rests."""

    async def opened() -> SerialLink:
        link = await open_link()
        try:
            if _set_low(link, True):
                await asyncio.sleep(PULSE)
                _set_low(link, False)
        except BaseException:
            link.close()
            raise
        return link

    return opened


def _set_low(link: SerialLink, low: bool) -> bool:
    """RTS asserted is a low level on a TTL adapter. False where the port has no such line (pty, socket) or is gone."""
    try:
        fcntl.ioctl(link.fileno(), termios.TIOCMBIS if low else termios.TIOCMBIC, _RTS)
    except OSError:
        return False
    return True
