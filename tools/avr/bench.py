"""A host that speaks to the firmware in lockstep: the laboratory bench of tests and plots."""

from __future__ import annotations

from dataclasses import fields
from types import TracebackType
from typing import Self, TypeVar

from firmware_bridge import messages
from firmware_bridge.framing import DELIMITER, Decoder
from firmware_bridge.messages import Ack, Config, Configure, GetConfig, Hello, HelloReply, Message, SetPoint, Telemetry
from tools.avr.boards import UNO, Board
from tools.avr.robot import AvrRobot

BOOT = 0.05  # s until it listens; the EEPROM's write takes most of it on a real chip
CLOCK_STARTS = 0.005  # s after power-up or reset, at the latest
TURNAROUND = 0.002  # s from the last byte of a request to its effect
FRAME_TIME = 0.005  # s; the longest frame takes less
SETPOINT_PERIOD = 0.1  # s, as the daemon sends them
STORING = 0.15  # s until a configuration is stored
ANSWER_LIMIT = 0.5  # s of waiting for a message that should come

Wanted = TypeVar("Wanted")


class NoAnswer(AssertionError):
    """The firmware did not say what it should have."""


class Bench:
    """A robot, a decoder, and the sequence number and nonce that the host knows of."""

    def __init__(self, board: Board = UNO, flash: bytes | None = None) -> None:
        """Powered up and listening, hands not shaken; see AvrRobot."""
        self.robot = AvrRobot(board, flash)
        self.nonce = 0
        self.seq = 0
        self._decoder = Decoder()
        self.robot.run(BOOT)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.robot.close()

    def say(self, message: Message, seq: int | None = None) -> int:
        """Sends one message, under the next number where none is given, and waits until it is obeyed."""
        if seq is None:
            self.seq = seq = (self.seq + 1) % 256
        self.robot.deliver(messages.to_bytes(message, seq))
        self.robot.run(TURNAROUND)
        return seq

    def heard(self) -> list[Message]:
        """What has come since the last call."""
        return [messages.parse(frame) for frame in self._decoder.feed(self.robot.receive())]

    def await_one(self, kind: type[Wanted]) -> Wanted:
        """The next message of that kind; NoAnswer."""
        until = self.robot.now + ANSWER_LIMIT
        while self.robot.now < until:
            for message in self.heard():
                if isinstance(message, kind):
                    return message
            self.robot.run(0.001)
        raise NoAnswer(f"no {kind.__name__} within {ANSWER_LIMIT} s")

    def ask(self, message: Message, kind: type[Wanted]) -> Wanted:
        """Sends one message and waits for its answer, of that kind; NoAnswer."""
        self.heard()
        self.say(message)
        return self.await_one(kind)

    def greet(self) -> HelloReply:
        """Shakes hands; remembers the nonce."""
        self.robot.deliver(DELIMITER)  # ends whatever half frame the firmware holds
        reply = self.ask(Hello(), HelloReply)
        self.nonce = reply.boot_nonce
        return reply

    def settings(self) -> Config:
        """The configuration in force; NoAnswer."""
        return self.ask(GetConfig(), Config)

    def configure(self, **changes: int) -> bool:
        """Has the configuration in force changed and stored; whether it was acknowledged."""
        now = {field.name: getattr(self.settings(), field.name) for field in fields(Configure)}
        self.heard()
        seq = self.say(Configure(**{**now, "boot_nonce": self.nonce, **changes}))
        self.robot.run(STORING)
        return Ack(Configure.CODE, seq) in self.heard()

    def report(self) -> Telemetry:
        """Telemetry that is written from now on, not one that is on its way."""
        self.robot.run(FRAME_TIME)
        self.heard()
        return self.await_one(Telemetry)

    def setpoint(self, left: int, right: int, nonce: int | None = None, *, age: float = 0.0) -> SetPoint:
        """Speeds in ticks/s as a host would have sent them `age` seconds ago; None: for the boot it greeted."""
        mcu_us = round((self.robot.up - CLOCK_STARTS - age) * 1e6) % 2**32
        return SetPoint(self.nonce if nonce is None else nonce, left, right, mcu_us)

    def drive(self, left: int, right: int) -> int:
        """One set-point, ticks/s; returns its number."""
        return self.say(self.setpoint(left, right))

    def hold(self, left: int, right: int, seconds: float) -> None:
        """Set-points as a daemon sends them, for so long."""
        until = self.robot.now + seconds
        while self.robot.now < until - 1e-9:
            begun = self.robot.now
            self.drive(left, right)
            self.robot.run_until(min(begun + SETPOINT_PERIOD, until))

    def rest(self) -> None:
        """Lets the watchdog stop the wheels, and the wheels run out."""
        self.robot.run(1.5)
