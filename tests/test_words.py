"""What docstrings name is there: parameters, attributes, and exceptions.

`name: what it is`, at the begin of a sentence, names a parameter of the function, or an attribute of the class.
"""

from __future__ import annotations

import ast
import builtins
import re
from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

import pytest

from tests.test_house import modules, statements

TERM = re.compile(r"(?:(?<=[.;)] )|^)((?:[a-z_]+, )*[a-z_]+): ")
VALUES = {
    "default", "empty", "errors", "inf", "infinite", "infinity", "neither", "none", "notice", "outputs", "source", "timestamp",
    "warning",
}  # fmt: skip
"""Words that stand like a name, and are a value, a part of what is returned, or the begin of a line of a table."""

GENERATED = {"canopen_master.blocking.classes"}
"""Modules that are written by a program, which takes their docstrings from the async classes: what these have, they may lack."""

Documented: TypeAlias = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


class Source(NamedTuple):
    module: str
    lines: list[str]
    documented: list[Documented]

    def text_of(self, node: Documented) -> str:
        return "\n".join(self.lines[node.lineno - 1 : node.end_lineno])


@pytest.fixture(scope="module")
def sources() -> list[Source]:
    found = []
    for module, path in modules().items():
        text = path.read_text(encoding="utf-8")
        documented = [node for node in statements(ast.parse(text)) if isinstance(node, Documented)]
        found.append(Source(module, text.splitlines(), documented))
    assert len(found) > 600
    return found


def parameters(node: Documented) -> set[str]:
    if isinstance(node, ast.ClassDef):
        return set()
    given = node.args
    every = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
    return {each.arg for each in every if each is not None}


def members(node: ast.ClassDef, text: str) -> Iterator[str]:
    """The fields, methods, parameters and attributes of a class, of which this is the text."""
    yield from re.findall(r"\bself\.(\w+)", text)
    yield from re.findall(r"^ +(\w+)(?:: | = )", text, re.MULTILINE)
    for each in statements(node):
        if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from (each.name, *parameters(each))


def documentation(node: Documented) -> str:
    return " ".join((ast.get_docstring(node) or "").split())


def test_a_docstring_explains_only_parameters_and_attributes_that_there_are(sources: list[Source]) -> None:
    classes: dict[str, tuple[set[str], list[str]]] = {}  # by their names, and by module and name
    for source in sources:
        for node in source.documented:
            if isinstance(node, ast.ClassDef):
                code = source.text_of(node).replace(ast.get_docstring(node, clean=False) or "\0", "")
                bases = [ast.unparse(base).partition("[")[0].rpartition(".")[2] for base in node.bases]
                classes[node.name] = classes[f"{source.module}.{node.name}"] = {*members(node, code)}, bases

    def known(name: str) -> set[str]:
        own, bases = classes.get(name, (set(), []))
        return own.union(*(known(base) for base in bases))

    absent, explained = [], 0
    for source in sources:
        if source.module in GENERATED:
            continue
        for node in source.documented:
            terms = {name for found in TERM.finditer(documentation(node)) for name in found[1].split(", ")} - VALUES
            explained += len(terms)
            place = f"{source.module}.{node.name}"
            there = known(place) if isinstance(node, ast.ClassDef) else parameters(node)
            absent += [f"{place}: {name}" for name in sorted(terms - there)]
    assert explained > 3000
    assert absent == []


def test_an_exception_that_a_docstring_names_is_there(sources: list[Source]) -> None:
    known = {node.name for source in sources for node in source.documented} | {*dir(builtins)}
    for source in sources:
        known |= {*re.findall(r"(?:\w\.|import .*\b)(\w+Error)\b", "\n".join(source.lines))}
    named = {
        (name, f"{source.module}.{node.name}")
        for source in sources
        for node in source.documented
        for name in re.findall(r"\b[A-Z][a-z]+\w+(?:Error|Length)\b", documentation(node))
    }
    assert len(named) > 500
    assert sorted(f"{where}: {name}" for name, where in named if name not in known) == []
