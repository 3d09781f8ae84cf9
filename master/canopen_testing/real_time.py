"""`virtual_time`: while it lasts, what runs in real time is an error in this thread, wherever it is called.

    time.sleep                        WallClockWaitError
    a wait for an event, a queue      WallClockWaitError: it is a `threading.Condition` that waits
    asyncio.run, trio.run             WallClockWaitError, unless the loop, or the clock, is that of the world
    a thread that is started          ThreadStartedError: when it acts is no matter of a seed, so no run can be repeated
    a SocketCAN socket                LocalProtocolError: it is a bus in earnest, whose drives would move

Allowed are threads whose work a program awaits (trio's, asyncio's: time stands still meanwhile, working_threads.py), the one that
writes a recording, which decides nothing, and those of tools; `allows_threads` allows all. Threads that run already are not seen.

These functions are replaced for that time. From Python 3.13 on, each `time.sleep` is seen by the audit event of that name.
Before, it is replaced in `time`, and in each module that has imported it by name (`from time import sleep`). What keeps it
elsewhere is not seen: a default of a parameter, an attribute of a class.

An audit hook cannot be taken away again, so there is one for the process, made at the first use. All of this does nothing outside
of `virtual_time`, nor in other threads.
"""

from __future__ import annotations

import _thread
import asyncio
import inspect
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any, Final, NamedTuple

from trio._core import _run

from canopen_proto.machine import LocalProtocolError

_HAS_EVENT: Final = sys.version_info >= (3, 13)
_PASSED_ON: Final = ("threading", "queue", "concurrent.futures", "canopen_testing.real_time")
"""Modules that start a thread, or wait, for somebody else."""
_TOOLS: Final = (
    "pytest_timeout", "pytest_asyncio", "pytest_trio", "anyio.", "execnet.", "xdist.", "coverage.", "debugpy.", "pydevd",
    "_pydev",
)  # fmt: skip
_AWAITED: Final = ("trio.", "asyncio.", "canopen_master.motion.recording", *_TOOLS)
_INSTEAD: Final = (
    "but the world of this test has its own time: `world.advance(...)` in a test, `await trio.sleep(...)` or "
    "`await asyncio.sleep(...)` in a program"
)


class WallClockWaitError(RuntimeError):
    """Code under test waits in real time, in a world whose time is virtual."""


class ThreadStartedError(RuntimeError):
    """Code under test starts a thread, which runs in real time, in a world whose time is virtual."""


class _Replaced(NamedTuple):
    """Where a function is to be replaced: its module, its name there, and the two functions."""

    module: Any
    name: str
    real: Callable[..., Any]
    watched: Callable[..., Any]


_worlds: dict[int, list[Callable[[], bool]]] = {}  # for which `virtual_time` is entered, by thread


@contextmanager
def virtual_time(allows_threads: Callable[[], bool]) -> Iterator[None]:
    """Let `time.sleep` in this thread raise WallClockWaitError; and the start of another one ThreadStartedError, but where it is
    allowed."""
    _watch()
    thread = threading.get_ident()
    _worlds.setdefault(thread, []).append(allows_threads)
    try:
        yield
    finally:
        _worlds[thread].remove(allows_threads)
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


def _watched(module: Any, name: str, refuse: Callable[..., None]) -> _Replaced:
    """Let a function be replaced by one that looks first. refuse: is given its arguments; raises."""
    real = getattr(module, name)

    @wraps(real)
    def watched(*args: Any, **options: Any) -> Any:
        __tracebackhide__ = True
        if threading.get_ident() in _worlds:
            refuse(*args, **options)
        return real(*args, **options)

    return _Replaced(module, name, real, watched)


def _refuse_wait(condition: threading.Condition, timeout: float | None = None) -> None:
    __tracebackhide__ = True
    if (timeout is None or timeout > 0) and not _is_allowed():
        raise WallClockWaitError(f"a wait for an event, a queue or another thread is one in real time, {_INSTEAD}")


def _refuse_loop(loop: object, *args: object) -> None:
    __tracebackhide__ = True
    if not hasattr(loop, "world"):
        _refuse_run(*args)


def _refuse_run(main: object = None, *args: object, **options: object) -> None:
    __tracebackhide__ = True
    if _starter(("asyncio",)).startswith(_TOOLS):
        return
    if inspect.iscoroutine(main):
        main.close()
    raise WallClockWaitError("this asyncio loop runs in real time: use `world.run_asyncio(main)`, or an async test")


def _refuse_clock(clock: object, *args: object) -> None:
    __tracebackhide__ = True
    if not _starter(("trio", "attr")).startswith(_TOOLS):
        text = "trio.run has a clock in real time: use `world.run(main)`, `trio.run(main, clock=world)`, or an async test"
        raise WallClockWaitError(text)


def _refuse_bus(made: socket.socket, family: int = -1, *args: object, **options: object) -> None:
    __tracebackhide__ = True
    if family == getattr(socket, "AF_CAN", None):
        raise LocalProtocolError(
            'a SocketCAN socket is a bus in earnest, and this is the world of a test: can.Bus(interface="canopen_world", '
            'channel="can0"), or open_master("socketcan:can0")'
        )


def _refuse_thread(function: Any, *args: object, **options: object) -> None:
    __tracebackhide__ = True
    if _is_allowed():
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


def _is_allowed() -> bool:
    return _worlds[threading.get_ident()][-1]() or _starter().startswith(_AWAITED)


def _starter(more: tuple[str, ...] = ()) -> str:
    """Return the name of the module that starts or waits now. more: modules that do so for somebody else."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith((*_PASSED_ON, *more)):
        frame = frame.f_back
    name: str = frame.f_globals.get("__name__", "")
    return name


_real_sleep: Final = time.sleep
_places: list[_Replaced] = [
    _watched(threading.Condition, "wait", _refuse_wait),
    _watched(asyncio, "run", _refuse_run),
    _watched(asyncio.BaseEventLoop, "run_until_complete", _refuse_loop),
    _watched(asyncio.BaseEventLoop, "run_forever", _refuse_loop),
    _watched(_run.SystemClock, "__init__", _refuse_clock),
    _watched(socket.socket, "__init__", _refuse_bus),
    _watched(_thread, "start_new_thread", _refuse_thread),
    *(
        _watched(threading, name, _refuse_thread)
        for name in ("_start_new_thread", "_start_joinable_thread")
        if hasattr(threading, name)  # in this version of Python
    ),
]
_searched = {__name__}  # modules


def _find_sleep() -> None:
    """Find `time.sleep` in the modules that were imported since the last look."""
    for name in sys.modules.keys() - _searched:
        _searched.add(name)
        contents = getattr(sys.modules[name], "__dict__", {})
        found = [each for each, value in [*contents.items()] if value is _real_sleep]
        _places.extend(_Replaced(sys.modules[name], each, _real_sleep, _sleep) for each in found)


def _refuse_sleep(seconds: float) -> None:
    __tracebackhide__ = True
    if seconds > 0 and threading.get_ident() in _worlds:
        raise WallClockWaitError(f"time.sleep({seconds:g}) waits in real time, {_INSTEAD}")
