"""The house of docs/architecture.md: which package may import which, and no circle anywhere.

Every import counts: inside a function, and under TYPE_CHECKING. The rooms of a folder are its folders and its files.
"""

from __future__ import annotations

import ast
import builtins
import importlib
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TypeAlias

import pytest

import canopen_proto

Graph: TypeAlias = "dict[str, set[str]]"

ARROWS = {
    "canopen_proto": set(),
    "canopen_data": {"canopen_proto"},
    "canopen_transports": {"canopen_proto"},
    "canopen_check": {"canopen_proto", "canopen_data"},
    "canopen_master": {"canopen_proto", "canopen_data", "canopen_transports"},
    "canopen_testing": {"canopen_proto", "canopen_data", "canopen_transports", "canopen_master", "canopen_check"},
    "canopen_ros": {"canopen_proto", "canopen_data", "canopen_transports", "canopen_master"},
    "canopen_gateway": {"canopen_proto", "canopen_transports", "canopen_master"},
    "canopen_cli": {
        "canopen_proto",
        "canopen_data",
        "canopen_transports",
        "canopen_master",
        "canopen_check",
        "canopen_ros",
        "canopen_gateway",
    },
}
"""What each package may import. Nobody imports the command line."""


def modules() -> dict[str, Path]:
    """All modules of all packages, by name."""
    found = {}
    for package in ARROWS:
        origin = importlib.import_module(package).__file__
        assert origin is not None
        top = Path(origin).parent
        for path in top.rglob("*.py"):
            parts = (package, *path.relative_to(top).with_suffix("").parts)
            found[".".join(parts).removesuffix(".__init__")] = path
    return found


def package_of(module: str) -> str:
    return max((name for name in ARROWS if f"{module}.".startswith(f"{name}.")), key=len)


def statements(tree: ast.AST) -> Iterator[ast.AST]:
    """All statements and what holds some; no expression, which can import nothing, and there are many."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        for field in ("body", "orelse", "finalbody", "handlers", "cases"):
            held = getattr(node, field, ())
            waiting += held if isinstance(held, list) else ()


def imported(tree: ast.AST, known: Iterable[str]) -> Iterator[str]:
    """The modules, of those that are known, that a source imports."""
    for node in statements(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                if full in known:
                    yield full
                elif node.module in known:
                    yield node.module


@pytest.fixture(scope="module")
def trees() -> dict[str, ast.Module]:
    """Each module's source, parsed once: it takes longer than all that is asked of it."""
    return {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in modules().items()}


@pytest.fixture(scope="module")
def graph(trees: dict[str, ast.Module]) -> Graph:
    assert len(trees) > 250
    return {name: set(imported(tree, trees)) - {name} for name, tree in trees.items()}


def rooms(graph: Graph, folder: str) -> Graph:
    """The same imports between the rooms of a folder. Each file of the folder is a room of its own; its front is none."""
    inside = f"{folder}."

    def room_of(module: str) -> str:
        return inside + module.removeprefix(inside).partition(".")[0]

    found: Graph = defaultdict(set)
    for module, others in graph.items():
        if module.startswith(inside):
            found[room_of(module)] |= {room_of(each) for each in others if each.startswith(inside)} - {room_of(module)}
    return found


def folders(graph: Graph) -> list[str]:
    return sorted({".".join(module.split(".")[:depth]) for module in graph for depth in range(1, module.count(".") + 1)})


def circle_in(graph: Mapping[str, set[str]]) -> list[str]:
    """The nodes of all circles, and those between two circles; none, if each node can stand above all that it imports."""
    left = {node: set(others) for node, others in graph.items()}
    while free := [node for node in left if not left[node] & left.keys() or not any(node in others for others in left.values())]:
        for node in free:
            del left[node]
    return sorted(left)


def test_each_package_imports_only_what_stands_below_it(graph: Graph) -> None:
    wrong = {
        f"{module} -> {other}"
        for module, others in graph.items()
        for other in others
        if (package := package_of(module)) != (below := package_of(other)) and below not in ARROWS[package]
    }
    assert wrong == set()


def test_no_files_import_each_other_in_a_circle(graph: Graph) -> None:
    assert circle_in(graph) == []


def test_no_folders_import_each_other_in_a_circle(graph: Graph) -> None:
    assert {"canopen_proto", "canopen_proto.manager", "canopen_cli.shared"} <= {*folders(graph)}
    assert {folder: circle for folder in folders(graph) if (circle := circle_in(rooms(graph, folder)))} == {}


def test_a_circle_would_be_seen() -> None:
    assert circle_in({"a": {"b"}, "b": {"c"}, "c": set()}) == []
    assert circle_in({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c"]
    text = "def f():\n    from canopen_proto.frame import Frame\nif TYPE_CHECKING:\n    import canopen_proto.machine"
    known = {"canopen_proto.frame", "canopen_proto.machine"}
    assert set(imported(ast.parse(text), known)) == known


ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


def test_the_page_of_the_house_names_each_folder_and_file_at_the_root_of_the_core() -> None:
    places = [
        f"{each.name}/" if each.is_dir() else each.name
        for each in Path(str(canopen_proto.__file__)).parent.iterdir()
        if (each.suffix == ".py" and each.name != "__init__.py") or (each / "__init__.py").is_file()
    ]
    assert "sdo/" in places
    assert sorted(place for place in places if not re.search(rf"\b{re.escape(place)}", PAGE)) == []


def table(head: str) -> dict[str, set[str]]:
    """The rows of a table of the page with two columns: what stands left -> what stands right."""
    rows = PAGE[PAGE.index(head) :].split("\n\n", 1)[0].splitlines()[2:]
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    return {left: {each.strip() for each in right.split(",")} - {"none"} for left, right in cells}


def test_the_page_of_the_house_has_the_arrows_between_the_rooms_of_the_core(graph: Graph) -> None:
    core = Path(str(canopen_proto.__file__)).parent
    folders_only = {room for room in rooms(graph, "canopen_proto") if (core / room.partition(".")[2] / "__init__.py").is_file()}

    def name(room: str) -> str:
        return f"{room.partition('.')[2]}/"

    arrows = {
        name(room): {name(each) for each in others & folders_only}
        for room, others in rooms(graph, "canopen_proto").items()
        if room in folders_only
    }
    assert table("| room | imports these rooms |") == arrows
    picture = re.findall(r"^(\d)   (\w.*)$", PAGE[PAGE.index("## The rooms of the core") :], re.MULTILINE)
    level = {room: int(number) for number, line in picture for room in line.split() if room.endswith("/")}
    assert level.keys() == arrows.keys()
    assert {room: number for room, number in level.items() if any(level[each] >= number for each in arrows[room])} == {}


def test_each_step_of_the_ways_on_the_page_is_in_the_file_that_it_names() -> None:
    steps = re.findall(r"^ *(\S.*?) {2,}(\w[\w/]*\.py) {2,}\S", PAGE, re.MULTILINE)
    assert len(steps) > 30
    elsewhere = {"SYNC", "Upload"}  # words, or what the file imports
    paths = modules()

    def absent(step: str, file: str) -> list[str]:
        path = paths.get(file.removeprefix("master/").removesuffix(".py").replace("/", "."))
        source = path.read_text(encoding="utf-8") if path is not None else ""
        names = re.findall(r"\b(?:[A-Z]\w+(?:\.\w+)?|\w+(?=\())", step.removeprefix("await node.").removeprefix("device."))
        parts = {part for name in names for part in name.split(".")} - elsewhere
        return [f"{file}: {part}" for part in sorted(parts) if not re.search(rf"\b{part}\b", source)]

    assert [each for step, file in steps for each in absent(step, file)] == []


@pytest.fixture(scope="module")
def classes(trees: dict[str, ast.Module]) -> dict[str, list[list[str]]]:
    """The names of each class's bases, by the class's name, for each place that defines it; inside of functions too."""
    found: dict[str, list[list[str]]] = defaultdict(list)
    for tree in trees.values():
        for node in statements(tree):
            if isinstance(node, ast.ClassDef):
                found[node.name].append([ast.unparse(base).rpartition(".")[2] for base in node.bases])
    assert len(found) > 1000
    return found


def derived(classes: Mapping[str, list[list[str]]], *roots: str) -> set[str]:
    """The classes that derive from one of these, over any number of steps."""
    found: set[str] = set()
    while more := {name for name, places in classes.items() if any({*bases} & {*roots, *found} for bases in places)} - found:
        found |= more
    return found


def test_no_two_classes_have_one_name(classes: dict[str, list[list[str]]]) -> None:
    assert [name for name, places in classes.items() if len(places) > 1] == []


FLOW = {
    "Cancelled": "as trio.Cancelled: it ends a procedure that somebody has cancelled; a BaseException, and no error",
    "NotApplicable": "it ends a conformance case with the result of that name, which is no failure",
}
"""Exceptions that are no errors, and why."""


def test_an_exception_is_an_error_by_its_name_and_an_event_is_not(classes: dict[str, list[list[str]]]) -> None:
    """One that begins with `_` never leaves its module: it is a jump."""
    builtin = [name for name, value in vars(builtins).items() if isinstance(value, type) and issubclass(value, BaseException)]
    exceptions = derived(classes, *builtin)
    assert {"TransportError", "AxisBusyError", "SdoTransferError"} <= exceptions
    others = {name for name in exceptions if not name.endswith("Error") and not name.startswith("_")}
    assert others == FLOW.keys()
    events = derived(classes, "Event")
    assert {"SdoAborted", "HeartbeatLost", "BusChanged"} <= events
    assert {name for name in events if name.endswith("Error")} == set()
