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

**What a call costs** is mostly two changes between threads: see LoopThread. A caller waits for a lock.
"""

from __future__ import annotations

import signal
import sys
import threading
from _thread import allocate_lock, get_ident
from collections.abc import Awaitable, Callable
from contextlib import AbstractAsyncContextManager
from time import monotonic
from types import FrameType, TracebackType
from typing import Any, Final, Generic, ParamSpec, TypeVar

import trio

from canopen_master.blocking.loop_thread import LOOK_UP, WATCH_INTERVAL, LoopThread, Work, held_in_shared_loop
from canopen_master.errors import CallTimeoutError, MasterClosedError, forked
from canopen_master.plain_text import clean_lines
from canopen_master.seconds import check_seconds
from canopen_proto.machine import LocalProtocolError

P = ParamSpec("P")
T = TypeVar("T")
R = TypeVar("R")

TAKE_BACK_TIME: Final = 30.0
"""Seconds that an interrupted call may take to clean up: a procedure takes CLEAN_UP_TIME, 1 s, or as long as a drive brakes. A
second Ctrl-C ends the waiting."""


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
        goes_last: bool = False,
        hurry: Callable[[], object] = lambda: None,
    ) -> None:
        """make: returns the context manager; called in the thread. Entering and leaving it are not cancelled: they must end by
        themselves. failure: why the context ended, None if it was left. clock: trio's; None: the real time. name: of the thread.

        shares_loop: it is held in the loop that all share, which has the real time. owner: the context is left when this thread
        has ended, as it is at the end of the main thread. goes_last: but not before all contexts of the same loop without this
        mark: simulated drives outlive their master. hurry: called in the loop if an interrupt comes while the context is
        left.
        """
        self._make = make
        self._failure = failure
        self._name = name
        self._clock = clock
        self._shares_loop = shares_loop
        self._owners = {threading.main_thread(), owner or threading.main_thread()}
        self.goes_last = goes_last
        self._hurry = hurry
        self._loop: LoopThread | None = None
        self._context: T | None = None
        self._scope = trio.CancelScope()
        self._is_open = False  # takes calls
        self._calls: set[_Call] = set()  # that run. Of the loop's thread
        self._last_call_ended = trio.Event()
        self._begun = threading.Event()
        self._entered = threading.Event()  # or it has failed to
        self._ended = threading.Event()
        self._is_stopping = False
        self._error: BaseException | None = None  # the error that ended the context
        self._was_told = False  # whether that error was raised to a caller

    @property
    def is_running(self) -> bool:
        """Whether calls are taken."""
        return self._is_open

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
                self._loop = held_in_shared_loop(self, self._name)
            else:
                self._loop = LoopThread(self, self._name, self._clock)
                self._loop.start()
            self.wait(self._entered)
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
        waits for its clean-up. Raises LocalProtocolError for a timeout that is no number of seconds, 0 or more; if called in the
        loop's own thread, which would wait for itself; and in a child process.
        """
        if timeout is not None:
            check_seconds("timeout", timeout, finite=False)
        result: R = self._called(_Call(self, function, args, kwargs, timeout))
        return result

    def do(self, function: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> R:
        """Call a plain function in the loop, and return its result. It must not block. Raises as `run` does."""
        result: R = self._called(_PlainCall(self, function, args, kwargs, None))
        return result

    def do_at_the_end(self, function: Callable[[], object]) -> None:
        """Call a plain function in the loop, also while the context is left; where the loop has ended, in this thread."""
        loop = self._loop
        if loop is None or loop.is_here:
            function()
            return
        if not loop.is_of_this_process:
            return
        call = _LastCall(self, function, (), {}, None)
        if loop.hand_over(call.begin):
            call.wait(loop.thread)
            call.result()
        else:
            function()

    def held(self, make: Callable[[], AbstractAsyncContextManager[R]]) -> Held[R]:
        """Return a context manager that holds an async one in the loop while its block runs. make: is called in the loop."""
        return Held(self, make)

    def _called(self, call: _Call) -> Any:
        """Hand a call to the loop, and wait for its end. Returns and raises as it does."""
        loop = self.loop
        try:
            if loop.hand_over(call.begin):
                call.wait(loop.thread)
            else:
                call.end(error=self.reason())
        except BaseException:  # interrupted
            self.take_back(call)
            raise
        return call.result()

    # ---- for the calls of this module ----

    @property
    def loop(self) -> LoopThread:
        """The loop that takes calls. Raises MasterClosedError before there is one, LocalProtocolError in its own thread, and in a
        child process."""
        loop = self._loop
        if loop is None:
            raise MasterClosedError
        if not loop.is_of_this_process:
            raise forked()
        if get_ident() == loop.ident:
            raise LocalProtocolError("the blocking API was called in the master's own thread; call it in another one")
        return loop

    def take_back(self, call: _Call) -> None:
        """Cancel a call, and wait for its clean-up."""
        loop = self.loop
        if loop.hand_over(call.cancel):
            until = monotonic() + TAKE_BACK_TIME
            while not call.is_done and monotonic() < until and loop.thread.is_alive():
                call.done.acquire(True, LOOK_UP)

    def wait(self, event: threading.Event) -> None:
        """Wait until something has happened in the loop. Raises MasterClosedError if the loop has ended without."""
        while not event.wait(LOOK_UP):
            if self._loop is not None and not self._loop.thread.is_alive() and not event.is_set():
                raise MasterClosedError  # trio itself has failed; its error was shown

    def begin(self, call: _Call) -> bool:
        """Return whether a call may begin, and count it; else tell it why. In the loop."""
        if self._is_open:
            self._calls.add(call)
            return True
        call.end(error=self.reason())
        return False

    def ended(self, call: _Call) -> None:
        """Count a call that `begin` has let begin. In the loop."""
        self._calls.discard(call)
        if not self._is_open and not self._calls:
            self._last_call_ended.set()

    def told(self, error: BaseException) -> BaseException:
        """Return an error that a caller gets."""
        if self._context is not None and error is self._failure(self._context):
            self._was_told = True
        return error

    def reason(self) -> BaseException:
        """Return why no calls are taken now. What its end has to say, `stop` says too."""
        failure = None if self._context is None else self._failure(self._context)
        if failure is not None:
            self._was_told = True
        return failure or self._error or MasterClosedError()

    # ---- in the loop ----

    async def hold(self) -> None:
        """See Holdable."""
        self._begun.set()
        try:
            await self._stay()
        except BaseException as error:  # noqa: BLE001 - every error belongs to the caller of `stop`
            self._error = error
        finally:
            self._entered.set()
            if self._error is not None and not self._was_told and self._is_orphaned and self._context is not None:
                print(clean_lines(str(self._error)), file=sys.stderr)  # no caller is left to get it
            self.at_the_end()
            self._ended.set()

    def at_the_end(self) -> None:
        """Is called in the loop once the context has ended."""

    async def _stay(self) -> None:
        async with self._make() as context:
            self._context = context
            with self._scope:  # around the body only: entering and leaving are not cancelled
                self._is_open = not self._is_stopping
                try:
                    self._entered.set()
                    while not (self._is_stopping or (self._is_orphaned and self._may_go)):
                        await trio.sleep(WATCH_INTERVAL)
                finally:
                    self._is_open = False
                    await self._end_calls()

    async def _end_calls(self) -> None:
        for call in self._calls:
            call.cancel()
        if self._calls:
            with trio.CancelScope(shield=True):
                await self._last_call_ended.wait()

    @property
    def _may_go(self) -> bool:
        return not self.goes_last or self._loop is None or all(each.goes_last for each in self._loop.held)

    @property
    def _is_orphaned(self) -> bool:
        """Whether a thread has ended that it was made for."""
        return not all(thread.is_alive() for thread in self._owners)

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
            if self._context is not None:
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
            self.wait(self._ended)
            if self._loop is not None:
                self._loop.join()

    def _soon(self, function: Callable[[], object]) -> None:
        """Run something in the loop, unless that is over."""

        def job() -> None:
            function()

        if self._loop is not None:
            self._loop.hand_over(job)


class _Call:
    """One call of an async function, and where its caller waits. See Background.run. done: a lock that its end releases."""

    __slots__ = ("_args", "_background", "_error", "_function", "_kwargs", "_scope", "_timeout", "_value", "done", "is_done")

    def __init__(
        self, background: Background[Any], function: Callable[..., Any], args: Any, kwargs: Any, timeout: float | None
    ) -> None:
        self._background = background
        self._function = function
        self._args = args
        self._kwargs = kwargs
        self._timeout = timeout
        self._scope: trio.CancelScope | None = None  # cancels it while it runs
        self._value: Any = None
        self._error: BaseException | None = None
        self.is_done = False
        self.done = allocate_lock()
        self.done.acquire()

    # ---- in the loop ----

    def begin(self) -> Work | None:
        """Return what has to be served. Nothing, if it was taken back before, or the context takes no calls."""
        return self if not self.is_done and self._background.begin(self) else None

    async def serve(self, scope: trio.CancelScope) -> None:
        """See Work."""
        if self.is_done:  # taken back meanwhile
            self._background.ended(self)
            return
        self._scope = scope
        value: Any = None
        error: BaseException | None = None
        try:
            if self._timeout is None:
                value = await self._function(*self._args, **self._kwargs)
            else:
                with trio.move_on_after(self._timeout) as limit:
                    value = await self._function(*self._args, **self._kwargs)
                if limit.cancelled_caught:
                    error = CallTimeoutError(self._timeout)
        except BaseException as raised:
            if _is_cancelled(raised):
                error = self._background.reason()
                raise
            error = self._background.told(raised)  # whatever it is belongs to the caller
        finally:
            self._scope = None
            self.end(value, error)
            self._background.ended(self)

    def cancel(self) -> None:
        """Cancel it. If it has not begun, it never will."""
        if self._scope is not None:
            self._scope.cancel()
        else:
            self.end(error=MasterClosedError())

    def end(self, value: Any = None, error: BaseException | None = None) -> None:
        """Tell the caller, who waits for it."""
        if not self.is_done:
            self._value, self._error, self.is_done = value, error, True
            self.done.release()

    # ---- in the caller's thread ----

    def wait(self, thread: threading.Thread) -> None:
        """Wait for the end. Raises MasterClosedError if the thread of the loop has ended without."""
        while not self.done.acquire(True, LOOK_UP):
            if not thread.is_alive() and not self.is_done:
                raise MasterClosedError

    def result(self) -> Any:
        """Return the value, or raise the error."""
        error, self._error = self._error, None
        if error is None:
            return self._value
        try:
            raise error
        finally:
            error = None  # else the error and this frame would hold each other


class _PlainCall(_Call):
    """A call of a plain function."""

    __slots__ = ()

    def begin(self) -> None:
        if not self.is_done and self._background.begin(self):
            self._do()
            self._background.ended(self)

    def _do(self) -> None:
        try:
            self.end(self._function(*self._args, **self._kwargs))
        except BaseException as error:  # noqa: BLE001 - whatever it is belongs to the caller
            self.end(error=self._background.told(error))


class _LastCall(_PlainCall):
    """A call of a plain function that is always let begin."""

    __slots__ = ()

    def begin(self) -> None:
        self._do()


class _HeldCall(_Call):
    """A call that holds a context. entered: it is in, or has failed to get there."""

    __slots__ = ("entered",)

    def __init__(self, background: Background[Any], function: Callable[..., Any]) -> None:
        super().__init__(background, function, (), {}, None)
        self.entered = threading.Event()

    def end(self, value: Any = None, error: BaseException | None = None) -> None:
        super().end(value, error)
        self.entered.set()

    def has_failed_by(self, error: BaseException) -> bool:
        """Return whether it ended with this error."""
        return self._error is error


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
        self._call = _HeldCall(background, self._hold)

    def __enter__(self) -> R:
        background, call = self._background, self._call
        loop = background.loop
        try:
            if not loop.hand_over(call.begin):
                call.end(error=background.reason())
            background.wait(call.entered)
        except BaseException:  # interrupted
            background.take_back(call)
            raise
        if not self._has_entered:
            call.result()
            raise MasterClosedError
        return self._value  # type: ignore[return-value]  # None only if that is the value

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> bool:
        background, call = self._background, self._call
        loop = background.loop
        self._error = error
        try:
            if loop.hand_over(self._let_go):
                call.wait(loop.thread)
        except BaseException:  # interrupted
            background.take_back(call)
            raise
        if error is not None and (call.has_failed_by(error) or not isinstance(error, Exception)):
            return False
        call.result()
        return error is not None

    def _let_go(self) -> None:
        if self._error is not None and not isinstance(self._error, Exception):
            self._call.cancel()
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


def _is_cancelled(error: BaseException) -> bool:
    """Return whether an exception is Cancelled, or a group of nothing else, as a nursery makes one."""
    if isinstance(error, BaseExceptionGroup):
        return error.split(trio.Cancelled)[1] is None
    return isinstance(error, trio.Cancelled)


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
