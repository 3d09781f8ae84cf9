"""Any bus of python-can as a transport.

How frames come in depends on what the backend offers:

- a file descriptor (SocketCAN, udp_multicast, serial adapters on POSIX): trio waits on it, and no thread is needed;
- nothing but a blocking `recv` (PCAN-Basic, Kvaser, python-can's `virtual`, ...): one reader thread fills a bounded queue. It
  looks up every READ_POLL whether it shall end, so that closing is quick and clean.

How they go out: directly where the backend does not block, in a worker thread else. Where the backend has no room (ENOBUFS: the
network queue is full because nobody acknowledges, or because the bus is slow) we try again for ROOM_TIME. One lock keeps the
senders in order. Frames are whole or nothing for every backend, so a cancel while waiting for room means: not sent.
"""

from __future__ import annotations

import os
import secrets
import socket
import struct
import threading
from contextlib import suppress
from typing import Final

import can
import trio

from canopen_proto.frame import Frame
from canopen_transports import diagnosis
from canopen_transports.errors import ReceiveOverrun, TransportError
from canopen_transports.locator import Locator
from canopen_transports.messages import BusError, RefusedMessage, frame_of, message_of
from canopen_transports.receive_queue import RECEIVE_QUEUE_SIZE, ReceiveQueue
from canopen_transports.transport import Received, check_frame

READ_POLL: Final = 0.05
"""Seconds between a reader thread's looks at whether it shall end."""
CLOSE_TIME: Final = 2.0
"""Seconds that closing waits for a reader thread whose driver does not come back."""
ROOM_TIME: Final = 1.0
"""Seconds that a sender waits for room. Ten frames, a network queue's usual length, take 0.13 s even at 10 kbit/s."""
ROOM_POLL: Final = 0.001
"""Seconds between two tries (no file descriptor tells when a network queue has room again): four frames at 500k."""
RECEIVE_BUFFER: Final = 2 << 20
"""Bytes asked of the kernel for received frames. Its usual 208 KiB hold only some 250 frames; it gives what rmem_max allows."""

# Backends whose send only puts the frame into a queue.
_SEND_DOES_NOT_BLOCK: Final = ("can.interfaces.virtual", "can.interfaces.pcan")

_SO_MEMINFO: Final = 55  # linux/sock_diag.h: getsockopt gives nine counters, the last one counts what the socket dropped
_MEMINFO: Final = struct.Struct("9I")


class PythonCanTransport(trio.abc.AsyncResource):
    """A python-can bus, opened by `open_transport` or by you. Must be made inside a `trio.run`.

    owned: whether `aclose` shuts the bus down. A bus that you hand over must not echo its own frames (receive_own_messages), and
    while it is wrapped nobody else may receive from it. queue_size: how many frames a reader thread keeps at most.

    refused, last_refusal: how many received messages were no classical CAN frames that make sense, and why the last was not.
    errors, last_error: how many error frames the controller reported, and what the last one said.
    """

    def __init__(
        self, bus: can.BusABC, *, owned: bool = True, queue_size: int = RECEIVE_QUEUE_SIZE, locator: Locator | None = None
    ) -> None:
        self._bus = bus
        self._owned = owned
        self._locator = locator if locator is not None else _locator_of(bus)
        self.locator = self._locator.text
        self.refused = 0
        self.last_refusal = ""
        self.errors = 0
        self.last_error = ""
        self._received = 0
        self._closed = False
        self._send_lock = trio.Lock()
        self._send_blocks = not _comes_from(bus, _SEND_DOES_NOT_BLOCK)
        # udp_multicast hands us our own frames too, and no longer knows where they came from: we know them by this mark.
        self._mark = secrets.token_hex(8) if _comes_from(bus, ("can.interfaces.udp_multicast",)) else None
        self._dropped = 0
        self._fd = _file_descriptor(bus)
        self._socket = _socket_of(self._fd)
        self._queue = ReceiveQueue(self.locator, queue_size)
        self._reader: threading.Thread | None = None
        if self._fd is None:
            token = trio.lowlevel.current_trio_token()
            self._reader = threading.Thread(target=self._read, args=(token,), name=f"receive {self.locator}", daemon=True)
            self._reader.start()

    async def send(self, frame: Frame) -> None:
        """Hand the frame to the backend, waiting up to ROOM_TIME for room; then TransportError (CO110) with the likely causes."""
        check_frame(frame)
        message = message_of(frame, self._mark)
        async with self._send_lock:
            give_up = trio.current_time() + ROOM_TIME
            while True:
                if self._closed:
                    raise trio.ClosedResourceError(f"{self.locator} was closed")
                try:
                    await self._send_once(message)
                except diagnosis.IO_ERRORS as error:
                    if self._closed or not diagnosis.queue_is_full(error):
                        raise self._failure(f"send {frame}", error) from error
                    if trio.current_time() >= give_up:
                        raise self._no_room(frame) from error
                else:
                    return
                await trio.sleep(ROOM_POLL)

    async def receive(self) -> Received:
        """The next frame from the bus."""
        if self._fd is None:
            return await self._queue.get()
        while True:
            if self._closed:
                raise trio.ClosedResourceError(f"{self.locator} was closed")
            await trio.lowlevel.wait_readable(self._fd)
            lost = self._newly_dropped()
            if lost:
                raise ReceiveOverrun(self.locator, lost, "the kernel's receive buffer for this socket was full")
            try:
                message = self._bus.recv(0)
            except diagnosis.IO_ERRORS as error:
                self._on_failed_read(error)
                continue
            received = self._accept(message) if message is not None else None
            if received is not None:
                return received

    async def aclose(self) -> None:
        """Wake who waits with ClosedResourceError, end the reader thread, and shut the bus down if it is ours."""
        if not self._closed:
            self._closed = True
            if self._fd is not None:
                trio.lowlevel.notify_closing(self._fd)
            self._queue.close()
            with trio.CancelScope(shield=True):
                if self._reader is not None:
                    await trio.to_thread.run_sync(self._reader.join, CLOSE_TIME)
                async with self._send_lock:  # whoever is sending notices at its next try
                    await self._shut_down()
        await trio.lowlevel.checkpoint()

    async def _shut_down(self) -> None:
        if self._socket is not None:
            self._socket.close()
        if self._owned:
            with suppress(*diagnosis.IO_ERRORS):  # an unplugged adapter cannot be told that we leave it
                if self._socket is not None:
                    self._bus.shutdown()
                else:
                    await trio.to_thread.run_sync(self._bus.shutdown)

    async def _send_once(self, message: can.Message) -> None:
        if self._socket is not None:
            self._bus.send(message, timeout=0)
        elif not self._send_blocks:
            self._bus.send(message)
        else:
            # A serial line takes a time limit; the other backends would take it as "wait for the acknowledge".
            timeout = ROOM_TIME if self._fd is not None else None
            await trio.to_thread.run_sync(self._bus.send, message, timeout)

    def _read(self, token: trio.lowlevel.TrioToken) -> None:
        """The reader thread."""
        with suppress(trio.RunFinishedError):  # nobody closed us, and the run is over
            while not self._closed:
                try:
                    message = self._bus.recv(READ_POLL)
                    received = self._accept(message) if message is not None else None
                except diagnosis.IO_ERRORS as error:
                    self._queue.fail(diagnosis.bus_lost(self._locator, "receive", error))
                    token.run_sync_soon(self._queue.wake)
                    return
                if received is not None:
                    self._queue.put(received)
                    token.run_sync_soon(self._queue.wake, idempotent=True)

    def _accept(self, message: can.Message) -> Received | None:
        """The frame that a message is, or None for what stops here. (Raises nothing in the reader thread, see error frames.)"""
        if message.is_error_frame:
            self._on_error_frame(message)
            return None
        if self._mark is not None and message.channel == self._mark:
            return None
        try:
            frame = frame_of(message)
        except RefusedMessage as reason:
            self._refuse(str(reason))
            return None
        self._received += 1
        # python-can's time stamp is a float of seconds: today's is good to some 0.2 us. Not to lose more, whole seconds go apart.
        seconds, fraction = divmod(message.timestamp, 1.0)
        return frame, int(seconds) * 1_000_000_000 + round(fraction * 1e9) if message.timestamp else None

    def _refuse(self, reason: str) -> None:
        self.refused += 1
        self.last_refusal = reason

    def _on_error_frame(self, message: can.Message) -> None:
        self.errors += 1
        if self._locator.interface != "socketcan":  # only there do we know what the bits mean; and it needs no reader thread
            self.last_error = "error frame"
            return
        report = BusError(message)
        self.last_error = report.text
        if report.overrun:
            raise ReceiveOverrun(self.locator, 1, report.text)
        if report.bus_off:
            raise diagnosis.not_acknowledged(self._locator, "go on", report.text, self._received)

    def _on_failed_read(self, error: Exception) -> None:
        """Raises, unless it was only a datagram that is not python-can's."""
        if self._mark is not None and not isinstance(error.__cause__, OSError):
            self._refuse(f"{error}: {error.__cause__}")
            return
        raise self._failure("receive", error) from error

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

    def _failure(self, doing: str, error: Exception) -> Exception:
        if self._closed:
            return trio.ClosedResourceError(f"{self.locator} was closed")
        return diagnosis.bus_lost(self._locator, doing, error)

    def _no_room(self, frame: Frame) -> TransportError:
        heard = f"{self._received} frames received so far" if self._received else "no frame ever received"
        seen = f"no room in the transmit queue for {ROOM_TIME:g} s; {heard}" + (f"; {self.last_error}" if self.last_error else "")
        return diagnosis.not_acknowledged(self._locator, f"send {frame}", seen, self._received)


def _file_descriptor(bus: can.BusABC) -> int | None:
    try:
        fd = bus.fileno()
    except (NotImplementedError, can.CanError, OSError):
        return None
    return fd if fd >= 0 else None


def _socket_of(fd: int | None) -> socket.socket | None:
    """A second handle on the socket behind a file descriptor; None if it is none (a serial line)."""
    if fd is None:
        return None
    own = os.dup(fd)
    try:
        handle = socket.socket(fileno=own)
    except OSError:
        os.close(own)
        return None
    handle.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
    return handle


def _comes_from(bus: can.BusABC, modules: tuple[str, ...]) -> bool:
    return any(cls.__module__.startswith(modules) for cls in type(bus).__mro__)


def _locator_of(bus: can.BusABC) -> Locator:
    """What to call a bus that was opened by somebody else."""
    parts = type(bus).__module__.split(".")
    interface = parts[2] if parts[:2] == ["can", "interfaces"] else type(bus).__name__
    channel = getattr(bus, "channel", "")
    channel = channel if isinstance(channel, str) else ""
    return Locator(f"{interface} ({bus.channel_info})", False, interface, channel, None, {})
