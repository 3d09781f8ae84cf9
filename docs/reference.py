"""Write the pages that are made from the sources: names.md, events.md, exceptions.md and objects.md.

    python docs/reference.py            all four; a test compares them with what this would write
    python docs/reference.py events     one of them

A public name is one that `__all__` of a package, or of a room directly below it, has. Who sends an event is read from the
sources: each class or function in which one is made.
"""

from __future__ import annotations

import argparse
import ast
import builtins
import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Final, NamedTuple

from canopen_proto.dictionary.standard import ROWS, Row

DOCS: Final = Path(__file__).parent
PACKAGES: Final = tuple(
    f"canopen_{name}" for name in ("proto", "data", "transports", "master", "check", "testing", "ros", "gateway")
)
"""The packages that are read. canopen_cli is a command: its interface is what it prints, and how it ends."""
PROGRAMS: Final = {"canopen_ros": "parameters, topics and services of a ROS node are its interface"}
"""Packages without public names, and why."""
COMMON: Final = {
    "node_id": "1 to 127: the node that it is about; 0: the network, not one node",
    "request_id": "the one that the command returned, which asked for this",
    "timestamp": "ns, by the transport's clock; None if it has none",
    "axis": "of the node, counted from 0",
    "index": "of the object, 0 to 0xFFFF",
    "subindex": "of the object, 0 to 0xFF",
    "frame": "the frame that it is about",
    "reason": "one line for people",
}
"""Fields that mean the same in all events."""


class Definition(NamedTuple):
    """Where a name is defined. text: its docstring."""

    module: str
    node: ast.AST
    text: str


class Module(NamedTuple):
    """A source: what it defines, and from where it takes other names. fronts: those of which it takes all."""

    tree: ast.Module
    definitions: Mapping[str, Definition]
    origins: Mapping[str, tuple[str, str]]
    fronts: Sequence[str]


@cache
def modules() -> dict[str, Module]:
    """Return all modules of the packages by their name."""
    found = {}
    for package in PACKAGES:
        top = Path(str(importlib.import_module(package).__file__)).parent
        for path in sorted(top.rglob("*.py")):
            parts = (package, *path.relative_to(top).with_suffix("").parts)
            name = ".".join(parts).removesuffix(".__init__")
            found[name] = _module(name, ast.parse(path.read_text(encoding="utf-8")))
    return found


def _module(name: str, tree: ast.Module) -> Module:
    definitions, origins, fronts = {}, {}, []
    statements = [inner for each in tree.body for inner in (each.body if isinstance(each, ast.If) else [each])]
    for place, node in enumerate(statements):
        match node:
            case ast.ClassDef() | ast.FunctionDef() | ast.AsyncFunctionDef() if not is_overload(node):
                definitions.setdefault(node.name, Definition(name, node, ast.get_docstring(node) or ""))
            case ast.AnnAssign(target=ast.Name(target)) | ast.Assign(targets=[ast.Name(target)]):
                definitions.setdefault(target, Definition(name, node, _text_after(statements, place)))
            case ast.ImportFrom(module=str(source), names=[ast.alias(name="*")]):
                fronts.append(source)
            case ast.ImportFrom(module=str(source)):
                origins.update({alias.asname or alias.name: (source, alias.name) for alias in node.names})
    return Module(tree, definitions, origins, fronts)


def is_overload(node: ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Return whether this only gives a type checker one more way to call a function."""
    return any(ast.unparse(each).rpartition(".")[2] == "overload" for each in node.decorator_list)


def _text_after(statements: list[ast.stmt], place: int) -> str:
    match statements[place + 1 : place + 2]:
        case [ast.Expr(ast.Constant(str(text)))]:
            return inspect.cleandoc(text)
    return ""


def definition_of(module: str, name: str) -> Definition:
    """Return where a name of a module is defined, over any number of imports."""
    while name not in (source := modules()[module]).definitions:
        module, name = source.origins.get(name) or next((each, name) for each in source.fronts if name in modules()[each].origins)
    return source.definitions[name]


@cache
def public_modules() -> dict[str, ModuleType]:
    """Return the packages and the rooms below them that have public names, by name."""
    found = {}
    for package in PACKAGES:
        if package not in PROGRAMS:
            top = importlib.import_module(package)
            rooms = sorted(
                f"{package}.{each.name}" for each in pkgutil.iter_modules(top.__path__) if not each.name.startswith("_")
            )
            for name in (package, *rooms):
                module = importlib.import_module(name)
                if hasattr(module, "__all__"):
                    found[name] = module
    return found


@cache
def homes() -> dict[str, str]:
    """Return from where each public class or function is imported, by "module:name" of its definition: the shortest way."""
    found: dict[str, str] = {}
    for module in sorted(public_modules(), key=lambda each: each.count(".")):
        for name in public_modules()[module].__all__:
            defined = definition_of(module, name)
            found.setdefault(f"{defined.module}:{name}", module)
    return found


@cache
def classes() -> dict[str, Definition]:
    """Return all classes of the packages by name (no two have the same)."""
    return {
        name: each
        for module in modules().values()
        for name, each in module.definitions.items()
        if isinstance(each.node, ast.ClassDef)
    }


@cache
def derived(*roots: str) -> list[str]:
    """Return the names of all classes that derive from one of these, but those that begin with `_`."""
    found: set[str] = set()

    def bases(name: str) -> set[str]:
        node = classes()[name].node
        return {ast.unparse(base).rpartition(".")[2] for base in node.bases} if isinstance(node, ast.ClassDef) else set()

    while more := {name for name in classes() if bases(name) & {*roots, *found}} - found:
        found |= more
    return sorted(name for name in found if not name.startswith("_"))


def home_of(name: str) -> str | None:
    """Return from where a class is imported, or None if it is not public."""
    return homes().get(f"{classes()[name].module}:{name}")


def cell(text: str) -> str:
    """Return a docstring as one line of a table."""
    return re.sub(r"\s+", " ", text).strip().replace("|", "\\|")


def sentence(text: str) -> str:
    """Return the first sentence of a docstring."""
    line = cell(text.split("\n\n")[0])
    end = re.search(r"\.(?= [A-Z`(]| *$)", line)
    return line[: end.end()] if end else line


def value_text(node: ast.AST) -> str:
    """Return what a name without a docstring of its own is set to, if that is short."""
    text = ast.unparse(node.value) if isinstance(node, (ast.Assign, ast.AnnAssign)) and node.value is not None else ""
    return f"`{text}`" if len(text) <= 80 else ""


def first_line(module: str) -> str:
    """Return what a module's docstring says first."""
    return sentence(ast.get_docstring(modules()[module].tree) or "")


KINDS: Final = {ast.ClassDef: "class", ast.FunctionDef: "function", ast.AsyncFunctionDef: "async function"}


def names_page() -> Iterator[str]:
    """Yield the lines of the list of public names."""
    yield "# Public names"
    yield ""
    yield "Made from the sources by `python docs/reference.py`. [What a version promises](promise.md) holds for these names,"
    yield "and for no others."
    for module, loaded in public_modules().items():
        yield ""
        yield f"{'#' * (2 + module.count('.'))} {module}"
        yield ""
        yield first_line(module)
        yield ""
        yield "| name | kind | |"
        yield "|---|---|---|"
        for name in sorted(loaded.__all__, key=str.lower):
            defined = definition_of(module, name)
            kind = KINDS.get(type(defined.node))
            text = defined.text
            if kind is None:
                value = getattr(loaded, name)
                kind = "function" if callable(value) and inspect.isroutine(value) else "value"
                text = text or (inspect.getdoc(value) or "" if kind == "function" else value_text(defined.node))
            elif kind == "class" and name in derived("Event"):
                kind = "event"
            yield f"| `{name}` | {kind} | {sentence(text)} |"


@cache
def senders() -> dict[str, list[str]]:
    """Return the classes and functions that make each event, by its name."""
    events = {*derived("Event")}
    found: dict[str, dict[str, None]] = {name: {} for name in events}

    def look(node: ast.AST, owner: str) -> None:
        match node:
            case ast.ClassDef() | ast.FunctionDef() | ast.AsyncFunctionDef() if not owner:
                owner = node.name
            case ast.Call(func=ast.Name(name) | ast.Attribute(attr=name)) if name in events and owner and owner != name:
                found[name][owner] = None
        for child in ast.iter_child_nodes(node):
            look(child, owner)

    for module in modules().values():
        look(module.tree, "")
    return {name: sorted(each) for name, each in found.items()}


def fields_of(name: str) -> dict[str, str]:
    """Return the fields of an event, with their types: the parameters of its `__init__`, or of that which it inherits."""
    node = classes()[name].node
    assert isinstance(node, ast.ClassDef)
    for each in node.body:
        if isinstance(each, ast.FunctionDef) and each.name == "__init__":
            return {arg.arg: ast.unparse(arg.annotation).strip("'\"") if arg.annotation else "" for arg in each.args.args[1:]}
    return fields_of(ast.unparse(node.bases[0]).rpartition(".")[2])


def field_text(field: str, kind: str) -> str:
    """Return a field with its type and, if the type has one, its unit."""
    unit = re.sub(r"\bTime\b", "int, ns", kind).replace(" | None", " or None")
    return f"`{field}`: {unit}".replace("|", "or")


def events_page() -> Iterator[str]:
    """Yield the lines of the reference of events."""
    yield "# Events"
    yield ""
    yield "Made from the sources by `python docs/reference.py`. All events: who makes one, when, and its fields. Import an"
    yield "event from the package or room in whose table it stands. `match` takes the fields in the order of this page."
    yield ""
    yield "These fields mean the same in all events:"
    yield ""
    yield "| field | |"
    yield "|---|---|"
    for field, text in COMMON.items():
        yield f"| `{field}` | {text} |"
    for module in (*public_modules(), None):
        named = [name for name in derived("Event") if home_of(name) == module]
        if not named:
            continue
        yield ""
        yield f"## {module or 'Of this project alone: not public'}"
        yield ""
        yield "| event | made by | when, and its fields |"
        yield "|---|---|---|"
        for name in named:
            fields = "; ".join(field_text(*each) for each in fields_of(name).items())
            public = [each for each in senders()[name] if not each.startswith("_")]
            makers = ", ".join(f"`{each}`" for each in public or senders()[name]) or "base of others"
            yield f"| `{name}` | {makers} | {cell(classes()[name].text)}<br>{fields} |"


@cache
def codes() -> dict[str, list[str]]:
    """Return the codes of docs/errors.md by exception."""
    found: dict[str, list[str]] = {}
    for code, cells in re.findall(
        r"^\| (CO[0-9]{3}) \|([^|]*)\|", (DOCS / "errors.md").read_text(encoding="utf-8"), re.MULTILINE
    ):
        for name in re.findall(r"`(\w+)`", cells):
            found.setdefault(name, []).append(code)
    return found


def exceptions() -> list[str]:
    """Return all exceptions of the packages, by name."""
    known = [name for name, value in vars(builtins).items() if isinstance(value, type) and issubclass(value, BaseException)]
    return derived(*known)


def exceptions_page() -> Iterator[str]:
    """Yield the lines of the reference of errors."""
    yield "# Exceptions"
    yield ""
    yield "Made from the sources by `python docs/reference.py`. All exceptions: from where to import them, what they derive"
    yield "from, and what they mean. [Errors and exit statuses](errors.md) lists the codes, with causes and next steps."
    for module in (*public_modules(), None):
        named = [name for name in exceptions() if home_of(name) == module]
        if not named:
            continue
        yield ""
        yield f"## {module or 'Of this project alone: not public'}"
        yield ""
        yield "| exception | derives from | meaning | codes |"
        yield "|---|---|---|---|"
        for name in named:
            node = classes()[name].node
            assert isinstance(node, ast.ClassDef)
            bases = ", ".join(f"`{ast.unparse(base)}`" for base in node.bases)
            yield f"| `{name}` | {bases} | {cell(classes()[name].text)} | {', '.join(codes().get(name, ()))} |"


OBJECT_PAGES: Final = ("services/*.md", "modes/*.md", "drives.md", "lss.md", "flash.md", "network.md")
"""Pages that tell what an object is for: those that name it."""


@cache
def object_pages() -> dict[str, str]:
    """Return the text of OBJECT_PAGES, by their names."""
    paths = (path for pattern in OBJECT_PAGES for path in sorted(DOCS.glob(pattern)))
    return {path.relative_to(DOCS).as_posix(): path.read_text(encoding="utf-8") for path in paths}


OTHER_OBJECTS: Final = """
## CiA 402: objects without a name here

Nothing here uses them. Read one by its number and type, if no file of the device names it: `canopen read 5 604D --type u8`.
Those of the first table stand in CiA's sample file, of an older edition (V2, from memory); newer drives have few of them.

| object | sub | title | type | access |
|---|---|---|---|---|
| 0x6045 | 00 | vl manipulated velocity | INTEGER16 | ro |
| 0x6047 | 01 to 04 | vl velocity min max: min and max positive, min and max negative | UNSIGNED32 | rw |
| 0x604D | 00 | vl pole number | UNSIGNED8 | rw |
| 0x604E | 00 | vl velocity reference | UNSIGNED32 | rw |
| 0x604F | 00 | vl ramp function time | UNSIGNED32 | rw |
| 0x6050 | 00 | vl slow down time | UNSIGNED32 | rw |
| 0x6051 | 00 | vl quick stop time | UNSIGNED32 | rw |
| 0x6052 | 00 | vl nominal percentage | INTEGER16 | rw |
| 0x6053 | 00 | vl percentage demand | INTEGER16 | ro |
| 0x6054 | 00 | vl actual percentage | INTEGER16 | ro |
| 0x6055 | 00 | vl manipulated percentage | INTEGER16 | ro |
| 0x6056 | 01, 02 | vl velocity motor min max amount | UNSIGNED32 | rw |
| 0x6057 | 01 to 04 | vl velocity motor min max, as 0x6047 | UNSIGNED32 | rw |
| 0x6058 | 01, 02 | vl frequency motor min max amount | UNSIGNED32 | rw |
| 0x6059 | 01 to 04 | vl frequency motor min max, as 0x6047 | UNSIGNED32 | rw |
| 0x6089 | 00 | position notation index | INTEGER8 | rw |
| 0x608A | 00 | position dimension index | UNSIGNED8 | rw |
| 0x608D | 00 | acceleration notation index | INTEGER8 | rw |
| 0x608E | 00 | acceleration dimension index | UNSIGNED8 | rw |
| 0x6093 | 01, 02 | position factor: numerator, feed constant (others: divisor) | UNSIGNED32 | rw |
| 0x6094 | 01, 02 | velocity encoder factor: numerator, divisor | UNSIGNED32 | rw |
| 0x6095 | 01, 02 | velocity factor 1: numerator, divisor | UNSIGNED32 | rw |
| 0x60F6 | the maker's | torque control parameters | the maker's | rw |
| 0x60F7 | the maker's | power stage parameters | the maker's | rw |
| 0x60F9 | 01, 02 | velocity control parameter set: gain, integration time constant | UNSIGNED16 | rw |
| 0x60FA | 00 | control effort | INTEGER32 | ro |
| 0x60FB | the maker's | position control parameter set | the maker's | rw |
| 0x6403 | 00 | motor catalogue number | VISIBLE_STRING | rw |
| 0x6404 | 00 | motor manufacturer | VISIBLE_STRING | rw |
| 0x6405 | 00 | http motor catalogue address | VISIBLE_STRING | rw |
| 0x6407 | 00 | motor service period | UNSIGNED32 | rw |
| 0x6410 | the maker's | motor data | the maker's | rw |
| 0x6503 | 00 | drive catalogue number | VISIBLE_STRING | rw |
| 0x6504 | 00 | drive manufacturer | VISIBLE_STRING | rw |
| 0x6505 | 00 | http drive catalogue address | VISIBLE_STRING | rw |
| 0x6510 | the maker's | drive data | the maker's | rw |

Of newer editions, and not complete; subindices from 01 on are one for each encoder:

| object | sub | title | type | access | source |
|---|---|---|---|---|---|
| 0x60A2 | 01, 02 | jerk factor: numerator, divisor | UNSIGNED32 | rw | a file of ros2_canopen |
| 0x60AB | 00 | SI unit jerk | UNSIGNED32 | rw | a file of ros2_canopen |
| 0x60D0 | 01, 02 | touch probe source | INTEGER16 | rw | from memory |
| 0x60D1 to 0x60D4 | 00 | touch probe time stamps | UNSIGNED32 | ro | from memory |
| 0x60E6, 0x60EB | 01 on | additional position encoder: increments, motor revolutions | UNSIGNED32 | rw | Nanotec, PD4-E manual |
| 0x60E8, 0x60ED | 01 on | additional gear ratio: motor, driving shaft revolutions | UNSIGNED32 | rw | Nanotec, PD4-E manual |
| 0x60E9, 0x60EE | 01 on | additional feed constant: feed, driving shaft revolutions | UNSIGNED32 | rw | Nanotec, PD4-E manual |
"""
"""Objects that the table of the package leaves out: nothing here needs them."""


def objects_page() -> Iterator[str]:
    """Yield the lines of the index of standard objects."""
    yield "# Objects by number"
    yield ""
    yield "The objects of CiA 301, CiA 302 and CiA 402 that have a name here, made from the table of this package by"
    yield "`python docs/reference.py`; then [those of CiA 402 that have none](#cia-402-objects-without-a-name-here). Read one by"
    yield "its name or number: `canopen read 5 statusword`, `canopen read 5 6041`."
    yield ""
    yield "Access: `rww` is `rw`, and an RPDO may carry it. PDO: whether a PDO may carry it. A default that is not there is the"
    yield "device's matter, most often 0. Subindex 0 of a record has a row only if it says more than the last subindex. A name in"
    yield "braces counts: `{n}` the objects of a range from 1 (`{m}` from 2), `{s}` is the subindex. Each of up to eight axes has"
    yield "the objects of CiA 402 once more, 0x800 higher: 0x6041, 0x6841, 0x7041 ... The names of a device's own file"
    yield "count for it; so do its types and its access, which differ from maker to maker."
    yield ""
    yield "Sources: CiA 301 v4.2.0, 7.5.2. CiA 302-2 and 302-3 v4.1.0, as Lely core has them. CiA 402: what most of seven drives'"
    yield "dictionaries and CiA's own sample file say; PDO is `yes` here if one of them, or a maker's manual, says so."
    for title, first, last in (
        ("CiA 301: communication", 0x1000, 0x1EFF),
        ("CiA 302: managers, programs, MPDO", 0x1F00, 0x1FFF),
        ("CiA 402: drives", 0x6000, 0x67FF),
    ):
        yield ""
        yield f"## {title}"
        yield ""
        yield "| object | sub | name | type | access | PDO | default | pages |"
        yield "|---|---|---|---|---|---|---|---|"
        for row in ROWS:
            if first <= row.indices.start <= last:
                yield f"| {' | '.join(_object_cells(row))} |"

    yield from OTHER_OBJECTS.splitlines()


def _object_cells(row: Row) -> Iterator[str]:
    variable, start = row.pattern, row.indices.start
    yield f"0x{start:04X}" if len(row.indices) == 1 else f"0x{start:04X} to 0x{row.indices[-1]:04X}"
    yield f"{row.subindices[0]:02X}" if row.is_field else f"{row.subindices[0]:02X} to {row.subindices[-1]:02X}"
    yield f"`{row.names[0]}`"
    yield variable.data_type.name
    yield str(variable.access)
    yield "yes" if variable.pdo_mappable else ""
    default = variable.default
    node = " + node-ID" if variable.adds_node_id else ""
    in_hex = node or (isinstance(default, int) and default > 0x7F)
    yield "" if default is None else f"0x{default:X}{node}" if in_hex else f"{default}"
    pages = [name for name, text in object_pages().items() if f"0x{start:04X}" in text]
    yield ", ".join(f"[{name.removesuffix('.md').rpartition('/')[2]}]({name})" for name in pages[:4])


PAGES: Final = {"names": names_page, "events": events_page, "exceptions": exceptions_page, "objects": objects_page}


def page(name: str) -> str:
    """Return the text of a page. name: one of PAGES."""
    return "\n".join(PAGES[name]()) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument(
        "pages", metavar="PAGE", nargs="*", choices=[*PAGES, []], help=f"one of {', '.join(PAGES)}; by default all"
    )
    for name in parser.parse_args().pages or PAGES:
        path = DOCS / f"{name}.md"
        path.write_text(page(name), encoding="utf-8")
        print(path)


if __name__ == "__main__":
    main()
