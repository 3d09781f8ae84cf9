"""Ctrl-C on asyncio, for a program that moves something.

`asyncio.run` cancels its main task at the first Ctrl-C, and raises KeyboardInterrupt at the next one: wherever the program is,
and also once more while it ends all tasks. While somebody holds here, our handler stands before that of asyncio:

- in the middle of a `protected` function a Ctrl-C waits for the next turn of the loop;
- while somebody waits for drives to stand (`wait`), it waits for the end of that;
- once a KeyboardInterrupt has ended the run, all tasks are being ended, and one more is dropped.

A handler of somebody else's, as Jupyter's, is called as asyncio's is. One that was set by `loop.add_signal_handler` knows nothing
of all this, and needs not: the loop calls it in a turn of its own.
"""

from __future__ import annotations

import asyncio
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, TypeAlias

from canopen_transports.loop.asyncio_parts import AsyncioToken
from canopen_transports.loop.protection import is_protected

_Handler: TypeAlias = Callable[[int, FrameType | None], Any]


class AsyncioInterrupts:
    """See this module's text. For the main thread; in another one no Ctrl-C comes, and nothing happens here."""

    def __init__(self, token: AsyncioToken) -> None:
        self._token = token
        self._holders = self._waiters = self._count = 0
        self._is_broken_off = False  # a KeyboardInterrupt has ended the run of the loop
        self._before: _Handler | None = None  # while our handler stands before it

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Do not interrupt protected functions in their middle."""
        self._holders += 1
        if self._holders == 1 and threading.current_thread() is threading.main_thread():
            before = signal.getsignal(signal.SIGINT)
            if callable(before):
                self._before = before
                signal.signal(signal.SIGINT, self._on_interrupt)
        try:
            yield
        finally:
            self._holders -= 1
            if not self._holders and self._before is not None:
                self._give_back(self._before)

    def _give_back(self, before: _Handler) -> None:
        if signal.getsignal(signal.SIGINT) == self._on_interrupt:
            # asyncio.run has given its own handler back already, if a Ctrl-C has ended it
            owner = getattr(getattr(before, "func", before), "__self__", None)
            is_over = self._is_broken_off and isinstance(owner, asyncio.Runner)
            signal.signal(signal.SIGINT, signal.default_int_handler if is_over else before)
        self._before = None
        self._is_broken_off = False

    @contextmanager
    def wait(self) -> Iterator[Callable[[], bool]]:
        """Let a Ctrl-C wait until the block is over; the function that it gives tells whether one has come."""
        with self.hold():
            self._waiters += 1
            count = self._count
            try:
                yield lambda: self._count > count
            finally:
                self._waiters -= 1
                if self._before is not None and self._count > count and not self._is_broken_off:
                    self._token.run_sync_soon(self._hand_on, self._before, signal.SIGINT, None)

    def _on_interrupt(self, number: int, frame: FrameType | None) -> None:
        self._count += 1
        if is_protected(frame):
            self._token.run_sync_soon(self._interrupt, number, None)
        else:
            self._interrupt(number, frame)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        if self._before is None:  # nobody holds any longer
            signal.raise_signal(number)
        elif not self._waiters and not self._is_broken_off:
            self._hand_on(self._before, number, frame)

    def _hand_on(self, handler: _Handler, number: int, frame: FrameType | None) -> None:
        try:
            handler(number, frame)
        except KeyboardInterrupt:
            self._is_broken_off = bool(self._holders)
            raise
