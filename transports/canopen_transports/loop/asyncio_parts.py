"""What tasks wait for on asyncio: parking lots, events, locks, files, threads, other computers.

Each wait holds back a cancel of asyncio's own while a shield stands around it: see asyncio_scopes.py.
"""

from __future__ import annotations

import asyncio
import contextvars
import errno
import os
import socket
import threading
from asyncio import CancelledError, Future
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Any, Final, TypeVar

from canopen_transports.loop.asyncio_scopes import AsyncioScope, AsyncioTasks, Yield
from canopen_transports.loop.interface import BusyResourceError, ClosedResourceError, RunFinishedError

T = TypeVar("T")

_NOT_YET: Final = (errno.EINPROGRESS, errno.EWOULDBLOCK, errno.EALREADY)


class AsyncioLot:
    """A parking lot: see `ParkingLot`."""

    def __init__(self, tasks: AsyncioTasks) -> None:
        self._tasks = tasks
        self._parked: dict[Future[None], None] = {}  # in order

    def __bool__(self) -> bool:
        return bool(self._parked)

    async def park(self) -> None:
        await self._tasks.check()
        while True:
            future = self._tasks.loop.create_future()
            self._parked[future] = None
            try:
                await future
            except CancelledError:
                was_woken = not future.cancelled()
                if not self._tasks.goes_on(was_woken):
                    raise
                if was_woken:
                    return
            else:
                return
            finally:
                self._parked.pop(future, None)

    def unpark(self) -> None:
        for future in self._parked:
            if not future.done():
                future.set_result(None)
                break

    def unpark_all(self) -> None:
        for future in self._parked:
            if not future.done():
                future.set_result(None)


class AsyncioEvent:
    """An event: see `OneTimeEvent`."""

    def __init__(self, tasks: AsyncioTasks) -> None:
        self._tasks = tasks
        self._lot = AsyncioLot(tasks)
        self._is_set = False

    def is_set(self) -> bool:
        return self._is_set

    def set(self) -> None:
        self._is_set = True
        self._lot.unpark_all()

    async def wait(self) -> None:
        if self._is_set:
            await checkpoint(self._tasks)
        while not self._is_set:
            await self._lot.park()


class AsyncioLock:
    """A lock: see `FairLock`. Who gives it back hands it to the one who waits longest."""

    def __init__(self, tasks: AsyncioTasks) -> None:
        self._tasks = tasks
        self._is_locked = False
        self._waiting: list[AsyncioLot] = []

    def locked(self) -> bool:
        return self._is_locked

    async def __aenter__(self) -> None:
        if not self._is_locked:
            await self._tasks.check()
            self._is_locked = True
            await checkpoint(self._tasks, may_be_cancelled=False)
            return
        place = AsyncioLot(self._tasks)
        self._waiting.append(place)
        try:
            while place in self._waiting:
                await place.park()
        except BaseException:
            if place in self._waiting:
                self._waiting.remove(place)
            else:
                self._release()
            raise

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._release()

    def _release(self) -> None:
        if self._waiting:
            self._waiting.pop(0).unpark()
        else:
            self._is_locked = False


async def checkpoint(tasks: AsyncioTasks, may_be_cancelled: bool = True) -> None:
    """Let other tasks run."""
    try:
        await Yield()
    except CancelledError:  # by asyncio: scopes never cancel this
        if not tasks.goes_on(not may_be_cancelled):
            raise
    if may_be_cancelled and tasks.is_cancelled():
        raise CancelledError("by a cancel scope")


class AsyncioFiles:
    """Waits for files."""

    def __init__(self, tasks: AsyncioTasks) -> None:
        self._tasks = tasks
        loop = tasks.loop
        self._reading: dict[int, Future[None]] = {}
        self._writing: dict[int, Future[None]] = {}
        self._ways: Final = (
            (self._reading, loop.add_reader, loop.remove_reader),
            (self._writing, loop.add_writer, loop.remove_writer),
        )

    async def wait(self, file: Any, is_writing: bool) -> None:
        """Wait until a file can be read, or written."""
        await self._tasks.check()
        fd: int = file if isinstance(file, int) else file.fileno()
        waiting, add, remove = self._ways[is_writing]
        if fd in waiting:
            raise BusyResourceError(f"another task waits for the file {fd} already")
        while True:
            future = waiting[fd] = self._tasks.loop.create_future()
            add(fd, _settle, future)
            try:
                await future
            except CancelledError:
                is_ready = not future.cancelled()
                if not self._tasks.goes_on(is_ready):
                    raise
                if is_ready:
                    future.result()
                    return
            else:
                return
            finally:
                if waiting.get(fd) is future:
                    del waiting[fd]
                    remove(fd)

    def notify_closing(self, file: Any) -> None:
        """Wake those who wait for a file."""
        fd: int = file if isinstance(file, int) else file.fileno()
        for waiting, _, remove in self._ways:
            future = waiting.pop(fd, None)
            if future is not None:
                remove(fd)
                if not future.done():
                    future.set_exception(ClosedResourceError("the file was closed"))


def _settle(future: Future[None]) -> None:
    if not future.done():
        future.set_result(None)


class AsyncioToken:
    """The way into the loop from other threads: see `LoopToken`."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._asked: set[Callable[..., object]] = set()

    def run_sync_soon(self, function: Callable[..., object], /, *args: Any, idempotent: bool = False) -> None:
        if idempotent:
            if function in self._asked:
                return
            self._asked.add(function)
        try:
            self._loop.call_soon_threadsafe(self._call, function, args)
        except RuntimeError:
            raise RunFinishedError("the loop has ended") from None

    def _call(self, function: Callable[..., object], args: tuple[Any, ...]) -> None:
        self._asked.discard(function)
        function(*args)


async def in_thread(
    tasks: AsyncioTasks, token: AsyncioToken, function: Callable[..., T], args: tuple[Any, ...], abandon: bool
) -> T:
    """See `Loop.in_thread`. A thread of its own, that nothing waits for: some drivers never return."""
    await tasks.check()
    results: list[T] = []
    failures: list[BaseException] = []
    lot = AsyncioLot(tasks)
    context = contextvars.copy_context()

    def work() -> None:
        try:
            results.append(context.run(function, *args))
        except BaseException as error:  # noqa: BLE001 - raised in the task
            failures.append(error)
        with suppress(RunFinishedError):
            token.run_sync_soon(lot.unpark_all)

    threading.Thread(target=work, name=f"in_thread {getattr(function, '__name__', '')}", daemon=True).start()
    with AsyncioScope(tasks, float("inf"), not abandon):
        while not (results or failures):
            await lot.park()
    if failures:
        try:
            raise failures.pop()
        finally:
            del failures
    return results[0]


class AsyncioSocket:
    """A TCP connection: see `StreamSocket`. sock: it, which does not block."""

    def __init__(self, sock: socket.socket, files: AsyncioFiles, tasks: AsyncioTasks) -> None:
        self._socket = sock
        self._files = files
        self._tasks = tasks

    async def send(self, data: bytes, /) -> int:
        await self._tasks.check()
        while True:
            try:
                count = self._sock().send(data)
            except (BlockingIOError, InterruptedError):
                await self._files.wait(self._sock(), True)
            else:
                await checkpoint(self._tasks, may_be_cancelled=False)
                return count

    async def recv(self, size: int, /) -> bytes:
        await self._tasks.check()
        while True:
            try:
                data = self._sock().recv(size)
            except (BlockingIOError, InterruptedError):
                await self._files.wait(self._sock(), False)
            else:
                await checkpoint(self._tasks, may_be_cancelled=False)
                return data

    def _sock(self) -> socket.socket:
        if self._socket.fileno() < 0:
            raise ClosedResourceError("this socket was closed")
        return self._socket

    def setsockopt(self, level: int, option: int, value: int, /) -> None:
        self._socket.setsockopt(level, option, value)

    def close(self) -> None:
        if self._socket.fileno() >= 0:
            self._files.notify_closing(self._socket)
            self._socket.close()


async def connect_tcp(tasks: AsyncioTasks, token: AsyncioToken, files: AsyncioFiles, host: str, port: int) -> AsyncioSocket:
    """See `Loop.connect_tcp`. The addresses of the host are tried in turn."""
    look_up = (host, port, 0, socket.SOCK_STREAM)
    failure: OSError = OSError(f"{host} has no address")
    for family, kind, protocol, _, address in await in_thread(tasks, token, socket.getaddrinfo, look_up, True):
        sock = socket.socket(family, kind, protocol)
        try:
            sock.setblocking(False)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            code = sock.connect_ex(address)
            if code in _NOT_YET:
                await files.wait(sock, True)
                code = sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            if not code:
                return AsyncioSocket(sock, files, tasks)
            failure = OSError(code, os.strerror(code))
        except BaseException:
            sock.close()
            raise
        sock.close()
    raise failure
