"""`LoopThread`: a trio loop in a thread of its own, for as long as something is held in it. `hand_over` gives it work.

All blocking masters of a process share one (`held_in_shared_loop`), so that those on one `virtual:` bus meet, and simulated
devices, too.

**The end of a script.** However the main thread ends (its last line, an exception, sys.exit, Ctrl-C), Python then waits for all
threads that are no daemons. Ours is not a daemon, and what is held in it looks every WATCH_INTERVAL whether the main thread is
still alive; if not, it ends, so that drives are halted while the interpreter still works. (A daemon thread with an atexit
function would be too late: from there on Python 3.12 starts no new threads, which transports may need.)

**Fork.** A child process has the memory of this thread, but not the thread: nothing is handed over there. It may begin a loop of
its own.
"""

from __future__ import annotations

import os
import socket
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Final, Protocol

import trio

WATCH_INTERVAL: Final = 0.05
"""The most seconds until the end of a thread is noticed."""
LOOK_UP: Final = 0.5
"""The longest single wait of a thread, in seconds: on Windows, and outside the main thread, an interrupt takes effect only when
the wait is over."""

SPARE_TASKS: Final = 8
"""The most tasks that wait for work: so many threads may call at once without one being made."""


class Holdable(Protocol):
    """Something that is held in a loop. goes_last: at the end of the process it waits for what is not."""

    goes_last: bool

    async def hold(self) -> None:
        """Stay until its end. It must not raise."""


class Work(Protocol):
    """Something that takes a task of the loop."""

    async def serve(self, scope: trio.CancelScope) -> None:
        """Do it. It must not raise. scope: around the task, which ends if it is cancelled."""


class LoopThread:
    """See this module's text. It begins with what is held first, and ends with what is held last.

    thread, ident: the one of the loop. held: what is held in it; for the loop's thread.

    One task, the front, waits for what other threads hand over, and does it itself: so a call wakes one task. While the front is
    busy with work that waits, the dispatcher is woken instead, and gives work to other tasks.
    """

    def __init__(self, first: Holdable, name: str, clock: trio.abc.Clock | None = None) -> None:
        """first: is begun at once. clock: trio's; None: the real time."""
        self._clock = clock
        self._pid = os.getpid()
        self.ident = 0
        self.held: list[Holdable] = [first]
        self._nursery: trio.Nursery | None = None
        self._spare: list[_Server] = []  # the tasks that wait
        self._jobs: deque[Callable[[], Work | None]] = deque()
        self._end = threading.RLock()  # for what was handed over at the end of the loop
        self._wakers: tuple[Waker, Waker] | None = None  # of the front and of the dispatcher; None before and after
        self._front_waits = False
        self._dispatcher_waits = False
        self._has_begun = threading.Event()
        self.thread = threading.Thread(target=self._run, name=name, daemon=False)

    @property
    def is_here(self) -> bool:
        """Whether the calling thread is this one."""
        return threading.get_ident() == self.ident

    @property
    def is_of_this_process(self) -> bool:
        """Whether the thread was not left behind by a fork."""
        return os.getpid() == self._pid

    def start(self) -> None:
        """Begin the thread. Returns once work can be handed over."""
        self.thread.start()
        while not self._has_begun.wait(LOOK_UP) and self.thread.is_alive():
            pass

    def hold(self, hold: Holdable) -> bool:
        """Begin one more; return False if the loop is ending, so that it takes none."""
        answered = threading.Event()
        has_begun = False

        def begin() -> None:
            nonlocal has_begun
            if self._nursery is not None:
                self.held.append(hold)
                self._nursery.start_soon(self._hold, hold)
                has_begun = True
            answered.set()

        if self.hand_over(begin):
            while not answered.wait(LOOK_UP) and self.thread.is_alive():
                pass
        return has_begun

    def hand_over(self, job: Callable[[], Work | None]) -> bool:
        """Call a function soon, in the loop; what it returns is served by a task. Returns False if the loop has ended.

        job: must not raise. Not for a child process: there is nobody who would call it.
        """
        self._jobs.append(job)  # before the look who waits: a task says that it waits before it looks at the jobs
        wakers = self._wakers  # no lock: the loop would stand still while a signal handler, here, waits for it
        if wakers is None:
            with self._end:
                if job not in self._jobs:
                    return True
                self._jobs.remove(job)
            return False
        if self._front_waits:
            wakers[0].wake()
        elif self._dispatcher_waits:
            wakers[1].wake()
        return True

    def _run(self) -> None:
        try:
            trio.run(self._main, clock=self._clock)
        finally:
            self._has_begun.set()

    async def _main(self) -> None:
        self.ident = threading.get_ident()
        wakers = Waker(), Waker()
        try:
            async with trio.open_nursery() as nursery:
                self._nursery, self._wakers = nursery, wakers
                nursery.start_soon(self._hold, self.held[0])
                nursery.start_soon(self._front, wakers[0])
                nursery.start_soon(self._dispatch, wakers[1])
                self._has_begun.set()
        finally:
            with self._end:
                self._wakers = None
                self._do_jobs()  # those of contexts that have ended: each is told so

    async def _hold(self, hold: Holdable) -> None:
        try:
            await hold.hold()
        finally:
            self.held.remove(hold)
            if not self.held and self._nursery is not None:
                self._nursery.cancel_scope.cancel()
                self._nursery = None  # it takes no more

    # ---- its tasks ----

    async def _front(self, waker: Waker) -> None:
        """Do what is handed over, until work was cancelled: another front goes on then."""
        scope = trio.CancelScope()
        with scope:
            while not scope.cancel_called:
                self._front_waits = True
                await (trio.lowlevel.checkpoint() if self._jobs else waker.wait())
                self._front_waits = False
                work = self._do_jobs()
                for each in work[1:]:
                    self._give(each)
                if work:
                    await work[0].serve(scope)
        if self._nursery is not None:
            self._nursery.start_soon(self._front, waker)

    async def _dispatch(self, waker: Waker) -> None:
        """Do what is handed over while the front is busy, and give the work in it to other tasks."""
        while True:
            self._dispatcher_waits = True
            await (trio.lowlevel.checkpoint() if self._jobs else waker.wait())
            self._dispatcher_waits = False
            for work in self._do_jobs():
                self._give(work)

    async def _serve(self, work: Work) -> None:
        """Serve work, again and again, until that was cancelled or there are tasks enough that wait."""
        server = _Server()
        with server.scope:
            while True:
                await work.serve(server.scope)
                if server.scope.cancel_called or len(self._spare) >= SPARE_TASKS:
                    return
                self._spare.append(server)
                work = await server.next_work()

    def _do_jobs(self) -> list[Work]:
        """Do what was handed over; return the work in it."""
        jobs = self._jobs
        return [work for _ in range(len(jobs)) if (work := jobs.popleft()()) is not None]

    def _give(self, work: Work) -> None:
        if self._spare:
            self._spare.pop().take(work)
        elif self._nursery is not None:
            self._nursery.start_soon(self._serve, work)

    def join(self) -> None:
        """Wait for the end of the thread, if nothing is held in it any more."""
        while not self.held and self.thread.is_alive():
            self.thread.join(LOOK_UP)


class _Server:
    """A task that serves. scope: around it."""

    __slots__ = ("_task", "_work", "scope")

    def __init__(self) -> None:
        self.scope = trio.CancelScope()
        self._task: trio.lowlevel.Task | None = None
        self._work: Work | None = None

    def take(self, work: Work) -> None:
        """Give it work, while it waits for some."""
        task, self._work = self._task, work
        assert task is not None
        trio.lowlevel.reschedule(task)

    async def next_work(self) -> Work:
        """Wait for `take`."""
        self._task = trio.lowlevel.current_task()
        await trio.lowlevel.wait_task_rescheduled(_abort)  # it is only interrupted when the loop ends
        assert self._work is not None
        return self._work


def _abort(_: object) -> trio.lowlevel.Abort:
    return trio.lowlevel.Abort.SUCCEEDED


class Waker:
    """Wakes a task of the loop from any thread: at half the cost of what trio has for all. It is closed when nobody has it any
    more: not while a thread is in the midst of `wake`."""

    def __init__(self) -> None:
        self._sockets: tuple[socket.socket, socket.socket] | None = None
        if hasattr(os, "eventfd"):  # Linux
            self._fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        else:
            self._sockets = socket.socketpair()
            for each in self._sockets:
                each.setblocking(False)

    def wake(self) -> None:
        """Wake the task. From any thread."""
        if self._sockets is None:
            os.eventfd_write(self._fd, 1)
        else:
            with suppress(BlockingIOError):  # it is full: the task will wake
                self._sockets[1].send(b"\0")

    async def wait(self) -> None:
        """Wait until `wake` was called since the last time."""
        if self._sockets is None:
            await trio.lowlevel.wait_readable(self._fd)
            try:
                os.eventfd_read(self._fd)
            except BlockingIOError:
                return
        else:
            await trio.lowlevel.wait_readable(self._sockets[0])
            try:
                self._sockets[0].recv(64)
            except BlockingIOError:
                return

    def __del__(self) -> None:
        if self._sockets is None:
            os.close(self._fd)
        else:
            for each in self._sockets:
                each.close()


_shared: LoopThread | None = None
_starting = threading.Lock()


def make_clock() -> trio.abc.Clock | None:
    """Return the clock of the shared loop; None: the real time. Tests have another one: their world is in one process."""
    return None


def held_in_shared_loop(hold: Holdable, name: str) -> LoopThread:
    """Hold something in the loop that all share; return the loop. It is begun if there is none."""
    global _shared
    with _starting:
        shared = _shared
        if shared is None or not shared.is_of_this_process or not shared.hold(hold):
            shared = _shared = LoopThread(hold, name, make_clock())
            shared.start()
        return shared


def _forget() -> None:
    global _shared, _starting
    _shared, _starting = None, threading.Lock()


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_forget)
