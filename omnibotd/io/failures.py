"""What a failed job leaves behind to be looked into: its report as JSON and the last picture. Blocking."""

from __future__ import annotations

import contextlib
import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from omnibotd.control_protocol import nulled

KEPT = 20  # failures; a picture and a page each, two megabytes in all
_NAME = re.compile(r"(?P<number>[0-9]{4,9})\.(?:json|jpg)")


class FailureStore:
    """Numbered files NNNN.json and NNNN.jpg in one directory. The oldest go; files of other names are nobody's."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory

    def save(self, facts: Mapping[str, Any], jpeg: bytes | None) -> Path:
        """Write one failure and return the path of its report, with which it is complete. OSError where it can't be."""
        self._directory.mkdir(parents=True, exist_ok=True)
        number = max(self._numbers(), default=0) + 1
        path = self._directory / f"{number:04}.json"
        facts = dict(facts)
        if jpeg is not None:
            path.with_suffix(".jpg").write_bytes(jpeg)
            facts["picture"] = path.with_suffix(".jpg").name
        new = self._directory / f".{path.name}.new"
        new.write_text(json.dumps(nulled(facts), indent=2) + "\n", "utf-8")
        os.replace(new, path)
        self._forget_oldest()
        return path

    def last(self) -> dict[str, Any] | None:
        """The newest report with its `file`; None where there is none that can be read."""
        for number in sorted(self._numbers(), reverse=True):
            path = self._directory / f"{number:04}.json"
            with contextlib.suppress(OSError, ValueError):
                facts = json.loads(path.read_text("utf-8"))
                if isinstance(facts, dict):
                    return {**facts, "file": str(path)}
        return None

    def _numbers(self) -> set[int]:
        try:
            names = [_NAME.fullmatch(path.name) for path in self._directory.iterdir()]
        except OSError:
            return set()
        return {int(name["number"]) for name in names if name}

    def _forget_oldest(self) -> None:
        for number in sorted(self._numbers(), reverse=True)[KEPT:]:
            for suffix in ("json", "jpg"):
                (self._directory / f"{number:04}.{suffix}").unlink(missing_ok=True)
