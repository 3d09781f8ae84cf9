"""The transport: frames in, frames out, nothing else.

A transport knows nothing of CANopen. It carries `Frame`s between one participant and one CAN bus, and keeps these promises, which
`canopen_transports.conformance` checks for our transports and can check for yours:

- Frames of one task arrive at each other participant once, and in the order in which they were sent.
- A participant does not receive its own frames.
- Only valid frames of classical CAN are handed out. CAN FD, error frames and invalid frames are dropped.
- A received frame is lost only with a `ReceiveOverrun` at its place, or while the bus is away: between a `BusStateChanged` with
  DOWN or BUS_OFF and one with UP or ACTIVE. If a frame is not sent, `send` raises.
- `send` and `receive` are whole or nothing: if cancelled, the frame was not sent, or no frame was taken. Both let other tasks
  run.
- Closing wakes a waiting `receive` or `send` with the loop's `ClosedResourceError`. Each later call raises it, too.
- After closing, or after a failed opening, no thread and no descriptor is left.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Protocol, TypeAlias, runtime_checkable

from canopen_proto.frame import EXTENDED, REMOTE, Frame, RoutingKey
from canopen_transports.errors import Report

MAX_STANDARD_ID = 0x7FF
MAX_EXTENDED_ID = 0x1FFFFFFF
MAX_LENGTH = 8

Received: TypeAlias = tuple[Frame, int | None]
"""A frame and its time stamp: ns on the transport's own clock, or None if it has none. The clock does not run back unless
somebody sets it. virtual: the loop's clock; with options, the end of the frame. socketcan: the kernel's clock (CLOCK_REALTIME)
when it took the frame; in the first moments after opening, when the frame was read. python-can: the backend's, since 1970 or
since the adapter started. file: that of the file. tcp: None."""


class Transport(Protocol):
    """One participant's place on one CAN bus. To write your own, give a class these three methods."""

    async def send(self, frame: Frame) -> None:
        """Hand a frame to the bus. Returns once the bus, or the adapter's queue, has taken it; that is not yet an acknowledge.

        If a queue is full, waits for room, and raises TransportError (CO110) if none comes. Raises FrameNotSentError (a
        TransportError) while a bus is away that may come back, and ValueError for a frame that classical CAN cannot carry.
        """

    async def receive(self) -> Received | Report:
        """Wait for the next frame of another participant and return it with its time stamp, or return a Report.

        A ReceiveOverrun reports frames that were lost here, a BusStateChanged the state of the bus. One task at a time should
        receive: of two, each gets some of the frames, or one is refused by BusyResourceError. Raises TransportError if the
        bus fails.
        """

    async def aclose(self) -> None:
        """Leave the bus. May be called twice. Even if cancelled, the transport is closed afterwards."""


@runtime_checkable
class FilteringTransport(Protocol):
    """The additional methods of a transport that can leave out unwanted frames. filtered: whether it shall."""

    filtered: bool

    def set_filters(self, keys: Iterable[RoutingKey] | None) -> bool:
        """Receive only frames of these routing keys (`Frame.key`) from now on; None: all. Returns whether it leaves out others
        now."""


@runtime_checkable
class EagerTransport(Protocol):
    """The additional method of a transport that can hand a frame to the bus at once."""

    def send_nowait(self, frame: Frame) -> bool:
        """Hand a frame to the bus. Returns False, and sends nothing, if there is no room: then use `send`. Raises what `send`
        raises."""


@runtime_checkable
class BatchTransport(Protocol):
    """The additional method of a transport that can return many frames at once."""

    async def receive_many(self, limit: int) -> list[Received | Report]:
        """Wait until something has come; return 1 to `limit` frames and reports, in order.

        If cancelled, it took nothing. Raises what `receive` raises, once everything before that was returned.
        """


@runtime_checkable
class PromptTransport(Protocol):
    """The additional method of a transport that can tell at once what has come."""

    def receive_nowait(self, limit: int) -> list[Received | Report] | None:
        """Return what has come and was not handed over yet, in order, `limit` items at most; an empty list if nothing has.

        None: that is not known at present, `receive` must be waited for. Raises what `receive` raises.
        """


@runtime_checkable
class PushingTransport(Protocol):
    """The additional method of a transport that can hand over a frame without waking a task."""

    def push_to(self, receiver: Callable[[Frame, int], None] | None) -> None:
        """Call `receiver` with each frame that comes while no earlier frame waits, and with its time stamp, which must be the
        loop's clock in ns. None: stop calling it.

        After many frames in a row, a frame may come by `receive` instead, as reports always do. The receiver may send, but must
        not raise.
        """


@runtime_checkable
class CyclicTransport(Protocol):
    """The additional methods of a transport that sends cyclic frames by itself. sends_sync: whether it shall send the SYNC."""

    sends_sync: bool

    def start_cyclic(self, frames: Sequence[Frame], period: int) -> None:
        """Send the first frame now, then one each `period` ns, in turn. Each frame comes back by `receive`.

        Replaces cyclic frames that are already sent.
        """

    def stop_cyclic(self) -> None:
        """Stop the cyclic frames."""


@runtime_checkable
class RatedTransport(Protocol):
    """The additional property of a transport that may know its bus's bit rate."""

    @property
    def bitrate(self) -> int | None:
        """bit/s; None if it is not known."""


@runtime_checkable
class NarrowTransport(Protocol):
    """The additional property of a transport that may not hand over all that others send: behind a filter, or a gateway."""

    @property
    def unheard(self) -> str | None:
        """Why it may leave out frames of others, for people ("the gateway forwards only answers"); None if it leaves out none.

        What our own machines want by `FilteringTransport` is not meant."""


def check_frame(frame: Frame) -> None:
    """Raise ValueError unless classical CAN can carry the frame. (`Frame` itself does not check, for speed.)"""
    if not frame.flags and 0 <= frame.can_id <= MAX_STANDARD_ID and len(frame.data) <= MAX_LENGTH:
        return  # nearly all of them
    extended = frame.flags & EXTENDED
    limit = MAX_EXTENDED_ID if extended else MAX_STANDARD_ID
    if not 0 <= frame.can_id <= limit:
        raise ValueError(f"cannot send {frame!r}: CAN-ID 0x{frame.can_id:X} is outside 0..0x{limit:X}")
    if frame.flags & ~(EXTENDED | REMOTE):
        raise ValueError(f"cannot send {frame!r}: unknown flags 0x{frame.flags:X}")
    if len(frame.data) > MAX_LENGTH:
        raise ValueError(f"cannot send {frame!r}: {len(frame.data)} bytes, classical CAN carries at most {MAX_LENGTH}")
    if frame.flags & REMOTE and (frame.data or not 0 <= frame.dlc <= MAX_LENGTH):
        raise ValueError(f"cannot send {frame!r}: a remote frame has no data, and a length of 0..{MAX_LENGTH}")
