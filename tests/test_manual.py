"""docs/manual.md speaks of every requirement of the manual, and of nothing that does not exist."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

from canopen_data import CHAIN_FILES, load_dictionary
from canopen_master import direct

PAGE = (Path(__file__).parent.parent / "docs" / "manual.md").read_text(encoding="utf-8")
REQUIREMENTS = {*range(1, 23), *range(30, 42), *range(50, 60), *range(70, 79)}


def test_every_requirement_has_its_row() -> None:
    rows = [int(number) for number in re.findall(r"^\| R(\d+) \|", PAGE.partition("## Each line and its test")[0], re.MULTILINE)]
    assert rows == sorted(REQUIREMENTS)


def test_every_requirement_is_built_and_has_its_test() -> None:
    rows = re.findall(r"^\| R(\d+) \| (\w+) \| `(tests/[\w/]+\.py)::(test_\w+)` \|$", PAGE, re.MULTILINE)
    assert [int(number) for number, *_ in rows] == sorted(REQUIREMENTS)
    assert {built for _, built, *_ in rows} == {"yes"}
    for _, _, file, name in rows:
        path = Path(__file__).parents[1] / file
        assert path.is_file(), file
        assert re.search(rf"^(?:async )?def {name}\(", path.read_text(encoding="utf-8"), re.MULTILINE), f"{file}: {name}"


def test_every_name_exists() -> None:
    names = set(re.findall(r"`((?:canopen_\w+|direct)(?:\.\w+)+)`", PAGE))
    assert len(names) > 50
    for name in names:
        head, *rest = name.split(".")
        found: object = direct if head == "direct" else importlib.import_module(head)
        for part in rest:
            if not hasattr(found, part):
                importlib.import_module(f"{found.__name__}.{part}")  # type: ignore[attr-defined]
            found = getattr(found, part)


def test_every_link_leads_somewhere(tmp_path: Path) -> None:
    docs = Path(__file__).parent.parent / "docs"
    for link in re.findall(r"\]\((\w+\.md)\)", PAGE):
        assert (docs / link).is_file(), link


def test_the_names_of_the_data_files_are_theirs(tmp_path: Path) -> None:
    dictionary, _ = load_dictionary(tmp_path)
    for pdo in ("schunk_default_tPDO", "schunk_debug_rPDO", "csp_rPDO"):
        assert pdo in PAGE
        assert dictionary.pdo(pdo)
    assert all(name in PAGE for name in CHAIN_FILES)
