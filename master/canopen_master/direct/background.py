"""`Background`: an async context (a master) in a trio thread of its own, and calls into it from all other threads.

`start` begins a thread that enters an async context manager and stays in it until `stop`. `call` hands an async function to that
thread, where it runs as a task inside the context, and waits for its result; any number of threads may call at the same time.

**Nothing is left running.** If a caller is interrupted while it waits (Ctrl-C), its call is taken back: the task is cancelled,
which halts what it moved, and only then does the interrupt go on. When the context ends (by `stop`, or by itself because a bus
failed), all waiting calls end with the reason.

**The end of a script.** However the main thread ends (its last line, an exception, sys.exit, Ctrl-C), Python then waits for all
threads that are no daemons. Ours is not a daemon. It checks every WATCH_INTERVAL whether the main thread is still alive; if not,
it leaves the context, so that the drives are halted while the interpreter still works. (A daemon thread with an atexit function
would be too late: from there on Python 3.12 starts no new threads, which transports may need.) A Ctrl-C while Python waits would
end the interpreter at once. So if SIGINT still has Python's own handler, such a Ctrl-C does nothing: see `_interrupt`. No thread
helps against a signal that kills the process: `signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))` makes an exception of
SIGTERM.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Awaitable, Callable
from concurrent.futures import Future, wait
from contextlib import AbstractAsyncContextManager, suppress
from types import FrameType
from typing import Any, Final, Generic, TypeAlias, TypeVar

import trio

from canopen_master.errors import MasterClosedError
from canopen_master.plain_text import clean_lines
from canopen_proto.machine import LocalProtocolError

Handler: TypeAlias = Callable[[int, FrameType | None], object]

T = TypeVar("T")
R = TypeVar("R")

WATCH_INTERVAL: Final = 0.05
"""The most seconds until the end of the main thread is noticed."""
TAKE_BACK_TIME: Final = 30.0
"""Seconds that an interrupted call may take to clean up: a procedure takes CLEAN_UP_TIME, 1 s, or as long as a drive brakes. A
second Ctrl-C ends the waiting."""
_LOOK_UP: Final = 0.5
"""The longest single wait of a thread, in seconds: on Windows, a Ctrl-C takes effect only when the wait is over."""


class Background(Generic[T]):
    """See this module's text. Use it once: start, any number of calls, stop."""

    def __init__(
        self,
        make: Callable[[], AbstractAsyncContextManager[T]],
        failure: Callable[[T], Exception | None] = lambda _: None,
        name: str = "canopen master",
        clock: trio.abc.Clock | None = None,
    ) -> None:
        """make: returns the context manager; called in the thread. Entering and leaving it are not cancelled: they must end by
        themselves. failure: why the context ended, None if it was left. clock: trio's; None: the real time. name: of the
        thread."""
        self._make = make
        self._failure = failure
        self._clock = clock
        self._entered: Future[T] = Future()
        self._scope = trio.CancelScope()
        self._nursery: trio.Nursery | None = None  # where calls run; None before and after. Of our thread
        self._token: trio.lowlevel.TrioToken | None = None
        self._is_stopping = False
        self._error: BaseException | None = None  # the error that ended the context
        self._was_told = False  # whether that error was raised to a caller
        self._thread = threading.Thread(target=self._run, name=name, daemon=False)

    @property
    def is_running(self) -> bool:
        """Whether the thread takes calls."""
        return self._nursery is not None

    def start(self) -> T:
        """Begin the thread, and enter the context there. Returns and raises as the context does."""
        _handle_interrupts(signal.default_int_handler, _interrupt)
        try:
            self._thread.start()
            _wait(self._entered)
        except BaseException:  # interrupted
            if not self._thread.is_alive():  # interrupted in Thread.start: the thread may still be starting
                wait((self._entered,), _LOOK_UP)
            self.stop()
            raise
        return self._entered.result()

    def call(self, function: Callable[[T], Awaitable[R]]) -> R:
        """Run an async function of the context in the thread, wait for its end, and return its result or raise its error.

        If the context is over, raises the error that ended it, or MasterClosedError. If interrupted, takes the call back and
        waits for its clean-up. Raises LocalProtocolError if called in that very thread, which would wait for itself.
        """
        if threading.current_thread() is self._thread:
            raise LocalProtocolError("the blocking API was called in the master's own thread; call it in another one")
        if self._token is None:
            raise MasterClosedError
        future: Future[R] = Future()
        scope = trio.CancelScope()
        try:
            self._token.run_sync_soon(self._begin, function, scope, future)
        except trio.RunFinishedError:
            raise self._reason() from None
        try:
            _wait(future)
        except BaseException:  # interrupted
            self._soon(scope.cancel)
            _wait(future, TAKE_BACK_TIME)
            raise
        return future.result()

    def stop(self) -> BaseException | None:
        """Leave the context, end the thread, and wait for that. May be called twice, and by several threads.

        Returns the error that ended the context, unless a call has raised it already.
        """
        self._is_stopping = True
        self._soon(self._scope.cancel)
        while self._thread.is_alive():
            self._thread.join(_LOOK_UP)
        _handle_interrupts(_interrupt, signal.default_int_handler)
        error = None if self._was_told else self._error
        self._was_told = True
        return error

    def _run(self) -> None:
        try:
            trio.run(self._serve, clock=self._clock)
        except BaseException as error:  # noqa: BLE001 - every error belongs to the caller of `stop`
            self._error = error
        if not self._entered.done():
            self._was_told = True
            self._entered.set_exception(self._error or MasterClosedError())
        if self._error is not None and not self._was_told and not threading.main_thread().is_alive():
            print(clean_lines(str(self._error)), file=sys.stderr)  # no caller is left to get it

    async def _serve(self) -> None:
        self._token = trio.lowlevel.current_trio_token()
        async with self._make() as self._context:
            with self._scope:  # around the body only: entering and leaving are not cancelled
                if self._is_stopping:
                    return
                async with trio.open_nursery() as nursery:
                    self._nursery = nursery
                    try:
                        self._entered.set_result(self._context)
                        while threading.main_thread().is_alive():
                            await trio.sleep(WATCH_INTERVAL)
                        nursery.cancel_scope.cancel()
                    finally:
                        self._nursery = None  # here: a nursery takes no task once its last one has ended

    def _begin(self, function: Callable[[T], Awaitable[R]], scope: trio.CancelScope, future: Future[R]) -> None:
        if self._nursery is None:
            future.set_exception(self._reason())
        else:
            self._nursery.start_soon(self._serve_call, function, scope, future)

    async def _serve_call(self, function: Callable[[T], Awaitable[R]], scope: trio.CancelScope, future: Future[R]) -> None:
        try:
            with scope:
                try:
                    future.set_result(await function(self._context))
                except trio.Cancelled:
                    raise
                except BaseException as error:  # noqa: BLE001 - whatever it is belongs to the caller
                    self._was_told = self._was_told or error is self._failure(self._context)
                    future.set_exception(error)
        finally:
            if not future.done():
                future.set_exception(self._reason())

    def _reason(self) -> BaseException:
        """Return why the thread takes no calls now."""
        self._was_told = True
        failure = self._failure(self._context) if self._entered.done() else None
        return failure or self._error or MasterClosedError()

    def _soon(self, function: Callable[[], object]) -> None:
        """Run something in the thread, unless that is over."""
        if self._token is not None:
            with suppress(trio.RunFinishedError):
                self._token.run_sync_soon(function)


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


def _wait(future: Future[Any], timeout: float = float("inf")) -> None:
    """Wait until a call is done, or the time is over; Ctrl-C interrupts it."""
    while timeout > 0 and not wait((future,), min(timeout, _LOOK_UP)).done:
        timeout -= _LOOK_UP
