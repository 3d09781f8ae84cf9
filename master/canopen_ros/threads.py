"""The bridge runs in trio's thread; ROS calls back in threads of its own. These are the ways between them.

async with open_bridge(parameters) as bridge, open_portal() as portal:
    portal.call(chain.call, "init")            # from any other thread: waits for the result
    portal.submit(chain.follow, goal, tell)    # returns a concurrent.futures.Future
    portal.post(chain.command_velocities, [0.1, 0.0])
    with OutgoingMessages() as outgoing:               # trio's thread never waits for a publisher
        outgoing.put(publisher.publish, message)
        await until_stopped(rospy.is_shutdown)
"""

from __future__ import annotations

import signal
import threading
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import Future
from contextlib import asynccontextmanager
from functools import partial
from types import TracebackType
from typing import Any, Final, TypeVar, TypeVarTuple, Unpack

import trio

from canopen_master.errors import MasterClosedError

T = TypeVar("T")
Args = TypeVarTuple("Args")

LONGEST_QUEUE: Final = 1024
"""Messages that wait for the publisher: ten seconds of joint states at 100 Hz. With more, the oldest are dropped."""
PATIENCE: Final = 1.0
"""Seconds that a publisher may take for what waits at the end."""
LOOK: Final = 0.1
"""Seconds between two looks whether ROS wants the node to end."""


class Portal:
    """Lets other threads use the bridge. Made by `open_portal`."""

    def __init__(self, nursery: trio.Nursery) -> None:
        self._nursery = nursery
        self._token = trio.lowlevel.current_trio_token()
        self._open: set[Future[Any]] = set()
        self._waiting: deque[Callable[..., Awaitable[None]]] = deque()  # to be started, one after the other
        self._lock = threading.Lock()
        self._is_closed = False

    def submit(self, function: Callable[[Unpack[Args]], Awaitable[T]], *args: *Args) -> Future[T]:
        """Start an async function in trio's thread; return a Future of its result. May be called in any thread.

        Functions begin in the order of the calls, each up to where it first waits: a stop does not begin before the goal that it
        is to stop.

        A Future that is cancelled before its function begins never runs it. Once the portal is closed, or closes while the
        function runs, the Future has MasterClosedError.
        """
        future: Future[T] = Future()
        with self._lock:
            if self._is_closed:
                future.set_exception(MasterClosedError())
                return future
            self._open.add(future)
        try:
            self._token.run_sync_soon(self._start, function, args, future)
        except trio.RunFinishedError:
            self._end(future, error=MasterClosedError())
        return future

    def call(self, function: Callable[[Unpack[Args]], Awaitable[T]], *args: *Args) -> T:
        """Run an async function in trio's thread, and wait for its result. Not for trio's thread itself. Raises its error, or
        MasterClosedError."""
        return self.submit(function, *args).result()

    def post(self, function: Callable[[Unpack[Args]], object], *args: *Args) -> None:
        """Call a function in trio's thread, soon, in the order of the calls, without waiting. It must not raise or block.

        Does nothing once the portal is closed.
        """
        with self._lock:
            if self._is_closed:
                return
        try:
            self._token.run_sync_soon(self._call, function, args)
        except trio.RunFinishedError:
            return

    def close(self) -> None:
        """Take no more calls, and end those under way. In trio's thread."""
        with self._lock:
            self._is_closed = True
        self._nursery.cancel_scope.cancel()

    def settle(self) -> None:
        """Give the Futures that are left over their error, once nothing runs any more."""
        for future in tuple(self._open):
            self._end(future, error=MasterClosedError())

    def _call(self, function: Callable[..., object], args: tuple[Any, ...]) -> None:
        if not self._is_closed:
            function(*args)

    def _start(self, function: Callable[..., Awaitable[Any]], args: tuple[Any, ...], future: Future[Any]) -> None:
        if not self._is_closed and future.set_running_or_notify_cancel():
            self._waiting.append(partial(self._run, function, args, future))
            if len(self._waiting) == 1:
                self._nursery.start_soon(self._start_all)

    async def _start_all(self) -> None:
        """Start what waits. Trio begins tasks that are started in one turn in any order."""
        while self._waiting:
            await self._nursery.start(self._waiting[0])
            self._waiting.popleft()

    async def _run(
        self,
        function: Callable[..., Awaitable[Any]],
        args: tuple[Any, ...],
        future: Future[Any],
        task_status: trio.TaskStatus[None],
    ) -> None:
        task_status.started()
        try:
            result = await function(*args)
        except Exception as error:  # noqa: BLE001 - the caller's thread gets it
            self._end(future, error=error)
        except BaseException:
            self._end(future, error=MasterClosedError())
            raise
        else:
            self._end(future, result)

    def _end(self, future: Future[Any], result: Any = None, *, error: Exception | None = None) -> None:
        with self._lock:
            self._open.discard(future)
        if future.done():
            return
        if error is None:
            future.set_result(result)
        else:
            future.set_exception(error)


@asynccontextmanager
async def open_portal() -> AsyncIterator[Portal]:
    """Open a portal for as long as the block runs. On leaving it, calls under way are cancelled, and waited for."""
    failure: BaseException | None = None
    async with trio.open_nursery() as nursery:
        portal = Portal(nursery)
        try:
            yield portal
        except BaseException as error:  # noqa: BLE001 - raised below: the nursery would make a group of it
            failure = error
        portal.close()
    portal.settle()
    if failure is not None:
        raise failure


class OutgoingMessages:
    """A thread that publishes, so that trio's thread never waits for a publisher; see this module's text.

    dropped: messages lost because the thread could not keep pace. failures: calls that raised; `last_failure` is the last error.

    size: how many messages wait at most.
    """

    def __init__(self, size: int = LONGEST_QUEUE) -> None:
        self._waiting: deque[tuple[Callable[..., object], tuple[Any, ...]]] = deque()
        self._size = size
        self._news = threading.Condition()
        self._is_over = False
        self._thread = threading.Thread(target=self._publish, name="publisher", daemon=True)
        self.dropped = 0
        self.failures = 0
        self.last_failure: Exception | None = None

    def put(self, function: Callable[[Unpack[Args]], object], *args: *Args) -> None:
        """Let the thread call a function, after those given before. The oldest call is dropped if too many wait."""
        with self._news:
            if len(self._waiting) >= self._size:
                self._waiting.popleft()
                self.dropped += 1
            self._waiting.append((function, args))
            self._news.notify()

    def __enter__(self) -> OutgoingMessages:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """End the thread once it has published all that waits, after PATIENCE at the latest."""
        with self._news:
            self._is_over = True
            self._news.notify()
        self._thread.join(PATIENCE)

    def _publish(self) -> None:
        while True:
            with self._news:
                while not self._waiting:
                    if self._is_over:
                        return
                    self._news.wait()
                function, args = self._waiting.popleft()
            try:
                function(*args)
            except Exception as error:  # noqa: BLE001 - of ROS, on its way down for example; the node goes on
                self.failures += 1
                self.last_failure = error


async def until_stopped(is_shutdown: Callable[[], bool] | None = None) -> None:
    """Wait for SIGINT or SIGTERM, or until `is_shutdown` returns True. In the main thread.

    Leaving the bridge then halts all drives, and shuts them down.
    """
    with trio.open_signal_receiver(signal.SIGINT, signal.SIGTERM) as signals:
        async with trio.open_nursery() as nursery:

            async def receive() -> None:
                async for _ in signals:
                    break
                nursery.cancel_scope.cancel()

            nursery.start_soon(receive)
            while is_shutdown is None or not is_shutdown():
                await trio.sleep(LOOK)
            nursery.cancel_scope.cancel()
