"""omnibotctl: asks and commands the daemon over its control socket. Standard library only: it must start in a blink."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import sys
from collections.abc import Sequence

from omnibotd import cli_output
from omnibotd.cli_parser import parser
from omnibotd.cli_verbs import NO_DAEMON, BadNews, Terminal, UsageError, print_json
from omnibotd.control_client import NoDaemon, RemoteError
from omnibotd.control_protocol import CANCELLED, INVALID_PARAMS, JOB_FAILED, REFUSED

DEFAULT_SOCKET = "/run/omnibotd/control.sock"
DONE, USAGE = 0, 2  # exit codes, beside NO_DAEMON and the daemon's own: JOB_FAILED, REFUSED, CANCELLED

_NEGATIVE = re.compile(r"-\.?\d")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; the exit code tells how it went."""
    words = _with_negative_numbers(sys.argv[1:] if arguments is None else arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # `timeout 60 omnibotctl goto …` must stop the robot, too
    try:
        return _run(words)
    except BrokenPipeError:  # `omnibotctl events | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE


def _run(words: Sequence[str]) -> int:
    as_json = "--json" in words
    try:
        options = parser(os.environ.get("OMNIBOT_SOCKET", DEFAULT_SOCKET)).parse_args(words)
        with contextlib.closing(Terminal(options.socket, as_json=as_json)) as terminal:
            options.run(terminal, options)
    except UsageError as error:
        return _failed(as_json, USAGE, "USAGE", str(error))
    except NoDaemon as error:
        return _failed(as_json, NO_DAEMON, "NO_DAEMON", str(error))
    except RemoteError as error:
        return _failed(as_json, _exit_code(error.code), error.name, str(error), error)
    except KeyboardInterrupt:
        return CANCELLED
    return DONE


def _failed(as_json: bool, code: int, name: str, message: str, remote: RemoteError | None = None) -> int:
    """Say what went wrong and, of a failed job, the facts behind it."""
    report = remote.report if remote else {}
    if as_json:
        error = {"code": code, "name": name, "message": message, **({"report": report} if report else {})}
        print_json({**(remote.result if isinstance(remote, BadNews) else {}), "ok": False, "error": error})
        return code
    print(f"omnibotctl: {name}: {message}", file=sys.stderr)
    if report:
        print(cli_output.report(report), file=sys.stderr)
    return code


def _exit_code(code: int) -> int:
    if code in {JOB_FAILED, NO_DAEMON, REFUSED, CANCELLED}:
        return code
    return USAGE if code == INVALID_PARAMS else JOB_FAILED


def _with_negative_numbers(words: Sequence[str]) -> list[str]:
    """Words such as -0.1, -1e-3 or -1,2,0 with a space before: argparse takes what holds a space for no option."""
    return [f" {word}" if _NEGATIVE.match(word) else word for word in words]


if __name__ == "__main__":
    sys.exit(main())
