"""The command line of omnibotctl."""

from __future__ import annotations

import argparse
from typing import Any, NoReturn

from omnibotd import __version__, cli_calibrate, cli_docking, cli_doctor, cli_files, cli_output
from omnibotd import cli_verbs as verbs


def _number(text: str) -> float:
    value = float(text)
    if not -1e6 < value < 1e6:
        raise ValueError
    return value


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise ValueError
    return value


_count.__name__ = "whole number above 0"
_number.__name__ = "number"  # how argparse calls it when refusing


def _pose(text: str) -> list[float]:
    values = [_number(part) for part in text.split(",")]
    if len(values) != 3:
        raise ValueError
    return values


_pose.__name__ = "pose X,Y,YAW in metres and radians"


class _Parser(argparse.ArgumentParser):
    """Raises UsageError instead of ending the program, so that --json holds for wrong usage too."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message: str) -> NoReturn:
        raise verbs.UsageError(f"{self.prog}: {message} (--help tells more)")


def parser(default_socket: str) -> argparse.ArgumentParser:
    """Of the whole command line; the options hold what the verb needs, `run(terminal, options)`, and `socket`."""
    top = _Parser(prog="omnibotctl", description="Ask and command omnibotd.", parents=[_general()])
    top.set_defaults(socket=default_socket)
    top.add_argument("--version", action="version", version=__version__)
    group = top.add_subparsers(metavar="VERB", required=True)
    _add_watching(group)
    _add_moving(group)
    _add_teaching(group)
    _add_maps(_family(group, "map", "list, choose, show, check, prune, save and delete maps"))
    _add_calibrations(_family(group, "calibrate", "measure the lens, the camera's axis, the wheels"))
    _add_places(_family(group, "place", "named places of the map"))
    return top


def _general() -> argparse.ArgumentParser:
    """Options that may stand before and behind the verb."""
    general = _Parser(add_help=False)
    general.add_argument("--socket", metavar="PATH", default=argparse.SUPPRESS, help="where omnibotd listens")
    general.add_argument("--json", action="store_true", default=argparse.SUPPRESS, help="print one JSON object")
    return general


def _family(group: Any, name: str, help_text: str) -> Any:
    made = group.add_parser(name, help=help_text, description=help_text, parents=[_general()])
    return made.add_subparsers(metavar="WHAT", required=True)


def _verb(group: Any, name: str, help_text: str, run: verbs.Verb, *arguments: str) -> argparse.ArgumentParser:
    """Adds a verb with its positional arguments; `name?` may be left out."""
    made: argparse.ArgumentParser = group.add_parser(name, help=help_text, description=help_text, parents=[_general()])
    made.set_defaults(run=run)
    for argument in arguments:
        made.add_argument(argument.strip("?"), nargs="?" if argument.endswith("?") else None)
    return made


def _add_at(verb: argparse.ArgumentParser) -> None:
    verb.add_argument("--at", type=_pose, metavar="X,Y,YAW", help="m, m, rad in the map")


def _add_watching(group: Any) -> None:
    status = _verb(group, "status", "what the robot is, where, and how it does", verbs.status)
    status.add_argument("--watch", action="store_true", help="again every second, until Ctrl-C")
    text = (
        "what is wrong with camera, base, calibration, disk, clock, processor, and how to mend it; without daemon, too"
    )
    doctor = _verb(group, "doctor", text, cli_doctor.doctor)
    doctor.add_argument(
        "--config", metavar="FILE", default=cli_doctor.CONFIG, help="omnibotd's, read where it does not answer"
    )
    _verb(group, "events", "what happens, one JSON object a line", verbs.events)


def _add_moving(group: Any) -> None:
    drive = _verb(group, "drive", "drive by hand, through the safety gate; Ctrl-C stops", verbs.drive)
    drive.add_argument("vx", type=_number, metavar="V", help="m/s forward")
    drive.add_argument("wz", type=_number, metavar="W", help="rad/s counter-clockwise")
    drive.add_argument("--for", dest="duration", type=_number, metavar="S", help="seconds; else until Ctrl-C")
    _add_at(_verb(group, "goto", "go to a place; Ctrl-C stops", verbs.goto, "place?"))
    route = _verb(group, "route", "go to several places one after the other; Ctrl-C stops", verbs.route)
    route.add_argument("places", nargs="+", metavar="PLACE")
    route.add_argument("--loops", type=_count, metavar="N", help="times round; once unless told")
    relocalise = verbs.simple("relocalise", "looking for the place", verbs.found, job=True)
    text = "find yourself from nothing: forget the pose, choose among the maps, look round, search; Ctrl-C stops"
    _verb(group, "relocalise", text, relocalise)
    _add_docking(group)
    _verb(group, "stop", "cancel any job and halt", verbs.simple("stop", "stopping", lambda _: ""))


def _add_docking(group: Any) -> None:
    text = "dock [NAME], or dock save NAME where the robot stands docked (again, in another light); Ctrl-C stops"
    dock = _verb(group, "dock", text, cli_docking.dock)
    dock.add_argument("words", nargs="*", metavar="[save] NAME")
    dock.add_argument("--trials", type=_count, metavar="N", help="leave and dock again N times; tell mean and spread")
    dock.add_argument("--fresh", action="store_const", const=True, help="with save: forget how the dock looked before")
    undock = verbs.simple("undock", "leaving the dock", cli_docking.undocked, job=True)
    _verb(group, "undock", "back out of the dock, half a metre; Ctrl-C stops", undock)


def _add_calibrations(calibrate: Any) -> None:
    text = "the lens, from a chessboard held before the camera, or from pictures of one; Ctrl-C ends it"
    camera = _verb(calibrate, "camera", text, cli_calibrate.camera)
    camera.add_argument("--images", metavar="FOLDER", help="pictures of the board; needs no daemon")
    camera.add_argument("--board", metavar="9x6", help="inner corners; seen in the pictures unless told")
    camera.add_argument("--square", type=_number, metavar="M", help="side of a square, 0.025 unless told")
    camera.add_argument("-o", dest="output", metavar="FILE", help="with --images: where to write, default camera.yaml")
    text = "tilt and optical centre of the camera, by a turn on the spot under a still ceiling; Ctrl-C stops"
    _verb(calibrate, "spin", text, cli_calibrate.spin)
    text = (
        "the wheels, by turns and drives of 1.2 m ahead; with --distance no drive, but what the tape says of the last"
    )
    base = _verb(calibrate, "base", text, cli_calibrate.base)
    base.add_argument(
        "--distance",
        type=_number,
        metavar="M",
        help="by tape, from where the last calibrate base began to where it ended",
    )


def _add_teaching(group: Any) -> None:
    record = _family(group, "record", "teach: drive round once while recording")
    start = verbs.simple("record.start", "starting", lambda result: f"recording to {result['path']}", "map")
    _verb(record, "start", "begin to record", start, "map")
    _verb(record, "stop", "end the recording", verbs.simple("record.stop", "ending", verbs.recorded))
    train = verbs.simple("train", "training", cli_output.map_facts, "map", "fresh", job=True)
    made = _verb(group, "train", "learn the newest recording of a map; a further drive adds to the map", train, "map")
    made.add_argument("--fresh", action="store_const", const=True, help="begin the map anew instead of adding to it")


def _add_maps(maps: Any) -> None:
    _verb(maps, "list", "all maps", verbs.simple("map.list", "reading", cli_output.maps))
    use = verbs.simple("map.use", "loading", lambda result: f"using {result['map']}, {result['nodes']} nodes", "map")
    _verb(maps, "use", "load a map", use, "map")
    _verb(maps, "info", "facts of a map", verbs.simple("map.info", "reading", cli_output.map_facts, "map"), "map?")
    _verb(maps, "verify", "check a map's file", verbs.verify, "map?")
    plot = _verb(
        maps, "plot", "draw a map with places, the way driven last and the route ahead", cli_files.plot, "map?"
    )
    plot.add_argument("-o", dest="output", metavar="FILE", help="FILE.png or FILE.svg, default MAP.png")
    prune = verbs.simple("map.prune", "pruning", verbs.pruned, "map", "nodes")
    text = "make a map smaller, keeping what covers the floor best; the version before stays on disk"
    _verb(maps, "prune", text, prune, "map?").add_argument(
        "--nodes", type=_count, required=True, metavar="N", help="nodes to keep at most"
    )
    _add_map_files(maps)


def _add_map_files(maps: Any) -> None:
    export = _verb(maps, "export", "write a map to a file, for safety or another robot", cli_files.export, "map")
    export.add_argument("-o", dest="output", metavar="FILE", help="default MAP.omap")
    imported = _verb(maps, "import", "take in a map that was exported", cli_files.import_map, "file")
    imported.add_argument("--name", metavar="NAME", help="what to call it; the file's name unless told")
    delete = verbs.simple("map.delete", "deleting", verbs.deleted, "map")
    _verb(maps, "delete", "take a map out of use; recordings and a safety copy stay on disk", delete, "map")


def _add_places(places: Any) -> None:
    add = verbs.simple("place.add", "saving", verbs.saved, "name", "at")
    _add_at(_verb(places, "add", "name a place: where the robot is, unless --at tells", add, "name"))
    _verb(places, "list", "all places and docks", verbs.simple("place.list", "reading", cli_output.places))
    rename = _verb(
        places,
        "rename",
        "call a place otherwise",
        verbs.simple("place.rename", "renaming", verbs.saved, "name", "to"),
    )
    rename.add_argument("name", metavar="OLD")
    rename.add_argument("to", metavar="NEW")
    _verb(places, "delete", "forget a place", verbs.simple("place.delete", "deleting", lambda _: "", "name"), "name")
