"""A Create 2 as its Open Interface shows it: what the base does with bytes, wheels and time.

After the Create 2 Open Interface specification (2016) and what owners report; shares nothing with the driver.
Sans-IO: the owner moves the bytes, turns wheels by `target` and reports them with `set_state`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from tools.sim.emulators.create2_sensors import GROUPS, SIZES, Sensors, pack

OFF, PASSIVE, SAFE, FULL = range(4)
TICK = 0.072 * 3.141592653589793 / 508.8  # m of floor a count
WHEELBASE = 0.235  # m
TOP_SPEED = 500  # mm/s
SPEED_STEP = 28.5  # mm/s, what the wheels really do
SENSOR_PERIOD = 0.015  # s
SLEEP_AFTER = 300.0  # s in Passive mode
BOOT_TIME = 1.0  # s; deaf meanwhile
LINE_LIMIT = 172  # bytes of stream a slot at 115200 baud
BANNER = (
    b"bl-start\r\nSTR730\r\nbootloader id: #x47135160 4FF05FFF\r\nbootloader rev: #x0001\r\n"
    b"2007-05-14-1715-L\r\nRoomba by iRobot!\r\nstr730\r\n2012-03-22-1549-L\r\nbattery-current-zero 257\r\n"
)
ANY, AWAKE, DRIVING = frozenset(range(4)), frozenset((PASSIVE, SAFE, FULL)), frozenset((SAFE, FULL))


@dataclass(frozen=True, slots=True)
class Command:
    """Where it is heard, what it does, and how many bytes follow: `length`, or as the `look`-th of them tells."""

    modes: frozenset[int]
    act: Callable[[bytes], None]
    length: int = 0
    look: int = 0
    scale: int = 1

    def complete(self, data: bytes) -> bool:
        """Whether all of its data has come."""
        if len(data) < self.look:
            return False
        return len(data) >= (self.look + self.scale * data[self.look - 1] if self.look else self.length)


class Create2Device:
    """One base, charged and awake, its OI off.

    `safe_on_dock` False makes the odd base that lets nobody into Safe mode on its dock.
    """

    def __init__(self, *, safe_on_dock: bool = True) -> None:
        self._safe_on_dock = safe_on_dock
        self._sensors = Sensors()
        self._true_ticks: tuple[int, int] | None = None
        self._docked = False
        self.commands = self._command_table()
        self.reset()
        self._deaf_until = float("-inf")
        self._out.clear()

    def reset(self, nonce: int = 0) -> None:
        """A new battery, or opcode 7: all forgotten, encoders at zero, and a long banner."""
        self.mode = OFF
        self.asleep = False
        self._pending = b""
        self._wheels = (0, 0)  # requested (left, right), mm/s
        self._cleaning = False
        self._stream: tuple[int, ...] = ()
        self._streaming = False
        self._slot_at: float | None = None
        self._idle_since: float | None = None
        self._garbled = False  # by a change of the baud rate
        self._deaf_until = float("inf")  # until the next poll knows the time
        self._sensors = replace(self._sensors, encoders=(0, 0), requested=(0, 0), mode=OFF)
        self._out = bytearray(BANNER)

    def wake(self) -> None:
        """The BRC wire pulled low for a moment, or a button pressed."""
        self.asleep = False
        self._idle_since = None

    def press_clean(self) -> None:
        """Somebody presses its big button: the base cleans."""
        self.wake()
        self._clean(b"")

    @property
    def target(self) -> tuple[float, float]:
        """Wheel speeds (left, right), ticks/s."""
        if self._cleaning:
            return 200.0 / 1000.0 / TICK, 200.0 / 1000.0 / TICK
        left, right = (round(speed / SPEED_STEP) * SPEED_STEP for speed in self._wheels)
        return left / 1000.0 / TICK, right / 1000.0 / TICK

    def set_state(
        self,
        left_ticks: int,
        right_ticks: int,
        *,
        bumper_left: bool = False,
        bumper_right: bool = False,
        cliff: bool = False,
        wheel_drop: bool = False,
        charging: bool | None = None,
        battery_mv: int = 15_600,
        range_ahead: float | None = None,
    ) -> None:
        """What the body does now; `charging` stands for the contacts of the home base. It has no range sensor."""
        self._count(left_ticks, right_ticks)
        self._sensors = replace(
            self._sensors,
            bumps=bumper_right | bumper_left << 1 | wheel_drop << 2 | wheel_drop << 3,
            cliffs=(0, int(cliff), int(cliff), 0),
            millivolts=battery_mv,
        )
        contact = bool(charging)
        self._keep_safe(arrived=contact and not self._docked)
        self._docked = contact
        self._update()

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes from the host. A command that lacks bytes waits for them, whatever they were meant to be."""
        if self.asleep or self._garbled or now < self._deaf_until:
            return
        for byte in data:
            if not self._pending and byte not in self.commands:
                continue
            self._pending += bytes((byte,))
            command = self.commands[self._pending[0]]
            if command.complete(self._pending[1:]):
                pending, self._pending = self._pending, b""
                if self.mode in command.modes:
                    command.act(pending[1:])
                    self._update()

    def poll(self, now: float) -> None:
        """Mind time; call at least every 10 ms."""
        if self._deaf_until == float("inf"):
            self._deaf_until = now + BOOT_TIME
        self._fall_asleep(now)
        if self._slot_at is None or self.asleep:
            self._slot_at = now
        if now < self._slot_at:
            return
        due = self._slot_at + SENSOR_PERIOD
        self._slot_at = due if due > now - SENSOR_PERIOD else now + SENSOR_PERIOD
        if self._streaming and self.mode != OFF and not self.asleep:
            self._out += self._frame()

    def data_to_send(self) -> bytes:
        """Bytes for the host since the last call."""
        data = bytes(self._out)
        self._out.clear()
        return data

    def _command_table(self) -> dict[int, Command]:
        ignored: Callable[[bytes], None] = lambda data: None  # noqa: E731 (lights and songs)
        return {
            7: Command(ANY, lambda data: self.reset()),
            128: Command(ANY, lambda data: self._enter(PASSIVE)),
            129: Command(AWAKE, self._set_baud, 1),
            131: Command(AWAKE, lambda data: self._enter(SAFE)),
            132: Command(AWAKE, lambda data: self._enter(FULL)),
            133: Command(AWAKE, self._power_off),
            134: Command(AWAKE, self._clean),
            135: Command(AWAKE, self._clean),
            136: Command(AWAKE, self._clean),
            137: Command(DRIVING, self._drive, 4),
            139: Command(DRIVING, ignored, 3),
            140: Command(AWAKE, ignored, look=2, scale=2),
            141: Command(DRIVING, ignored, 1),
            142: Command(AWAKE, self._answer, 1),
            143: Command(AWAKE, self._clean),
            145: Command(DRIVING, self._drive_direct, 4),
            146: Command(DRIVING, self._drive_pwm, 4),
            148: Command(AWAKE, self._set_stream, look=1),
            149: Command(AWAKE, lambda data: self._answer(data[1:]), look=1),
            150: Command(AWAKE, self._pause, 1),
            173: Command(ANY, lambda data: self._enter(OFF)),
        }

    def _enter(self, mode: int) -> None:
        """Every change of mode stops the wheels."""
        self.mode = mode
        self._wheels = (0, 0)
        self._cleaning = False
        self._idle_since = None
        self._keep_safe(arrived=False)

    def _keep_safe(self, *, arrived: bool) -> None:
        """Safe mode ends at a dropped wheel, a cliff ahead, or when a charger comes."""
        if self.mode != SAFE:
            return
        over_the_edge = any(self._sensors.cliffs) and sum(self._wheels) > 0
        refused = self._docked and not self._safe_on_dock
        if self._sensors.bumps & 12 or over_the_edge or arrived or refused:
            self._enter(PASSIVE)

    def _fall_asleep(self, now: float) -> None:
        if self.mode != PASSIVE or self._cleaning:
            self._idle_since = None
        elif self._idle_since is None:
            self._idle_since = now
        elif now - self._idle_since > SLEEP_AFTER:
            self.asleep, self.mode, self._streaming = True, OFF, False

    def _power_off(self, data: bytes) -> None:
        self._enter(PASSIVE)
        self.asleep = True

    def _set_baud(self, data: bytes) -> None:
        self._garbled = data[0] != 11

    def _clean(self, data: bytes) -> None:
        self._enter(PASSIVE)
        self._cleaning = True

    def _drive(self, data: bytes) -> None:
        speed, radius = _signed(data[:2]), _signed(data[2:])
        if radius in (-32768, 32767):
            self._move(speed, speed)
        elif radius in (-1, 1):
            self._move(-speed * radius, speed * radius)
        elif radius:
            share = WHEELBASE * 500.0 / radius
            self._move(round(speed * (1.0 - share)), round(speed * (1.0 + share)))

    def _drive_direct(self, data: bytes) -> None:
        self._move(_signed(data[2:]), _signed(data[:2]))

    def _drive_pwm(self, data: bytes) -> None:
        right, left = (round(_signed(part) * TOP_SPEED / 255) for part in (data[:2], data[2:]))
        self._move(left, right)

    def _move(self, left: int, right: int) -> None:
        self._wheels = (max(-TOP_SPEED, min(TOP_SPEED, left)), max(-TOP_SPEED, min(TOP_SPEED, right)))
        self._keep_safe(arrived=False)

    def _set_stream(self, data: bytes) -> None:
        """A list that holds an unknown packet, or more than fits on the line, streams nothing."""
        ids = tuple(data[1:])
        known = all(number in SIZES for number in ids)
        self._stream = ids if known and sum(1 + SIZES[n] for n in ids) + 3 <= LINE_LIMIT else ()
        self._streaming = bool(self._stream)

    def _pause(self, data: bytes) -> None:
        self._streaming = data[0] == 1 and bool(self._stream)

    def _answer(self, ids: bytes) -> None:
        for number in ids:
            if number in SIZES:
                self._out += self._packet(number)

    def _packet(self, number: int) -> bytes:
        """The data of a packet or group; what counts the way since it was last read begins anew."""
        data = pack(self._sensors, number)
        members = GROUPS.get(number, (number,))
        if 19 in members:
            self._sensors = replace(self._sensors, distance=0.0)
        if 20 in members:
            self._sensors = replace(self._sensors, angle=0.0)
        return data

    def _frame(self) -> bytes:
        body = b"".join(bytes((number,)) + self._packet(number) for number in self._stream)
        frame = bytes((19, len(body))) + body
        return frame + bytes((-sum(frame) & 0xFF,))

    def _count(self, left: int, right: int) -> None:
        """The encoders have one channel: the direction is the command's, and without one up."""
        before = self._true_ticks or (left, right)
        self._true_ticks = (left, right)
        moved = (left - before[0], right - before[1])
        signs = (-1 if speed < 0 else 1 for speed in self._wheels)
        counts = tuple(
            (count + sign * abs(step) + 2**15) % 2**16 - 2**15
            for count, step, sign in zip(self._sensors.encoders, moved, signs, strict=True)
        )
        self._sensors = replace(
            self._sensors,
            encoders=(counts[0], counts[1]),
            distance=self._sensors.distance + sum(moved) / 2.0 * TICK * 1000.0,
            angle=self._sensors.angle + (moved[1] - moved[0]) * TICK / WHEELBASE * 57.29577951308232,
        )

    def _update(self) -> None:
        """What follows from mode and contacts."""
        charging = 2 if self._docked and self.mode in (OFF, PASSIVE) else 0
        self._sensors = replace(
            self._sensors,
            mode=self.mode,
            requested=self._wheels,
            sources=2 if self._docked else 0,
            charging=charging,
            milliamperes=1200 if charging else -240,
        )


def _signed(data: bytes) -> int:
    return int.from_bytes(data, "big", signed=True)
