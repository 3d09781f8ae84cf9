"""Two ways to take frames from a python-can bus, and which backend needs which.

- `DescriptorReader`: the loop waits for the bus's file descriptor, without a thread (SocketCAN, udp_multicast, slcan on POSIX).
- `ThreadReader`: for a backend that has only a blocking `recv` (PCAN-Basic, Kvaser, python-can's `virtual`, ...), one thread
  fills a bounded queue. It checks each READ_POLL whether it should end, so that closing is quick and clean.

A reader only decides when to look at the bus. The look itself is the transport's: `take(timeout)` queues what came, and returns
False when nothing more will come. Then the reader is over: another bus needs another reader.
"""

from __future__ import annotations

import os
import socket
import stat
import struct
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Final

import can

from canopen_transports.driver_calls import DRIVER_TIME
from canopen_transports.errors import ReceiveOverrun, Report
from canopen_transports.loop import current_loop
from canopen_transports.receive_queue import ReceiveQueue
from canopen_transports.transport import Received

READ_POLL: Final = 0.05
"""Seconds between a reader thread's checks of whether it should end, and of the adapter's status."""
RECEIVE_BUFFER: Final = 2 << 20
"""Bytes asked of the kernel for received frames; it gives at most rmem_max. Its usual 208 KiB hold only some 250 frames."""

# These have a descriptor, but waiting for it is not enough: `serial` and `seeedstudio` block until a frame is whole (0.1 s and
# more, in which the whole loop would stand still), and `robotell` buffers what it reads beyond one frame.
_DESCRIPTOR_IS_NOT_ENOUGH: Final = ("can.interfaces.serial", "can.interfaces.seeedstudio", "can.interfaces.robotell")

_SO_MEMINFO: Final = 55  # linux/sock_diag.h: nine counters; the last one counts dropped frames
_MEMINFO: Final = struct.Struct("9I")


class DescriptorReader:
    """Lets the loop wait for the file descriptor. is_over: nothing more will come; what came before is still in the queue."""

    def __init__(self, locator: str, fd: int, queue: ReceiveQueue, take: Callable[[float], bool]) -> None:
        self._loop = current_loop()
        self._locator = locator
        self._fd = fd
        self._queue = queue
        self._take = take
        self._socket = _socket_of(fd) if is_socket(fd) else None
        self._dropped = 0
        self._is_woken = False
        self.is_over = False

    async def get(self) -> Received | Report | None:
        """Return the next frame or report, or None: look again. If cancelled, it took none."""
        if self.is_over or self._is_woken or not self._queue.is_empty():
            await self._loop.checkpoint()
        else:
            with suppress(self._loop.ClosedResourceError):  # somebody has called `wake`
                await self._loop.wait_readable(self._fd)
        if self._queue.is_empty() and not self.is_over:
            lost = self._newly_dropped()
            if lost:
                self._queue.report(ReceiveOverrun(self._locator, lost, "the kernel's receive buffer for this socket was full"))
            self.is_over = not self._take(0)
        return self._queue.take()

    def wake(self) -> None:
        """Make a task that waits in `get` look again. Only in the loop's thread, and before `stop`."""
        self._is_woken = True
        self._loop.notify_closing(self._fd)

    async def stop(self) -> None:
        """Give the bus back, which was closed or `is_over`."""
        if self._socket is not None:
            self._socket.close()

    def _newly_dropped(self) -> int:
        """Return how many frames the kernel has dropped for this socket since the last call."""
        if self._socket is None:
            return 0
        try:
            counters: tuple[int, ...] = _MEMINFO.unpack(self._socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size))
        except OSError:  # not Linux
            return 0
        dropped = counters[-1]
        lost, self._dropped = (dropped - self._dropped) & 0xFFFFFFFF, dropped
        return lost


class ThreadReader:
    """Reads in a thread until the transport is closed, the bus is gone, or the first frame after the end of the run.

    is_over: as of DescriptorReader.
    """

    def __init__(self, locator: str, queue: ReceiveQueue, take: Callable[[float], bool]) -> None:
        self._queue = queue
        self._take = take
        self._loop = current_loop()
        self._token = self._loop.token()
        self.is_over = False
        self._thread = threading.Thread(target=self._run, name=f"receive {locator}", daemon=True)
        self._thread.start()

    async def get(self) -> Received | Report | None:
        await self._loop.checkpoint()
        while (received := self._queue.take()) is None and not self.is_over:
            await self._queue.woken()
        return received

    def wake(self) -> None:
        """Does nothing: the thread checks by itself."""

    async def stop(self) -> None:
        await self._loop.in_thread(self._thread.join, DRIVER_TIME)

    def _run(self) -> None:
        with suppress(self._loop.RunFinishedError):  # the run ended before the transport was closed
            while self._take(READ_POLL):
                if not self._queue.is_empty():
                    self._token.run_sync_soon(self._queue.wake, idempotent=True)
            self.is_over = True
            self._token.run_sync_soon(self._queue.wake)


def file_descriptor(bus: can.BusABC) -> int | None:
    """Return the bus's file descriptor, or None."""
    try:
        fd = bus.fileno()
    except (NotImplementedError, can.CanError, OSError):
        return None
    return fd if fd >= 0 else None


def descriptor_is_enough(bus: can.BusABC) -> bool:
    """Return whether a bus can be read without blocking whenever its file descriptor is readable."""
    return not comes_from(bus, _DESCRIPTOR_IS_NOT_ENOUGH)


def comes_from(bus: can.BusABC, modules: tuple[str, ...]) -> bool:
    """Return whether a bus is of one of these backends of python-can."""
    return any(cls.__module__.startswith(modules) for cls in type(bus).__mro__)


def is_socket(fd: int) -> bool:
    """Return whether a file descriptor is a socket, not a serial line."""
    return stat.S_ISSOCK(os.fstat(fd).st_mode)


def _socket_of(fd: int) -> socket.socket:
    """Return a second handle on the socket of a file descriptor."""
    handle = socket.socket(fileno=os.dup(fd))
    handle.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
    return handle
