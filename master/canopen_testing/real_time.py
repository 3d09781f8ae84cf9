"""`virtual_time`: while it lasts, what runs in real time is an error in this thread: `time.sleep`, and a thread that is started.

**time.sleep.** From Python 3.13 on, each one is seen, by the audit event of that name. Before 3.13, the function is replaced for
that time: in `time`, and in each module that has imported it by name (`from time import sleep`). What keeps it elsewhere is not
seen: a default of a parameter, an attribute of a class.

**Threads.** When a thread runs is no matter of a seed, so a program with one cannot be repeated. The functions that start one are
replaced for that time. Allowed are threads whose work a program awaits (trio's, asyncio's: time stands still meanwhile,
working_threads.py), the one that writes a recording, which decides nothing, and those of tools. Threads that run already are not
seen.

An audit hook cannot be taken away again, so there is one for the process, made at the first use. All of this does nothing outside
of `virtual_time`, nor in other threads.
"""

from __future__ import annotations

import _thread
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final, NamedTuple, Protocol

_HAS_EVENT: Final = sys.version_info >= (3, 13)
_PASSED_ON: Final = ("threading", "concurrent.futures", "canopen_testing.real_time")
"""Modules that start a thread for somebody else."""
_ALLOWED: Final = (
    "trio.", "asyncio.", "canopen_master.motion.recording",
    "pytest_timeout", "execnet.", "xdist.", "coverage.", "debugpy.", "pydevd", "_pydev",
)  # fmt: skip


class WallClockWaitError(RuntimeError):
    """Code under test waits in real time, in a world whose time is virtual."""


class ThreadStartedError(RuntimeError):
    """Code under test starts a thread, which runs in real time, in a world whose time is virtual."""


class Tolerant(Protocol):
    """The part of a ProgramWorld that counts here."""

    allows_threads: bool


class _Place(NamedTuple):
    """Where a function is to be replaced: its module, its name there, and the two functions."""

    module: Any
    name: str
    real: Callable[..., Any]
    watched: Callable[..., Any]


_worlds: dict[int, list[Tolerant]] = {}  # for which `virtual_time` is entered, by thread


@contextmanager
def virtual_time(world: Tolerant) -> Iterator[None]:
    """Let `time.sleep` in this thread raise WallClockWaitError, and the start of another thread ThreadStartedError."""
    _watch()
    thread = threading.get_ident()
    _worlds.setdefault(thread, []).append(world)
    try:
        yield
    finally:
        _worlds[thread].remove(world)
        if not _worlds[thread]:
            del _worlds[thread]
        if not _worlds:
            for place in _places:
                setattr(place.module, place.name, place.real)


def _watch() -> None:
    if not _HAS_EVENT:
        _find_sleep()
    elif not hasattr(sys, "_canopen_testing_watches"):
        sys._canopen_testing_watches = True  # type: ignore[attr-defined]
        sys.addaudithook(_look)
    for place in _places:
        setattr(place.module, place.name, place.watched)


def _look(event: str, args: tuple[Any, ...]) -> None:
    __tracebackhide__ = True
    if event == "time.sleep":
        _refuse_sleep(args[0])


def _sleep(seconds: float) -> None:
    __tracebackhide__ = True
    _refuse_sleep(seconds)
    _real_sleep(seconds)


def _starting(start: Callable[..., Any]) -> Callable[..., Any]:
    """Return what stands for a function that starts a thread: its first argument is what the thread does."""

    def start_watched(function: Callable[..., Any], *args: Any, **options: Any) -> Any:
        __tracebackhide__ = True
        _refuse_thread(function)
        return start(function, *args, **options)

    return start_watched


_real_sleep: Final = time.sleep
_STARTS: Final = ((_thread, "start_new_thread"), (threading, "_start_new_thread"), (threading, "_start_joinable_thread"))
_places: list[_Place] = [
    _Place(module, name, start, _starting(start))
    for module, name in _STARTS
    if (start := getattr(module, name, None)) is not None  # of this version of Python
]
_searched = {__name__}  # modules


def _find_sleep() -> None:
    """Find `time.sleep` in the modules that were imported since the last look."""
    for name in sys.modules.keys() - _searched:
        _searched.add(name)
        contents = getattr(sys.modules[name], "__dict__", {})
        found = [each for each, value in [*contents.items()] if value is _real_sleep]
        _places.extend(_Place(sys.modules[name], each, _real_sleep, _sleep) for each in found)


def _refuse_sleep(seconds: float) -> None:
    __tracebackhide__ = True
    if seconds > 0 and threading.get_ident() in _worlds:
        raise WallClockWaitError(
            f"time.sleep({seconds:g}) waits in real time, but the world of this test has its own: `world.advance(...)` in a "
            "test, `await trio.sleep(...)` or `await asyncio.sleep(...)` in a program"
        )


def _refuse_thread(function: Any) -> None:
    __tracebackhide__ = True
    worlds = _worlds.get(threading.get_ident())
    if not worlds or worlds[-1].allows_threads or _starter().startswith(_ALLOWED):
        return
    thread = getattr(function, "__self__", None)
    name = f"the thread {thread.name!r}" if isinstance(thread, threading.Thread) else "a thread"
    target = getattr(thread, "_target", None) or function
    raise ThreadStartedError(
        f"{name} ({getattr(target, '__qualname__', target)}) runs in real time, and the world of this test does not: when it "
        "acts is no matter of the seed, so no run can be repeated. Await its work (`trio.to_thread.run_sync`, "
        "`asyncio.to_thread`): time stands still meanwhile. A can.Notifier needs no thread with `loop=`. If the thread decides "
        "nothing on the bus: `world.allows_threads = True`"
    )


def _starter() -> str:
    """Return the name of the module that starts a thread now."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith(_PASSED_ON):
        frame = frame.f_back
    name: str = frame.f_globals.get("__name__", "")
    return name
