"""A raw CAN socket on trio: no thread, nothing between the kernel and the frame.

**Receiving.** One system call takes all frames that are there, up to a batch (batch.py), each with the kernel's time stamp. They
are kept until they are asked for, so that a cancelled `receive` has taken none; between two batches other tasks run. Frames that
the kernel had to drop are told at their place by its own counter; those dropped last, behind which nothing came, by a look at the
same counter when a burst is over.

**Sending.** A full queue shows in two ways. The socket's own limit: the kernel says EAGAIN, and tells by poll when there is room
again. The interface's queue (`txqueuelen`, as a rule 10 frames): ENOBUFS, and nobody tells when it has room. So the socket's
limit is set so low (SEND_BUFFER) that it is reached first: we then never have more frames under way than that queue holds, and no
SYNC stands behind a long row of SDO frames. Where other programs fill the queue, ENOBUFS remains, and is tried again each
ROOM_POLL.

**What is no frame.** Error frames become `BusStateChanged` where they tell something new. At an interface that goes down we look
each UP_POLL until it is up again, be it the same or, after an adapter was plugged in again, a new one of that name; the two
reports stand around what may be missing. What was received before it went down is handed out first. While the bus is away,
sending raises `FrameNotSent`. It also raises it at bus-off, where the kernel accepts frames and silently drops them. A bus-off
that came before we listened, or whose error frame was lost, shows by the interface's carrier.

**Filters.** `?filter=ids`: the kernel only lets through what the caller asks for by `set_filters` (a master's pump does: the
CAN-IDs that its machines want). That spares the wakes for foreign frames, but hides from error messages what other nodes say.

Left out: CAN FD (the kernel gives such frames only to those who ask for them), and time stamps of the adapters' own hardware
clocks, each of which begins somewhere else.
"""

from __future__ import annotations

import ctypes
import errno
import socket
from collections import deque
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Final

import trio

from canopen_proto.frame import EXTENDED, REMOTE, Frame, RoutingKey
from canopen_transports import diagnosis
from canopen_transports.errors import (
    BUS_LOST,
    BusState,
    BusStateChanged,
    FrameNotSent,
    ReceiveOverrun,
    Report,
)
from canopen_transports.locator import Locator, Option
from canopen_transports.socketcan import kernel
from canopen_transports.socketcan.batch import BATCH, Batch
from canopen_transports.socketcan.broadcast import Broadcast, check_cyclic
from canopen_transports.socketcan.error_frames import ErrorReport
from canopen_transports.transport import MAX_LENGTH, MAX_STANDARD_ID, Received, check_frame

ROOM_TIME: Final = 1.0
"""Seconds that a sender waits for room. Ten frames, a network queue's usual length, take 0.13 s even at 10 kbit/s."""
ROOM_POLL: Final = 0.001
"""Seconds between two tries after ENOBUFS: four frames at 500k."""
UP_POLL: Final = 0.05
"""Seconds between two looks at an interface that is down."""
SEND_BUFFER: Final = 1
"""Bytes for frames under way: the least that the kernel allows, 4608, where it counts 384 to 770 for a frame: 6 to 12 frames."""
RECEIVE_BUFFER: Final = 4 << 20
"""Bytes for received frames; doubled and counted likewise: 10 000 frames. Without root's rights the kernel gives what
rmem_max allows."""
CROWD: Final = 16
"""So many frames at once make it worth a look at whether more were dropped: fewer fill no receive buffer."""
QUIET_TIME: Final = 1.0
"""Seconds before the same kind of fault is reported again: some come with each frame."""
MAX_BACKLOG: Final = 256
"""Batches that are taken in at most when the interface goes down: more than the receive buffer holds."""

_GONE: Final = (errno.ENETDOWN, errno.ENODEV, errno.ENXIO)
_DOWN_OR_OFF: Final = (BusState.DOWN, BusState.BUS_OFF)
_COUNTER: Final = 0xFFFFFFFF  # the kernel counts dropped frames in 32 bits


class SocketCanTransport(trio.abc.AsyncResource):
    """A raw CAN socket; made by `open_socketcan`.

    filtered: whether the kernel shall only let through what `set_filters` says; a Network that is driven with such a transport
    hears not all (`hears_all`). sends_sync: whether the bus's SYNC shall be sent by `start_cyclic`. state: the controller's, or
    DOWN. errors, last_error: how many error frames came, and what the last one said. received: how many frames.
    """

    def __init__(self, locator: Locator, *, filtered: bool = False, sends_sync: bool = False) -> None:
        """Raises OSError."""
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
        self._send_lock = trio.Lock()
        self._broadcast: Broadcast | None = None
        self._carrier_was_lost = False
        self._open()
        self._look_at_carrier()

    def _open(self) -> None:
        """A new socket, bound to the interface of our name."""
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
        """Whether the interface is up, None where it is gone. (The kernel binds to one that is DOWN, too.)"""
        return kernel.is_up(self._socket, self._locator.channel)

    # ---- sending ----

    async def send(self, frame: Frame) -> None:
        """Hand the frame to the kernel, waiting up to ROOM_TIME for room; then TransportError (CO110) with the likely causes.

        FrameNotSent while the interface is down or the controller bus-off.
        """
        check_frame(frame)
        await trio.lowlevel.checkpoint_if_cancelled()
        data = kernel.pack(frame)
        if self._send_lock.locked() or self._try_to_send(frame, data):
            async with self._send_lock:
                await self._wait_and_send(frame, data)
        await trio.lowlevel.cancel_shielded_checkpoint()

    def send_nowait(self, frame: Frame) -> bool:
        """Hand the frame to the kernel at once; False, and nothing was sent, where it has no room or others wait for it."""
        check_frame(frame)
        return not self._send_lock.locked() and not self._try_to_send(frame, kernel.pack(frame))

    def _try_to_send(self, frame: Frame, data: bytes) -> int:
        """Send, or EAGAIN or ENOBUFS for want of room; else 0."""
        if self._closed:
            raise trio.ClosedResourceError(f"{self.locator} was closed")
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
        give_up = trio.current_time() + ROOM_TIME
        while number := self._try_to_send(frame, data):
            if trio.current_time() >= give_up:
                raise diagnosis.no_room(self._locator, f"send {frame}", ROOM_TIME, self.received, self.last_error)
            if number == errno.ENOBUFS:
                await trio.sleep(ROOM_POLL)
            else:
                with (
                    suppress(trio.ClosedResourceError),
                    trio.move_on_at(give_up),
                ):  # closed, or the bus is away: the next try tells
                    await trio.lowlevel.wait_writable(self._socket)

    def _not_sent(self, frame: Frame) -> FrameNotSent:
        if self.state is BusState.BUS_OFF:
            return FrameNotSent.because(
                diagnosis.not_acknowledged(self._locator, f"send {frame}", self.last_error, self.received)
            )
        seen, cause, tries = self._why_away()
        return FrameNotSent(BUS_LOST, self.locator, f"cannot send {frame} on {self.locator}", seen=seen, cause=cause, tries=tries)

    # ---- receiving ----

    async def receive(self) -> Received | Report:
        """The next frame, with the kernel's time stamp (CLOCK_REALTIME), or a report. One task at a time."""
        return (await self.receive_many(1))[0]

    async def receive_many(self, limit: int) -> list[Received | Report]:
        """What the kernel has received, as soon as there is something: one batch at most. One task at a time."""
        await trio.lowlevel.checkpoint_if_cancelled()
        items = self._items
        while not items:
            await self._wait()
        return [items.popleft() for _ in range(min(limit, len(items)))]

    async def _wait(self) -> None:
        """Wait until the socket is readable, then read one batch of frames."""
        if self._closed:
            raise trio.ClosedResourceError(f"{self.locator} was closed")
        if self.state is BusState.DOWN:
            if not self._is_back():
                await trio.sleep(UP_POLL)
            return
        if self._is_burst:
            await trio.lowlevel.checkpoint()  # there is probably more; but others shall run, too
        else:
            with suppress(trio.ClosedResourceError):  # closed, or the bus is away: the next turn tells
                await trio.lowlevel.wait_readable(self._socket)
        if not self._closed and not self._items:  # a sender may have found the bus away meanwhile
            self._read()

    def _read(self) -> None:
        """Take in a batch."""
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
            self._note_dropped(self._dropped_at_look)  # all that was there at the last look has been taken in
            self._dropped_at_look = self._drop_counter()
            self._is_burst = self._dropped_at_look != self._dropped  # frames queued before the drop are handed out first
        if self._dropped != dropped:  # an error frame may be among what was lost
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
                    continue  # nothing that a wire carries: some program wrote it, and the kernel does not look
                length = min(length, MAX_LENGTH)
                if flags & REMOTE:
                    items.append((Frame(can_id, b"", flags, length), stamp))
                else:
                    items.append((Frame(can_id, data[:length], EXTENDED), stamp))
            received += 1
        self.received += received
        return count

    def _note_dropped(self, dropped: int) -> None:
        """The kernel has dropped so many frames so far; what is new of it is reported here."""
        lost = (dropped - self._dropped) & _COUNTER
        if 0 < lost <= _COUNTER >> 1:  # else it comes from before our last look
            self._dropped = dropped
            self._items.append(ReceiveOverrun(self.locator, lost, "the kernel's receive buffer for this socket was full"))

    def _drop_counter(self) -> int:
        counters: tuple[int, ...] = kernel.MEMINFO.unpack(
            self._socket.getsockopt(socket.SOL_SOCKET, kernel.SO_MEMINFO, kernel.MEMINFO.size)
        )
        return counters[-1]

    # ---- what is no frame ----

    def _on_error_frame(self, can_id: int, data: bytes) -> None:
        report = ErrorReport(can_id, data)
        self.errors += 1
        self.last_error = report.text
        if report.overrun:
            self._items.append(ReceiveOverrun(self.locator, 1, report.text))
        state = report.state
        if state in (BusState.FAULT, BusState.NO_ACKNOWLEDGE):  # no state of the controller, and it may come with each frame
            now = trio.current_time()
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
        trio.lowlevel.notify_closing(self._socket)  # a waiting receiver has something to return

    def _why_away(self) -> tuple[str, str, tuple[str, ...]]:
        """What is seen of an interface that is not up, the cause, what to do."""
        name = self._locator.channel
        if self.is_up() is None:
            cause = "the adapter was unplugged, or somebody removed or renamed it"
            return f"{name} is gone", cause, ("plug it in again", "ip link")
        return f"{name} is DOWN", "somebody set it down, or the adapter was unplugged", (diagnosis.bring_up(self._locator),)

    def _look_at_carrier(self) -> None:
        """Word of bus-off, or of its end, may have come before we listened, or be among what was lost."""
        if kernel.has_carrier(self._locator.channel) is False:
            if self.state not in _DOWN_OR_OFF:
                self._change(BusState.BUS_OFF, f"{self._locator.channel} has no carrier")
        elif self.state is BusState.BUS_OFF:
            self._carrier_was_lost = True

    def _go_down(self) -> None:
        """The interface went down, or away. What came before stands before the report."""
        for _ in range(MAX_BACKLOG):
            with suppress(OSError):  # more word of the same
                if not self._take():
                    break
        self._note_dropped(self._drop_counter())
        self._is_burst = False
        self.state = BusState.DOWN
        self._report(BusState.DOWN, *self._why_away())

    def _is_back(self) -> bool:
        """Whether the bus that is away has come back; then it is reported. (Of the end of bus-off an error frame tells, too.)"""
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
        if self._socket.getsockname() != (name,):  # its index is no sign: a new one may have the same
            old = self._socket
            try:
                if self._broadcast is not None:
                    self._broadcast.restart()
                self._open()
            except OSError:  # it went away again under our hands
                return False
            trio.lowlevel.notify_closing(old)
            old.close()
            seen = f"there is a new {name}, and it is UP"
        self.state = BusState.ACTIVE
        self._report(BusState.UP, seen)
        self._look_at_carrier()
        return self.state is BusState.ACTIVE

    # ---- filters, cyclic frames ----

    def set_filters(self, keys: Iterable[RoutingKey] | None) -> bool:
        """Receive only frames of these routing keys (`Network.can_ids()`) from now on; None: all. No frame is lost in between.

        Whether the kernel filters now: more than 512 keys are more than it can, so all frames come again.
        """
        wanted = None if keys is None else [kernel.filter_for(key) for key in dict.fromkeys(keys)]
        everything = wanted is None or len(wanted) > kernel.MAX_FILTERS
        self._filters = bytes(kernel.CAN_FILTER.size) if wanted is None or everything else b"".join(wanted)
        if not self._closed:
            self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, self._filters)
        return not everything

    def start_cyclic(self, frames: Sequence[Frame], period: int) -> None:
        """Let the kernel send these frames in turn, one each `period` ns (see `Broadcast`). We receive them like foreign ones.

        Frames that are sent already start again. Raises ValueError for impossible frames or an impossible period, and
        TransportError if the kernel refuses.
        """
        if self._closed:
            raise trio.ClosedResourceError(f"{self.locator} was closed")
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
        """Leave the bus; a waiting task wakes with ClosedResourceError."""
        if not self._closed:
            self._closed = True
            self._items.clear()
            self.stop_cyclic()
            trio.lowlevel.notify_closing(self._socket)
            self._socket.close()
        await trio.lowlevel.checkpoint()


_OPTIONS: Final[dict[str, tuple[Option, ...]]] = {"filter": ("ids",), "sync": ("bcm",)}


def open_socketcan(locator: Locator) -> SocketCanTransport:
    """The transport for a locator that was parsed and whose interface is there. Raises TransportError."""
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
