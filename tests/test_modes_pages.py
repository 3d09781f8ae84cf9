"""The pages of docs/modes: their examples run, in virtual time; their tables are those of the code; their pictures are there."""

from __future__ import annotations

import re
from pathlib import Path
from types import ModuleType

import pytest

from canopen_proto.dictionary.standard import find_standard
from canopen_proto.drives.cia402.homing_methods import HOMING_METHODS, homing_name
from canopen_proto.drives.cia402.modes import Mode, mode_name
from canopen_proto.drives.cia402.states import State
from tests.docs_build import DOCS, load_build

PAGES = sorted(path.stem for path in (DOCS / "modes").glob("*.md"))
SHORT = {re.search(r"\((\w+)\)", mode_name(mode))[1] for mode in Mode if mode}  # type: ignore[index]


@pytest.fixture(scope="module")
def build() -> ModuleType:
    return load_build()


def test_each_mode_has_a_page_and_a_picture(build: ModuleType) -> None:
    assert set(PAGES) == SHORT == set(build.PICTURES)
    for page in PAGES:
        text = (DOCS / "modes" / f"{page}.md").read_text(encoding="utf-8")
        assert f"]({page}.png)" in text
        assert (DOCS / "modes" / f"{page}.png").stat().st_size > 10_000
        for heading in ("## What is sent", "## Objects", "## Limits, stops, errors", "## How makers differ"):
            assert heading in text, page


@pytest.mark.thorough(3)
@pytest.mark.parametrize("page", PAGES)
def test_the_example_moves_the_drive_and_leaves_it_without_power(build: ModuleType, page: str, tmp_path: Path) -> None:
    run = build.run_example(page, sample=0.02)
    drive = run.drive.drive
    assert drive.state is State.SWITCH_ON_DISABLED
    positions = {each.values[0x606400] for each in run.samples}
    assert max(positions) - min(positions) > 5_000, "it is a picture of a motion"
    shown = {each.values[0x606100] for each in run.samples}
    assert any(f"({page})" in mode_name(mode) for mode in shown)


@pytest.mark.thorough
def test_a_picture_is_drawn(build: ModuleType, tmp_path: Path) -> None:
    picture = build.PICTURES["pp"]
    build.draw(picture, build.run_example("pp", sample=0.02).samples, tmp_path / "pp.png")
    assert (tmp_path / "pp.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("page", PAGES)
def test_the_objects_are_the_standards(page: str) -> None:
    text = (DOCS / "modes" / f"{page}.md").read_text(encoding="utf-8").partition("## Objects")[2]
    rows = re.findall(r"^\| 0x([0-9A-F]{4})(?::([0-9A-F]{2}))? \| (\w+) \| (\w+) \|", text, re.MULTILINE)
    assert len(rows) >= 3
    for index, subindex, name, kind in rows:
        variable = find_standard(int(index, 16), int(subindex or "0", 16))
        assert variable is not None, index
        assert (name, kind) == (variable.name.partition(":")[0], variable.data_type.name), index


def test_the_homing_methods() -> None:
    text = (DOCS / "modes" / "hm.md").read_text(encoding="utf-8")
    for number in HOMING_METHODS:
        assert f"| {number} | {homing_name(number)} |" in text
