"""The firmware on a pty in real time: `python -m tools.avr.realtime [--board uno|mega] [--link PATH]`.

A daemon's `base.port` may name the pty. The wheels hang in the air: they turn, and nothing is in their way.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from firmware_bridge.emulator import Emulator, IdealWheels
from tools.avr.boards import BOARDS
from tools.avr.building import BuildError, ToolsMissing
from tools.avr.device import AvrDevice

MOTOR_LAG = 0.08  # s


async def serve(emulator: Emulator) -> None:
    """Until SIGINT or SIGTERM; prints where the base is."""
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    task = asyncio.create_task(emulator.run())
    print(json.dumps({"port": emulator.port}), flush=True)
    await stop.wait()
    task.cancel()


@contextmanager
def linked(link: Path | None, port: str) -> Iterator[None]:
    """A symbolic link to the pty for as long as it lives. OSError where something is in its place."""
    if link is None:
        yield
        return
    link.symlink_to(port)
    try:
        yield
    finally:
        link.unlink(missing_ok=True)


def main() -> int:
    """Exit code: 0 after SIGINT or SIGTERM, 1 where something needed is missing (said on stderr)."""
    parser = argparse.ArgumentParser(prog="python -m tools.avr.realtime", description=__doc__)
    parser.add_argument("--board", choices=sorted(BOARDS), default="uno")
    parser.add_argument("--link", type=Path, metavar="PATH", help="make this a symbolic link to the pty")
    options = parser.parse_args()
    try:
        emulator = Emulator(AvrDevice(BOARDS[options.board]), IdealWheels(MOTOR_LAG))
        with linked(options.link, emulator.port):
            asyncio.run(serve(emulator))
    except (ToolsMissing, BuildError, OSError) as error:
        print(f"tools.avr.realtime: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
