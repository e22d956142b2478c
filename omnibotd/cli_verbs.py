"""The verbs of omnibotctl: how each is said, what it asks of the daemon, and what it shows of the answer."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any, NoReturn

from omnibotd import cli_output
from omnibotd.cli_output import LiveLine
from omnibotd.control_client import Client, NoDaemon, RemoteError
from omnibotd.control_protocol import CANCELLED, JOB_FAILED
from omnibotd.core.error_name import ErrorName

NO_DAEMON = 3  # exit code
_REPEAT = 0.1  # s between set-points; the daemon forgets one after half a second or so
_WATCH = 1.0  # s between pictures of `status --watch`

Params = dict[str, Any]
Show = Callable[[Mapping[str, Any]], str]
Verb = Callable[["Terminal", argparse.Namespace], None]


class UsageError(Exception):
    """The command line makes no sense; the message is for a person."""


class Terminal:
    """Where a verb asks and shows: one connection, made when it is first needed, and one way of output."""

    def __init__(self, path: str, *, as_json: bool) -> None:
        self._path = path
        self._client: Client | None = None
        self.as_json = as_json
        self.live = LiveLine(quiet=as_json)

    @property
    def client(self) -> Client:
        if self._client is None:
            self._client = Client(self._path)
        return self._client

    def close(self) -> None:
        if self._client is not None:
            self._client.close()

    def ask(self, method: str, params: Params, waiting_for: str) -> Params:
        """The daemon's answer; what takes longer than a second shows that it does, and what it told last."""
        told = ""

        def on_feedback(values: Params) -> None:
            nonlocal told
            told = f": {cli_output.feedback(values)}"
            self.live.show(waiting_for + told)

        def on_wait(seconds: float) -> None:
            self.live.show(f"{waiting_for}{told}, {cli_output.duration(seconds)} so far")

        asked = {key: value for key, value in params.items() if value is not None}
        try:
            return self.client.call(method, asked, on_feedback, on_wait)
        finally:
            self.live.clear()

    def show(self, result: Mapping[str, Any], human: str) -> None:
        if self.as_json:
            print_json({**result, "ok": True, "error": None})
            return
        if human:
            print(human, flush=True)
        for warning in result.get("warnings") or ():
            print(f"warning: {warning}", file=sys.stderr)

    def cancel(self) -> NoReturn:
        """Ctrl-C while the robot is at work: stop it, and say whether it heard."""
        try:
            self.client.stop()
        except (NoDaemon, RemoteError) as error:
            raise RemoteError(
                CANCELLED, ErrorName.CANCELLED, f"cancelled, but THE STOP WAS NOT CONFIRMED: {error}"
            ) from None
        raise RemoteError(
            CANCELLED, ErrorName.CANCELLED, "cancelled: the robot was told to stop, and confirmed it"
        ) from None


def print_json(values: Mapping[str, Any]) -> None:
    print(json.dumps(values), flush=True)


def simple(method: str, waiting_for: str, show: Show, *names: str, job: bool = False) -> Verb:
    """A verb that is one request, whose parameters are the options of the same names."""

    def run(terminal: Terminal, options: argparse.Namespace) -> None:
        params = {name: getattr(options, name) for name in names}
        try:
            result = terminal.ask(method, params, waiting_for)
        except KeyboardInterrupt:
            if job:
                terminal.cancel()
            raise
        terminal.show(result, show(result))

    return run


def status(terminal: Terminal, options: argparse.Namespace) -> None:
    while True:
        result = terminal.ask("status", {}, "status")
        if options.watch and sys.stdout.isatty() and not terminal.as_json:
            print("\x1b[H\x1b[2J", end="")
        terminal.show(result, cli_output.status(result))
        if not options.watch:
            return
        time.sleep(_WATCH)


def drive(terminal: Terminal, options: argparse.Namespace) -> None:
    twist = {"vx": options.vx, "wz": options.wz}
    what = f"driving {options.vx:g} m/s {options.wz:g} rad/s"
    try:
        if options.duration is not None:
            terminal.show(terminal.ask("drive", {**twist, "for": options.duration}, what), "")
            return
        began = time.monotonic()
        while True:
            repeated = time.monotonic()
            terminal.client.call("drive", twist)
            terminal.live.show(f"{what}, {cli_output.duration(repeated - began)}; Ctrl-C stops")
            time.sleep(max(0.0, repeated + _REPEAT - time.monotonic()))
    except KeyboardInterrupt:
        terminal.live.clear()
        terminal.cancel()
    finally:
        terminal.live.clear()


def goto(terminal: Terminal, options: argparse.Namespace) -> None:
    if (options.place is None) == (options.at is None):
        raise UsageError("goto: name a place, or say --at X,Y,YAW")
    simple("goto", f"to {options.place or options.at}", _arrival, "place", "at", job=True)(terminal, options)


def _arrival(result: Mapping[str, Any]) -> str:
    error = result.get("error_estimate_m")
    within = f", within {error:.2f} m" if error is not None else ""
    return f"arrived after {cli_output.duration(result['seconds'])}: {cli_output.pose(result.get('pose'))}{within}"


def saved(result: Mapping[str, Any]) -> str:
    return f"{result['name']} saved at {cli_output.pose(result.get('pose'))}"


def route(terminal: Terminal, options: argparse.Namespace) -> None:
    what = "round " + ", ".join(options.places)
    simple("route", what, cli_output.route, "places", "loops", job=True)(terminal, options)


def found(result: Mapping[str, Any]) -> str:
    sure = f"confidence {result['confidence']:.2f}"
    after = cli_output.duration(result["seconds"])
    return f"found after {after} in map {result['map']}: {cli_output.pose(result.get('pose'))}, {sure}"


def deleted(result: Mapping[str, Any]) -> str:
    return f"map {result['map']} is deleted; its file stays as {result['kept']}, and its recordings are kept"


def pruned(result: Mapping[str, Any]) -> str:
    head = f"pruned from {result['nodes_before']} to {result['nodes']} nodes; the version before is {result['kept']}"
    return f"{head}\n{cli_output.map_facts(result)}"


def verify(terminal: Terminal, options: argparse.Namespace) -> None:
    result = terminal.ask("map.verify", {"map": options.map}, "verifying")
    if result["ok"]:
        terminal.show(result, cli_output.verification(result))
        return
    if not terminal.as_json:
        print(cli_output.verification(result))
    raise BadNews(JOB_FAILED, ErrorName.STORAGE, result["message"], result)


class BadNews(RemoteError):
    """An answer that is a failure in itself: damage, or an unwell robot; `result` is printed in JSON all the same."""

    def __init__(self, code: int, name: str, message: str, result: Mapping[str, Any]) -> None:
        super().__init__(code, name, message)
        self.result = result


def events(terminal: Terminal, options: argparse.Namespace) -> None:
    for event in terminal.client.events():
        print_json(event)


def recorded(result: Mapping[str, Any]) -> str:
    return f"recorded {cli_output.recording(result)}"
