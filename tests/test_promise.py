"""docs/promise.md: the public names are those of the pages, and README and docs use no others."""

from __future__ import annotations

import ast
import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
IMPORT = re.compile(r"^ *(?:from (canopen_[\w.]+) import (\([^)]*\)|[^#\n]+)|import (canopen_[\w.]+))", re.MULTILINE)
NOT_FOR_USERS = {
    "ContradictionError": "within canopen_master.ros_configurations",
    "DrivesNotOffError": "of the ROS 2 node: ends its process",
    "FramingError": "within the TCP bus",
    "GoalRefusedError": "of the ROS node: becomes the answer to a goal",
    "JointError": "within a chain: becomes a ChainError",
    "LogDamagedError": "of readers of log files: becomes a LogFileError",
    "MessageRefusedError": "of what python-can hands over: the message is left out, and told",
    "NoMachineError": "of the ROS node's parameters",
    "NotAFrameError": "of the reader of candump's text: the line is left out, and told",
    "NotLinearError": "within canopen_master.ros_configurations",
    "ParameterError": "of the ROS node's parameters: ends its process",
    "UnusableValueError": "within canopen_master.ros_configurations",
}
"""Exceptions that never reach the caller of a public name, and why."""


@pytest.fixture(scope="module")
def reference() -> ModuleType:
    """docs/reference.py."""
    spec = importlib.util.spec_from_file_location("docs_reference", ROOT / "docs" / "reference.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["names", "events", "exceptions", "objects"])
def test_a_page_is_what_the_sources_say(reference: ModuleType, name: str) -> None:
    written = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    assert written == reference.page(name), "the page is older than the sources: python docs/reference.py"


def test_each_public_name_is_there_and_has_a_text(reference: ModuleType) -> None:
    modules = reference.public_modules()
    assert {"canopen_proto", "canopen_proto.drives", "canopen_data", "canopen_transports", "canopen_master"} <= modules.keys()
    without = []
    for module, loaded in modules.items():
        assert len(set(loaded.__all__)) == len(loaded.__all__), module
        for name in loaded.__all__:
            assert hasattr(loaded, name), f"{module}.{name}"
            defined = reference.definition_of(module, name)
            if isinstance(defined.node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and not defined.text:
                without.append(f"{module}.{name}")
    assert without == []


def test_each_event_and_exception_that_a_user_meets_is_public(reference: ModuleType) -> None:
    assert [name for name in reference.derived("Event") if reference.home_of(name) is None] == []
    assert {name for name in reference.exceptions() if reference.home_of(name) is None} == NOT_FOR_USERS.keys()


def test_each_event_says_who_makes_it_when_and_what_its_numbers_mean(reference: ModuleType) -> None:
    bases = {base for name in reference.derived("Event") for base in bases_of(reference, name)}
    for name in reference.derived("Event"):
        text = reference.classes()[name].text
        fields = [field for field in reference.fields_of(name) if field not in reference.COMMON]
        assert [field for field in fields if not re.search(rf"\b{field}\b", text)] == [], name
        assert reference.senders()[name] or name in bases, f"nobody makes {name}"


def bases_of(reference: ModuleType, name: str) -> list[str]:
    return [ast.unparse(base) for base in reference.classes()[name].node.bases]


def imports(text: str) -> list[tuple[str, str]]:
    """What the Python blocks of a page import from our packages: module and name."""
    found = []
    for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL):  # some are a part of a program, and no program
        for module, names, whole in IMPORT.findall(block):
            found += [(module, name.split()[0]) for name in names.strip("() \n").split(",") if name.strip()]
            found += [(whole, "")] if whole else []
    return found


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_a_document_imports_public_names_only(reference: ModuleType, path: Path) -> None:
    modules = reference.public_modules()
    for module, name in imports(path.read_text(encoding="utf-8")):
        assert module in modules, f"{module} is no public module"
        assert not name or name in modules[module].__all__ or f"{module}.{name}" in modules, f"{module}.{name} is not public"


def test_a_private_import_would_be_seen() -> None:
    assert imports("```python\nfrom canopen_proto.sdo.client import TIMEOUT\nimport canopen_data\n```") == [
        ("canopen_proto.sdo.client", "TIMEOUT"),
        ("canopen_data", ""),
    ]


def place_of(path: str) -> Path:
    """Where a file of the table is: those of a package may be installed elsewhere than these tests are."""
    parts = Path(path).parts
    package = next((number for number, part in enumerate(parts) if part.startswith("canopen_")), None)
    if package is None:
        return ROOT / path
    spec = importlib.util.find_spec(parts[package])
    assert spec is not None, path
    assert spec.origin is not None, path
    return Path(spec.origin).parent.joinpath(*parts[package + 1 :])


def test_each_row_of_what_is_supported_names_what_shows_it() -> None:
    text = (ROOT / "docs" / "supported.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if re.match(r"\|(?!-)", line)]
    assert len(rows) > 70
    for row in rows:
        shown = re.findall(r"[\w/]+\.py", row[-1])
        assert [path for path in shown if not place_of(path).is_file()] == [], row
        is_claimed = re.match(r"(yes|both|master|values)\b", row[-2]) is not None
        assert shown or "](" in row[-1] or not is_claimed, f"nothing shows this: {row}"
