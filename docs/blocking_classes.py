"""Write the classes of `canopen_master.blocking` from the async ones: master/canopen_master/blocking/classes.py.

    python docs/blocking_classes.py     a test compares the file with what this would write

Each public method, property and attribute of an async class becomes one of its blocking twin, with the same parameters and text.
A coroutine gets one more parameter, `timeout`. What has no twin stands in LEFT_OUT, with the reason.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import textwrap
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

from canopen_proto.machine import Event

PATH: Final = Path(__file__).parents[1] / "master" / "canopen_master" / "blocking" / "classes.py"
WIDTH: Final = 130


class Spec(NamedTuple):
    """A class to be made. base: of what it inherits. is_kept: its async object has one twin as long as the master lives."""

    source: str
    base: str = "Twin"
    is_kept: bool = False


CLASSES: Final = {
    "Node": Spec("canopen_master.node:Node", "NodeTwin", is_kept=True),
    "Device": Spec("canopen_master.motion.device:Device", is_kept=True),
    "Subscription": Spec("canopen_master.participant.subscription:Subscription"),
    "ReadStream": Spec("canopen_master.streams:ReadStream"),
    "Recorder": Spec("canopen_master.motion.recording:Recorder"),
    "Cycles": Spec("canopen_master.motion.cycles:Cycles"),
    "Progresses": Spec("canopen_master.motion.moving:Progresses"),
    "Jog": Spec("canopen_master.motion.target_motion:Jog"),
    "Targets": Spec("canopen_master.motion.target_motion:Targets"),
    "Moving": Spec("canopen_master.motion.moving:Moving"),
    "Chain": Spec("canopen_master.motion.chain:Chain", "BlockingMoving", is_kept=True),
    "Together": Spec("canopen_master.motion.moving:Together", "BlockingMoving"),
    "Master": Spec("canopen_master.master:Master", "MasterTwin", is_kept=True),
    "DriveCommissioning": Spec("canopen_master.commissioning:DriveCommissioning"),
    "SimulatedDevices": Spec("canopen_master.simulation.serving:SimulatedDevices"),
}
"""The async classes, in the order of the file."""

FUNCTIONS: Final = {
    "open_master": "canopen_master.session:open_master",
    "together": "canopen_master.motion.moving:together",
    "boot_network": "canopen_master.network_booting:boot_network",
    "simulated_drives": "canopen_master.simulation.serving:simulated_drives",
    "simulated_devices": "canopen_master.simulation.serving:simulated_devices",
}

_CALLBACK = "it calls in the loop's thread: `on`"
_INSIDE = "for the other classes of canopen_master"
_BY_PROCEDURE = "`run` takes procedures; `in_loop` gives what has no blocking form"
LEFT_OUT: Final = {
    "Master.begin": _BY_PROCEDURE,
    "Node.begin_use": _INSIDE,
    "Node.guard_for": _CALLBACK,
    "Master.body": _INSIDE,
    "Master.check_loop": _INSIDE,
    "Master.end_all": _INSIDE,
    "Master.finish": _INSIDE,
    "Master.guard_sync": _CALLBACK,
    "Master.halt_and_flush": _INSIDE,
    "Master.launch": _INSIDE,
    "Master.on_failure": _INSIDE,
    "Master.pump": _INSIDE,
    "Master.runner": _INSIDE,
    "Master.start": _INSIDE,
    "Master.subscribe": "`events`",
    "Master.take_back": _INSIDE,
    "Master.unwatch": _CALLBACK,
    "Master.watch": _CALLBACK,
    "Master.watchdogs": _INSIDE,
    "Node.begin": _BY_PROCEDURE,
    "Node.error_of": _INSIDE,
    "Node.request": _BY_PROCEDURE,
    "Node.send_nmt": "for procedures: `nmt`",
    "Node.watch": _CALLBACK,
    "Device.occupy": _INSIDE,
    "Device.release": _INSIDE,
    "Moving.members": _INSIDE,
    "Moving.next_news": "`progress`",
    "Moving.present_motion": _INSIDE,
    "Chain.begun": "tasks wait for it: `progress`",
    "Chain.changed": "tasks wait for it: `progress`",
    "Subscription.batches": "`receive_batch`",
    "Subscription.end": _INSIDE,
    "Subscription.put": _INSIDE,
    "Subscription.put_all": _INSIDE,
    "SimulatedDevices.hosts": "of the loop's thread: `change`",
    "simulate": "it serves for ever: `simulated_devices`",
    "Host": "of the loop's thread: `SimulatedDevices.change`",
    "MasterSession": "`open_master` opens at once",
    "Demonstration": "what `canopen demo` runs, and its events",
}
"""What has no blocking form, and why."""

ATTRIBUTES: Final = {
    "Master.halts": "list[Halt]",
    "Node.remote": "RemoteNode",
    "Node.name": "str",
    "Device.axis": "Axis",
    "Device.node": "Node",
    "Device.following": "Following",
    "Device.limits": "SetPointLimits",
    "Device.sdo_round_trips": "int",
    "Chain.name": "str",
    "Chain.devices": "tuple[Device, ...]",
    "Chain.settings": "ChainSettings",
    "Subscription.dropped": "int",
    "ReadStream.size": "int",
    "Recorder.path": "FilePath",
    "Recorder.rows": "int",
    "Recorder.lost": "int",
    "DriveCommissioning.master": "Master",
    "DriveCommissioning.node": "Node",
    "DriveCommissioning.settings": "AxisSettings",
    "DriveCommissioning.done": "list[str]",
    "DriveCommissioning.has_moved": "bool",
    "DriveCommissioning.is_homed": "bool",
    "Master.is_closed": "bool",
}
"""The types of attributes that no annotation gives."""

RENAMED: Final = {"ReadStream.aclose": "close"}
"""What has another name here."""
AT_THE_END: Final = {"Subscription.close", "Subscription.__exit__", "Recorder.close"}
"""What ends something, and also has to work while the master is left, or after that."""
IN_THE_CALLER: Final = {"Recorder.wait"}
"""What blocks by itself, and is called in the caller's thread."""
CONSTANT: Final = {"Node.node_id", "Node.bus", "Node.dictionary", "Node.network"}
"""Properties that never change: they are read in the caller's thread."""

FROM_TWIN: Final = (
    *("Twin", "MasterTwin", "NodeTwin", "open_session", "open_context", "attribute", "in_a_thread", "together_of_none"),
    *("E", "R", "V"),
)
"""What the file uses of twin.py."""

WORDS: Final = (
    (r"`async with `?block", "`with` block"),
    (r"\basync (with|for)\b", r"\1"),
    (r"\bawait ", ""),
    (r"\banother task\b", "another thread"),
    (r"\bother tasks run\b", "other tasks of the loop run"),
    (r"\bthe task that waits is cancelled, or Ctrl-C comes\b", "the call is interrupted, or its time is over"),
    (r"\b(I|i)f the task is cancelled\b", r"\1f the call is interrupted, or its time is over"),
    (r"\bA cancelled wait\b", "A wait that is interrupted"),
    (r"\bis cancelled\b", "is interrupted"),
    (r"\bif cancelled\b", "if interrupted"),
    (r"\ban iterable or an async iterable\b", "an iterable; it is asked in a thread of its own"),
    (r"\ban async iterator\b", "an iterator"),
    (r"\bAn async iterator\b", "An iterator"),
    (r", as everywhere in trio\b", ""),
    (r"\bEntering the block raises BusError\b", "Raises BusError"),
    (r"On leaving\s+it, see this module's text\.", "How it ends: docs/blocking.md."),
    (r"\bOpen a master of one or several buses:", "Open a master of one or several buses, at once:"),
)
"""What is said otherwise in the text of a blocking class."""
PER_MODULE: Final = {
    ("pathlib", "Path"): "FilePath",
}
"""Names that have another one here, by where they are defined: `Path` is one of joints."""


@cache
def tree_of(module: str) -> ast.Module:
    """Return the syntax of a module."""
    return ast.parse(inspect.getsource(importlib.import_module(module)))


@cache
def origins(module: str) -> dict[str, tuple[str, str]]:
    """Return from where a module has each of its names."""
    found: dict[str, tuple[str, str]] = {}
    for node in ast.walk(tree_of(module)):
        match node:
            case ast.ImportFrom(module=str(source)):
                found.update({alias.asname or alias.name: (source, alias.name) for alias in node.names})
            case ast.Import():
                found.update({alias.asname or alias.name: (alias.name, "") for alias in node.names})
    for node in tree_of(module).body:
        match node:
            case ast.ClassDef() | ast.FunctionDef() | ast.AsyncFunctionDef():
                found[node.name] = module, node.name
            case ast.AnnAssign(target=ast.Name(name)) | ast.Assign(targets=[ast.Name(name)]):
                found[name] = module, name
    return found


def value_of(module: str, name: str) -> object:
    """Return what a name of a module means."""
    return getattr(importlib.import_module(module), name)


class Translator(ast.NodeTransformer):
    """Changes the names of a module in annotations and defaults into those of the file that is written. used: what it imports."""

    def __init__(self, module: str, used: dict[str, tuple[str, str]], *, is_async: bool = False) -> None:
        self.module = module
        self.used = used

    def visit_Name(self, node: ast.Name) -> ast.AST:
        if node.id in CLASSES:
            return ast.Name("BlockingMoving" if node.id == "Moving" else f"Blocking{node.id}")
        origin = origins(self.module).get(node.id)
        if origin is None:
            return node  # a builtin
        name = PER_MODULE.get(origin, node.id)
        kind = getattr(importlib.import_module(self.module), node.id, None)
        if isinstance(kind, TypeVar):
            name = "R" if kind.__bound__ is None else "E" if kind.__bound__ is Event else "V"
            origin = "canopen_master.blocking.twin", name
        if node.id == "AbstractAsyncContextManager":
            name, origin = "AbstractContextManager", ("contextlib", "AbstractContextManager")
        if node.id == "Pieces":
            self.used["Iterable"] = "collections.abc", "Iterable"
            self.used["Buffer"] = "canopen_proto.sdo.transfer", "Buffer"
            return ast.parse("Iterable[Buffer]", mode="eval").body
        if value_of(*self.used.setdefault(name, origin)) is not value_of(*origin):
            raise SystemExit(f"{name} of {origin} is also {self.used[name]}: see PER_MODULE")
        return ast.Name(name)

    def text(self, node: ast.AST | None) -> str:
        """Return an annotation or a default as it is written."""
        if node is None:
            return ""
        copy = ast.parse(ast.unparse(node), mode="eval").body
        return ast.unparse(self.visit(copy)).replace("'", '"')


class Parameter(NamedTuple):
    """One parameter. star: "*", "**", or "" ; is_keyword: only by keyword."""

    name: str
    annotation: str
    default: str
    star: str = ""
    is_keyword: bool = False
    original: str = ""

    @property
    def declared(self) -> str:
        text = f"{self.star}{self.name}" + (f": {self.annotation}" if self.annotation else "")
        return text + (f" = {self.default}" if self.default else "")

    @property
    def passed(self) -> str:
        value = self.name
        if re.search(r"\bBlocking\w+", self.annotation):
            if self.star:
                value = f"(each._inner for each in {self.name})"
            elif "None" in self.annotation:
                value = f"None if {self.name} is None else {self.name}._inner"
            else:
                value = f"{self.name}._inner"
        elif self.annotation == "Iterable[Buffer]":
            value = f"in_a_thread({self.name})"
        return f"{self.star}{value}" if self.star else f"{self.name}={value}" if self.is_keyword else value


Function = ast.FunctionDef | ast.AsyncFunctionDef


def parameters(node: Function, translator: Translator, *, skip: int) -> list[Parameter]:
    """Return the parameters of a function; the first `skip` are left out."""
    found = []
    arguments = node.args
    plain = [*arguments.posonlyargs, *arguments.args]
    defaults = [None] * (len(plain) - len(arguments.defaults)) + list(arguments.defaults)
    for argument, default in list(zip(plain, defaults, strict=True))[skip:]:
        found.append(Parameter(argument.arg, translator.text(argument.annotation), translator.text(default)))
    if arguments.vararg is not None:
        found.append(Parameter(arguments.vararg.arg, translator.text(arguments.vararg.annotation), "", "*"))
    for argument, default in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True):
        found.append(Parameter(argument.arg, translator.text(argument.annotation), translator.text(default), "", True))
    return found


def declared(each: Iterable[Parameter]) -> list[str]:
    """Return parameters as they are declared, with the star before those that go by keyword."""
    found: list[str] = []
    has_star = False
    for parameter in each:
        if parameter.is_keyword and not has_star:
            found.append("*")
            has_star = True
        has_star = has_star or parameter.star == "*"
        found.append(parameter.declared)
    return found


def fitted(before: str, items: list[str], after: str, indent: str) -> Iterator[str]:
    """Yield the lines of something with brackets, as the formatter would lay it out."""
    line = f"{indent}{before}{', '.join(items)}{after}"
    if len(line) <= WIDTH:
        yield line
        return
    yield f"{indent}{before}"
    inner = f"{indent}    {', '.join(items)}"
    if len(inner) <= WIDTH:
        yield inner
    else:
        yield from (f"{indent}    {item}," for item in items)
    yield f"{indent}{after}"


def said(text: str, indent: str) -> Iterator[str]:
    """Yield the lines of a docstring."""
    for pattern, replacement in WORDS:
        text = re.sub(pattern, replacement, text)
    paragraphs = []
    for number, paragraph in enumerate(text.split("\n\n")):
        if any(line.startswith("    ") for line in paragraph.splitlines()):
            paragraphs.append("\n".join(f"{indent}{line}" for line in paragraph.splitlines()))
            continue
        first = '"""' if number == 0 else ""
        filled = textwrap.fill(
            first + " ".join(paragraph.split()),
            WIDTH,
            initial_indent=indent,
            subsequent_indent=indent,
            break_long_words=False,
            break_on_hyphens=False,
        )
        paragraphs.append(filled)
    whole = "\n\n".join(paragraphs)
    is_one_line = "\n" not in whole and len(whole) + 3 <= WIDTH
    yield from (whole + '"""' if is_one_line else f'{whole}\n{indent}"""').splitlines()


def text_of(node: ast.AST) -> str:
    """Return the docstring of a class or function."""
    return ast.get_docstring(node) or ""  # type: ignore[arg-type]


def decorators(node: Function) -> list[str]:
    """Return the names of what decorates a function."""
    return [ast.unparse(each) for each in node.decorator_list]


def _place(name: str) -> tuple[int, str]:
    """Return where a name stands among those that are imported: constants, classes, functions."""
    return (0 if name.isupper() and len(name) > 1 else 1 if name.lstrip("_")[0].isupper() else 2), name


class Writer:
    """Writes the file. used: what it imports."""

    def __init__(self) -> None:
        self.used: dict[str, tuple[str, str]] = {}

    def returned(self, annotation: str, before: str, items: list[str] | None) -> Iterator[str]:
        """Yield the statements that return what a call gives, as its twin. before: the call; items: its arguments, None: it is a
        value."""
        indent = " " * 8
        kinds = re.findall(r"Blocking(\w+)", annotation)
        if not kinds:
            start = "" if annotation == "None" else "return "
            yield from [f"{indent}{start}{before}"] if items is None else fitted(f"{start}{before}(", items, ")", indent)
            return
        kind = kinds[-1]
        made, first = ("self._hub.twin", f"Blocking{kind}") if CLASSES[kind].is_kept else (f"Blocking{kind}", "self._hub")
        twin = f"{made}({first}, "
        found = before if items is None else f"{before}({', '.join(items)})"
        if annotation.startswith("dict[tuple["):
            yield f"{indent}return {{"
            yield f"{indent}    (self._hub.twin(Blocking{kinds[0]}, node), axis): {twin}each)"
            yield f"{indent}    for (node, axis), each in dict({found}).items()"
            yield f"{indent}}}"
        elif annotation.startswith(("dict[", "Mapping[")):
            if items:
                yield from fitted(f"found = {before}(", items, ")", indent)
                found = "found"
            yield f"{indent}return {{name: {twin}each) for name, each in dict({found}).items()}}"
        elif annotation.startswith("tuple["):
            yield f"{indent}return tuple({twin}each) for each in {found})"
        else:
            yield from fitted(f"return {made}(", [first, found], ")", indent)

    def method(self, owner: str, node: Function, module: str) -> Iterator[str]:
        """Yield the lines of a method."""
        translator = Translator(module, self.used)
        given = parameters(node, translator, skip=1)
        marks, name, key = decorators(node), node.name, f"{owner}.{node.name}"
        returns = translator.text(node.returns)
        is_context = any(each.endswith("asynccontextmanager") for each in marks) or "AbstractContextManager" in returns
        takes_timeout = (
            isinstance(node, ast.AsyncFunctionDef) and not is_context and all(each.name != "timeout" for each in given)
        )
        shown = [*given, Parameter("timeout", "float | None", "None", "", True)] if takes_timeout else given
        if "overload" in marks:
            self.used["overload"] = "typing", "overload"
            yield "    @overload"
            yield from fitted(f"def {name}(", ["self", *declared(shown)], f") -> {returns}: ...", "    ")
            return
        passed = [each.passed for each in given]
        if "property" in marks:
            yield "    @property"
            yield f"    def {name}(self) -> {returns}:"
            yield from said(text_of(node) or f"See the async {owner}.", " " * 8)
            if key in CONSTANT:
                yield f"        return self._inner.{name}"
            else:
                yield from self.returned(returns, "self._hub.do", [f"lambda: self._inner.{name}"])
            return
        if f"{name}.setter" in marks:
            yield f"    @{name}.setter"
            yield f"    def {name}(self, {given[0].declared}) -> None:"
            yield f'        self._hub.do(setattr, self._inner, "{name}", {given[0].name})'
            return
        if is_context:
            self.used["AbstractContextManager"] = "contextlib", "AbstractContextManager"
            inner = re.sub(r"^(AsyncIterator|AbstractContextManager)\[(.*)\]$", r"\2", returns)
            self.used.pop("AsyncIterator", None)
            yield from fitted(f"def {name}(", ["self", *declared(shown)], f") -> AbstractContextManager[{inner}]:", "    ")
            yield from said(text_of(node), " " * 8)
            yield from fitted(
                "return self._hub.context(", [inner, f"lambda: self._inner.{name}({', '.join(passed)})"], ")", " " * 8
            )
            return
        if key in RENAMED:
            yield f"    def {RENAMED[key]}(self) -> None:"
            yield from said(text_of(node), " " * 8)
            yield f"        self._hub.end(self._inner.{name})"
            return
        yield from fitted(f"def {name}(", ["self", *declared(shown)], f") -> {returns}:", "    ")
        yield from said(text_of(node), " " * 8)
        if isinstance(node, ast.AsyncFunctionDef):
            limit = "timeout" if takes_timeout else "None"
            yield from self.returned(returns, "self._hub.run", [limit, f"self._inner.{name}", *passed])
        elif key in AT_THE_END:
            yield f"        self._hub.do_at_the_end(self._inner.{name})"
        elif key in IN_THE_CALLER:
            yield from self.returned(returns, f"self._inner.{name}", passed)
        else:
            yield from self.returned(returns, "self._hub.do", [f"self._inner.{name}", *passed])

    def attribute(self, owner: str, name: str, annotation: str, module: str) -> Iterator[str]:
        """Yield the lines of a property that stands for an attribute: read in the caller's thread, since that is one step."""
        shown = Translator(module, self.used).text(ast.parse(annotation, mode="eval").body)
        if "Blocking" not in shown:
            self.used["Final"] = "typing", "Final"
            yield f'    {name}: Final[{shown}] = attribute("{name}", "{owner}")'
            return
        yield "    @property"
        yield f"    def {name}(self) -> {shown}:"
        yield f'        """As of the async {owner}; see the text of this class."""'
        yield from self.returned(shown, f"self._inner.{name}", None)

    def special(self, owner: str, node: Function, module: str) -> Iterator[str]:
        """Yield what stands for an async iterator, and for a context manager that only closes."""
        returns = Translator(module, self.used).text(node.returns)
        self.used["Self"] = "typing", "Self"
        match node.name:
            case "__aiter__":
                yield "    def __iter__(self) -> Self:"
                yield "        return self"
            case "__anext__":
                yield f"    def __next__(self) -> {returns}:"
                yield "        return self._hub.next(self._inner)"
            case "__aenter__":
                yield "    def __enter__(self) -> Self:"
                yield "        return self"
            case "__aexit__":
                yield "    def __exit__(self, *error: object) -> None:"
                yield "        self.close()"

    def members(self, owner: str, spec: Spec) -> Iterator[list[str]]:
        """Yield the lines of each member of a class."""
        module, _, name = spec.source.partition(":")
        cls = getattr(importlib.import_module(module), name)
        done: set[str] = set()
        for base in cls.__mro__:
            if base in (object,) or base.__module__ == "typing" or (spec.base == "BlockingMoving" and base.__name__ == "Moving"):
                continue
            where = base.__module__
            found = next(each for each in tree_of(where).body if isinstance(each, ast.ClassDef) and each.name == base.__name__)
            yield from self.attributes(owner, found, where, done)
            names_here: set[str] = set()
            for node in found.body:
                if not isinstance(node, Function) or node.name in done or f"{owner}.{node.name}" in LEFT_OUT:
                    continue
                names_here.add(node.name)
                if not node.name.startswith("_"):
                    yield list(self.method(owner, node, where))
                elif lines := list(self.special(owner, node, where)):
                    yield lines
            done |= names_here

    def attributes(self, owner: str, found: ast.ClassDef, module: str, done: set[str]) -> Iterator[list[str]]:
        properties = {node.name for node in found.body if isinstance(node, Function)}
        init = next((node for node in found.body if isinstance(node, ast.FunctionDef) and node.name == "__init__"), None)
        for node in ast.walk(init) if init is not None else ():
            match node:
                case ast.AnnAssign(target=ast.Attribute(ast.Name("self"), name)):
                    pairs = [(name, ast.unparse(node.annotation))]
                case ast.Assign():
                    targets = [each for target in node.targets for each in getattr(target, "elts", [target])]
                    pairs = [
                        (each.attr, ATTRIBUTES.get(f"{owner}.{each.attr}", ""))
                        for each in targets
                        if isinstance(each, ast.Attribute) and ast.unparse(each.value) == "self"
                    ]
                case _:
                    continue
            for name, annotation in pairs:
                if name.startswith("_") or name in done or name in properties or f"{owner}.{name}" in LEFT_OUT:
                    continue
                if not annotation:
                    raise SystemExit(f"of which type is {owner}.{name}? ATTRIBUTES has to tell")
                done.add(name)
                yield list(self.attribute(owner, name, annotation, module))

    def a_class(self, owner: str, spec: Spec) -> Iterator[str]:
        """Yield the lines of a class."""
        module, _, name = spec.source.partition(":")
        cls = getattr(importlib.import_module(module), name)
        self.used[name] = module, name
        found = next(each for each in tree_of(module).body if isinstance(each, ast.ClassDef) and each.name == name)
        is_generic = bool(getattr(cls, "__parameters__", ()))
        if is_generic:
            self.used["E"] = "canopen_master.blocking.twin", "E"
            base = f"Twin[{name}[E]], Generic[E]"
            self.used["Generic"] = "typing", "Generic"
        elif spec.base == "Twin":
            base = f"Twin[{name}]"
        elif spec.base == "BlockingMoving":
            base = spec.base
        else:
            base = spec.base
        yield f"class Blocking{owner}({base}):"
        yield from said(self.class_text(owner, found, module), "    ")
        if spec.base == "BlockingMoving":
            yield ""
            yield f"    _inner: {name}"
        if owner == "DriveCommissioning":
            yield ""
            init = next(node for node in found.body if isinstance(node, ast.FunctionDef) and node.name == "__init__")
            given = parameters(init, Translator(module, self.used), skip=1)
            yield from fitted("def __init__(", ["self", *declared(given)], ") -> None:", "    ")
            yield "        hub = master._hub"
            yield f"        super().__init__(hub, hub.do({owner}, {', '.join(each.passed for each in given)}))"
        for member in self.members(owner, spec):
            if member:
                if not (member[0].strip() != "@overload" and self.last == "@overload"):
                    yield ""
                self.last = member[0].strip()
                yield from member

    last = ""

    def class_text(self, owner: str, node: ast.ClassDef, module: str) -> str:
        text = text_of(node)
        return f"The blocking {owner}. {text.removeprefix('See this module' + chr(39) + 's text. ')}"

    def function(self, name: str, source: str) -> Iterator[str]:
        """Yield the lines of a function."""
        module = source.partition(":")[0]
        node = next(each for each in tree_of(module).body if isinstance(each, Function) and each.name == name)
        translator = Translator(module, self.used)
        given = parameters(node, translator, skip=0)
        returns = translator.text(node.returns)
        passed = [each.passed for each in given]
        self.used[f"_{name}"] = module, name
        if name == "open_master":
            yield from fitted(f"def {name}(", declared(given), ") -> BlockingMaster:", "")
            yield from said(text_of(node), "    ")
            yield "    return open_session("
            yield "        BlockingMaster,"
            yield from fitted(f"_{name}(", passed, "),", " " * 8)
            yield "    )"
        elif any(each.endswith("asynccontextmanager") for each in decorators(node)):
            inner = re.sub(r"^AsyncIterator\[(.*)\]$", r"\1", returns)
            self.used.pop("AsyncIterator", None)
            self.used["AbstractContextManager"] = "contextlib", "AbstractContextManager"
            yield from fitted(f"def {name}(", declared(given), f") -> AbstractContextManager[{inner}]:", "")
            yield from said(text_of(node), "    ")
            yield from fitted("return open_context(", [inner, f"lambda: _{name}({', '.join(passed)})"], ")", "    ")
        elif name == "together":
            yield from fitted(f"def {name}(", declared(given), f") -> {returns}:", "")
            yield from said(text_of(node), "    ")
            yield "    if not chains:"
            yield "        together_of_none()"
            yield "    hub = chains[0]._hub"
            yield f"    return {returns}(hub, hub.do(_{name}, {', '.join(passed)}))"
        else:
            shown = [*given, Parameter("timeout", "float | None", "None", "", True)]
            yield from fitted(f"def {name}(", declared(shown), f") -> {returns}:", "")
            yield from said(text_of(node), "    ")
            yield from fitted(f"return {given[0].name}._hub.run(", ["timeout", f"_{name}", *passed], ")", "    ")

    def imports(self, body: str) -> Iterator[str]:
        """Yield the imports of the file."""
        modules: dict[str, list[str]] = {}
        names = {node.id for node in ast.walk(ast.parse(body)) if isinstance(node, ast.Name)}
        for name, (module, original) in self.used.items():
            if name in names:
                modules.setdefault(module, []).append(original if original == name else f"{original} as {name}")
        for is_ours in (False, True):
            for module in sorted(each for each in modules if each.startswith("canopen_") == is_ours):
                plain = sorted((each for each in modules[module] if " as " not in each), key=_place)
                for statement in ([plain] if plain else []) + [[each] for each in sorted(modules[module]) if " as " in each]:
                    line = f"from {module} import {', '.join(statement)}"
                    wrapped = [f"from {module} import (", *(f"    {each}," for each in statement), ")"]
                    yield from [line] if len(line) <= WIDTH else wrapped
            yield ""

    def page(self) -> str:
        """Return the text of the file."""
        lines: list[str] = []
        for owner, spec in CLASSES.items():
            lines += [*self.a_class(owner, spec), "", ""]
        for name, source in FUNCTIONS.items():
            lines += [*self.function(name, source), "", ""]
        body = "\n".join(lines).rstrip() + "\n"
        twin = "canopen_master.blocking.twin"
        self.used.update({name: (twin, name) for name in FROM_TWIN})
        head = [
            '"""The blocking forms of the master, its nodes, drives and chains.',
            "",
            "Made from the async classes by `python docs/blocking_classes.py`: change those, not this file.",
            '"""',
            "",
            "from __future__ import annotations",
            "",
            *self.imports(body),
            "",
            "",
        ]
        return "\n".join(head) + body


def text() -> str:
    """Return the text of the file."""
    return Writer().page()


def main() -> None:
    PATH.write_text(text(), encoding="utf-8")
    print(PATH)


if __name__ == "__main__":
    main()
