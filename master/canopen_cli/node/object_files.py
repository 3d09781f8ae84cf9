"""`canopen read -o FILE` and `canopen write --file FILE`: move objects into files and back, piece by piece.

The bytes are those of the wire. If the device has block transfer, no object is held whole in memory. A checksum ends the
transfer: the file gets its new content (`whole_file`) only if the checksum was right, so a broken transfer destroys no good file.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import IO, Any, Final

import trio

from canopen_cli.shared.problem import CommandError, ExitCode, cannot_read
from canopen_cli.shared.screen import Screen, counted, escape, node_text
from canopen_cli.shared.values import object_json
from canopen_master.node import Node
from canopen_proto.dictionary import Variable
from canopen_proto.sdo.client import Block

PIECE: Final = 4096
"""Bytes read from a file at once."""
PATIENCE: Final = 1.0
"""Seconds before progress is shown: most transfers take less."""
REDRAW: Final = 0.1
"""Seconds between two updates of the progress."""
ROUNDS: Final = "the device rounds or limits the value, or it is a command that takes effect and vanishes"


@dataclass
class FileTransfer:
    """A finished transfer. seconds: how long it took."""

    node_id: int
    variable: Variable
    path: str
    size: int
    seconds: float

    def __str__(self) -> str:
        rate = f", {self.size / self.seconds / 1000:.1f} kB/s" if self.seconds > 0 else ""
        return f"{self.size} bytes in {self.seconds:.2f} s{rate}"

    def as_json(self) -> dict[str, Any]:
        """Return the transfer for --json."""
        return {
            "node": self.node_id,
            **object_json(self.variable),
            "file": self.path,
            "bytes": self.size,
            "seconds": round(self.seconds, 3),
        }


async def read_into_file(
    screen: Screen, node: Node, variable: Variable, path: str, file: IO[bytes], block: Block
) -> FileTransfer:
    """Read an object into an open file. path: its name. Raises OSError, and what Node.read_stream raises."""
    started = trio.current_time()
    with progress(screen, node, variable, None) as show:
        async with node.read_stream(variable.index, variable.subindex, block=block) as stream:
            async for piece in stream:
                file.write(piece)
                show(stream.size)
    return FileTransfer(node.node_id, variable, path, stream.size, trio.current_time() - started)


async def write_from_file(screen: Screen, node: Node, variable: Variable, path: str, block: Block, verify: bool) -> FileTransfer:
    """Write the content of a file to an object, and with `verify` read it back and compare.

    Raises CommandError if the file cannot be read or the device reads back something else, and what Node.write_stream raises.
    """
    started = trio.current_time()
    with _opened(path) as file, progress(screen, node, variable, size_of(file)) as show:
        done = 0

        def pieces() -> Iterator[bytes]:
            nonlocal done
            while piece := file.read(PIECE):
                yield piece
                done += len(piece)
                show(done)

        await node.write_stream(variable.index, variable.subindex, pieces(), size_of(file), block=block)
    transfer = FileTransfer(node.node_id, variable, path, done, trio.current_time() - started)
    if verify:
        await _compare(screen, node, variable, path, block)
    return transfer


async def _compare(screen: Screen, node: Node, variable: Variable, path: str, block: Block) -> None:
    with _opened(path) as file, progress(screen, node, variable, size_of(file)) as show:
        async with node.read_stream(variable.index, variable.subindex, block=block) as stream:
            is_equal = True
            async for piece in stream:
                show(stream.size)
                is_equal = is_equal and file.read(len(piece)) == piece
            if is_equal and not file.read(1):
                return
    shown = f"something else: {counted(stream.size, 'byte')}"
    cause = "the device converts what it gets, or the object reads as something else than what was written"
    raise not_as_written(node.node_id, variable, path, shown, cause=cause)


def not_as_written(
    node_id: int, variable: Variable, what: str, shown: str, *, seen: str = "", cause: str = ROUNDS
) -> CommandError:
    """Return the error of a node that took a value, and shows another. what: it took, for people."""
    failed = f"node {node_id} took {what} for {variable.label}, but shows {shown}"
    index, subindex = variable.index, variable.subindex
    return CommandError(
        ExitCode.VERIFY_MISMATCH, "CO205", failed, seen=seen, cause=cause, node=node_id, index=index, subindex=subindex
    )


def size_of(file: IO[bytes]) -> int | None:
    """Return the size of a file; None if only reading it tells (a pipe)."""
    status = os.fstat(file.fileno())
    return status.st_size if stat.S_ISREG(status.st_mode) else None


@contextmanager
def _opened(path: str) -> Iterator[IO[bytes]]:
    with ExitStack() as stack:
        try:
            file = stack.enter_context(open(path, "rb"))
        except OSError as error:
            raise cannot_read(path, error) from error
        yield file


@contextmanager
def progress(screen: Screen, node: Node, variable: Variable, size: int | None) -> Iterator[Callable[[int], None]]:
    """Show a bar on a terminal once the transfer lasts longer than PATIENCE. Gives a function to call with the bytes so far.
    size: bytes in all; None: not known."""
    # A file's alone:
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

    bar = Progress(
        TextColumn(f"{node_text(node.node_id)} {escape(variable.label)}"),
        BarColumn(),
        DownloadColumn(),
        TransferSpeedColumn(),
        TimeRemainingColumn(),
        console=screen.err,
        auto_refresh=False,  # it is drawn when bytes came, without a thread
        transient=True,
        get_time=trio.current_time,
    )
    task = bar.add_task("", total=size)
    drawn = trio.current_time() + PATIENCE - REDRAW

    def show(done: int) -> None:
        nonlocal drawn
        bar.update(task, completed=done)
        if screen.draws and trio.current_time() >= drawn + REDRAW:
            drawn = trio.current_time()
            bar.start()
            bar.refresh()

    try:
        yield show
    finally:
        bar.stop()
