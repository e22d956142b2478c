"""The verb `doctor`: asks the daemon and looks at the PC; where no daemon answers, looks at what it can by itself."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omnibotd import findings
from omnibotd.cli_verbs import NO_DAEMON, BadNews, Terminal
from omnibotd.control_client import NoDaemon
from omnibotd.control_protocol import JOB_FAILED
from omnibotd.findings import Finding, Grade

CONFIG = "/etc/omnibotd/omnibotd.yaml"
_MARKS = {Grade.OK: "ok", Grade.WARNING: "WARNING", Grade.WRONG: "WRONG", Grade.UNKNOWN: "?"}
_WIDTH = 100  # columns of a remedy


def doctor(terminal: Terminal, options: argparse.Namespace) -> None:
    """Raises BadNews where anything is wrong, so that the exit status tells; warnings alone are no failure."""
    found, absent = _examined(terminal, Path(options.config))
    result = {"daemon": absent is None, "findings": [finding.values() for finding in found]}
    bad = [finding.name for finding in found if finding.grade is Grade.WRONG]
    if absent is None and not bad:
        terminal.show(result, report(found))
        return
    if not terminal.as_json:
        print(report(found), flush=True)
    if absent is not None:
        raise BadNews(NO_DAEMON, "NO_DAEMON", str(absent), result)
    raise BadNews(JOB_FAILED, "UNWELL", f"wrong: {', '.join(dict.fromkeys(bad))}", result)


def _examined(terminal: Terminal, config: Path) -> tuple[list[Finding], NoDaemon | None]:
    """All findings, and why the daemon could not be asked, if so."""
    from omnibotd import local_checks  # noqa: PLC0415 - it loads YAML, and the other verbs start in a blink without

    try:
        told = terminal.ask("doctor", {}, "examining")
    except NoDaemon as absent:
        terminal.live.show("no daemon: examining what can be without")
        try:
            return local_checks.without_daemon(config, str(absent)), absent
        finally:
            terminal.live.clear()
    share: Any = told.get("processor_share")
    return [*findings.from_values(told["findings"]), *local_checks.machine(daemon_share=share)], None


def report(found: Sequence[Finding]) -> str:
    """A line each, and below what is not well what to do about it."""
    marks = max(map(len, _MARKS.values()))
    names = max(len(finding.name) for finding in found)
    lines = []
    for finding in found:
        lines.append(f"{_MARKS[finding.grade]:{marks}}  {finding.name:{names}}  {finding.found}")
        indent = " " * (marks + names + 4)
        if finding.remedy:
            lines += textwrap.wrap(
                finding.remedy, _WIDTH, initial_indent=f"{indent}-> ", subsequent_indent=f"{indent}   "
            )
    return "\n".join(lines)
