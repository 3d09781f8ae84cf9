"""Any bus of python-can as a transport.

How frames come in depends on what the backend offers:

- a file descriptor (SocketCAN, udp_multicast, serial adapters on POSIX): trio waits on it, and no thread is needed;
- nothing but a blocking `recv` (PCAN-Basic, Kvaser, python-can's `virtual`, ...): one reader thread fills a bounded queue. It
  looks up every READ_POLL whether it shall end, so that closing is quick and clean.

How they go out: directly where the backend does not block, in a worker thread else. Where the backend has no room (ENOBUFS: the
network queue is full because nobody acknowledges, or because the bus is slow) we try again for ROOM_TIME. One lock keeps the
senders in order. Frames are whole or nothing for every backend, so a cancel while waiting for room means: not sent.

**When the bus goes away** (adapter unplugged, driver failed, interface down), a transport that was opened by a locator reports
DOWN, opens the bus anew each REOPEN_PAUSE until that succeeds, and reports UP; meanwhile `send` raises FrameNotSent. A bus that
you opened yourself cannot be opened anew: it ends with a TransportError.

**The controller's state** is known for pcan, whose status the reader thread looks at each READ_POLL, and for SocketCAN by its
error frames; the other backends tell only that there was an error frame. Out of bus-off a PEAK adapter is brought back by
initialising it anew after REOPEN_PAUSE (`?auto_reset=true` leaves that to its driver, which does it at once).

What python-can hides, and so we cannot tell either: that a serial-line adapter refused a command (it answers BELL).
"""

from __future__ import annotations

import os
import secrets
import socket
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final

import can
import trio

from canopen_proto.frame import Frame
from canopen_transports import diagnosis, peak
from canopen_transports.errors import (
    NOT_ACKNOWLEDGED,
    BusState,
    BusStateChanged,
    FrameNotSent,
    ReceiveOverrun,
    TransportError,
)
from canopen_transports.leftovers import close_serial_line
from canopen_transports.listen_only import is_listen_only
from canopen_transports.locator import Locator
from canopen_transports.messages import RefusedMessage, frame_of, message_of
from canopen_transports.receive_queue import RECEIVE_QUEUE_SIZE, ReceiveQueue
from canopen_transports.transport import Received, check_frame

READ_POLL: Final = 0.05
"""Seconds between a reader thread's looks at whether it shall end, and at the adapter's status."""
CLOSE_TIME: Final = 2.0
"""Seconds that closing waits for a reader thread whose driver does not come back."""
REOPEN_PAUSE: Final = 0.5
"""Seconds before each try to open anew a bus that went away. Long enough that a node which disturbs a bus until it is bus-off
leaves the others nearly all of the time."""
ROOM_TIME: Final = 1.0
"""Seconds that a sender waits for room. Ten frames, a network queue's usual length, take 0.13 s even at 10 kbit/s."""
ROOM_POLL: Final = 0.001
"""Seconds between two tries (no file descriptor tells when a network queue has room again): four frames at 500k."""
QUIET_TIME: Final = 1.0
"""Seconds before an error on the wire is reported again: they may come with each frame."""
RECEIVE_BUFFER: Final = 2 << 20
"""Bytes asked of the kernel for received frames. Its usual 208 KiB hold only some 250 frames; it gives what rmem_max allows."""

# Backends whose send only puts the frame into a queue.
_SEND_DOES_NOT_BLOCK: Final = ("can.interfaces.virtual", "can.interfaces.pcan")
_NONSENSE: Final = (ValueError, LookupError)
"""What python-can's parser of a serial line makes of what is no frame."""
_GARBLED: Final = "the serial line's speed (tty_baudrate) is wrong, or it is no such adapter"
_AWAY: Final = (BusState.DOWN, BusState.BUS_OFF)

_SO_MEMINFO: Final = 55  # linux/sock_diag.h: getsockopt gives nine counters, the last one counts what the socket dropped
_MEMINFO: Final = struct.Struct("9I")


class PythonCanTransport(trio.abc.AsyncResource):
    """A python-can bus, opened by `open_transport` or by you. Must be made inside a `trio.run`.

    owned: whether `aclose` shuts the bus down. A bus that you hand over must not echo its own frames (receive_own_messages), and
    while it is wrapped nobody else may receive from it. queue_size: how many frames a reader thread keeps at most. reopen: opens
    the bus anew, in a worker thread, when it went away; raises TransportError.

    state: the controller's as far as it is known, or DOWN. received: how many frames came. refused, last_refusal: how many
    messages were no classical CAN frames that make sense, and why the last was not. errors, last_error: how many error frames the
    controller reported, and what the last one said. listen_only: whether nothing can be sent.
    """

    def __init__(
        self,
        bus: can.BusABC,
        *,
        owned: bool = True,
        queue_size: int = RECEIVE_QUEUE_SIZE,
        locator: Locator | None = None,
        reopen: Callable[[], can.BusABC] | None = None,
    ) -> None:
        self._owned = owned
        self._locator = locator if locator is not None else _locator_of(bus)
        self._reopen = reopen
        self.locator = self._locator.text
        self.listen_only = is_listen_only(self._locator)
        self.state = BusState.ACTIVE
        self.received = 0
        self.refused = 0
        self.last_refusal = ""
        self.errors = 0
        self.last_error = ""
        self._quiet_until = 0.0
        self._closed = False
        self._closing = trio.Event()
        self._send_lock = trio.Lock()
        self._send_blocks = not _comes_from(bus, _SEND_DOES_NOT_BLOCK)
        # udp_multicast hands us our own frames too, and no longer knows where they came from: we know them by this mark.
        self._mark = secrets.token_hex(8) if _comes_from(bus, ("can.interfaces.udp_multicast",)) else None
        self._queue = ReceiveQueue(self.locator, queue_size)
        self._attach(bus)

    def _attach(self, bus: can.BusABC) -> None:
        """Begin to use a bus."""
        self._bus = bus
        self._is_open = True
        self._lost: Exception | None = None  # why the bus is to be opened anew; until somebody has looked, perhaps in vain
        self._is_over = False  # it was reported, and only opening it anew helps
        self._dropped = 0
        self._fd = _file_descriptor(bus)
        self._socket = _socket_of(self._fd)
        self._peak = peak.PeakStatus(bus) if _comes_from(bus, ("can.interfaces.pcan",)) else None
        self._status = 0
        self._reader: threading.Thread | None = None
        if self._fd is None:
            token = trio.lowlevel.current_trio_token()
            self._reader = threading.Thread(target=self._read, args=(token,), name=f"receive {self.locator}", daemon=True)
            self._reader.start()

    # ---- sending ----

    async def send(self, frame: Frame) -> None:
        """Hand the frame to the backend, waiting up to ROOM_TIME for room; then TransportError (CO110) with the likely causes.

        FrameNotSent while the bus is away (see this module's text), and where it was opened to listen only.
        """
        check_frame(frame)
        message = message_of(frame, self._mark)
        async with self._send_lock:
            give_up = trio.current_time() + ROOM_TIME
            while True:
                if self._closed:
                    raise trio.ClosedResourceError(f"{self.locator} was closed")
                if self.state in _AWAY or self._lost is not None or self.listen_only:
                    raise self._not_sent(frame)
                try:
                    await self._send_once(message)
                except diagnosis.IO_ERRORS as error:
                    if self._closed or not diagnosis.queue_is_full(error):
                        raise self._failed_send(frame, error) from error
                    if trio.current_time() >= give_up:
                        raise self._no_room(frame) from error
                else:
                    return
                await trio.sleep(ROOM_POLL)

    async def _send_once(self, message: can.Message) -> None:
        if self._socket is not None:
            self._bus.send(message, timeout=0)
        elif not self._send_blocks:
            self._bus.send(message)
        else:
            # A serial line takes a time limit; the other backends would take it as "wait for the acknowledge".
            timeout = ROOM_TIME if self._fd is not None else None
            await trio.to_thread.run_sync(self._bus.send, message, timeout)

    def _failed_send(self, frame: Frame, error: Exception) -> Exception:
        if self._closed:
            return trio.ClosedResourceError(f"{self.locator} was closed")
        status = self._peak.code(error) if self._peak is not None else 0
        if status and not peak.is_lost(status):
            return self._not_sent(frame, str(error), status)  # the reader thread looks at the status soon, and reports it
        if self._reopen is None:
            return diagnosis.bus_lost(self._locator, f"send {frame}", error)
        self._lost = error
        if self._fd is not None:
            trio.lowlevel.notify_closing(self._fd)  # who waits to receive has something to tell
        return self._not_sent(frame)

    def _not_sent(self, frame: Frame, seen: str = "", status: int = 0) -> FrameNotSent:
        doing = f"send {frame}"
        if self.listen_only:
            return FrameNotSent(
                NOT_ACKNOWLEDGED,
                self.locator,
                f"cannot {doing} on {self.locator}",
                seen="it was opened to listen only",
                tries=("open it without listen_only",),
            )
        if self.state is BusState.BUS_OFF or status & peak.BUS_OFF:
            why = diagnosis.not_acknowledged(self._locator, doing, seen or "the controller is bus-off", self.received)
        else:
            why = diagnosis.bus_lost(self._locator, doing, self._lost or can.CanOperationError(seen or self.last_error))
        return FrameNotSent(why.code, self.locator, why.failed, seen=why.seen, cause=why.cause, tries=why.tries)

    def _no_room(self, frame: Frame) -> TransportError:
        heard = f"{self.received} frames received so far" if self.received else "no frame ever received"
        seen = f"no room in the transmit queue for {ROOM_TIME:g} s; {heard}" + (f"; {self.last_error}" if self.last_error else "")
        return diagnosis.not_acknowledged(self._locator, f"send {frame}", seen, self.received)

    # ---- receiving ----

    async def receive(self) -> Received:
        """The next frame from the bus. BusStateChanged for what it reports besides."""
        await trio.lowlevel.checkpoint_if_cancelled()
        while True:
            if self._is_over and self._queue.is_empty():
                await self._come_back()
            elif self._fd is None:
                return await self._queue.get()
            elif (received := await self._receive_by_descriptor(self._fd)) is not None:
                return received

    async def _receive_by_descriptor(self, fd: int) -> Received | None:
        if self._closed:
            raise trio.ClosedResourceError(f"{self.locator} was closed")
        if self._lost is not None:
            raise self._go_down(self._lost)
        with suppress(trio.ClosedResourceError):  # closed, or the bus is lost: the next turn tells
            await trio.lowlevel.wait_readable(fd)
        if self._closed or self._lost is not None:
            return None
        lost = self._newly_dropped()
        if lost:
            raise ReceiveOverrun(self.locator, lost, "the kernel's receive buffer for this socket was full")
        try:
            message = self._bus.recv(0)
        except diagnosis.IO_ERRORS as error:
            failure = self._failed_read(error)
            if failure is None:
                return None
            raise failure from error
        accepted = self._accept(message) if message is not None else None
        if isinstance(accepted, TransportError):
            raise accepted
        return accepted

    def _failed_read(self, error: Exception) -> TransportError | None:
        """What a failed read of a descriptor means; None for a datagram that is not python-can's."""
        if self._mark is not None and not isinstance(error.__cause__, OSError):
            self._refuse(f"{error}: {error.__cause__}")
            return None
        nonsense = error if isinstance(error, _NONSENSE) else error.__cause__
        if isinstance(nonsense, _NONSENSE):
            self._refuse(f"{type(nonsense).__name__}: {nonsense}")
            flush = getattr(self._bus, "flush", None)
            if flush is not None:  # python-can's slcan keeps a line that it cannot decode, and would stumble over it for ever
                flush()
            return ReceiveOverrun(self.locator, 1, f"the adapter sent what is no frame: {self.last_refusal}", cause=_GARBLED)
        if self._reopen is None:
            return diagnosis.bus_lost(self._locator, "receive", error)
        return self._go_down(error)

    def _read(self, token: trio.lowlevel.TrioToken) -> None:
        """The reader thread. It ends when the transport is closed, or the bus went away."""
        bus, queue = self._bus, self._queue
        next_look = 0.0
        with suppress(trio.RunFinishedError):  # nobody closed us, and the run is over
            while not (self._closed or self._is_over):
                try:
                    message = bus.recv(READ_POLL)
                    accepted = self._accept(message) if message is not None else None
                    if isinstance(accepted, TransportError):
                        queue.report(accepted)
                    elif accepted is not None:
                        queue.put(accepted)
                    if self._lost is not None:  # a sender has met it
                        raise self._lost
                    now = time.monotonic()
                    if self._peak is not None and now >= next_look:
                        next_look = now + READ_POLL
                        self._follow(self._peak, self._peak.look())
                except diagnosis.IO_ERRORS as error:
                    if not self._on_failed_recv(error):
                        token.run_sync_soon(queue.wake)
                        return
                if not queue.is_empty():
                    token.run_sync_soon(queue.wake, idempotent=True)

    def _on_failed_recv(self, error: Exception) -> bool:
        """In the reader thread. Whether it may go on."""
        status = self._peak.code(error) if self._peak is not None else 0
        if self._peak is not None and status and not peak.is_lost(status):
            self._follow(self._peak, status | self._peak.look())
            time.sleep(ROOM_POLL)  # should each read fail
            return not self._closed
        if self._reopen is None:
            self._queue.fail(diagnosis.bus_lost(self._locator, "receive", error))
        else:
            self._queue.report(self._go_down(error))
        return False

    def _follow(self, status_of: peak.PeakStatus, status: int) -> None:
        """In the reader thread: report what is new in a PEAK adapter's status."""
        new, self._status = status & ~self._status, status
        if peak.has_overrun(new):
            self._queue.report(ReceiveOverrun(self.locator, 1, status_of.text(new)))
        if peak.is_lost(status):
            raise can.CanOperationError(status_of.text(status))
        state = peak.state_of(status)
        if state is not self.state:
            self._queue.report(self._change(state, status_of.text(status)))
            # The driver brings it back by itself, the owner of the bus may do so, or we open it anew.
            self._is_over = state is BusState.BUS_OFF and self._reopen is not None and not self._locator.options.get("auto_reset")

    # ---- the bus's state ----

    def _change(self, state: BusState, seen: str) -> BusStateChanged:
        """The report of a new state of the controller."""
        self.state = state
        if state not in (BusState.BUS_OFF, BusState.NO_ACKNOWLEDGE):
            return BusStateChanged(self.locator, state, seen)
        why = diagnosis.not_acknowledged(self._locator, "go on", seen, self.received)
        return BusStateChanged(self.locator, state, seen, cause=why.cause, tries=why.tries)

    def _go_down(self, error: Exception) -> BusStateChanged:
        """The report that the bus is gone, and is opened anew from now on."""
        self.state = BusState.DOWN
        self._lost = error
        self._is_over = True
        why = diagnosis.bus_lost(self._locator, "go on", error)
        tries = why.tries if self._locator.interface == "socketcan" else ("plug it in again: it is then opened by itself",)
        return BusStateChanged(self.locator, BusState.DOWN, why.seen, cause=why.cause, tries=tries)

    async def _come_back(self) -> None:
        """One try, after a pause, to open the bus anew; raises BusStateChanged when it is there."""
        with trio.move_on_after(REOPEN_PAUSE):
            await self._closing.wait()
        async with self._send_lock:
            if self._closed:
                raise trio.ClosedResourceError(f"{self.locator} was closed")
            assert self._reopen is not None  # else it cannot be over
            with trio.CancelScope(shield=True):  # whoever cancels us shall find the bus open or not, but not half
                await self._shut_down()
                try:
                    bus = await trio.to_thread.run_sync(self._reopen)
                except TransportError as error:
                    if self.state is BusState.DOWN:
                        return
                    raise self._go_down(can.CanOperationError(error.seen)) from error
            was_off = self.state is BusState.BUS_OFF
            self.state = BusState.ACTIVE
            self._attach(bus)
        if was_off:
            raise BusStateChanged(self.locator, BusState.ACTIVE, "the controller was initialised anew after bus-off")
        raise BusStateChanged(self.locator, BusState.UP, "the bus could be opened again")

    async def aclose(self) -> None:
        """Wake who waits with ClosedResourceError, end the reader thread, and shut the bus down if it is ours."""
        if not self._closed:
            self._closed = True
            self._closing.set()
            if self._fd is not None and self._is_open:
                trio.lowlevel.notify_closing(self._fd)
            self._queue.close()
            with trio.CancelScope(shield=True):
                async with self._send_lock:  # whoever is sending, or opening the bus anew, notices at its next step
                    await self._shut_down()
        await trio.lowlevel.checkpoint()

    async def _shut_down(self) -> None:
        """Let go of the bus; once."""
        if not self._is_open:
            return
        self._is_open = False
        if self._reader is not None:
            await trio.to_thread.run_sync(self._reader.join, CLOSE_TIME)
        if self._socket is not None:
            self._socket.close()
        if self._owned:
            with suppress(*diagnosis.IO_ERRORS):  # an unplugged adapter cannot be told that we leave it
                if self._socket is not None:
                    self._bus.shutdown()
                else:
                    await trio.to_thread.run_sync(self._bus.shutdown)
            close_serial_line(self._bus)

    def _accept(self, message: can.Message) -> Received | TransportError | None:
        """The frame that a message is, or what it reports, or None for what stops here."""
        if message.is_error_frame:
            return self._on_error_frame(message)
        if self._mark is not None and message.channel == self._mark:
            return None
        try:
            frame = frame_of(message)
        except RefusedMessage as reason:
            self._refuse(str(reason))
            return None
        self.received += 1
        # python-can's time stamp is a float of seconds: today's is good to some 0.2 us. Not to lose more, whole seconds go apart.
        seconds, fraction = divmod(message.timestamp, 1.0)
        return frame, int(seconds) * 1_000_000_000 + round(fraction * 1e9) if message.timestamp else None

    def _refuse(self, reason: str) -> None:
        self.refused += 1
        self.last_refusal = reason

    def _on_error_frame(self, message: can.Message) -> TransportError | None:
        self.errors += 1
        state: BusState | None = BusState.FAULT
        self.last_error = "error frame"
        if self._peak is not None:
            self.last_error = peak.error_text(message)
        elif self._locator.interface == "socketcan":
            from canopen_transports.socketcan.error_frames import ErrorReport  # only now, as its package is Linux's alone

            report = ErrorReport(message.arbitration_id, bytes(message.data))
            self.last_error, state = report.text, report.state
            if report.overrun:
                return ReceiveOverrun(self.locator, 1, report.text)
        if state in (BusState.FAULT, BusState.NO_ACKNOWLEDGE):  # no state of the controller, and it may come with each frame
            now = time.monotonic()
            if now < self._quiet_until:
                return None
            self._quiet_until = now + QUIET_TIME
            return BusStateChanged(self.locator, state, self.last_error)
        if state is None or state is self.state:
            return None
        return self._change(state, self.last_error)

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
