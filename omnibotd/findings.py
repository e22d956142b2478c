"""What `doctor` finds: one thing checked, how it is, and how to mend it. Pure: figures in, findings out.

Used by the daemon, which knows the running robot, and by the client, which looks by itself where no daemon answers. So
neither numpy nor OpenCV here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

# A place estimate per tick of 0.1 s is what navigation was tuned with; with half of that it still steers.
LEAST_RATE = 5.0  # frames/s
# A teaching drive of five minutes takes 60 MB; a map of 20,000 nodes, and the copies kept of it, 16 MB.
LITTLE_ROOM, NO_ROOM = 1e9, 1e8  # bytes
# Lateness of the control tick of 100 ms: noticeable; and so late that bases with a dead-man of 250 ms may stutter.
LATE, TOO_LATE = 0.030, 0.080  # s
BUSY = 0.8  # share of the processor above which nothing is left for a bad moment
MEMORY_SCARCE = 100e6  # bytes available to programs
# Brightness of 0..255: below, a ceiling drowns in noise; above, a sensor tells nothing.
DARK, BRIGHT = 20.0, 250
GLARE = 0.25  # share of the picture that may be as bright as that: lamps take a tenth
FLAT = 4.0  # spread of brightness in the picture: a covered lens
DIRTY = 0.02  # share of the view that stays the same however the robot turns; by chance it is a tenth of that


class Grade(StrEnum):
    """How something is; what could not be looked at is UNKNOWN."""

    OK = "ok"
    WARNING = "warning"
    WRONG = "wrong"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Finding:
    """`found` is a short sentence; `remedy` says what to do, empty where nothing need be done."""

    name: str
    grade: Grade
    found: str
    remedy: str = ""

    def values(self) -> dict[str, str]:
        return {key: str(value) for key, value in asdict(self).items()}


def from_values(told: Iterable[Mapping[str, Any]]) -> list[Finding]:
    """Findings as the daemon sent them."""
    return [
        Finding(str(entry["name"]), Grade(entry["grade"]), str(entry["found"]), str(entry.get("remedy", "")))
        for entry in told
    ]


def ok(name: str, found: str) -> Finding:
    return Finding(name, Grade.OK, found)


def wrong(name: str, found: str, remedy: str) -> Finding:
    return Finding(name, Grade.WRONG, found, remedy)


def warning(name: str, found: str, remedy: str) -> Finding:
    return Finding(name, Grade.WARNING, found, remedy)


def unknown(name: str, found: str, remedy: str = "") -> Finding:
    return Finding(name, Grade.UNKNOWN, found, remedy)


def frame_rate(rate: float, wanted: float) -> Finding:
    """`wanted` is what the camera was asked for, or has agreed to."""
    found = f"{rate:.1f} pictures a second, {wanted:g} asked for"
    remedy = (
        "give more light or set camera.exposure below the time between two pictures; plug the camera straight into the "
        "PC; see that no other program is busy"
    )
    if rate < LEAST_RATE:
        return wrong("frame rate", found, remedy)
    return warning("frame rate", found, remedy) if rate < 0.85 * wanted else ok("frame rate", found)


def picture(mean: float, spread: float, glare: float) -> Finding:
    """Brightness (0..255), its spread, and the share of the picture that is as bright as can be."""
    found = f"brightness {mean:.0f} of 255, spread {spread:.0f}, {glare:.0%} glaring"
    if spread < FLAT:
        return wrong("picture", f"{found}: shows nothing", "take the cap or dust off the lens; put on the light")
    if mean < DARK:
        return warning("picture", f"{found}: too dark", "put on the light, or set camera.exposure to more")
    if glare > GLARE:
        return warning("picture", f"{found}: too bright", "set camera.exposure to less, 0.005 for a start")
    return ok("picture", found)


def dirt(share: float) -> Finding | None:
    """Share of the view in which the lens is known to be dirty; it is known once the robot has turned all round."""
    if share < DIRTY:
        return None
    return warning("lens", f"{share:.0%} of the view stays the same however the robot turns", "wipe the lens")


def disk(free: float, folder: str) -> Finding:
    found = f"{free / 1e9:.1f} GB free for {folder}"
    remedy = f"delete recordings that are trained: {folder}/recordings; they are the large ones"
    if free < NO_ROOM:
        return wrong("disk", found, remedy)
    return warning("disk", found, remedy) if free < LITTLE_ROOM else ok("disk", found)


def clock(now: float, built: float, synchronised: bool | None) -> Finding:
    """Wall-clock seconds, those at which this program was installed, and whether a time service keeps the clock."""
    if now < built:
        return wrong(
            "clock",
            "the clock is behind the day this program was installed; recordings and calibrations get false dates",
            "set it (`timedatectl set-time`), and renew the battery on the PC's board",
        )
    if synchronised is None:
        return unknown("clock", "plausible; whether a time service keeps it is not known")
    if not synchronised:
        return warning(
            "clock", "plausible, but no time service keeps it", "`timedatectl set-ntp true`, where there is a network"
        )
    return ok("clock", "kept by a time service")


def loop(late_p99: float, late_max: float) -> Finding:
    """Lateness (s) of the control tick during the last minute."""
    found = f"ticks late by {1e3 * late_p99:.0f} ms (99 %), {1e3 * late_max:.0f} ms at most"
    remedy = "end other programs on this PC; lower camera.width and camera.height or camera.fps"
    if late_p99 > TOO_LATE:
        return wrong("control loop", found, remedy)
    return warning("control loop", found, remedy) if late_p99 > LATE else ok("control loop", found)


def processor(busy: float, by_daemon: float | None) -> Finding:
    """Shares: of all processors that was busy, of one core that the daemon used."""
    own = "" if by_daemon is None else f", {by_daemon:.0%} of a core by omnibotd"
    found = f"{busy:.0%} of this PC's processor in use{own}"
    if busy > BUSY:
        return warning("processor", found, "`top` says by whom; end what need not run on a robot")
    return ok("processor", found)


def memory(available: float) -> Finding:
    found = f"{available / 1e6:.0f} MB available"
    if available < MEMORY_SCARCE:
        return warning("memory", found, "end other programs; training a map takes up to 300 MB")
    return ok("memory", found)


def stable_name(name: str, key: str, path: str, better: str | None) -> Finding | None:
    """A kernel's name such as /dev/ttyUSB0 may be another device's after a replug; `better` names this one for good."""
    if better is None or path == better:
        return None
    return warning(name, f"{path} may get another name when it is plugged in again", f"set {key}: {better}")
