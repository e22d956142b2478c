"""tools/reproduce: every table and figure of the issue is there, and what it prints, writes and puts on the page."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from tools.reproduction import __main__ as launcher
from tools.reproduction import page, running
from tools.reproduction.item import Check, Compared, Item, NotPossible, Outcome
from tools.reproduction.registry import GROUPS, ITEMS

WANTED = {
    *(f"table-{name}" for name in ("4.1", "4.2", "4.3", "4.4", "6.1", "7.1", "7.2")),
    *(f"figure-{name}" for name in ("4.5", "4.7", "5.4", "5.5", "5.6", "5.7", "6.6", "6.7", "6.12", "6.13", "6.14")),
    *(f"figure-{name}" for name in ("7.6", "7.7", "7.8", "7.9")),
}


def _drawn(data: Mapping[str, Any], figure: Figure) -> None:
    figure.subplots().plot(data["values"])


def made(name: str, met: bool = True) -> Item:
    def run(quick: bool) -> Outcome:
        values = [1, 2] if quick else [1, 2, 3]
        return Outcome(
            (Compared("a thing", "1.5 m", "1.4 m"),), (Check("at most 2 m", "1.4 m", met),), {"values": values}
        )

    return Item(name, "made up", ("it is made up",), run, _drawn)


@pytest.fixture
def two(monkeypatch: pytest.MonkeyPatch) -> None:
    items = (made("table-1.1"), made("figure-1.2", met=False))
    for module, name, value in (
        (launcher, "ITEMS", items),
        (launcher, "GROUPS", (items,)),
        (page, "ITEMS", items),
        (running, "ITEMS", items),
    ):
        monkeypatch.setattr(module, name, value)


def test_every_table_and_figure_that_was_asked_for_is_there() -> None:
    names = [item.name for item in ITEMS]
    assert set(names) >= WANTED
    assert len(set(names)) == len(names) == sum(map(len, GROUPS))


def test_every_item_says_what_differs() -> None:
    assert all(item.differs and item.title for item in ITEMS)


@pytest.mark.usefixtures("two")
def test_it_prints_both_figures_and_writes_numbers_and_a_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert launcher.main(["table-1.1", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "1.5 m" in said
    assert "1.4 m" in said
    assert "differs: it is made up" in said
    assert "met: at most 2 m" in said
    result = json.loads((tmp_path / "table-1.1.json").read_text())
    assert result["data"]["values"] == [1, 2, 3]
    assert (tmp_path / "table-1.1.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.usefixtures("two")
def test_a_missed_acceptance_is_told_by_the_exit_status(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert launcher.main(["--all", "--out", str(tmp_path)]) == 1
    assert "acceptance missed: figure-1.2" in capsys.readouterr().out


@pytest.mark.usefixtures("two")
def test_quick_is_not_judged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert launcher.main(["--all", "--quick", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "MISSED" not in said
    assert json.loads((tmp_path / "table-1.1.json").read_text())["data"]["values"] == [1, 2]


def test_what_can_not_be_run_here_is_told_and_counts_as_missed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(quick: bool) -> Outcome:
        raise NotPossible("its data are absent")

    items = (Item("table-1.1", "made up", ("it is made up",), run, _drawn),)
    for module in (launcher, running):
        monkeypatch.setattr(module, "ITEMS", items)
    monkeypatch.setattr(launcher, "GROUPS", (items,))
    assert launcher.main(["--all", "--out", str(tmp_path)]) == 1
    assert "not possible: its data are absent" in capsys.readouterr().out
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("arguments", [["table-9.9"], []])
def test_what_is_not_there_is_refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        launcher.main(arguments)
    assert "--list" in capsys.readouterr().err


def test_list_names_them_all(capsys: pytest.CaptureFixture[str]) -> None:
    assert launcher.main(["--list"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == len(ITEMS)


@pytest.mark.usefixtures("two")
def test_the_page_gets_results_where_it_has_their_places(tmp_path: Path) -> None:
    launcher.main(["--all", "--out", str(tmp_path)])
    there = tmp_path / "README.md"
    places = "".join(f"<!-- {name} -->\nold\n<!-- end {name} -->\n" for name in ("overview", "table-1.1", "figure-1.2"))
    there.write_text("By hand.\n" + places, "utf-8")
    assert page.write_page(tmp_path, there) == ["table-1.1", "figure-1.2"]
    text = there.read_text("utf-8")
    assert text.startswith("By hand.\n")
    assert "old" not in text
    assert "| a thing | 1.5 m | 1.4 m |" in text
    assert "**Missed**: at most 2 m" in text
    assert (tmp_path / "pictures" / "table-1.1.png").exists()


@pytest.mark.usefixtures("two")
def test_a_page_without_a_place_says_which(tmp_path: Path) -> None:
    launcher.main(["--all", "--out", str(tmp_path)])
    (tmp_path / "README.md").write_text("nothing\n", "utf-8")
    with pytest.raises(page.PageError, match=r"no place for table-1\.1"):
        page.write_page(tmp_path, tmp_path / "README.md")


def test_the_page_has_a_place_for_every_item() -> None:
    text = (Path(__file__).parents[2] / page.PAGE).read_text("utf-8")
    missing = [item.name for item in ITEMS if f"<!-- {item.name} -->\n" not in text]
    assert missing == []


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("group", GROUPS, ids=lambda group: group[0].name)
def test_all_run_quickly(group: tuple[Item, ...], tmp_path: Path) -> None:
    for item in group:
        outcome = item.run(True)
        json.dumps(outcome.data)
        assert outcome.compared
        figure = Figure()
        item.draw(outcome.data, figure)
        figure.savefig(tmp_path / "picture.png")
        assert np.all([check.wanted for check in outcome.checks])


@pytest.mark.timeout(300)  # three processes start: on a busy machine that takes a while
def test_groups_run_beside_each_other_as_users_start_them(tmp_path: Path) -> None:
    """Started as a program, workers must find what they are told to run."""
    command = [sys.executable, "-m", "tools.reproduction", "figure-5.4", "mirrors", "--quick", "--out", str(tmp_path)]
    made = subprocess.run(command, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    assert {path.name for path in tmp_path.glob("*.json")} == {"figure-5.4.json", "mirrors.json"}
