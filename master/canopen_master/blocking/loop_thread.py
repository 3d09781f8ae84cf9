"""`LoopThread`: a trio loop in a thread of its own, for as long as something is held in it. `hand_over` gives it work.

All blocking masters of a process share one (`shared_loop`), so that those on one `virtual:` bus meet, and simulated devices too.

**The end of a script.** However the main thread ends (its last line, an exception, sys.exit, Ctrl-C), Python then waits for all
threads that are no daemons. Ours is not a daemon, and what is held in it looks every WATCH_INTERVAL whether the main thread is
still alive; if not, it ends, so that drives are halted while the interpreter still works. (A daemon thread with an atexit
function would be too late: from there on Python 3.12 starts no new threads, which transports may need.)

**Fork.** A child process has the memory of this thread, but not the thread: nothing is handed over there. It may begin a loop of
its own.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Awaitable, Callable
from typing import Final

import trio

from canopen_proto.machine import LocalProtocolError

WATCH_INTERVAL: Final = 0.05
"""The most seconds until the end of a thread is noticed."""
LOOK_UP: Final = 0.5
"""The longest single wait of a thread, in seconds: on Windows, and outside the main thread, an interrupt takes effect only when
the wait is over."""

Hold = Callable[[], Awaitable[None]]


class LoopThread:
    """See this module's text. It begins with what is held first, and ends with what is held last. thread: the one of the loop."""

    def __init__(self, first: Hold, name: str, clock: trio.abc.Clock | None = None) -> None:
        """first: is begun at once. clock: trio's; None: the real time."""
        self._clock = clock
        self._pid = os.getpid()
        self._ident = 0
        self._held = 1
        self._nursery: trio.Nursery | None = None
        self._token: trio.lowlevel.TrioToken | None = None
        self._has_begun = threading.Event()
        self.thread = threading.Thread(target=self._run, args=(first,), name=name, daemon=False)

    @property
    def is_here(self) -> bool:
        """Whether the calling thread is this one."""
        return threading.get_ident() == self._ident

    @property
    def is_of_this_process(self) -> bool:
        """Whether the thread was not left behind by a fork."""
        return os.getpid() == self._pid

    def start(self) -> None:
        """Begin the thread. Returns once work can be handed over."""
        self.thread.start()
        while not self._has_begun.wait(LOOK_UP) and self.thread.is_alive():
            pass

    def hold(self, hold: Hold) -> bool:
        """Begin one more; return False if the loop is ending, so that it takes none."""
        answer = WaitingPlace()

        def begin() -> None:
            if self._nursery is not None and self._held:
                self._held += 1
                self._nursery.start_soon(self._hold, hold)
                answer.value = True
            answer.set()

        return self.hand_over(begin) and answer.wait(self.thread) and answer.value is True

    def hand_over(self, function: Callable[..., object], *arguments: object) -> bool:
        """Call a function soon, in the loop; return False if that has ended. It must not raise.

        Raises LocalProtocolError in a child process.
        """
        if os.getpid() != self._pid:
            raise forked()
        if self._token is None:
            return False
        try:
            self._token.run_sync_soon(function, *arguments)
        except trio.RunFinishedError:
            return False
        return True

    def _run(self, first: Hold) -> None:
        try:
            trio.run(self._serve, first, clock=self._clock)
        finally:
            self._has_begun.set()

    async def _serve(self, first: Hold) -> None:
        self._ident = threading.get_ident()
        self._token = trio.lowlevel.current_trio_token()
        async with trio.open_nursery() as nursery:
            self._nursery = nursery
            nursery.start_soon(self._hold, first)
            self._has_begun.set()

    async def _hold(self, hold: Hold) -> None:
        try:
            await hold()
        finally:
            self._held -= 1  # here: a nursery takes no task once its last one has ended

    def join(self) -> None:
        """Wait for the end of the thread, if nothing is held in it any more."""
        while not self._held and self.thread.is_alive():
            self.thread.join(LOOK_UP)


class WaitingPlace:
    """A place where one thread waits for another. value: what it was told."""

    __slots__ = ("_lock", "value")

    def __init__(self) -> None:
        self.value: object = None
        self._lock = threading.Lock()
        self._lock.acquire()

    def set(self) -> None:
        """Let the other thread go on. To be called once."""
        self._lock.release()

    def wait(self, thread: threading.Thread) -> bool:
        """Wait until `set` was called; return False if the thread that would do so has ended without."""
        while not self.wait_once():
            if not thread.is_alive():
                return self._lock.acquire(blocking=False)
        return True

    def wait_once(self) -> bool:
        """Wait, LOOK_UP at most; return whether `set` was called."""
        return self._lock.acquire(timeout=LOOK_UP)


def forked() -> LocalProtocolError:
    """Return the error for the use of a master in a child process."""
    return LocalProtocolError(
        "this master belongs to the process that this one was forked from, and so do its thread and its bus; "
        "open a master of its own here, or start processes by the method `spawn`"
    )


_shared: LoopThread | None = None
_starting = threading.Lock()


def held_in_shared_loop(hold: Hold, name: str) -> LoopThread:
    """Hold something in the loop that all share; return the loop. It is begun if there is none."""
    global _shared
    with _starting:
        shared = _shared
        if shared is None or not shared.is_of_this_process or not shared.hold(hold):
            shared = _shared = LoopThread(hold, name)
            shared.start()
        return shared


def _forget() -> None:
    global _shared, _starting
    _shared, _starting = None, threading.Lock()


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_forget)
