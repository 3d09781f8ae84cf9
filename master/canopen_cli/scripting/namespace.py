"""The names that a script of `canopen run`, and a line of `canopen shell`, find: `master`, `node`, `nodes`, `bus`, `args`."""

from __future__ import annotations

import ast
import builtins
import codeop
import inspect
import traceback
import types
from collections.abc import Iterator, Sequence
from typing import Any, Final

from canopen_cli.shared.failures import problem_of
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_cli.shared.session import BusSession
from canopen_master.node import Node

_INTERNAL: Final = "CO900"
_FLAGS: Final = ast.PyCF_ALLOW_TOP_LEVEL_AWAIT


class Nodes:
    """The nodes of the bus: `nodes[5]`, or `nodes["lift"]` of a machine file. Iterated: the node-IDs that were used."""

    def __init__(self, session: BusSession) -> None:
        self._session = session
        self._used: dict[int, Node] = {}

    def __getitem__(self, key: int | str) -> Node:
        node_id = self._session.files.settings.node_id(str(key))
        if node_id not in self._used:
            self._used[node_id] = self._session.node(node_id)
        return self._used[node_id]

    def __iter__(self) -> Iterator[int]:
        return iter(sorted(self._used))

    def __repr__(self) -> str:
        return f"<the nodes of {self._session.bus}: nodes[5]>"


def names_for(session: BusSession, node_id: int | None = None, args: Sequence[str] = ()) -> dict[str, Any]:
    """Return the names that the code finds. node_id: of `node`; None: there is none."""
    nodes = Nodes(session)
    names: dict[str, Any] = {
        "__name__": "__main__",
        "__builtins__": builtins,
        "master": session.master,
        "nodes": nodes,
        "bus": session.bus,
        "args": list(args),
    }
    if node_id is not None:
        names["node"] = nodes[node_id]
    return names


def compiled(text: str, name: str) -> types.CodeType:
    """Compile a whole script, in which `await` may stand at the top level. Raises SyntaxError, ValueError."""
    code: types.CodeType = compile(text, name, "exec", flags=_FLAGS, dont_inherit=True)
    return code


def line_compiler() -> codeop.CommandCompiler:
    """Return a function that compiles a statement of a prompt: None if it is not whole yet. It raises SyntaxError, ValueError,
    OverflowError."""
    compiler = codeop.CommandCompiler()
    compiler.compiler.flags |= _FLAGS
    return compiler


async def execute(code: types.CodeType, names: dict[str, Any]) -> None:
    """Run compiled code. Raises what it raises."""
    result = types.FunctionType(code, names)()
    if inspect.iscoroutine(result):
        await result


def failure_of(error: BaseException, name: str) -> CommandError:
    """Return the error for what code of a user has raised: that of the master, or its own, with the line in its file. name: of
    the file."""
    places = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == name]
    line = places[-1] if places else error.lineno if isinstance(error, SyntaxError) else None
    place = f"{name}:{line}" if line else name
    known = problem_of(error)
    if known.code != _INTERNAL:
        known.also = [*known.also, f"at {place}"]
        return known
    text = error.msg if isinstance(error, SyntaxError) else str(error)
    failed = f"{place}: {type(error).__name__}{f': {text}' if text else ''}"
    tries = ["the same with -vv, for the traceback"]
    if isinstance(error, SyntaxError):
        tries.insert(0, "Python, as in  print(await nodes[5].read('statusword'))  : no words of the command line")
    problem = CommandError(ExitCode.DIFFERENT, "CO157", failed, tries=tries)
    problem.__cause__ = error
    return problem
