"""Where a program waits: the lines of its own code at which its tasks are, for the error about a program that is stuck."""

from __future__ import annotations

import asyncio
import linecache
import sys
import sysconfig
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, Final, NamedTuple

import trio

MAX_TASKS: Final = 10
"""Tasks that are shown."""
_PACKAGES: Final = ("canopen_proto", "canopen_data", "canopen_transports", "canopen_master", "canopen_testing", "canopen_check")
_INSTALLED: Final = tuple({*(sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib"))})


class WaitingTasks(NamedTuple):
    """Where the tasks of a program wait. lines: in words. traceback: of the first one, as if it had raised an error there."""

    lines: list[str]
    traceback: TracebackType | None


def trio_waits() -> WaitingTasks:
    """Return where the tasks of this trio run wait."""
    root = trio.lowlevel.current_root_task()
    tasks = [] if root is None else [*_tree(root)]
    return _waiting([frame for frame, _ in task.iter_await_frames()] for task in tasks)


def asyncio_waits() -> WaitingTasks:
    """Return where the tasks of the running asyncio loop wait."""
    tasks = sorted(asyncio.all_tasks(), key=lambda task: (len(task.get_name()), task.get_name()))
    return _waiting([*_frames(task.get_coro())] for task in tasks)


def _tree(task: trio.lowlevel.Task) -> Iterator[trio.lowlevel.Task]:
    yield task
    for nursery in task.child_nurseries:
        for child in sorted(nursery.child_tasks, key=lambda task: task.name):
            yield from _tree(child)


def _frames(awaited: Any) -> Iterator[FrameType]:
    """The frames of a coroutine that waits, from the outside in."""
    while awaited is not None:
        for kind in ("cr", "gi", "ag"):
            frame = getattr(awaited, f"{kind}_frame", None)
            if frame is not None:
                yield frame
                awaited = getattr(awaited, f"{kind}_await", None) or getattr(awaited, f"{kind}_yieldfrom", None)
                break
        else:
            return


def _waiting(tasks: Iterable[list[FrameType]]) -> WaitingTasks:
    lines, traceback = [], None
    for frames in tasks:
        own = [frame for frame in frames if _is_own(frame)]
        if not own:
            continue
        path, number = own[-1].f_code.co_filename, own[-1].f_lineno
        lines.append(f"  {Path(path).name}:{number} in {own[-1].f_code.co_qualname}: {linecache.getline(path, number).strip()}")
        if len(lines) == 1:
            for frame in reversed(own):
                traceback = TracebackType(traceback, frame, frame.f_lasti, frame.f_lineno)
    return WaitingTasks(lines[:MAX_TASKS], traceback)


def _is_own(frame: FrameType) -> bool:
    name = frame.f_globals.get("__name__", "").partition(".")[0]
    return name not in _PACKAGES and name not in sys.stdlib_module_names and not frame.f_code.co_filename.startswith(_INSTALLED)
