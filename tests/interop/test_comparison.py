"""docs/comparison.md: each expression about another Python stack is true for the version that the page names."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from functools import cache
from importlib.metadata import distribution, version
from pathlib import Path
from types import ModuleType

import canopen
import durand
import pytest

from tests.docs_build import DOCS

PAGE = (DOCS / "comparison.md").read_text(encoding="utf-8")
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in PAGE.partition("## How the Python cells were found")[2].splitlines()
    if line.startswith("| ") and not line.startswith("| row")
]


@cache
def text(package: ModuleType) -> str:
    """The sources of all modules of a package."""
    names = [package.__name__, *(each.name for each in pkgutil.walk_packages(package.__path__, f"{package.__name__}."))]
    paths = [importlib.import_module(name).__file__ for name in names]
    return "\n".join(Path(path).read_text(encoding="utf-8") for path in paths if path)


def scripts(name: str) -> list[str]:
    """The commands that a distribution installs."""
    return [each.name for each in distribution(name).entry_points if each.group == "console_scripts"]


@pytest.mark.parametrize("row", ROWS, ids=[row[0] for row in ROWS])
def test_each_expression_is_true(row: list[str]) -> None:
    for module in (
        "canopen.lss",
        "durand.services.sdo",
        "durand.services.pdo",
        "durand.services.lss",
        "durand.services.heartbeat",
    ):
        importlib.import_module(module)
    scope = {"canopen": canopen, "durand": durand, "source": inspect.getsource, "text": text, "scripts": scripts}
    for cell in row[1:]:
        assert eval(cell.strip("`"), scope), cell


def test_each_row_of_the_comparison_has_its_expressions_and_each_stack_its_version() -> None:
    compared = re.findall(r"^\| ([^|]+) \| [^|]+ \| (yes|no)[^|]* \|", PAGE.partition("## How")[0], re.MULTILINE)
    assert {row[0] for row in ROWS} >= {name for name, _ in compared}
    for name in ("canopen", "durand"):
        assert f"`{name}` {version(name)}" in PAGE
