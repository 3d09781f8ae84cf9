"""`current_loop`: finds the loop that runs this code."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Generic, TypeVar

from sniffio import thread_local  # trio says here that it runs

if TYPE_CHECKING:
    from canopen_transports.loop.interface import Loop

V = TypeVar("V")

_trio: Loop | None = None


class NoLoopError(RuntimeError):
    """Something that needs a running event loop was called where neither trio nor asyncio runs."""


def current_loop() -> Loop:
    """Return the loop that runs this code: trio's, else asyncio's. Raises NoLoopError."""
    if thread_local.name == "trio":
        return _trio or _load_trio()
    if "asyncio" in sys.modules:
        from canopen_transports.loop.on_asyncio import running_loop

        if (found := running_loop()) is not None:
            return found
    raise NoLoopError("neither trio nor asyncio runs here: call this in trio.run(...) or asyncio.run(...)")


def _load_trio() -> Loop:
    global _trio
    from canopen_transports.loop.on_trio import TrioLoop

    _trio = TrioLoop()
    return _trio


class RunVar(Generic[V]):
    """A value for each run of a loop, as trio.lowlevel.RunVar. make: makes the first one."""

    def __init__(self, make: Callable[[], V]) -> None:
        self._make = make

    def get(self) -> V:
        """Return the value of this run."""
        values = current_loop().values
        if self not in values:
            values[self] = self._make()
        value: V = values[self]
        return value

    def set(self, value: V) -> None:
        """Set the value of this run."""
        current_loop().values[self] = value
