"""`LineWriter`: lines for stdout whose reader may be slow: a pager, a terminal that is stopped (Ctrl-S), a program in a pipe.

A bus does not wait. So a thread writes, while the command goes on listening. If FULL lines wait, further ones are left out and
counted, until the reader has taken half of them; a line at their place says how many are missing. A recording waits, and nothing
is left out.
"""

from __future__ import annotations

import os
import select
import stat
import sys
from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from typing import IO, Final

import trio

from canopen_cli.shared.screen import Screen

FULL: Final = 20_000
"""Lines that wait for the reader: some seconds of a bus at full load."""
CHUNK: Final = 500
"""Lines that are written at once."""
LAST_WORDS: Final = 0.5
"""Seconds for what is still to be written when the command is interrupted."""
LOOK: Final = 1.0
"""Seconds between two looks whether there is still a reader: on a bus without frames nothing is written that would tell."""


class LineWriter:
    """See this module's text. left_out: how many lines were left out."""

    def __init__(self, missing: Callable[[int], str], *, waits: bool, clear: Callable[[], None] | None = None) -> None:
        """missing: makes the line that tells how many are missing. waits: for the reader, instead of leaving lines out. clear: is
        called before lines are written."""
        self.left_out = 0
        self._missing = missing
        self._waits = waits
        self._clear = clear
        self._lines: deque[str] = deque()
        self._gap = 0
        self._in_hand = 0
        self._is_ended = False
        self._is_stuck = False
        self._has_lines = trio.Event()
        self._has_room = trio.Event()
        self._is_written = trio.Event()
        self._descriptor = _descriptor_of(sys.stdout)

    @property
    def waiting(self) -> int:
        """How many lines are not yet written."""
        return len(self._lines) + self._in_hand

    async def put(self, line: str) -> None:
        """Write a line, with its end. Returns at once, unless this writer waits for its reader."""
        while self._waits and len(self._lines) >= FULL:
            self._has_room = trio.Event()
            await self._has_room.wait()
        if self._gap and len(self._lines) <= FULL // 2:
            self._tell_gap()
        if self._gap or len(self._lines) >= FULL:
            self._gap += 1
            self.left_out += 1
        else:
            self._lines.append(line)
        self._has_lines.set()

    async def finish(self) -> None:
        """Wait until all is written."""
        self._is_ended = True
        if self._gap:
            self._tell_gap()
        self._has_lines.set()
        await self._is_written.wait()

    def _tell_gap(self) -> None:
        self._lines.append(self._missing(self._gap))
        self._gap = 0

    async def run(self) -> None:
        """Write what comes, until `finish`."""
        try:
            while self._lines or not self._is_ended:
                await self._write_next()
        except trio.Cancelled:
            with trio.move_on_after(LAST_WORDS, shield=True):
                while self._lines and not self._is_stuck:
                    await self._write_next()
            self.left_out += self.waiting
            raise
        self._is_written.set()

    async def _write_next(self) -> None:
        if not self._lines:
            self._has_lines = trio.Event()
            await self._has_lines.wait()
            return
        taken = [self._lines.popleft() for _ in range(min(CHUNK, len(self._lines)))]
        self._in_hand = len(taken)
        if self._clear is not None:
            self._clear()
        await self._write("".join(taken))
        self._in_hand = 0
        self._has_room.set()

    async def _write(self, text: str) -> None:
        if self._descriptor is None:
            sys.stdout.write(text)
            sys.stdout.flush()
            await trio.lowlevel.checkpoint()
            return
        descriptor, data = self._descriptor, text.encode(sys.stdout.encoding, sys.stdout.errors or "replace")
        is_done, failures = trio.Event(), list[OSError]()
        token = trio.lowlevel.current_trio_token()

        def write() -> None:
            try:
                _write_all(descriptor, data)
            except OSError as error:
                failures.append(error)

        def tell(_: object) -> None:
            with suppress(trio.RunFinishedError):  # given up below
                token.run_sync_soon(is_done.set)

        trio.lowlevel.start_thread_soon(write, tell)
        try:
            await is_done.wait()
        except trio.Cancelled:
            with trio.move_on_after(LAST_WORDS, shield=True):
                await is_done.wait()
            if not is_done.is_set():
                self._is_stuck = True
                raise
        if failures:
            raise failures[0]


@asynccontextmanager
async def open_line_writer(
    screen: Screen, missing: Callable[[int], str], *, waits: bool, clear: Callable[[], None] | None = None
) -> AsyncIterator[LineWriter]:
    """Give a writer while the block runs, and write at its end what is left; see LineWriter. Raises what the block raises, and
    OSError if the reader has gone; both in a group."""
    writer = LineWriter(missing, waits=waits, clear=clear)
    async with trio.open_nursery() as nursery:
        nursery.start_soon(writer.run)
        if not waits:
            nursery.start_soon(_look_for_reader, screen)
        try:
            yield writer
        except Exception:
            await writer.finish()
            raise
        await writer.finish()
        nursery.cancel_scope.cancel()


async def _look_for_reader(screen: Screen) -> None:
    while True:
        screen.check_reader()
        await trio.sleep(LOOK)


def _descriptor_of(stream: IO[str]) -> int | None:
    """Return the descriptor of a stream that may make its writer wait; None for a file, a test, a notebook, and on Windows."""
    try:
        descriptor = stream.fileno()
        waits = os.name == "posix" and not stat.S_ISREG(os.fstat(descriptor).st_mode)
    except (OSError, ValueError):
        return None
    return descriptor if waits else None


def _write_all(descriptor: int, data: bytes) -> None:
    while data:
        try:
            data = data[os.write(descriptor, data) :]
        except BlockingIOError:  # somebody else with this terminal has made it so
            select.select([], [descriptor], [])
