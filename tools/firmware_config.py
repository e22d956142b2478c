"""Shows or changes what a board with our firmware is configured for: tools/firmware-config PORT [NAME=VALUE ...].

Stop the daemon first: it holds the port. Names and units: firmware_bridge/firmware/README.md.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Protocol, TypeVar

import serial

from firmware_bridge import messages
from firmware_bridge.framing import DELIMITER, Decoder
from firmware_bridge.messages import (
    Ack,
    Capability,
    Config,
    ConfigSource,
    Configure,
    GetConfig,
    Hello,
    HelloReply,
    MalformedMessage,
    Message,
)

NAMES = tuple(field.name for field in fields(Configure) if field.name != "boot_nonce")
TRIES, PATIENCE = 10, 0.3  # each, s: a board that the port's opening has reset takes two seconds
CONFIG_SOURCES = {
    ConfigSource.DEFAULT: "the firmware's defaults: nothing was ever stored",
    ConfigSource.STORED: "stored on the board",
    ConfigSource.DAMAGED: "the firmware's defaults: what was stored is damaged",
}

Wanted = TypeVar("Wanted")


class Failed(Exception):
    """The board did not answer, or refused; the text says what to do."""


class Line(Protocol):
    """A serial line."""

    def write(self, data: bytes) -> object: ...

    def read(self) -> bytes:
        """What has come, after a short wait at most."""


class SerialLine:
    """A pyserial port."""

    def __init__(self, port: str) -> None:
        self._port = serial.serial_for_url(port, baudrate=115200, timeout=0.02)

    def write(self, data: bytes) -> object:
        return self._port.write(data)

    def read(self) -> bytes:
        return bytes(self._port.read(self._port.in_waiting or 1))


class Board:
    """The board on the other end, hands shaken."""

    def __init__(self, line: Line, clock: Callable[[], float]) -> None:
        """Raises Failed where nothing answers, or nothing with a configuration."""
        self._line = line
        self._clock = clock
        self._decoder = Decoder()
        self._seq = 0
        self.hello = self._ask(Hello(), HelloReply)
        if Capability.CONFIGURATION not in Capability(self.hello.capabilities):
            raise Failed("this base has no configuration to show: is it our firmware?")

    def config(self) -> Config:
        return self._ask(GetConfig(), Config)

    def configure(self, changes: dict[str, int]) -> None:
        """Raises Failed where the board refuses."""
        now = self.config()
        wanted = Configure(now.boot_nonce, **{name: getattr(now, name) for name in NAMES})
        try:
            self._ask(replace(wanted, **changes), Ack)
        except Failed:
            raise Failed("the board refused: a value is out of its range, or the wheels are driven") from None

    def _ask(self, message: Message, kind: type[Wanted]) -> Wanted:
        """Repeats it under one number until the answer comes."""
        self._seq += 1
        for _ in range(TRIES):
            self._line.write(DELIMITER + messages.to_bytes(message, self._seq))
            until = self._clock() + PATIENCE
            while self._clock() < until:
                for answer in self._heard():
                    if isinstance(answer, kind):
                        return answer
        raise Failed(f"no answer within {TRIES * PATIENCE:.0f} s: is it the right port, and the daemon stopped?")

    def _heard(self) -> list[Message]:
        heard = []
        for frame in self._decoder.feed(self._line.read()):
            try:
                heard.append(messages.parse(frame))
            except MalformedMessage:
                continue  # what was said before the port was opened
        return heard


def change(text: str) -> tuple[str, int]:
    """`NAME=VALUE` of the command line; argparse.ArgumentTypeError."""
    name, _, value = text.partition("=")
    if name not in NAMES:
        raise argparse.ArgumentTypeError(f"{name!r} is no setting; there are: {', '.join(NAMES)}")
    try:
        return name, int(value, 0)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: expected {name}= and a whole number") from None


def show(board: Board) -> str:
    """The board and its settings, a line each."""
    config = board.config()
    name = board.hello.board.rstrip(b"\0").decode("ascii", errors="replace")
    lines = [f"{name}, firmware {board.hello.firmware:08x}; {CONFIG_SOURCES[ConfigSource(config.source)]}"]
    return "\n".join(lines + [f"{name}={getattr(config, name)}" for name in NAMES])


def main() -> int:
    """Exit code: 0 done, 1 the board did not answer or refused."""
    parser = argparse.ArgumentParser(prog="tools/firmware-config", description=__doc__)
    parser.add_argument("port", help="serial device, or a pyserial URL")
    parser.add_argument("changes", nargs="*", type=change, metavar="NAME=VALUE")
    options = parser.parse_args()
    try:
        board = Board(SerialLine(options.port), time.monotonic)
        if options.changes:
            board.configure(dict(options.changes))
        print(show(board))
    except (Failed, messages.BridgeError, OSError) as error:
        print(f"tools/firmware-config: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
