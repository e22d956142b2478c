"""tools/reproduction/README.md: its tables and pictures are made from what a run left in a folder."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tools.reproduction.registry import ITEMS

PAGE = Path("tools/reproduction/README.md")
PICTURES = "pictures"  # beside the page

Row = Mapping[str, Any]


class PageError(Exception):
    """A folder without results, or a page without a place for one."""


def write_page(results: Path, page: Path) -> list[str]:
    """Every result in the folder in its place, its picture beside the page; the names of those. Raises PageError."""
    paths = {item.name: results / f"{item.name}.json" for item in ITEMS}
    rows = [json.loads(path.read_text("utf-8")) for path in paths.values() if path.exists()]
    if not rows:
        raise PageError(f"{results} holds no results: run tools/reproduce --all first")
    text = page.read_text("utf-8")
    pictures = page.parent / PICTURES
    pictures.mkdir(exist_ok=True)
    for row in rows:
        text = _placed(text, row["name"], section(row))
        shutil.copyfile(results / f"{row['name']}.png", pictures / f"{row['name']}.png")
    page.write_text(_placed(text, "overview", overview(rows)), "utf-8")
    return [row["name"] for row in rows]


def section(row: Row) -> str:
    """One table or figure: printed and ours side by side, acceptance, what differs, the picture."""
    lines = [f"| {row['title']} | thesis | ours |", "|---|---|---|"]
    lines += [f"| {_cells(one['what'], one['thesis'], one['ours'])} |" for one in row["compared"]]
    lines += ["", *(f"- {_verdict(check)}: {check['wanted']}: {check['found']}" for check in row["checks"])]
    lines += [f"- Differs: {why}." for why in row["differs"]]
    return "\n".join([*lines, "", f"![{row['title']}]({PICTURES}/{row['name']}.png)"])


def overview(rows: Sequence[Row]) -> str:
    """All of them, a line each."""
    lines = ["| | | acceptance |", "|---|---|---|"]
    for row in rows:
        met = sum(check["met"] for check in row["checks"])
        missed = "; ".join(f"missed: {check['wanted']}" for check in row["checks"] if not check["met"])
        judged = f"{met} of {len(row['checks'])} met" if row["checks"] else "nothing asked for"
        judged += f"; {missed}" if missed else ""
        lines.append(f"| {_cells(row['name'], row['title'], judged)} |")
    return "\n".join(lines)


def _verdict(check: Row) -> str:
    return "Met" if check["met"] else "**Missed**"


def _cells(*texts: str) -> str:
    return " | ".join(text.replace("|", "/") for text in texts)


def _placed(text: str, name: str, made: str) -> str:
    """The text with `made` between the comments that begin and end this name's place."""
    place = re.compile(rf"(<!-- {re.escape(name)} -->\n).*?(<!-- end {re.escape(name)} -->)", re.DOTALL)
    if not place.search(text):
        raise PageError(f"the page has no place for {name}: put <!-- {name} --> and <!-- end {name} --> in it")
    return place.sub(lambda found: f"{found[1]}{made}\n{found[2]}", text)
