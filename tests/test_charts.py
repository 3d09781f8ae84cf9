"""docs/charts: the pictures are what the machines' tables say, and show every state and every transition."""

from __future__ import annotations

import importlib.util
from types import ModuleType
from xml.etree import ElementTree

import pytest

from canopen_proto.drives.cia402.states import TRANSITIONS, State
from canopen_proto.lss.messages import LssState
from canopen_proto.nmt import NmtState
from tests.docs_build import DOCS


@pytest.fixture(scope="module")
def charts() -> ModuleType:
    """docs/charts.py."""
    spec = importlib.util.spec_from_file_location("docs_charts", DOCS / "charts.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["nmt", "cia402", "lss", "sdo"])
def test_a_picture_is_what_the_tables_say(charts: ModuleType, name: str) -> None:
    path = DOCS / "charts" / f"{name}.svg"
    assert path.read_text(encoding="utf-8") == charts.svg(charts.CHARTS[name]()), "older than the sources: python docs/charts.py"
    assert f"](charts/{name}.svg)" in (DOCS / "states.md").read_text(encoding="utf-8")


def words_of(name: str) -> set[str]:
    root = ElementTree.parse(DOCS / "charts" / f"{name}.svg").getroot()
    return {"".join(each.itertext()) for each in root.iter() if each.tag.endswith("text")}


def test_each_state_and_each_transition_is_shown(charts: ModuleType) -> None:
    assert {charts.name(state) for state in NmtState} <= words_of("nmt")
    shown = words_of("cia402")
    assert {str(state) for state in State if state is not State.UNKNOWN} <= shown
    numbers = {int(words.split()[0]) for words in shown if words[0].isdigit()}
    assert numbers == {number for _, number in TRANSITIONS.values()} == set(range(17))
    assert {state.name.lower() for state in LssState} <= words_of("lss")


def test_a_new_row_of_a_table_is_a_new_arrow(charts: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    more = {**TRANSITIONS, (State.FAULT, charts.Command.SHUTDOWN): (State.READY_TO_SWITCH_ON, 99)}
    monkeypatch.setattr(charts, "TRANSITIONS", more)
    assert "99 shutdown" in charts.svg(charts.drive_chart())
