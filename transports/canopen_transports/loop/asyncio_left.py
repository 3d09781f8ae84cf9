"""A loop that is left as it is at the end of Python: it was stopped and never closed, or runs in a thread that is a daemon.

`asyncio.run` cancels all tasks at its end. A kernel of Jupyter stops its loop and does nothing more, and so does who calls
`loop.stop()` behind `run_forever`. Whoever has to put something in order first (a master: its drives move) is cancelled here, and
gets TIME to do it.
"""

from __future__ import annotations

import asyncio
import atexit
import os
from concurrent.futures import TimeoutError as FutureTimeoutError
from contextlib import suppress
from typing import Any, Final

TIME: Final = 5.0
"""Seconds, at most, until Python goes on to its end."""

_waiting: set[asyncio.Task[Any]] = set()
_process = 0


def cancelled_at_exit(task: asyncio.Task[Any]) -> None:
    """Cancel a task at the end of Python, if its loop is left then, and wait until it is done."""
    global _process
    if _process != os.getpid():  # in a child by `fork`, the tasks of its parent are none of its own
        _process = os.getpid()
        _waiting.clear()
        atexit.unregister(_end)
        atexit.register(_end)
    _waiting.add(task)
    task.add_done_callback(_waiting.discard)


def _end() -> None:
    if _process != os.getpid():
        return
    for loop in {task.get_loop() for task in _waiting}:
        if loop.is_closed():
            continue
        ending = _cancel({task for task in _waiting if task.get_loop() is loop})
        if loop.is_running():
            with suppress(TimeoutError, FutureTimeoutError):
                asyncio.run_coroutine_threadsafe(ending, loop).result(2 * TIME)
            continue
        task = loop.create_task(ending)
        task.add_done_callback(lambda _, loop=loop: loop.stop())  # type: ignore[misc]
        while not task.done():
            loop.run_forever()  # who stopped it may do so once more, as Jupyter's kernel does


async def _cancel(tasks: set[asyncio.Task[Any]]) -> None:
    for task in tasks:
        task.cancel()
    await asyncio.wait(tasks, timeout=TIME)
