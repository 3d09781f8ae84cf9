"""docs/live.md: its pictures are there, and are drawn from a demonstration in virtual time; its commands have the options."""

from __future__ import annotations

import re
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import click
import pytest

from canopen_cli import app
from canopen_proto.observer.observer import RULES
from fuzz.recall import MADE, PLACES, Recall, of_made
from tests.docs_build import DOCS, load_build
from tests.examples import takes_all

PAGE = (DOCS / "live.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def build() -> ModuleType:
    return load_build()


def words_of(path: Path) -> str:
    """The text of an SVG, one line for each line of the terminal."""
    root = ElementTree.parse(path).getroot()
    return "\n".join("".join(each.itertext()) for each in root.iter() if each.tag.endswith("text")).replace("\u00a0", " ")


@pytest.mark.thorough
def test_the_pictures_are_drawn(build: ModuleType, tmp_path: Path) -> None:
    build.draw_live(tmp_path)
    for name, texts in {
        "watch": ("operation enabled", "6064:00", "position_actual_value, the last 10 s", "⠤"),
        "top": ("SYNC each 10.00 ms", "0x2310", "continuous over-current", "127 (0x7F)"),
    }.items():
        assert f"](live/{name}.svg)" in PAGE
        for path in (tmp_path / f"{name}.svg", DOCS / "live" / f"{name}.svg"):
            words = words_of(path)
            assert all(text in words for text in texts), (path, words)
            assert "font-face" not in path.read_text(encoding="utf-8"), "a picture loads nothing from elsewhere"


@pytest.mark.parametrize(
    ("name", "text"),
    [("scan", "Simulated Schunk"), ("info", "NMT state"), ("state", "it does not move"), ("check", "the drive is in fault")],
)
def test_the_screens_are_what_the_commands_print(
    build: ModuleType, name: str, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CANOPEN_BUS", raising=False)
    path = DOCS / "screens" / f"{name}.svg"
    assert text in words_of(path)
    assert build.SCREENS[name] in words_of(path)
    if name != "check":  # which needs a recording of a whole demonstration
        printed = re.sub(r"\x1b\[[\d;]*m", "", build.printed_by(build.SCREENS[name]))
        shown = "".join(words_of(path).split())  # a line is several texts there, one for each style
        assert [line for line in printed.splitlines() if "".join(line.split()) not in shown] == []


@pytest.mark.parametrize(
    ("name", "text"), [("nodes", "Powerball"), ("objects", "20000"), ("drives", "try: remove the cause"), ("traffic", "0x3220")]
)
def test_the_views_of_the_tui_are_there(build: ModuleType, name: str, text: str) -> None:
    assert set(build.TUI_VIEWS) == {path.stem for path in (DOCS / "tui").glob("*.svg")}
    path = DOCS / "tui" / f"{name}.svg"
    assert text in words_of(path)
    assert "font-face" not in path.read_text(encoding="utf-8"), "a picture loads nothing from elsewhere"


def test_each_option_on_the_page_exists() -> None:
    for name in ("watch", "top", "tui"):
        section = PAGE.partition(f"\n## {name}\n")[2].partition("\n## ")[0]
        command = app.cli.get_command(click.Context(app.cli), name)
        assert command is not None
        shown = {option for each in command.params for option in (*each.opts, *each.secondary_opts)}
        assert set(re.findall(r"(?<![\w-])--[a-z0-9]+", section)) - shown == set(), name


RECALL: tuple[int, ...] = MADE if takes_all() else MADE[::4]
"""Every day some of the recordings, and one place in each."""


@pytest.fixture(scope="module")
def recall() -> Recall:
    return of_made(PLACES if takes_all() else 1, RECALL)


def test_at_least_95_percent_of_the_planted_faults_are_found_and_nothing_else(recall: Recall) -> None:
    short = {rule for rule, planted in recall.planted.items() if recall.found[rule] < 0.95 * planted}
    assert (short, recall.false) == (set(), [])
    assert min(recall.planted[rule] for rule in RULES) > 0, "each rule is planted"


def test_the_table_of_planted_faults_is_what_the_program_prints(recall: Recall) -> None:
    lines = list(recall.lines())
    first = PAGE.index(lines[0])
    printed = PAGE[first:].splitlines()[: len(lines)]
    if takes_all():
        assert printed == lines
    assert [line.split("|")[1] for line in printed[2:-2]] == [f" `{rule}` " for rule in RULES]
    assert printed[-1].endswith(" frames: 0 false words.")
