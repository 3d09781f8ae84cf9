"""Any bus of python-can as a transport.

**Receiving** depends on the backend: the loop waits for its file descriptor, or one thread reads it (see `readers`).

**Sending** is direct if the backend does not block, else in a worker thread. If the backend has no room (ENOBUFS: the network
queue is full because nobody acknowledges, or because the bus is slow) we try again for ROOM_TIME. A lock keeps the senders in
order. Every backend sends a frame whole or not at all, so a cancel while waiting for room means: not sent.

**When the bus goes away** (adapter unplugged, driver failed or hanging, interface down), a transport that was opened by a locator
reports DOWN. It tries to open the bus again each REOPEN_PAUSE, and reports UP when it succeeds; meanwhile `send` raises
FrameNotSentError. A bus that you opened yourself cannot be opened again: the transport ends with a TransportError.

**The controller's state** is known for pcan, whose status the reader thread looks at each READ_POLL, and for SocketCAN by its
error frames; the other backends report only that there was an error frame. After bus-off, a PEAK adapter is initialised again
after REOPEN_PAUSE (with `?auto_reset=true` its driver does that at once).

python-can hides that a serial-line adapter refused a command (it answers BELL), so we cannot report it.
"""

from __future__ import annotations

import functools
import secrets
import struct
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Final

import can

from canopen_proto.frame import Frame
from canopen_transports import diagnosis, peak
from canopen_transports.diagnosis import QUIET_TIME, ROOM_POLL, ROOM_TIME
from canopen_transports.driver_calls import call
from canopen_transports.error_frames import ErrorReport
from canopen_transports.errors import (
    NOT_ACKNOWLEDGED,
    BusState,
    BusStateChanged,
    FrameNotSentError,
    ReceiveOverrun,
    Report,
    TransportError,
)
from canopen_transports.leftovers import drop_garbage, has_hung_up, shut_down
from canopen_transports.listen_only import is_listen_only
from canopen_transports.locator import Locator
from canopen_transports.loop import AsyncResource, current_loop
from canopen_transports.messages import MessageRefusedError, frame_of, message_of, timestamp_of
from canopen_transports.readers import (
    READ_POLL,
    DescriptorReader,
    ThreadReader,
    comes_from,
    descriptor_is_enough,
    file_descriptor,
    is_socket,
)
from canopen_transports.receive_queue import RECEIVE_QUEUE_SIZE, ReceiveQueue
from canopen_transports.transport import Received, check_frame

REOPEN_PAUSE: Final = 0.5
"""Seconds before each try to open a bus again. Long enough that a node which disturbs a bus until it is bus-off leaves the bus to
the others nearly all of the time."""
IDLE_PAUSE: Final = 0.001
"""Seconds that a reader thread rests after its backend failed, or returned nothing without waiting."""
MAX_NONSENSE: Final = 100
"""After so many invalid frames in a row, this is not such an adapter (or `select` refuses its descriptor each time)."""

# Backends whose send only puts the frame into a queue.
_SEND_DOES_NOT_BLOCK: Final = ("can.interfaces.virtual", "can.interfaces.pcan")
# Backends whose `is_rx` is False for this bus's own frames alone. gs_usb always returns them; some others say the same of frames
# of other programs on this computer (socketcan, kvaser), which have to be heard.
_MARKS_OWN_FRAMES: Final = ("can.interfaces.gs_usb", "can.interfaces.pcan", "can.interfaces.virtual")
_NONSENSE: Final = (ValueError, LookupError, TypeError, struct.error)
"""The exceptions of python-can's parsers of serial lines for an invalid frame."""
_GARBLED: Final = "the serial line's speed (tty_baudrate) is wrong, or this is another kind of adapter"
_AWAY: Final = (BusState.DOWN, BusState.BUS_OFF)


class PythonCanTransport(AsyncResource):
    """A python-can bus, opened by `open_transport` or by you. Must be made where trio or asyncio runs.

    owned: whether `aclose` shuts the bus down. Nobody else may receive from a bus that you hand over. It must not echo its own
    frames (receive_own_messages): python-can marks them for gs_usb, pcan and virtual, and they are dropped; those of other
    backends are taken for another participant's. queue_size: how many frames a reader thread keeps at most. reopen: opens the bus
    again after it went away; raises TransportError.

    state: the controller's as far as it is known, or DOWN. bitrate: that of the locator. received: how many frames came. refused,
    last_refusal: how many messages were not valid frames of classical CAN, and why the last was not. errors, last_error: how many
    error frames the controller reported, and the text of the last one. listen_only: whether nothing can be sent.
    """

    def __init__(
        self,
        bus: can.BusABC,
        *,
        owned: bool = True,
        queue_size: int = RECEIVE_QUEUE_SIZE,
        locator: Locator | None = None,
        reopen: Callable[[], Awaitable[can.BusABC]] | None = None,
    ) -> None:
        self._loop = current_loop()
        self._owned = owned
        self._locator = locator if locator is not None else _locator_of(bus)
        self._reopen = reopen
        self.locator = self._locator.text
        self.bitrate = self._locator.bitrate
        self.listen_only = is_listen_only(self._locator)
        self.state = BusState.ACTIVE
        self.received = 0
        self.refused = 0
        self.last_refusal = ""
        self.errors = 0
        self.last_error = ""
        self._quiet_until = 0.0
        self._nonsense = 0  # in a row
        self._closed = False
        self._reopening = self._loop.cancel_scope()
        self._send_lock = self._loop.lock()
        # udp_multicast also returns our own frames; this mark tells them apart.
        self._mark = secrets.token_hex(8) if comes_from(bus, ("can.interfaces.udp_multicast",)) else None
        self._queue = ReceiveQueue(self.locator, queue_size)
        self._attach(bus)

    def _attach(self, bus: can.BusABC) -> None:
        """Begin to use a bus."""
        self._bus = bus
        self._is_open = True
        self._lost: Exception | None = None  # why it can no longer be used
        self._is_over = False  # reported; nothing more will come
        self._marks_own = comes_from(bus, _MARKS_OWN_FRAMES)
        self._peak = peak.PeakStatus(bus) if comes_from(bus, ("can.interfaces.pcan",)) else None
        self._status = 0
        self._next_look = 0.0
        fd = file_descriptor(bus)
        self._is_socket = fd is not None and is_socket(fd)
        self._is_serial_line = fd is not None and not self._is_socket
        # Some of the others understand a time limit as "wait for the acknowledge".
        self._send_limit = {"timeout": 0.0} if self._is_socket else {"timeout": ROOM_TIME} if self._is_serial_line else {}
        self._send_blocks = not (self._is_socket or comes_from(bus, _SEND_DOES_NOT_BLOCK))
        self._reader: DescriptorReader | ThreadReader
        if fd is not None and descriptor_is_enough(bus):
            self._reader = DescriptorReader(self.locator, fd, self._queue, self._take)
        else:
            self._reader = ThreadReader(self.locator, self._queue, self._take)

    @property
    def unheard(self) -> str | None:
        """As `NarrowTransport`: python-can may have been told to filter."""
        return "python-can was told to filter (can_filters)" if self._bus.filters else None

    # ---- sending ----

    async def send(self, frame: Frame) -> None:
        """Hand the frame to the backend. Waits up to ROOM_TIME for room, then raises TransportError (CO110) with the likely
        causes.

        Raises FrameNotSentError while the bus is away (see this module's text), and on a bus that was opened to listen only.
        """
        check_frame(frame)
        message = message_of(frame, self._mark)
        async with self._send_lock:
            give_up = self._loop.current_time() + ROOM_TIME
            while True:
                if self._closed:
                    raise self._loop.ClosedResourceError(f"{self.locator} was closed")
                if self.state in _AWAY or self._lost is not None or self.listen_only:
                    raise self._not_sent(frame)
                try:
                    await self._send_once(message)
                except diagnosis.DRIVER_ERRORS as error:
                    if self._closed or not diagnosis.queue_is_full(error):
                        raise self._failed_send(frame, error) from error
                    if self._loop.current_time() >= give_up:
                        raise diagnosis.no_room(
                            self._locator, f"send {frame}", ROOM_TIME, self.received, self.last_error
                        ) from error
                else:
                    return
                await self._loop.sleep(ROOM_POLL)

    async def _send_once(self, message: can.Message) -> None:
        send = functools.partial(self._bus.send, message, **self._send_limit)
        if self._send_blocks:
            await call(send)
        else:
            send()

    def _failed_send(self, frame: Frame, error: Exception) -> Exception:
        if self._closed:
            return self._loop.ClosedResourceError(f"{self.locator} was closed")
        status = self._peak.code(error) if self._peak is not None else 0
        if status and not peak.is_lost(status):
            return self._not_sent(frame, str(error))  # the reader thread looks at the status soon, and reports it
        self._lost = error
        self._reader.wake()  # a waiting `receive` has something to report
        return self._not_sent(frame)

    def _not_sent(self, frame: Frame, seen: str = "") -> TransportError:
        doing = f"send {frame}"
        if self.listen_only:
            return FrameNotSentError(
                NOT_ACKNOWLEDGED,
                self.locator,
                f"cannot {doing} on {self.locator}",
                seen="it was opened to listen only",
                tries=("open it without listen_only",),
            )
        if self.state is BusState.BUS_OFF or seen:
            why = diagnosis.not_acknowledged(self._locator, doing, seen or "the controller is bus-off", self.received)
        else:
            why = self._bus_lost(doing)
            if self._reopen is None:
                return why
        return FrameNotSentError.because(why)

    # ---- receiving ----

    async def receive(self) -> Received | Report:
        await self._loop.checkpoint_if_cancelled()
        while True:
            over = self._reader.is_over and self._queue.is_empty()
            received = await (self._come_back() if over else self._reader.get())
            if received is not None:
                return received

    async def receive_many(self, limit: int) -> list[Received | Report]:
        first = await self.receive()
        return [first] if self._queue.is_empty() else [first, *self._queue.take_many(limit - 1)]

    def _take(self, timeout: float) -> bool:
        """Look at the bus once, in the loop's thread or the reader's, and queue what came. Returns False if nothing more will
        come."""
        if self._closed:
            return False
        if self._lost is not None:  # a sender found out
            self._end(self._lost)
            return False
        began = time.monotonic()
        try:
            message = self._bus.recv(timeout)
            if message is not None:
                self._accept(message)
            elif has_hung_up(self._bus):
                raise ConnectionResetError("the server has closed the connection")
            elif time.monotonic() - began < timeout / 2:
                time.sleep(IDLE_PAUSE)
            if self._peak is not None and began >= self._next_look:
                self._next_look = began + READ_POLL
                self._follow(self._peak, self._peak.look())
        except diagnosis.DRIVER_ERRORS as error:
            try:
                self._on_failed_read(error)
            except diagnosis.DRIVER_ERRORS as worse:  # clearing up may fail, too, as with an unplugged line
                self._end(worse)
            if timeout:
                time.sleep(IDLE_PAUSE)  # in case every read fails
        return not (self._closed or self._is_over)

    def _on_failed_read(self, error: Exception) -> None:
        """Queue what a failed read means."""
        status = self._peak.code(error) if self._peak is not None else 0
        nonsense = error if isinstance(error, _NONSENSE) else error.__cause__
        if self._peak is not None and status:
            self._follow(self._peak, status | self._peak.look())
        elif self._mark is not None and isinstance(error, can.CanError) and not isinstance(error.__cause__, OSError):
            self._refuse(f"{error}: {error.__cause__}")  # a datagram that is not python-can's
        elif isinstance(nonsense, _NONSENSE) and self._nonsense < MAX_NONSENSE:
            self._nonsense += 1
            self._refuse(f"{type(nonsense).__name__}: {nonsense}")
            seen = f"what came is not a valid frame: {self.last_refusal}"
            cause = _GARBLED if self._is_serial_line else "another kind of device is at the other end, or its driver is faulty"
            self._queue.report(ReceiveOverrun(self.locator, 1, seen, cause=cause))
            drop_garbage(self._bus)
        else:
            self._end(error)

    def _follow(self, status_of: peak.PeakStatus, status: int) -> None:
        """Report what is new in a PEAK adapter's status."""
        new, self._status = status & ~self._status, status
        if peak.has_overrun(new):
            self._queue.report(ReceiveOverrun(self.locator, 1, status_of.text(new)))
        if peak.is_lost(status):
            self._end(can.CanOperationError(status_of.text(status)))
        elif (state := peak.state_of(status)) is not self.state:
            self._queue.report(self._change(state, status_of.text(status)))
            # The driver or the bus's owner brings it back, or we open it again.
            self._is_over = state is BusState.BUS_OFF and self._reopen is not None and not self._locator.options.get("auto_reset")

    def _accept(self, message: can.Message) -> None:
        """Queue the frame or the report in a message; drop our own and invalid frames."""
        if message.is_error_frame:
            self._on_error_frame(message)
        elif not message.is_rx and self._marks_own:
            return
        elif self._mark is None or message.channel != self._mark:
            try:
                frame = frame_of(message)
            except MessageRefusedError as reason:
                self._refuse(str(reason))
            else:
                self.received += 1
                self._nonsense = 0
                self._queue.put((frame, timestamp_of(message)))

    def _refuse(self, reason: str) -> None:
        self.refused += 1
        self.last_refusal = reason

    def _on_error_frame(self, message: can.Message) -> None:
        self.errors += 1
        state: BusState | None = BusState.FAULT
        self.last_error = "error frame"
        if self._peak is not None:
            self.last_error = peak.error_text(message)
        elif self._locator.interface == "socketcan":
            report = ErrorReport(message.arbitration_id, bytes(message.data))
            self.last_error, state = report.text, report.state
            if report.overrun:
                self._queue.report(ReceiveOverrun(self.locator, 1, report.text))
                return
        if state in (BusState.FAULT, BusState.NO_ACKNOWLEDGE):  # not a state of the controller; may come with each frame
            now = time.monotonic()
            if now >= self._quiet_until:
                self._quiet_until = now + QUIET_TIME
                self._queue.report(BusStateChanged(self.locator, state, self.last_error))
        elif state is not None and state is not self.state:
            self._queue.report(self._change(state, self.last_error))

    # ---- the bus's state ----

    def _change(self, state: BusState, seen: str) -> BusStateChanged:
        """Return the report of a new state of the controller."""
        self.state = state
        if state not in (BusState.BUS_OFF, BusState.NO_ACKNOWLEDGE):
            return BusStateChanged(self.locator, state, seen)
        why = diagnosis.not_acknowledged(self._locator, "go on", seen, self.received)
        return BusStateChanged(self.locator, state, seen, cause=why.cause, tries=why.tries)

    def _end(self, error: Exception) -> None:
        """The bus is gone. Report it if the bus can be opened again; else `receive` raises it, after all earlier frames."""
        self._lost = error
        self._is_over = True
        if self._reopen is not None:
            self._queue.report(self._down(error))

    def _bus_lost(self, doing: str) -> TransportError:
        return diagnosis.bus_lost(self._locator, doing, self._lost or can.CanOperationError(self.last_error))

    def _down(self, error: Exception) -> BusStateChanged:
        self.state = BusState.DOWN
        why = diagnosis.bus_lost(self._locator, "go on", error)
        tries = why.tries if self._locator.interface == "socketcan" else ("plug it in again; it is then opened automatically",)
        return BusStateChanged(self.locator, BusState.DOWN, why.seen, cause=why.cause, tries=tries)

    async def _come_back(self) -> BusStateChanged | None:
        """Wait REOPEN_PAUSE and try once to open the bus again. Returns the report of it, or None."""
        if self._closed:
            raise self._loop.ClosedResourceError(f"{self.locator} was closed")
        if self._reopen is None:
            raise self._bus_lost("receive")
        was_off = self.state is BusState.BUS_OFF
        with self._loop.cancel_scope() as self._reopening:  # `aclose` cancels this
            await self._loop.sleep(REOPEN_PAUSE)
            async with self._send_lock:
                await self._shut_down()
                try:
                    bus = await self._reopen()
                except TransportError as error:
                    self._lost = can.CanOperationError(error.seen)
                    return None if self.state is BusState.DOWN else self._down(self._lost)
                self.state = BusState.ACTIVE
                self._attach(bus)
        if self._closed:
            raise self._loop.ClosedResourceError(f"{self.locator} was closed")
        if was_off:
            return BusStateChanged(self.locator, BusState.ACTIVE, "the controller was initialised again after bus-off")
        return BusStateChanged(self.locator, BusState.UP, "the bus was opened again")

    async def aclose(self) -> None:
        """Wake waiting tasks with ClosedResourceError, end the reader thread, and shut the bus down if we own it."""
        if not self._closed:
            self._closed = True
            if self._is_open:
                self._reader.wake()
            self._queue.close()
            self._reopening.cancel()
            with self._loop.cancel_scope(shield=True):
                async with self._send_lock:  # a task that sends or reopens notices at its next step
                    await self._shut_down()
        await self._loop.checkpoint()

    async def _shut_down(self) -> None:
        """Give the bus back: once, and even if cancelled."""
        if not self._is_open:
            return
        self._is_open = False
        with self._loop.cancel_scope(shield=True):
            await self._reader.stop()
            if self._owned and self._is_socket:
                shut_down(self._bus)
            elif self._owned:
                with suppress(TimeoutError):  # its thread is left behind
                    await call(functools.partial(shut_down, self._bus))


def _locator_of(bus: can.BusABC) -> Locator:
    """Return a locator that names a bus which somebody else opened."""
    parts = type(bus).__module__.split(".")
    interface = parts[2] if parts[:2] == ["can", "interfaces"] else type(bus).__name__
    channel = getattr(bus, "channel", "")
    channel = channel if isinstance(channel, str) else ""
    return Locator(f"{interface} ({bus.channel_info})", False, interface, channel, None, {})
