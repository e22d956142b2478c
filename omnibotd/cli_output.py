"""What omnibotctl shows a person: aligned tables on standard output, one live line on standard error."""

from __future__ import annotations

import math
import shutil
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

# Confidence from which a pose steers the robot and may be saved (as the daemon decides), below which it says nothing.
_SURE, _LOST = 0.9, 0.5

Values = Mapping[str, Any]


class LiveLine:
    """Progress on standard error: a line that is written over on a terminal, else at most one line a second."""

    def __init__(self, *, quiet: bool) -> None:
        self._terminal = sys.stderr.isatty()
        self._quiet = quiet and not self._terminal
        self._shown = -math.inf
        self._dirty = False

    def show(self, text: str) -> None:
        if self._terminal:
            width = shutil.get_terminal_size().columns - 1
            print(f"\r{text[:width]}\x1b[K", end="", file=sys.stderr, flush=True)
            self._dirty = True
        elif not self._quiet and time.monotonic() - self._shown >= 1.0:
            print(text, file=sys.stderr, flush=True)
            self._shown = time.monotonic()

    def clear(self) -> None:
        if self._dirty:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
            self._dirty = False


def table(rows: Sequence[Sequence[object]], right: Sequence[int] = ()) -> str:
    """Rows of cells as aligned columns; those numbered in `right` are flush right."""
    cells = [[str(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return "\n".join(_row(row, widths, right).rstrip() for row in cells)


def _row(cells: Sequence[str], widths: Sequence[int], right: Sequence[int]) -> str:
    columns = enumerate(zip(cells, widths, strict=True))
    return "  ".join(cell.rjust(width) if at in right else cell.ljust(width) for at, (cell, width) in columns)


def feedback(values: Values) -> str:
    """One line of a job's feedback."""
    parts = [str(values[key]) for key in ("state", "stage", "complaint", "hint") if values.get(key)]
    formats: dict[str, Callable[[Any], str]] = {
        "waypoint": lambda value: (
            f"way-point {value}" + (f" of {values['waypoints']}" if "waypoints" in values else "")
        ),
        "loop": lambda value: f"loop {value} of {values['loops']}" if values.get("loops", 1) > 1 else "",
        "trial": lambda value: f"trial {value} of {values['trials']}, {values['docked']} docked",
        "progress": lambda value: f"{value:.0%}",
        "found": lambda value: f"{value} boards seen, {values['kept']} kept",
        "missing": _missing,
        "distance_remaining": lambda value: f"{value:.2f} m to go",
        "confidence": lambda value: f"confidence {value:.2f}",
        "number_of_recoveries": lambda value: _plural(value, "recovery", "recoveries") if value else "",
        "retries": lambda value: _plural(value, "retry", "retries") if value else "",
        "navigation_time": duration,
        "seconds": duration,
    }
    parts += [form(values[key]) for key, form in formats.items() if values.get(key) is not None]
    return "  ".join(part for part in parts if part)


def _missing(parts: Any) -> str:
    """Of the picture, where the board was not seen yet."""
    return f"still missing: {', '.join(parts)}" if parts else "seen everywhere"


def _plural(count: float, one: str, many: str) -> str:
    return f"{count} {one if count == 1 else many}"


def status(values: Values) -> str:
    rows = [
        ("omnibotd", f"{values['version']}, up {duration(values['uptime_s'])}, {values['memory_mb']:.0f} MB"),
        ("state", _state(values)),
        ("map", values.get("map") or "none: say map use NAME, or record and train one"),
        ("pose", pose(values.get("pose"))),
        ("confidence", _confidence(values)),
        ("place", values.get("place") or "-"),
        ("battery", _battery(values)),
        ("base", _base(values["base"])),
        ("camera", _camera(values["camera"])),
        (
            "loop",
            "{period_ms:.0f} ms, late p99 {late_ms_p99:.1f} ms, max {late_ms_max:.1f} ms".format(**values["loop"]),
        ),
    ]
    if values.get("recording"):
        rows.insert(2, ("recording", recording(values["recording"])))
    rows += [(f"calibration {entry['name']}", _calibration(entry)) for entry in values.get("calibrations") or ()]
    if values.get("last_failure"):
        rows.append(("last failure", _last_failure(values["last_failure"])))
    return table(rows)


def _calibration(values: Values) -> str:
    about = f"of {values['date']}, residual {values['residual']}"
    return about if values["in_use"] else f"NOT IN USE: {values['reason']} ({about})"


def _last_failure(values: Values) -> str:
    where = f"; report and picture: {values['file']}" if values.get("file") else ""
    return f"{values['job']} at {values['time']}: {values['error']}, {values['message']}{where}"


_UNITS = {"distance_left": "m", "sigma": "m", "x": "m", "y": "m", "yaw": "rad"}


def report(values: Values) -> str:
    """The facts behind a failure as aligned lines: what was seen and, where that is known, what was expected."""
    rows = []
    for name, value in values.items():
        expected = values.get(f"expected_{name}")
        if name.removeprefix("expected_") not in values or not name.startswith("expected_"):
            beside = "" if expected is None else f", expected {_value(expected)}"
            rows.append((f"  {name.replace('_', ' ')}", f"{_value(value)} {_UNITS.get(name, '')}".rstrip() + beside))
    return table(rows)


def _value(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def route(values: Values) -> str:
    """The arrivals as a table, and how it went in all."""
    rows = [
        (entry["loop"], entry["place"], duration(entry["seconds"]), pose(entry.get("pose")))
        for entry in values["arrivals"]
    ]
    head = ("LOOP", "PLACE", "AFTER", "POSE")
    whole = f"arrived {_plural(values['arrived'], 'time', 'times')} in {duration(values['seconds'])}"
    return f"{table([head, *rows], right=(0, 2))}\n{whole}"


def _state(values: Values) -> str:
    job = values.get("job")
    return f"{job['name']}  {feedback(job)}" if job else str(values.get("state") or "IDLE")


def pose(values: Values | None) -> str:
    if values is None:
        return "unknown"
    return f"x {values['x']:.3f} m  y {values['y']:.3f} m  yaw {math.degrees(values['yaw']):.1f}\N{DEGREE SIGN}"


def _confidence(values: Values) -> str:
    confidence, sigma = values.get("confidence"), values.get("sigma")
    if confidence is None:
        return "-"
    verdict = "sure" if confidence >= _SURE else "lost" if confidence < _LOST else "not sure"
    return f"{confidence:.2f}, {verdict}" + (f", within {sigma:.2f} m" if sigma is not None else "")


def _battery(values: Values) -> str:
    battery = values.get("battery")
    volts = "-" if battery is None else f"{battery:.1f} V"
    return f"{volts}, charging" if values.get("charging") else volts


def _base(values: Values) -> str:
    driver = values.get("driver") or "no driver"
    if not values["connected"]:
        return f"{driver}, NOT CONNECTED: {values.get('reason') or 'no reason known'}"
    about = " ".join(str(values[key]) for key in ("board", "firmware") if values.get(key))
    return f"{driver}, connected" + (f", {about}" if about else "")


def _camera(values: Values) -> str:
    if not values["ok"]:
        return f"{values['source']}, NO PICTURES: {values.get('reason') or 'no reason known'}"
    size = f"{values['width']}x{values['height']}" if values.get("width") else "size unknown"
    age = f", newest {values['age_s']:.2f} s old" if values.get("age_s") is not None else ""
    return f"{values['source']}, {_format(values)}{size}, {values['rate_hz']:.1f} Hz{age}"


def _format(values: Values) -> str:
    stream = values.get("stream")
    return f"{stream['format']} " if stream else ""


def recording(values: Values) -> str:
    parts = [f"map {values.get('map')}", duration(values["seconds"]), f"{values['distance_m']:.1f} m driven"]
    parts += [f"{values['coverage_m2']:.1f} m\N{SUPERSCRIPT TWO} covered"]
    return ", ".join([*parts, f"{values['frames']} frames", size(values["bytes"])])


def maps(values: Values) -> str:
    rows: list[tuple[object, ...]] = [("", "NAME", "NODES", "SIZE", "RECORDINGS")]
    for entry in values["maps"]:
        nodes = "damaged" if entry["nodes"] is None else entry["nodes"] if entry["trained"] else "untrained"
        recordings = size(entry["recording_bytes"]) if entry["recording_bytes"] else "-"
        rows.append(("*" if entry["active"] else "", entry["name"], nodes, size(entry["bytes"]), recordings))
    return table(rows, right=(2, 3, 4)) if len(rows) > 1 else "no maps yet: say record start NAME and drive round"


def map_facts(values: Values) -> str:
    """What `train` and `map info` tell, as far as it is there."""
    links = values.get("links")
    facts = {
        "map": values.get("map") or values.get("name"),
        "nodes": values.get("nodes"),
        "links": ", ".join(f"{count} {kind}" for kind, count in links.items()) if isinstance(links, Mapping) else links,
        "SOM units": values.get("units"),
        "size": size(values["bytes"]) if values.get("bytes") else None,
        "kB per 1000 nodes": values.get("kb_per_1000_nodes"),
        "quantisation error": _number(values.get("quantization_error")),
        "topographic error": _number(values.get("topographic_error")),
        "ceiling height": f"{values['ceiling_height']:.2f} m" if values.get("ceiling_height") else None,
        "time taken": duration(values["seconds"]) if values.get("seconds") is not None else None,
    }
    rows = [(name, fact) for name, fact in facts.items() if fact is not None]
    statistics = values.get("statistics") or {}
    rows += [(name.replace("_", " "), _number(value)) for name, value in statistics.items() if not _told(name, values)]
    parts = [table(rows)]
    if values.get("sessions"):
        parts.append(_sessions(values))
    if "places" in values:
        parts.append(places(values))
    return "\n".join(parts)


def _told(name: str, values: Values) -> bool:
    """Whether a statistic stands above already, among the facts or the links."""
    return name in values or name.removesuffix("_links") in (values.get("links") or {})


def _sessions(values: Values) -> str:
    """Teaching drives the map was made of, then recordings that wait to be learnt."""
    sizes = {entry["file"]: size(entry["bytes"]) for entry in values.get("recordings") or ()}
    rows = [
        (
            "session",
            entry["session"] + 1,
            entry["nodes"],
            entry["recording"] or "-",
            sizes.get(entry["recording"], "not on disk") if entry["recording"] else "",
        )
        for entry in values["sessions"]
    ]
    rows += [
        ("", "", "untrained", entry["file"], size(entry["bytes"]))
        for entry in values.get("recordings") or ()
        if not entry["trained"]
    ]
    return table([("", "NO", "NODES", "RECORDING", ""), *rows], right=(1, 2, 4))


def places(values: Values) -> str:
    rows = [
        (kind, name, f"{at['x']:.3f}", f"{at['y']:.3f}", f"{math.degrees(at['yaw']):.1f}")
        for kind, group in (("place", values["places"]), ("dock", values.get("docks") or {}))
        for name, at in sorted(group.items())
    ]
    head = ("", "NAME", "X m", "Y m", "YAW \N{DEGREE SIGN}")
    return table([head, *rows], right=(2, 3, 4)) if rows else "no places yet: say place add NAME"


def verification(values: Values) -> str:
    rows = [(part["name"], size(part["bytes"]), "ok" if part["ok"] else "DAMAGED") for part in values["sections"]]
    return "\n".join([*([table(rows, right=(1,))] if rows else []), values["message"]])


def duration(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def size(count: float) -> str:
    for unit in ("B", "kB", "MB"):
        if count < 1000:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000
    return f"{count:.1f} GB"


def _number(value: object) -> str | None:
    return f"{value:.4g}" if isinstance(value, int | float) else None
