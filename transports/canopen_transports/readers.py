"""How the frames of a python-can bus come in: two ways, and which backend needs which.

- `DescriptorReader`: trio waits on the bus's file descriptor, and nothing else runs (SocketCAN, udp_multicast, slcan on POSIX).
- `ThreadReader`: for what has nothing but a blocking `recv` (PCAN-Basic, Kvaser, python-can's `virtual`, ...), one thread fills a
  bounded queue. It looks up every READ_POLL whether it shall end, so that closing is quick and clean.

Both only say when to look at the bus. The look itself is the transport's: `take(timeout)` puts what came into the queue, and
returns False when nothing more will come. Then the reader is over: another bus needs another reader.
"""

from __future__ import annotations

import os
import socket
import stat
import struct
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from typing import Final

import can
import trio

from canopen_transports.driver_calls import DRIVER_TIME
from canopen_transports.errors import ReceiveOverrun, Report
from canopen_transports.receive_queue import ReceiveQueue
from canopen_transports.transport import Received

READ_POLL: Final = 0.05
"""Seconds between a reader thread's looks at whether it shall end, and at the adapter's status."""
RECEIVE_BUFFER: Final = 2 << 20
"""Bytes asked of the kernel for received frames. Its usual 208 KiB hold only some 250 frames; it gives what rmem_max allows."""

# These have a descriptor, and yet waiting for it is not enough: `serial` and `seeedstudio` wait for the rest of a frame (0.1 s
# and more, in which all of trio would stand still), and `robotell` keeps what it has read beyond one frame in its own buffer.
_DESCRIPTOR_IS_NOT_ENOUGH: Final = ("can.interfaces.serial", "can.interfaces.seeedstudio", "can.interfaces.robotell")

_SO_MEMINFO: Final = 55  # linux/sock_diag.h: getsockopt gives nine counters, the last one counts what the socket dropped
_MEMINFO: Final = struct.Struct("9I")


class Reader(ABC):
    """See this module's text. is_over: nothing more will come; what has come is still in the queue."""

    is_over = False

    @abstractmethod
    async def get(self) -> Received | Report | None:
        """The next frame or report. None: look again. Cancelled, it took none."""

    @abstractmethod
    def wake(self) -> None:
        """Let whoever waits in `get` look again. Only in the trio thread, and before `stop`."""

    @abstractmethod
    async def stop(self) -> None:
        """Let go of the bus. It was closed, or `is_over`."""


class DescriptorReader(Reader):
    """Waits in trio."""

    def __init__(self, locator: str, fd: int, queue: ReceiveQueue, take: Callable[[float], bool]) -> None:
        self._locator = locator
        self._fd = fd
        self._queue = queue
        self._take = take
        self._socket = _socket_of(fd) if is_socket(fd) else None
        self._dropped = 0
        self._is_woken = False

    async def get(self) -> Received | Report | None:
        if self.is_over or self._is_woken or not self._queue.is_empty():
            await trio.lowlevel.checkpoint()
        else:
            with suppress(trio.ClosedResourceError):  # somebody has called `wake`
                await trio.lowlevel.wait_readable(self._fd)
        if self._queue.is_empty() and not self.is_over:
            lost = self._newly_dropped()
            if lost:
                self._queue.report(ReceiveOverrun(self._locator, lost, "the kernel's receive buffer for this socket was full"))
            self.is_over = not self._take(0)
        return self._queue.take()

    def wake(self) -> None:
        self._is_woken = True
        trio.lowlevel.notify_closing(self._fd)

    async def stop(self) -> None:
        if self._socket is not None:
            self._socket.close()

    def _newly_dropped(self) -> int:
        """How many frames the kernel has dropped for this socket since we last asked."""
        if self._socket is None:
            return 0
        try:
            counters: tuple[int, ...] = _MEMINFO.unpack(self._socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size))
        except OSError:  # not Linux
            return 0
        dropped = counters[-1]
        lost, self._dropped = (dropped - self._dropped) & 0xFFFFFFFF, dropped
        return lost


class ThreadReader(Reader):
    """Reads in a thread, until the transport is closed or the bus went away; left open, until the first frame after the run."""

    def __init__(self, locator: str, queue: ReceiveQueue, take: Callable[[float], bool]) -> None:
        self._queue = queue
        self._take = take
        self._token = trio.lowlevel.current_trio_token()
        self._thread = threading.Thread(target=self._run, name=f"receive {locator}", daemon=True)
        self._thread.start()

    async def get(self) -> Received | Report | None:
        await trio.lowlevel.checkpoint()
        while (received := self._queue.take()) is None and not self.is_over:
            await self._queue.woken()
        return received

    def wake(self) -> None:
        """Nothing to do: it looks up by itself."""

    async def stop(self) -> None:
        await trio.to_thread.run_sync(self._thread.join, DRIVER_TIME)

    def _run(self) -> None:
        with suppress(trio.RunFinishedError):  # nobody closed us, and the run is over
            while self._take(READ_POLL):
                if not self._queue.is_empty():
                    self._token.run_sync_soon(self._queue.wake, idempotent=True)
            self.is_over = True
            self._token.run_sync_soon(self._queue.wake)


def file_descriptor(bus: can.BusABC) -> int | None:
    """The bus's file descriptor, if it has one."""
    try:
        fd = bus.fileno()
    except (NotImplementedError, can.CanError, OSError):
        return None
    return fd if fd >= 0 else None


def descriptor_is_enough(bus: can.BusABC) -> bool:
    """Whether a bus that has a file descriptor can be read whenever that is readable, at once."""
    return not comes_from(bus, _DESCRIPTOR_IS_NOT_ENOUGH)


def comes_from(bus: can.BusABC, modules: tuple[str, ...]) -> bool:
    """Whether a bus is of one of these backends of python-can."""
    return any(cls.__module__.startswith(modules) for cls in type(bus).__mro__)


def is_socket(fd: int) -> bool:
    """Whether there is a socket behind a file descriptor, and not a serial line."""
    return stat.S_ISSOCK(os.fstat(fd).st_mode)


def _socket_of(fd: int) -> socket.socket:
    """A second handle on the socket behind a file descriptor."""
    handle = socket.socket(fileno=os.dup(fd))
    handle.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
    return handle
