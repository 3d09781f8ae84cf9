"""A raw CAN socket: no thread, nothing between the kernel and the frame.

**Receiving.** One system call takes all waiting frames, up to a batch (batch.py), each with the kernel's time stamp. They are
kept until `receive` asks for them, so that a cancelled `receive` has taken none. Other tasks run between two batches. The kernel
counts the frames that it drops: its counter comes with the next frame, so the loss is reported at its place. When a burst is
over, we read the same counter once more, as no frame may follow the last loss.

**Sending.** A queue can be full in two ways. At the socket's own limit the kernel says EAGAIN, and poll tells when there is room
again. At the limit of the interface's queue (`txqueuelen`, usually 10 frames) it says ENOBUFS, and nothing tells when there is
room. So we set the socket's limit so low (SEND_BUFFER) that it is reached first. Then we never have more frames under way than
that queue holds, and no SYNC waits behind a long row of SDO frames. If other programs fill the queue, ENOBUFS remains, and we try
again each ROOM_POLL.

**Reports.** An error frame becomes a `BusStateChanged` if it reports something new. If the interface goes down, we look each
UP_POLL until it is up again; after an adapter was plugged in again, that is a new interface of the same name. Frames may be
missing between the two reports, DOWN and UP; frames from before DOWN are handed out first. While the bus is away, sending raises
`FrameNotSentError`. It also raises it at bus-off, where the kernel accepts frames and silently drops them. The interface's
carrier shows a bus-off that came before we listened, or whose error frame was lost.

**Filters.** With `?filter=ids` the kernel lets through only what the caller asks for by `set_filters`; a master's pump asks for
the CAN-IDs that its machines want. That spares wake-ups for other frames, but hides the other nodes from error messages.

Left out: CAN FD (the kernel gives such frames only on request), and time stamps of the adapters' own hardware clocks, whose zero
differs.
"""

from __future__ import annotations

import ctypes
import errno
import socket
from collections import deque
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Final

from canopen_proto.frame import EXTENDED, REMOTE, Frame, RoutingKey
from canopen_transports import diagnosis
from canopen_transports.diagnosis import QUIET_TIME, ROOM_POLL, ROOM_TIME
from canopen_transports.error_frames import ErrorReport
from canopen_transports.errors import (
    BUS_LOST,
    BusState,
    BusStateChanged,
    FrameNotSentError,
    ReceiveOverrun,
    Report,
)
from canopen_transports.locator import Locator, Option
from canopen_transports.loop import AsyncResource, current_loop
from canopen_transports.socketcan import kernel
from canopen_transports.socketcan.batch import BATCH, Batch
from canopen_transports.socketcan.bit_rate import bitrate_of
from canopen_transports.socketcan.broadcast import Broadcast, check_cyclic
from canopen_transports.transport import MAX_LENGTH, MAX_STANDARD_ID, Received, check_frame

UP_POLL: Final = 0.05
"""Seconds between two looks at an interface that is down."""
SEND_BUFFER: Final = 1
"""Bytes for frames under way. The kernel raises it to its least, 4608; it counts 384 to 770 for a frame, so 6 to 12 frames fit.
"""
RECEIVE_BUFFER: Final = 4 << 20
"""Bytes for received frames. The kernel doubles it: 10 000 frames fit. Without root's rights it gives at most rmem_max."""
CROWD: Final = 16
"""After so many frames at once we look whether the kernel dropped more: fewer fill no receive buffer."""
MAX_BACKLOG: Final = 256
"""The most batches that are read when the interface goes down: more than the receive buffer holds."""

_GONE: Final = (errno.ENETDOWN, errno.ENODEV, errno.ENXIO)
_DOWN_OR_OFF: Final = (BusState.DOWN, BusState.BUS_OFF)
_COUNTER: Final = 0xFFFFFFFF  # the kernel counts dropped frames in 32 bits


class SocketCanTransport(AsyncResource):
    """A raw CAN socket; made by `open_socketcan`.

    filtered: whether `set_filters` shall take effect; a Network on such a transport does not hear all frames (`hears_all`).
    sends_sync: whether `start_cyclic` shall send the bus's SYNC. state: the controller's, or DOWN. errors, last_error: how many
    error frames came, and the text of the last one. received: how many frames.
    """

    def __init__(self, locator: Locator, *, filtered: bool = False, sends_sync: bool = False) -> None:
        """Raises OSError."""
        self._loop = current_loop()
        self.locator = locator.text
        self.filtered = filtered
        self.sends_sync = sends_sync
        self.state = BusState.ACTIVE
        self.errors = 0
        self.last_error = ""
        self.received = 0
        self._locator = locator
        self._quiet_until = {BusState.FAULT: 0.0, BusState.NO_ACKNOWLEDGE: 0.0}
        self._closed = False
        self._filters: bytes | None = None
        self._items: deque[Received | Report] = deque()
        self._batch = Batch(ctypes.CDLL(None, use_errno=True))
        self._is_burst = False
        self._send_lock = self._loop.lock()
        self._broadcast: Broadcast | None = None
        self._carrier_was_lost = False
        self._open()
        self._look_at_carrier()

    def _open(self) -> None:
        """Make a new socket, bound to the interface of our name."""
        sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        try:
            sock.setblocking(False)
            try:
                sock.setsockopt(socket.SOL_SOCKET, kernel.SO_RCVBUFFORCE, RECEIVE_BUFFER)
            except PermissionError:
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
            sock.setsockopt(socket.SOL_SOCKET, kernel.SO_TIMESTAMPNS, 1)
            sock.setsockopt(socket.SOL_SOCKET, kernel.SO_RXQ_OVFL, 1)
            sock.setsockopt(socket.SOL_CAN_RAW, kernel.CAN_RAW_ERR_FILTER, kernel.ALL_ERRORS)
            if self._filters is not None:
                sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, self._filters)
            sock.bind((self._locator.channel,))
        except BaseException:
            sock.close()
            raise
        self._socket = sock
        self._dropped = self._dropped_at_look = 0

    def is_up(self) -> bool | None:
        """Return whether the interface is up; None if it is gone. (The kernel also binds to an interface that is DOWN.)"""
        return kernel.is_up(self._socket, self._locator.channel)

    # ---- sending ----

    @property
    def bitrate(self) -> int | None:
        """The bit rate of the interface in bit/s, as the kernel tells it now; None if it does not."""
        return bitrate_of(self._locator.channel)

    async def send(self, frame: Frame) -> None:
        """Hand the frame to the kernel. Waits up to ROOM_TIME for room, then raises TransportError (CO110) with the likely
        causes.

        Raises FrameNotSentError while the interface is down or the controller bus-off.
        """
        check_frame(frame)
        await self._loop.checkpoint_if_cancelled()
        data = kernel.pack(frame)
        if self._send_lock.locked() or self._try_to_send(frame, data):
            async with self._send_lock:
                await self._wait_and_send(frame, data)
        await self._loop.cancel_shielded_checkpoint()

    def send_nowait(self, frame: Frame) -> bool:
        """Hand the frame to the kernel at once. Returns False, and sends nothing, if there is no room or another task waits."""
        check_frame(frame)
        return not self._send_lock.locked() and not self._try_to_send(frame, kernel.pack(frame))

    def _try_to_send(self, frame: Frame, data: bytes) -> int:
        """Send the frame and return 0; if there is no room, return EAGAIN or ENOBUFS."""
        if self._closed:
            raise self._loop.ClosedResourceError(f"{self.locator} was closed")
        if self.state in _DOWN_OR_OFF and not self._is_back():
            raise self._not_sent(frame)
        try:
            self._socket.send(data)
        except OSError as error:
            if error.errno in (errno.EAGAIN, errno.ENOBUFS):
                return error.errno
            if error.errno in _GONE:
                self._go_down()
                raise self._not_sent(frame) from error
            raise diagnosis.bus_lost(self._locator, f"send {frame}", error) from error
        return 0

    async def _wait_and_send(self, frame: Frame, data: bytes) -> None:
        give_up = self._loop.current_time() + ROOM_TIME
        while number := self._try_to_send(frame, data):
            if self._loop.current_time() >= give_up:
                raise diagnosis.no_room(self._locator, f"send {frame}", ROOM_TIME, self.received, self.last_error)
            if number == errno.ENOBUFS:
                await self._loop.sleep(ROOM_POLL)
            else:
                # ClosedResourceError: the transport was closed, or the bus is away. The next try shows which.
                with suppress(self._loop.ClosedResourceError), self._loop.move_on_at(give_up):
                    await self._loop.wait_writable(self._socket)

    def _not_sent(self, frame: Frame) -> FrameNotSentError:
        if self.state is BusState.BUS_OFF:
            return FrameNotSentError.because(
                diagnosis.not_acknowledged(self._locator, f"send {frame}", self.last_error, self.received)
            )
        seen, cause, tries = self._why_away()
        return FrameNotSentError(
            BUS_LOST, self.locator, f"cannot send {frame} on {self.locator}", seen=seen, cause=cause, tries=tries
        )

    # ---- receiving ----

    async def receive(self) -> Received | Report:
        """Return the next frame, with the kernel's time stamp (CLOCK_REALTIME), or a report. One task at a time."""
        return (await self.receive_many(1))[0]

    async def receive_many(self, limit: int) -> list[Received | Report]:
        """Wait until the kernel has received something; return at most one batch. One task at a time. limit: how many at most."""
        await self._loop.checkpoint_if_cancelled()
        items = self._items
        while not items:
            await self._wait()
        return [items.popleft() for _ in range(min(limit, len(items)))]

    def receive_nowait(self, limit: int) -> list[Received | Report] | None:
        """Return what the kernel has received; None while frames come in bursts, and while the interface is down. limit: how many
        at most."""
        if self._closed:
            raise self._loop.ClosedResourceError(f"{self.locator} was closed")
        if not self._items:
            if self._is_burst or self.state is BusState.DOWN:
                return None
            self._read()
        return [self._items.popleft() for _ in range(min(limit, len(self._items)))]

    async def _wait(self) -> None:
        """Wait until the socket is readable, then read one batch of frames."""
        if self._closed:
            raise self._loop.ClosedResourceError(f"{self.locator} was closed")
        if self.state is BusState.DOWN:
            if not self._is_back():
                await self._loop.sleep(UP_POLL)
            return
        if self._is_burst:
            await self._loop.checkpoint()  # more frames probably wait, but other tasks shall run, too
        else:
            with suppress(self._loop.ClosedResourceError):  # closed, or the bus is away: the next turn shows which
                await self._loop.wait_readable(self._socket)
        if not self._closed and not self._items:  # a sender may have seen the bus go away meanwhile
            self._read()

    def _read(self) -> None:
        """Read one batch."""
        dropped = self._dropped
        try:
            count = self._take()
        except OSError as error:
            if error.errno not in _GONE:
                raise diagnosis.bus_lost(self._locator, "receive", error) from error
            self._go_down()
            return
        crowded = self._is_burst or count >= CROWD
        self._is_burst = count == BATCH
        if crowded and not self._is_burst:
            self._note_dropped(self._dropped_at_look)  # all frames from before the last look were read
            self._dropped_at_look = self._drop_counter()
            self._is_burst = self._dropped_at_look != self._dropped  # frames queued before the drop are handed out first
        if self._dropped != dropped:  # an error frame may be among the lost frames
            self._look_at_carrier()

    def _take(self) -> int:
        count = self._batch.receive(self._socket.fileno())
        items = self._items
        received = 0
        for can_id, length, data, stamp, dropped in self._batch.frames(count):
            if dropped:
                self._note_dropped(dropped)
            if can_id <= MAX_STANDARD_ID:
                items.append((Frame(can_id, data[:length]), stamp))
            elif can_id & kernel.ERROR_FRAME:
                self._on_error_frame(can_id, data[:length])
                continue
            else:
                flags = can_id >> 30
                can_id &= socket.CAN_EFF_MASK
                if can_id > MAX_STANDARD_ID and not flags & EXTENDED:
                    continue  # no wire carries this: a program wrote it, and the kernel does not check
                length = min(length, MAX_LENGTH)
                if flags & REMOTE:
                    items.append((Frame(can_id, b"", flags, length), stamp))
                else:
                    items.append((Frame(can_id, data[:length], EXTENDED), stamp))
            received += 1
        self.received += received
        return count

    def _note_dropped(self, dropped: int) -> None:
        """Report the frames that are new in the kernel's count of dropped frames."""
        lost = (dropped - self._dropped) & _COUNTER
        if 0 < lost <= _COUNTER >> 1:  # else the count is older than our last look
            self._dropped = dropped
            self._items.append(ReceiveOverrun(self.locator, lost, "the kernel's receive buffer for this socket was full"))

    def _drop_counter(self) -> int:
        counters: tuple[int, ...] = kernel.MEMINFO.unpack(
            self._socket.getsockopt(socket.SOL_SOCKET, kernel.SO_MEMINFO, kernel.MEMINFO.size)
        )
        return counters[-1]

    # ---- reports ----

    def _on_error_frame(self, can_id: int, data: bytes) -> None:
        report = ErrorReport(can_id, data)
        self.errors += 1
        self.last_error = report.text
        if report.overrun:
            self._items.append(ReceiveOverrun(self.locator, 1, report.text))
        state = report.state
        if state in (BusState.FAULT, BusState.NO_ACKNOWLEDGE):  # not a state of the controller; may come with each frame
            now = self._loop.current_time()
            if now >= self._quiet_until[state]:
                self._quiet_until[state] = now + QUIET_TIME
                self._report(state, report.text)
        elif state is not None and state is not self.state:
            self._change(state, report.text)

    def _change(self, state: BusState, seen: str) -> None:
        self.state = state
        self._carrier_was_lost = state is BusState.BUS_OFF and kernel.has_carrier(self._locator.channel) is False
        self._report(state, seen)

    def _report(self, state: BusState, seen: str, cause: str = "", tries: tuple[str, ...] = ()) -> None:
        if state in (BusState.BUS_OFF, BusState.NO_ACKNOWLEDGE):
            likely = diagnosis.not_acknowledged(self._locator, "go on", seen, self.received)
            cause, tries = likely.cause, likely.tries
        self._items.append(BusStateChanged(self.locator, state, seen, cause=cause, tries=tries))
        self._loop.notify_closing(self._socket)  # wake a waiting receiver

    def _why_away(self) -> tuple[str, str, tuple[str, ...]]:
        """Return what is seen of an interface that is not up, the cause, and what to do."""
        name = self._locator.channel
        if self.is_up() is None:
            cause = "the adapter was unplugged, or somebody removed or renamed it"
            return f"{name} is gone", cause, ("plug it in again", "ip link")
        return f"{name} is DOWN", "somebody set it down, or the adapter was unplugged", (diagnosis.bring_up(self._locator),)

    def _look_at_carrier(self) -> None:
        """Follow the carrier: the error frame of a bus-off, or of its end, may have come before we listened, or been lost."""
        if kernel.has_carrier(self._locator.channel) is False:
            if self.state not in _DOWN_OR_OFF:
                self._change(BusState.BUS_OFF, f"{self._locator.channel} has no carrier")
        elif self.state is BusState.BUS_OFF:
            self._carrier_was_lost = True

    def _go_down(self) -> None:
        """Report that the interface went down or away, after all frames that came before."""
        for _ in range(MAX_BACKLOG):
            with suppress(OSError):  # the same error again
                if not self._take():
                    break
        self._note_dropped(self._drop_counter())
        self._is_burst = False
        self.state = BusState.DOWN
        self._report(BusState.DOWN, *self._why_away())

    def _is_back(self) -> bool:
        """Return whether the bus is back, and report it if so. (An error frame also reports the end of bus-off.)"""
        name = self._locator.channel
        if self.state is BusState.BUS_OFF:
            runs = self._carrier_was_lost and kernel.has_carrier(name) is True
            if runs:
                self._change(BusState.ACTIVE, f"{name} has a carrier again")
            return runs
        self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)  # clear the pending socket error: we know of it already
        if not self.is_up():
            return False
        seen = f"{name} is UP again"
        if self._socket.getsockname() != (name,):  # not the index: a new interface may have the same one
            old = self._socket
            try:
                if self._broadcast is not None:
                    self._broadcast.restart()
                self._open()
            except OSError:  # it went away again meanwhile
                return False
            self._loop.notify_closing(old)
            old.close()
            seen = f"there is a new {name}, and it is UP"
        self.state = BusState.ACTIVE
        self._report(BusState.UP, seen)
        self._look_at_carrier()
        return self.state is BusState.ACTIVE

    # ---- filters, cyclic frames ----

    def set_filters(self, keys: Iterable[RoutingKey] | None) -> bool:
        """Receive only frames of these routing keys (`Network.can_ids()`) from now on; None: all. No frame is lost in between.

        Returns whether the kernel filters now. It cannot filter for more than 512 keys; then all frames come.
        """
        wanted = None if keys is None else [kernel.filter_for(key) for key in dict.fromkeys(keys)]
        everything = wanted is None or len(wanted) > kernel.MAX_FILTERS
        self._filters = bytes(kernel.CAN_FILTER.size) if wanted is None or everything else b"".join(wanted)
        if not self._closed:
            self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, self._filters)
        return not everything

    def start_cyclic(self, frames: Sequence[Frame], period: int) -> None:
        """Let the kernel send these frames in turn, one each `period` ns (see `Broadcast`). We receive them like frames of
        others.

        Replaces cyclic frames that are already sent. Raises ValueError for impossible frames or an impossible period, and
        TransportError if the kernel refuses.
        """
        if self._closed:
            raise self._loop.ClosedResourceError(f"{self.locator} was closed")
        check_cyclic(frames, period)
        self.stop_cyclic()
        try:
            self._broadcast = Broadcast(self._locator.channel, frames, period)
        except OSError as error:
            raise diagnosis.bus_lost(self._locator, f"send {frames[0]} cyclically", error) from error

    def stop_cyclic(self) -> None:
        """Stop the cyclic frames."""
        if self._broadcast is not None:
            self._broadcast.close()
            self._broadcast = None

    async def aclose(self) -> None:
        """Leave the bus. A waiting task wakes with ClosedResourceError."""
        if not self._closed:
            self._closed = True
            self._items.clear()
            self.stop_cyclic()
            self._loop.notify_closing(self._socket)
            self._socket.close()
        await self._loop.checkpoint()


_OPTIONS: Final[dict[str, tuple[Option, ...]]] = {"filter": ("ids",), "sync": ("bcm",)}


def open_socketcan(locator: Locator) -> SocketCanTransport:
    """Open the bus of a locator whose interface exists. Raises TransportError."""
    for name, value in locator.options.items():
        if value not in _OPTIONS.get(name, ()):
            raise diagnosis.unknown_option(locator, f"{name}={value}", [f"{key}={each[0]}" for key, each in _OPTIONS.items()])
    try:
        transport = SocketCanTransport(locator, filtered="filter" in locator.options, sends_sync="sync" in locator.options)
    except OSError as error:
        raise diagnosis.cannot_open(locator, error) from error
    if not transport.is_up():
        transport._socket.close()
        raise diagnosis.interface_down(locator)
    return transport
