"""`virtual_time`: while it lasts, `time.sleep` in this thread is an error.

From Python 3.13 on, each `time.sleep` is seen, by the audit event of that name. An audit hook cannot be taken away again, so
there is one for the process, made at the first use; it does nothing outside of `virtual_time`, nor in other threads. Before 3.13
`time.sleep` is replaced for that time, and code that has imported the function before (`from time import sleep`) is not seen.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_threads: dict[int, int] = {}  # how often `virtual_time` is entered, by thread
_in_earnest = time.sleep
_HAS_EVENT = sys.version_info >= (3, 13)


class WallClockWaitError(RuntimeError):
    """Code under test waits in real time, in a world whose time is virtual."""


@contextmanager
def virtual_time() -> Iterator[None]:
    """Let `time.sleep` in this thread raise WallClockWaitError."""
    _watch()
    thread = threading.get_ident()
    _threads[thread] = _threads.get(thread, 0) + 1
    try:
        yield
    finally:
        _threads[thread] -= 1
        if not _threads[thread]:
            del _threads[thread]
        if not _threads and not _HAS_EVENT:
            time.sleep = _in_earnest


def _watch() -> None:
    if not _HAS_EVENT:
        time.sleep = _sleep  # type: ignore[assignment]
    elif not hasattr(sys, "_canopen_testing_watches"):
        sys._canopen_testing_watches = True  # type: ignore[attr-defined]
        sys.addaudithook(_look)


def _look(event: str, args: tuple[Any, ...]) -> None:
    if event == "time.sleep":
        _refuse(args[0])


def _sleep(seconds: float) -> None:
    _refuse(seconds)
    _in_earnest(seconds)


def _refuse(seconds: float) -> None:
    if seconds > 0 and threading.get_ident() in _threads:
        raise WallClockWaitError(
            f"time.sleep({seconds:g}) waits in real time, but the world of this test has its own: `world.advance(...)` in a "
            "test, `await trio.sleep(...)` or `await asyncio.sleep(...)` in a program"
        )
