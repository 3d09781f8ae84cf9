"""`canopen read` and `canopen write`: read and write objects of a node by SDO, by name or number."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any, Protocol

import click

from canopen_cli.node.object_files import FileTransfer, not_as_written, read_into_file, write_from_file
from canopen_cli.shared.dry_run import run_or_show
from canopen_cli.shared.new_files import check_new_file, new_file
from canopen_cli.shared.numbers import NumberCommand
from canopen_cli.shared.options import NodeOfObject, Settings, command, commanding, enabling, together, with_named_object
from canopen_cli.shared.over_text import is_text_gateway, refuse_over_text
from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, escape, node_text
from canopen_cli.shared.session import open_session
from canopen_cli.shared.values import (
    BYTES,
    TYPES,
    as_json,
    block_of,
    find_object,
    hex_text,
    object_json,
    parse_value,
    physical,
    physical_text,
    place_text,
    value_text,
)
from canopen_master.errors import SdoRefusedError
from canopen_master.node import Node
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import ObjectDictionary, Variable

if TYPE_CHECKING:
    from canopen_cli.shared.text_gateway import TextSession


@dataclass(frozen=True)
class AccessRequest:
    """The choices of the command line. type_name, block: see --type and --block; None if not given."""

    node_id: int
    type_name: str | None
    block: bool | None
    verify: bool = False


_accessing = together(
    "request",
    AccessRequest,
    click.option(
        "--type",
        "type_name",
        type=click.Choice(list(TYPES)),
        help="Of an object that the dictionary does not have, such as 2000:01.",
    ),
    click.option(
        "--block/--no-block",
        default=None,
        help="By SDO block transfer, or never so. By default where it pays and the device can.",
    ),
)
"""The options of an access. The command has its argument `node_id` besides, perhaps `verify`, and takes `request`."""


@dataclass
class ObjectReading:
    """The value of an object as it was read."""

    node_id: int
    variable: Variable
    value: Value
    constants: tuple[str, ...]

    def row(self) -> tuple[str, str, str, str, str]:
        """Return the cells for a table."""
        place, name = place_text(self.variable), escape(self.variable.name)
        words = escape(", ".join(self.constants))
        meaning = physical_text(self.variable, self.value)
        value = value_text(self.variable, self.value) + (f" = {meaning}" if meaning else "")
        return place, name, escape(value), hex_text(self.variable, self.value), words

    def as_json(self) -> dict[str, Any]:
        """Return the value for --json."""
        return {
            "node": self.node_id,
            **object_json(self.variable),
            "type": self.variable.data_type.name,
            "value": as_json(self.variable, self.value),
            "hex": hex_text(self.variable, self.value) or None,
            "constants": list(self.constants),
            "physical": physical(self.variable, self.value),
            "unit": self.variable.unit,
        }


COLUMNS = ("object", "name", "value", "hex", "constants")


async def read_object(node: Node, variable: Variable, block: bool | None = None) -> ObjectReading:
    """Read an object, also one that the node's dictionary lacks. block: see --block; None decides by the object."""
    how = block_of(variable, block)
    if node.dictionary.get(variable.index, variable.subindex) is not None:
        message = await node.read_message(variable, block=how)
        return ObjectReading(node.node_id, variable, message.value, message.constants)
    value = variable.decode(await node.read_bytes(variable.index, variable.subindex, block=how))
    return ObjectReading(node.node_id, variable, value, ())


@command()
@click.argument("node_id", metavar="NODE", type=NodeOfObject())
@click.argument("keys", metavar="OBJECT...", nargs=-1)
@_accessing
@click.option("-o", "--output", metavar="FILE", help="Write the bytes of the object, as they come, into a file.")
def read(settings: Settings, screen: Screen, request: AccessRequest, keys: tuple[str, ...], output: str | None) -> int:
    """Read objects of a node. Exit status 7: the node refused some of them.

    An OBJECT is a name (statusword, identity_object:vendor_id) or a number in hexadecimal (6041, 0x6041, 60C1:01).

    \b
    canopen read 3 statusword -b demo
    canopen read 3:statusword -b demo
    canopen read 3 6041 6064 --json -b demo
    canopen read 3 1008 -o name.bin -b demo
    """
    keys = with_named_object(keys, request.node_id)
    refuse_over_text(settings, output=output, block=request.block)
    if output is not None:
        _refuse_type(request.type_name)
        if len(keys) > 1:
            raise usage("CO001", f"one file takes one object, not {len(keys)}")
        check_new_file(settings, screen, output)
        with new_file(output) as file:  # opening a pipe waits for its reader: do it here, where Ctrl-C ends the wait
            taken = run(settings, screen, lambda: _read_file(settings, screen, request, keys[0], output, file))
        _tell_file(settings, screen, taken, "→")
        return ExitCode.OK
    readings, refused = run(settings, screen, lambda: _read(settings, screen, request, keys), over_text=True)
    if settings.json:
        documents = [reading.as_json() for reading in readings]
        screen.json(documents if len(keys) > 1 else documents[0])
    else:
        screen.say(f"[bold]{node_text(request.node_id)}[/]")
        screen.table(COLUMNS, [reading.row() for reading in readings], right=("value", "hex"))
    for place, why in refused:
        screen.say(f"[yellow]not read: {place}: {escape(why)}[/]")
    return ExitCode.PARTIAL if refused else ExitCode.OK


class ObjectWay(Protocol):
    """A way to the objects of a node. dictionary: of the node."""

    @property
    def dictionary(self) -> ObjectDictionary: ...

    async def read(self, variable: Variable) -> ObjectReading:
        """Read an object, also one that the dictionary lacks."""

    async def write(self, variable: Variable, value: Value) -> None:
        """Write an object, also one that the dictionary lacks."""


class _OverBus:
    """The way over a bus. block: see --block."""

    def __init__(self, node: Node, block: bool | None) -> None:
        self.dictionary = node.dictionary
        self._node = node
        self._block = block

    async def read(self, variable: Variable) -> ObjectReading:
        return await read_object(self._node, variable, self._block)

    async def write(self, variable: Variable, value: Value) -> None:
        how = block_of(variable, self._block)
        if self.dictionary.get(variable.index, variable.subindex) is not None:
            await self._node.write(variable, value, block=how)
        else:
            await self._node.write_bytes(variable.index, variable.subindex, variable.encode(value), block=how)


class _OverText:
    """The way over a text gateway."""

    def __init__(self, session: TextSession, node_id: int) -> None:
        self.dictionary = session.files.dictionary_of(node_id)
        self._gateway = session.gateway
        self._node_id = node_id

    async def read(self, variable: Variable) -> ObjectReading:
        value = variable.decode(await self._gateway.read(self._node_id, variable.index, variable.subindex))
        return ObjectReading(self._node_id, variable, value, _constants(self.dictionary, variable, value))

    async def write(self, variable: Variable, value: Value) -> None:
        await self._gateway.write(self._node_id, variable.index, variable.subindex, variable.encode(value))


def _constants(dictionary: ObjectDictionary, variable: Variable, value: Value) -> tuple[str, ...]:
    return dictionary.names_of(variable, value) if variable in dictionary else ()


@asynccontextmanager
async def _way(settings: Settings, screen: Screen, request: AccessRequest, *, writes: bool) -> AsyncIterator[ObjectWay]:
    """Open the way to a node's objects, over the bus or text gateway of the options. writes: else it only reads, and waits for
    its turn."""
    if is_text_gateway(settings.named_bus()):
        from canopen_cli.shared.text_gateway import open_text  # only here: a client of its own

        async with open_text(settings, screen) as text:
            yield _OverText(text, request.node_id)
        return
    async with AsyncExitStack() as stack:
        session = await stack.enter_async_context(open_session(settings, screen))
        if not writes:
            await stack.enter_async_context(session.turn(request.node_id))
        yield _OverBus(session.node(request.node_id), request.block)


async def _read(
    settings: Settings, screen: Screen, request: AccessRequest, keys: tuple[str, ...]
) -> tuple[list[ObjectReading], list[tuple[str, str]]]:
    """Return what was read, and which objects the node refused, with the reason. Raises the first refusal if nothing was read."""
    async with _way(settings, screen, request, writes=False) as way:
        variables = [find_object(way.dictionary, key, request.type_name) for key in keys]
        for variable in variables:
            _tell_other_type(screen, way.dictionary, variable, request)
            _check_readable(variable)
        readings: list[ObjectReading] = []
        refused: list[tuple[Variable, SdoRefusedError]] = []
        for variable in variables:
            try:
                readings.append(await way.read(variable))
            except SdoRefusedError as error:
                refused.append((variable, error))
        if not readings:
            raise refused[0][1]
        return readings, [(place_text(variable), f"{error.failed}: {error.seen}") for variable, error in refused]


async def _read_file(
    settings: Settings, screen: Screen, request: AccessRequest, key: str, output: str, file: IO[bytes]
) -> FileTransfer:
    async with open_session(settings, screen) as session, session.claim(request.node_id):
        node = session.node(request.node_id)
        variable = find_object(node.dictionary, key, BYTES)
        _check_readable(variable)
        return await read_into_file(screen, node, variable, output, file, block_of(variable, request.block))


def _refuse_type(type_name: str | None) -> None:
    """Raise a CommandError for a --type where a file is: it would say nothing."""
    if type_name is not None:
        raise usage("CO001", "a file has the bytes of the object as they are: no --type", tries=("the same without --type",))


def _tell_other_type(screen: Screen, dictionary: ObjectDictionary, variable: Variable, request: AccessRequest) -> None:
    """Say that the dictionary has another type than the command line, and that its type is taken."""
    if request.type_name is None or dictionary.get(variable.index, variable.subindex) is None:
        return
    if variable.data_type is not TYPES[request.type_name]:
        known = f"{place_text(variable)} is {variable.data_type.name} in the dictionary"
        screen.say(f"[yellow]{known}: --type {request.type_name} does not count for it[/]")


def _check_readable(variable: Variable) -> None:
    if not variable.access.readable:
        raise usage("CO303", f"{variable.label} is write-only", seen="nothing was sent")


def _check_writable(variable: Variable) -> None:
    if not variable.access.writable:
        raise usage("CO303", f"{variable.label} is {variable.access}: it cannot be written", seen="nothing was sent")


def _write_only(variable: Variable) -> CommandError:
    """Return the error of --verify for an object that cannot be read back."""
    label, tries = variable.label, ("the same without --verify",)
    return usage("CO303", f"{label} is write-only: it cannot be read back", seen="nothing was written", tries=tries)


async def _value_before(way: ObjectWay, variable: Variable) -> ObjectReading | None:
    """Read an object before it is written. None if it is write-only, by the dictionary or by the device itself."""
    if not variable.access.readable:
        return None
    try:
        return await way.read(variable)
    except SdoRefusedError as error:
        if error.abort_code != AbortCode.WRITE_ONLY:
            raise
        return None


def _tell_file(settings: Settings, screen: Screen, transfer: FileTransfer, arrow: str, **more: Any) -> None:
    if settings.json:
        screen.json({**transfer.as_json(), **more})
    else:
        place = f"{node_text(transfer.node_id)} {escape(transfer.variable.label)}"
        screen.data(f"{place} [bold]{arrow} {escape(transfer.path)}[/]: {transfer}")


@command(cls=NumberCommand)
@click.argument("node_id", metavar="NODE", type=NodeOfObject())
@click.argument("words", metavar="OBJECT [VALUE]", nargs=-1)
@_accessing
@click.option("--file", "path", metavar="FILE", help="Write what a file holds, instead of a VALUE.")
@click.option("--verify", is_flag=True, help="Read it back; exit status 13 where it is not what was written.")
@enabling
@commanding
def write(settings: Settings, screen: Screen, request: AccessRequest, words: tuple[str, ...], path: str | None) -> None:
    """Write an object of a node, and show its value before and after.

    A VALUE is a number (12, 0x0C, -5), or the name of a constant. A value that does not fit the object is refused
    before anything is sent.

    \b
    canopen write 3 controlword sm_shutdown -b demo
    canopen write 3 6081 20000 -b demo
    canopen write 5 1F50:01 --file firmware.bin
    """
    key, *values = with_named_object(words, request.node_id)
    if len(values) > 1:
        raise usage("CO001", f"one VALUE is written, not {len(values)}", tries=("a text with blanks in quotes",))
    text = values[0] if values else None
    refuse_over_text(settings, file=path, block=request.block, dry_run=settings.dry_run)
    if path is not None and text is None:
        _refuse_type(request.type_name)
        written = run_or_show(settings, screen, lambda: _write_file(settings, screen, request, key, path))
        _tell_file(settings, screen, written, "←", verified=request.verify)
        return
    if path is not None or text is None:
        raise usage("CO001", "give either a VALUE or --file FILE", tries=("canopen write --help",))
    before, after = run_or_show(settings, screen, lambda: _write(settings, screen, request, key, text), over_text=True)
    if settings.json:
        previous = None if before is None else as_json(before.variable, before.value)
        screen.json({**after.as_json(), "previous": previous, "verified": request.verify})
        return
    old = "?" if before is None else _shown(before)
    screen.data(f"{node_text(request.node_id)} {escape(after.variable.label)}: {escape(old)} [bold]→ {escape(_shown(after))}[/]")


def _shown(reading: ObjectReading) -> str:
    numbers = (hex_text(reading.variable, reading.value), physical_text(reading.variable, reading.value))
    number = ", ".join(text for text in numbers if text)
    words = f" [{', '.join(reading.constants)}]" if reading.constants else ""
    return f"{value_text(reading.variable, reading.value)}{f' ({number})' if number else ''}{words}"


async def _write_file(settings: Settings, screen: Screen, request: AccessRequest, key: str, path: str) -> FileTransfer:
    async with open_session(settings, screen) as session, session.claim_to_write(request.node_id):
        node = session.node(request.node_id)
        variable = find_object(node.dictionary, key, BYTES)
        _check_writable(variable)
        if request.verify and not variable.access.readable:
            raise _write_only(variable)
        return await write_from_file(screen, node, variable, path, block_of(variable, request.block), request.verify)


async def _write(
    settings: Settings, screen: Screen, request: AccessRequest, key: str, text: str
) -> tuple[ObjectReading | None, ObjectReading]:
    async with _way(settings, screen, request, writes=True) as way:
        node_id, dictionary = request.node_id, way.dictionary
        variable = find_object(dictionary, key, request.type_name)
        _tell_other_type(screen, dictionary, variable, request)
        value = parse_value(dictionary, variable, text)
        _check_writable(variable)
        variable.check_limits(value)
        variable.encode(value)  # raises before anything is sent
        before = await _value_before(way, variable)
        if request.verify and before is None:
            raise _write_only(variable)
        await way.write(variable, value)
        after = ObjectReading(node_id, variable, value, _constants(dictionary, variable, value))
        if request.verify:
            shown = await way.read(variable)
            if shown.value != value:
                raise not_as_written(node_id, variable, _shown(after), _shown(shown))
        return before, after
