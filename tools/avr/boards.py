"""The boards that the firmware is built for, and where a robot's wires end on them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """The wiring table of firmware_bridge/firmware/README.md; pins as "B1": port and bit, pairs as (left, right)."""

    name: str
    mcu: str
    standby: str
    pwm: tuple[str, str]
    forward: tuple[str, str]
    backward: tuple[str, str]
    channel_a: tuple[str, str]
    channel_b: tuple[str, str]
    bumpers: tuple[str, str]
    charger: str
    battery: int  # channel of the converter


UNO = Board(
    name="uno",
    mcu="atmega328p",
    standby="B0",
    pwm=("B1", "B2"),
    forward=("D6", "B3"),
    backward=("D7", "B4"),
    channel_a=("C0", "C2"),
    channel_b=("C1", "C3"),
    bumpers=("D4", "D5"),
    charger="C5",
    battery=4,
)
MEGA = Board(
    name="mega",
    mcu="atmega2560",
    standby="A4",
    pwm=("B5", "B6"),
    forward=("A0", "A2"),
    backward=("A1", "A3"),
    channel_a=("B0", "B2"),
    channel_b=("B1", "B3"),
    bumpers=("A6", "A7"),
    charger="C7",
    battery=0,
)
BOARDS = {board.name: board for board in (UNO, MEGA)}
