"""canopen_proto is pure: no I/O, no clock, no threads, no chance, and nothing but the standard library.

Three proofs, since each has a hole that another one closes:

- the sources import from a short list of harmless modules, call no built-in that does I/O, and take no date from a clock;
- a fresh interpreter without site-packages, in which importing a forbidden module fails, imports all of canopen_proto;
- after that no module is loaded but our own and those that the short list itself loads (the standard library's `datetime`
  imports `time` for its own needs: that is why the list is compared, and not the bare absence of `time`).
"""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import canopen_proto
from tests.builds import loads_by_itself

ROOT = Path(canopen_proto.__file__).parent
MORE = ROOT / "testing" / "strategies"
"""For users of hypothesis, which it needs. Nothing else of the core imports it: tests/test_house.py."""
SOURCES = sorted(path for path in ROOT.rglob("*.py") if MORE not in path.parents)
MODULES = [".".join(path.relative_to(ROOT.parent).with_suffix("").parts).removesuffix(".__init__") for path in SOURCES]

ALLOWED = {
    "__future__", "abc", "binascii", "bisect", "collections", "collections.abc", "csv", "dataclasses", "datetime", "difflib",
    "enum", "functools", "heapq", "importlib", "importlib.machinery", "io", "itertools", "math", "operator", "re", "reprlib",
    "string", "struct", "tomllib", "types", "typing", "xml.parsers", "xml.parsers.expat",
}  # fmt: skip
FORBIDDEN = {
    "asyncio", "can", "canopen", "click", "concurrent", "http", "logging", "matplotlib", "msgpack", "multiprocessing", "numpy",
    "os", "pathlib", "queue", "random", "rich", "sched", "secrets", "select", "selectors", "serial", "signal", "socket", "ssl",
    "subprocess", "tempfile", "threading", "time", "trio", "urllib", "uuid",
}  # fmt: skip
IMPURE_CALLS = {"breakpoint", "compile", "eval", "exec", "input", "open", "print", "__import__"}
CLOCKS = {"now", "today", "utcnow"}

PROBE = """
import importlib, sys
root, modules, allowed, forbidden = {root!r}, {modules!r}, {allowed!r}, {forbidden!r}
for name in allowed:
    importlib.import_module(name)
before = set(sys.modules)
for name in forbidden:
    if name not in before:
        sys.modules[name] = None  # an import of it raises
poisoned = {{name for name in forbidden if sys.modules.get(name, 0) is None}}
sys.path.insert(0, root)
for name in modules:
    importlib.import_module(name)
new = {{name for name in sys.modules if name not in before}} - poisoned
for name in poisoned:
    del sys.modules[name]  # the interpreter looks into some of them when it ends
own = {{name for name in new if name.partition(".")[0] == "canopen_proto" or name.endswith("__mypyc")}}
print(*sorted(new - own))
print(*sorted(poisoned))
"""


def imports_of(tree: ast.AST) -> set[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            node.body = []  # read by type checkers and mypyc, never run
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative imports hide where a name comes from"
            found.add(node.module or "")
    return found


def impurities_of(tree: ast.AST) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            called = node.func
            if isinstance(called, ast.Name) and called.id in IMPURE_CALLS:
                found.add(called.id)
            if isinstance(called, ast.Attribute) and called.attr in CLOCKS:
                of = ast.unparse(called.value)
                if of.endswith(("datetime", "date")):
                    found.add(f"{of}.{called.attr}")
        elif isinstance(node, ast.AsyncFunctionDef | ast.Await | ast.AsyncFor | ast.AsyncWith):
            found.add("async")
    return found


@pytest.mark.parametrize("path", SOURCES, ids=MODULES)
def test_a_module_imports_nothing_but_harmless_modules(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"), str(path))
    foreign = {name for name in imports_of(tree) if name.partition(".")[0] != "canopen_proto"}
    assert foreign <= ALLOWED
    assert impurities_of(tree) == set()


def test_the_check_of_the_sources_sees_what_it_is_for() -> None:
    text = "import time, os.path\nfrom random import choice\nasync def f():\n  print(open('x'))\n  datetime.datetime.now()"
    tree = ast.parse(text)
    assert imports_of(tree) == {"time", "os.path", "random"}
    assert impurities_of(tree) == {"print", "open", "async", "datetime.datetime.now"}


def test_all_of_it_imports_where_nothing_impure_can_be_imported() -> None:
    assert len(MODULES) > 10
    probe = PROBE.format(root=str(ROOT.parent), modules=MODULES, allowed=sorted(ALLOWED), forbidden=sorted(FORBIDDEN))
    # -I and -S: no site-packages, no .pth file, no variables of the environment.
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-W", "error", "-c", probe], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stderr == ""
    loaded, poisoned = done.stdout.splitlines()
    assert loaded.split() == []
    # What the interpreter itself or the harmless modules load can't be poisoned; these at least must have been.
    assert set(poisoned.split()) >= {
        "asyncio", "can", "logging", "random", "select", "selectors", "socket", "subprocess", "threading", "trio",
    }  # fmt: skip


LOADED = """
import sys
before = set(sys.modules)
import canopen_proto.network
print(*sorted(set(sys.modules) - before))
"""


@loads_by_itself
def test_a_network_is_imported_without_what_it_does_not_need() -> None:
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", f"import sys; sys.path.insert(0, {str(ROOT.parent)!r}){LOADED}"],
        capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    loaded = set(done.stdout.split())
    assert "canopen_proto.network" in loaded
    assert loaded.isdisjoint(
        {"ast", "csv", "dataclasses", "datetime", "decimal", "difflib", "importlib.metadata", "inspect", "tomllib"}
    )
    parts = {name.split(".")[1] for name in loaded if name.startswith("canopen_proto.")}
    assert parts <= {
        "abort",
        "bus_knowledge",
        "compiling",
        "follower",
        "frame",
        "frame_bits",
        "group",
        "lazy_names",
        "machine",
        "multiplexer",
        "network",
        "nmt",
        "procedures",
        "sdo",
        "sync",
    }
