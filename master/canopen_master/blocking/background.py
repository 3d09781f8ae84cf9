"""`Background`: an async context (a master) that is held in the thread of a trio loop, and calls into it from all other threads.

`start` enters an async context manager in that thread, and stays in it until `stop`. `run` hands an async function to the loop,
where it runs as a task inside the context, and waits for its result; `do` a plain one. Any number of threads may call at the same
time.

**Nothing is left running.** If a caller is interrupted while it waits (Ctrl-C), or its time is over, its call is taken back: the
task is cancelled, which halts what it moved, and only then does the interrupt go on. When the context ends (by `stop`, by itself
because a bus failed, or because a thread has ended that it was made for), all waiting calls end with the reason.

**The end of a script** is that of the main thread: see loop_thread.py. A Ctrl-C while Python waits for our thread would end the
interpreter at once. So if SIGINT still has Python's own handler, such a Ctrl-C does nothing: see `_interrupt`. No thread helps
against a signal that kills the process: `signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))` makes an exception of SIGTERM.

**What a call costs** is mostly two changes between threads. So tasks that have served a call wait for the next one, and a caller
waits for a lock.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Awaitable, Callable
from contextlib import AbstractAsyncContextManager
from time import monotonic
from types import FrameType, TracebackType
from typing import Any, Final, Generic, ParamSpec, TypeVar

import trio

from canopen_master.blocking.loop_thread import LOOK_UP, WATCH_INTERVAL, LoopThread, WaitingPlace, held_in_shared_loop
from canopen_master.errors import CallTimeoutError, MasterClosedError
from canopen_master.plain_text import clean_lines
from canopen_proto.machine import LocalProtocolError

P = ParamSpec("P")
T = TypeVar("T")
R = TypeVar("R")

TAKE_BACK_TIME: Final = 30.0
"""Seconds that an interrupted call may take to clean up: a procedure takes CLEAN_UP_TIME, 1 s, or as long as a drive brakes. A
second Ctrl-C ends the waiting."""
SPARE_TASKS: Final = 8
"""The most tasks that wait for calls: as many threads may call without one being made."""


class Background(Generic[T]):
    """See this module's text. Use it once: start, any number of calls, stop."""

    def __init__(
        self,
        make: Callable[[], AbstractAsyncContextManager[T]],
        failure: Callable[[T], Exception | None] = lambda _: None,
        name: str = "canopen master",
        clock: trio.abc.Clock | None = None,
        *,
        shares_loop: bool = False,
        owner: threading.Thread | None = None,
        hurry: Callable[[], object] = lambda: None,
    ) -> None:
        """make: returns the context manager; called in the thread. Entering and leaving it are not cancelled: they must end by
        themselves. failure: why the context ended, None if it was left. clock: trio's; None: the real time. name: of the thread.

        shares_loop: it is held in the loop that all share, which has the real time. owner: the context is left when this thread
        has ended, as it is at the end of the main thread. hurry: called in the loop if an interrupt comes while the context is
        left.
        """
        self._make = make
        self._failure = failure
        self._name = name
        self._clock = clock
        self._shares_loop = shares_loop
        self._owners = {threading.main_thread(), owner or threading.main_thread()}
        self._hurry = hurry
        self._loop: LoopThread | None = None
        self._context: T | None = None
        self._scope = trio.CancelScope()
        self._nursery: trio.Nursery | None = None  # where calls run; None before and after. Of the loop's thread
        self._spare: list[_Worker] = []  # the tasks that wait for calls. Of the loop's thread
        self._begun = threading.Event()
        self._entered = threading.Event()  # or it has failed to
        self._ended = threading.Event()
        self._is_stopping = False
        self._error: BaseException | None = None  # the error that ended the context
        self._was_told = False  # whether that error was raised to a caller

    @property
    def is_running(self) -> bool:
        """Whether calls are taken."""
        return self._nursery is not None

    @property
    def present(self) -> T:
        """What the context gave. Raises MasterClosedError before."""
        if self._context is None:
            raise MasterClosedError
        return self._context

    @property
    def is_of_this_process(self) -> bool:
        """Whether it was not left behind by a fork."""
        return self._loop is None or self._loop.is_of_this_process

    def start(self) -> T:
        """Enter the context in the thread, which is begun if need be. Returns and raises as the context does."""
        _running.add(self)
        _handle_interrupts(signal.default_int_handler, _interrupt)
        try:
            if self._shares_loop:
                self._loop = held_in_shared_loop(self._hold, self._name)
            else:
                self._loop = LoopThread(self._hold, self._name, self._clock)
                self._loop.start()
            self._wait(self._entered)
        except BaseException:  # interrupted
            self._begun.wait(LOOK_UP)  # perhaps in Thread.start: the thread may still be starting
            self.stop()
            raise
        if self._context is None:
            raise self.stop() or MasterClosedError()
        return self._context

    # ---- calls ----

    def call(self, function: Callable[[T], Awaitable[R]]) -> R:
        """Run an async function of the context in the loop; see `run`."""
        return self.run(None, function, self.present)

    def run(self, timeout: float | None, function: Callable[P, Awaitable[R]], /, *args: P.args, **kwargs: P.kwargs) -> R:
        """Run an async function in the loop, wait for its end, and return its result or raise its error.

        timeout: seconds; then the call is taken back, and once that is done CallTimeoutError is raised. None: no limit.

        If the context is over, raises the error that ended it, or MasterClosedError. If interrupted, takes the call back and
        waits for its clean-up. Raises LocalProtocolError if called in the loop's own thread, which would wait for itself, and
        in a child process.
        """
        result: R = self._called(self._begin, _Call(function, args, kwargs, timeout))
        return result

    def do(self, function: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> R:
        """Call a plain function in the loop, and return its result. It must not block. Raises as `run` does."""
        result: R = self._called(self._do, _Call(function, args, kwargs, None))
        return result

    def do_at_the_end(self, function: Callable[[], object]) -> None:
        """Call a plain function in the loop, also while the context is left; where the loop has ended, in this thread."""
        loop = self._loop
        if loop is None or loop.is_here:
            function()
            return
        call = _Call(function, (), {}, None)
        if loop.hand_over(self._do_anyway, call):
            call.wait(loop.thread)
            self._result_of(call)
        else:
            function()

    def held(self, make: Callable[[], AbstractAsyncContextManager[R]]) -> Held[R]:
        """Return a context manager that holds an async one in the loop while its block runs. make: is called in the loop."""
        return Held(self, make)

    def _called(self, begin: Callable[[_Call], None], call: _Call) -> Any:
        loop = self._loop_for(call)
        try:
            if loop.hand_over(begin, call):
                call.wait(loop.thread)
            else:
                call.end(error=self._reason())
        except BaseException:  # interrupted
            self._take_back(call, loop)
            raise
        return self._result_of(call)

    def _loop_for(self, call: _Call) -> LoopThread:
        loop = self._loop
        if loop is None:
            raise MasterClosedError
        if loop.is_here:
            raise LocalProtocolError("the blocking API was called in the master's own thread; call it in another one")
        return loop

    def _result_of(self, call: _Call) -> Any:
        error = call.error
        if error is None:
            return call.value
        try:
            raise error
        finally:
            call.error = error = None  # else the error and this frame would hold each other

    def _take_back(self, call: _Call, loop: LoopThread) -> None:
        """Cancel a call, and wait for its clean-up."""
        if loop.hand_over(self._cancel, call):
            until = monotonic() + TAKE_BACK_TIME
            while not call.is_done and monotonic() < until and loop.thread.is_alive():
                call.wait_once()

    # ---- in the loop ----

    async def _hold(self) -> None:
        self._begun.set()
        try:
            await self._stay()
        except BaseException as error:  # noqa: BLE001 - every error belongs to the caller of `stop`
            self._error = error
        finally:
            self._nursery = None
            self._entered.set()
            if self._error is not None and not self._was_told and self._is_orphaned and self._context is not None:
                print(clean_lines(str(self._error)), file=sys.stderr)  # no caller is left to get it
            self._ended.set()

    async def _stay(self) -> None:
        async with self._make() as context:
            self._context = context
            with self._scope:  # around the body only: entering and leaving are not cancelled
                if self._is_stopping:
                    return
                async with trio.open_nursery() as nursery:
                    self._nursery = nursery
                    try:
                        self._entered.set()
                        while not (self._is_orphaned or self._is_stopping):
                            await trio.sleep(WATCH_INTERVAL)
                        nursery.cancel_scope.cancel()
                    finally:
                        self._nursery = None  # here: a nursery takes no task once its last one has ended

    @property
    def _is_orphaned(self) -> bool:
        """Whether a thread has ended that it was made for."""
        return not all(thread.is_alive() for thread in self._owners)

    def _begin(self, call: _Call) -> None:
        if call.is_done:
            return  # it was taken back before
        if self._nursery is None:
            call.end(error=self._reason())
        elif self._spare:
            self._spare.pop().take(call)
        else:
            self._nursery.start_soon(self._serve, _Worker(call))

    def _do(self, call: _Call) -> None:
        if call.is_done:
            return
        if self._nursery is None:
            call.end(error=self._reason())
        else:
            self._do_anyway(call)

    def _do_anyway(self, call: _Call) -> None:
        try:
            call.end(call.function(*call.args, **call.kwargs))
        except BaseException as error:  # noqa: BLE001 - whatever it is belongs to the caller
            call.end(error=self._told(error))

    def _cancel(self, call: _Call) -> None:
        if call.scope is not None:
            call.scope.cancel()
        elif not call.is_done:
            call.end(error=MasterClosedError())  # it has not begun, and nobody looks at its result

    async def _serve(self, worker: _Worker) -> None:
        """Serve one call after the other, until one is cancelled or there are tasks enough that wait."""
        with worker.scope:
            while True:
                await self._serve_call(worker)
                if worker.scope.cancel_called or len(self._spare) >= SPARE_TASKS:
                    return
                self._spare.append(worker)
                try:
                    await worker.next_call()
                finally:
                    if worker in self._spare:
                        self._spare.remove(worker)

    async def _serve_call(self, worker: _Worker) -> None:
        call = worker.call
        if call.is_done:
            return
        call.scope = worker.scope
        value: Any = None
        error: BaseException | None = None
        try:
            if call.timeout is None:
                value = await call.function(*call.args, **call.kwargs)
            else:
                with trio.move_on_after(call.timeout) as limit:
                    value = await call.function(*call.args, **call.kwargs)
                if limit.cancelled_caught:
                    error = CallTimeoutError(call.timeout)
        except trio.Cancelled:
            error = self._reason()
            raise
        except BaseException as raised:  # noqa: BLE001 - whatever it is belongs to the caller
            error = self._told(raised)
        finally:
            call.scope = None
            call.end(value, error)

    def _told(self, error: BaseException) -> BaseException:
        if self._context is not None and error is self._failure(self._context):
            self._was_told = True
        return error

    def _reason(self) -> BaseException:
        """Return why no calls are taken now."""
        self._was_told = True
        failure = None if self._context is None else self._failure(self._context)
        return failure or self._error or MasterClosedError()

    # ---- the end ----

    def stop(self) -> BaseException | None:
        """Leave the context, and wait for that; the thread ends if nothing else is held in it. May be called twice, and by
        several threads. In a child process it does nothing.

        Returns the error that ended the context, unless a call has raised it already. An interrupt meanwhile is raised once the
        context is left; a second one at once.
        """
        if not self.is_of_this_process:
            return None
        if self._loop is not None and self._loop.is_here:
            raise LocalProtocolError("a master cannot be closed in its own thread; close it in another one")
        self._is_stopping = True
        interrupt: BaseException | None = None
        try:
            self._leave()
        except BaseException as raised:  # noqa: BLE001 - raised again below
            interrupt = raised
            self._soon(self._hurry)
            self._leave()
        _running.discard(self)
        if not _running:
            _handle_interrupts(_interrupt, signal.default_int_handler)
        error = None if self._was_told else self._error
        self._was_told = True
        if interrupt is not None:
            raise interrupt
        return error

    def _leave(self) -> None:
        self._soon(self._scope.cancel)
        if self._begun.is_set():
            self._wait(self._ended)
            if self._loop is not None:
                self._loop.join()

    def _wait(self, event: threading.Event) -> None:
        while not event.wait(LOOK_UP):
            if self._loop is not None and not self._loop.thread.is_alive() and not event.is_set():
                raise MasterClosedError  # trio itself has failed; its error was shown

    def _soon(self, function: Callable[[], object]) -> None:
        """Run something in the loop, unless that is over."""
        if self._loop is not None:
            self._loop.hand_over(function)


class _Call:
    """One call: what is called, and where its caller waits. scope: cancels it while it runs."""

    __slots__ = ("_slot", "args", "error", "function", "is_done", "kwargs", "scope", "timeout", "value")

    def __init__(self, function: Callable[..., Any], args: Any, kwargs: Any, timeout: float | None) -> None:
        self.function = function
        self.args = args
        self.kwargs = kwargs
        self.timeout = timeout
        self.scope: trio.CancelScope | None = None
        self.is_done = False
        self.value: Any = None
        self.error: BaseException | None = None
        self._slot = WaitingPlace()

    def end(self, value: Any = None, error: BaseException | None = None) -> None:
        """Tell the caller."""
        if not self.is_done:
            self.value, self.error, self.is_done = value, error, True
            self._slot.set()

    def wait(self, thread: threading.Thread) -> None:
        """Wait for the end. Raises MasterClosedError if the thread has ended without."""
        if not self._slot.wait(thread):
            raise MasterClosedError

    def wait_once(self) -> None:
        """Wait for the end, LOOK_UP at most."""
        self._slot.wait_once()


class _HeldCall(_Call):
    """A call that holds a context. entered: it is in, or has failed to get there."""

    __slots__ = ("entered",)

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function, (), {}, None)
        self.entered = threading.Event()

    def end(self, value: Any = None, error: BaseException | None = None) -> None:
        super().end(value, error)
        self.entered.set()


class Held(Generic[R]):
    """The context manager that `Background.held` returns. An error of its block reaches the async one; an interrupt cancels
    it."""

    def __init__(self, background: Background[Any], make: Callable[[], AbstractAsyncContextManager[R]]) -> None:
        self._background = background
        self._make = make
        self._value: R | None = None
        self._has_entered = False
        self._leave: trio.Event | None = None
        self._error: BaseException | None = None  # of the block
        self._call = _HeldCall(self._hold)

    def __enter__(self) -> R:
        background, call = self._background, self._call
        loop = background._loop_for(call)
        try:
            if not loop.hand_over(background._begin, call):
                call.end(error=background._reason())
            background._wait(call.entered)
        except BaseException:  # interrupted
            background._take_back(call, loop)
            raise
        if not self._has_entered:
            background._result_of(call)
            raise MasterClosedError
        return self._value  # type: ignore[return-value]  # None only if that is the value

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> bool:
        background, call = self._background, self._call
        loop = background._loop_for(call)
        self._error = error
        try:
            if loop.hand_over(self._let_go):
                call.wait(loop.thread)
        except BaseException:  # interrupted
            background._take_back(call, loop)
            raise
        if error is not None and (call.error is error or not isinstance(error, Exception)):
            return False
        background._result_of(call)
        return error is not None

    def _let_go(self) -> None:
        if self._error is not None and not isinstance(self._error, Exception):
            self._background._cancel(self._call)
        elif self._leave is not None:
            self._leave.set()

    async def _hold(self) -> None:
        async with self._make() as self._value:
            self._leave = trio.Event()
            self._has_entered = True
            self._call.entered.set()
            await self._leave.wait()
            if self._error is not None:
                raise self._error


class _Worker:
    """A task that serves calls. call: the present one. scope: around the task."""

    __slots__ = ("_task", "call", "scope")

    def __init__(self, call: _Call) -> None:
        self.call = call
        self.scope = trio.CancelScope()
        self._task: trio.lowlevel.Task | None = None

    def take(self, call: _Call) -> None:
        """Give it a call, while it waits for one."""
        task, self._task = self._task, None
        assert task is not None
        self.call = call
        trio.lowlevel.reschedule(task)

    async def next_call(self) -> None:
        """Wait for `take`."""
        self._task = trio.lowlevel.current_task()

        def abort(_: object) -> trio.lowlevel.Abort:
            self._task = None
            return trio.lowlevel.Abort.SUCCEEDED

        await trio.lowlevel.wait_task_rescheduled(abort)


_running: set[Background[Any]] = set()
"""Those whose end needs a Ctrl-C to be handled."""


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Handle a Ctrl-C as Python's own handler does, but do nothing once the main thread has ended and drives are being halted."""
    if threading.main_thread().is_alive():
        signal.default_int_handler(number, frame)


def _handle_interrupts(
    present: Callable[[int, FrameType | None], object], new: Callable[[int, FrameType | None], object]
) -> None:
    """Change the handler of Ctrl-C from `present` to `new`. Does nothing if the program has its own handler, or outside the main
    thread, which alone may change it."""
    if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) == present:
        signal.signal(signal.SIGINT, new)
