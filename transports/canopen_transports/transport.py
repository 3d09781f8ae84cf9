"""What a transport is: frames in, frames out, nothing else.

A transport knows no CANopen. It carries `Frame`s between one participant and one CAN bus, and it keeps these promises, which
`canopen_transports.conformance` checks for each of ours and can check for yours:

- Frames sent by one task arrive at each other participant once and in the order in which they were sent.
- Our own frames do not come back.
- Only classical CAN frames that make sense are handed out: CAN FD, error frames and nonsense stop at the edge.
- A received frame is lost only with a `ReceiveOverrun` at its place, or while the bus is away: between a `BusStateChanged` with
  DOWN or BUS_OFF and one with UP or ACTIVE. A frame that is not sent makes `send` raise.
- `send` and `receive` are whole or nothing: cancelled, the frame was not sent, and no frame was taken. Both let other tasks run.
- Once closed, a waiting `receive` or `send` wakes with `trio.ClosedResourceError`, and so does each later one.
- Closed, or not opened, it leaves nothing behind: no thread, no descriptor.
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
"""A frame and its time stamp: ns on the transport's own clock, which does not run back unless somebody sets it; None where it has
none. virtual: trio's clock, with physics the frame's last bit. socketcan: the kernel's (CLOCK_REALTIME) when it took the frame;
in the first moments after opening, when it was read. Of python-can it is the backend's: since 1970, or since the adapter was
started. file: that of the file. tcp: None.
"""


class Transport(Protocol):
    """One participant's place on one CAN bus. Write your own by giving a class these three methods."""

    async def send(self, frame: Frame) -> None:
        """Hand a frame to the bus: returns once the bus, or the adapter's queue, has taken it; that is not yet an acknowledge.

        Waits for room where a queue is full, and raises TransportError (CO110) when none comes; FrameNotSent (a TransportError)
        while a bus is away that may come back. ValueError for a frame that classical CAN cannot carry.
        """

    async def receive(self) -> Received | Report:
        """Wait for the next frame of another participant, and return it with its time stamp; or return a Report: a ReceiveOverrun
        if frames were lost here, a BusStateChanged if the bus has something to tell.

        One task at a time should receive: of two, each gets some of the frames, or one is refused by trio.BusyResourceError.
        Raises TransportError when the bus fails.
        """

    async def aclose(self) -> None:
        """Leave the bus. May be called twice. Even if cancelled, the transport is closed afterwards."""


@runtime_checkable
class FilteringTransport(Protocol):
    """The additional methods of a transport that can leave out frames that nobody wants. filtered: whether it shall."""

    filtered: bool

    def set_filters(self, keys: Iterable[RoutingKey] | None) -> bool:
        """Receive only frames of these routing keys (`Frame.key`) from now on, None: all. Whether it now leaves out others."""


@runtime_checkable
class EagerTransport(Protocol):
    """The additional method of a transport that can hand a frame to the bus at once."""

    def send_nowait(self, frame: Frame) -> bool:
        """Hand a frame to the bus; False, and nothing was sent, where it has no room: then use `send`. Errors as there."""


@runtime_checkable
class BatchTransport(Protocol):
    """The additional method of a transport that can hand over many frames at once."""

    async def receive_many(self, limit: int) -> list[Received | Report]:
        """Wait until something has come; return what is there, in order: one frame or report at least, `limit` at most.

        Cancelled, it took nothing. Raises what `receive` raises, once everything before that was returned.
        """


@runtime_checkable
class PushingTransport(Protocol):
    """The additional method of a transport that can hand over a frame in the very turn in which it is sent."""

    def push_to(self, receiver: Callable[[Received], None] | None) -> None:
        """Call `receiver` with each frame that comes, as long as no other waits before it. None: end this.

        A frame that comes right behind many others need not be pushed: it comes by `receive`, as reports do. The receiver may
        send, but must not raise.
        """


@runtime_checkable
class CyclicTransport(Protocol):
    """The additional methods of a transport that sends cyclic frames by itself. sends_sync: whether it shall send the SYNC."""

    sends_sync: bool

    def start_cyclic(self, frames: Sequence[Frame], period: int) -> None:
        """Send the first frame now, one more each `period` ns, in turn; each comes back by `receive`.

        Cyclic frames that are sent already start again.
        """

    def stop_cyclic(self) -> None:
        """Stop the cyclic frames."""


def check_frame(frame: Frame) -> None:
    """ValueError unless classical CAN can carry the frame. (`Frame` itself does not check: it stands in hot paths.)"""
    if not frame.flags and 0 <= frame.can_id <= MAX_STANDARD_ID and frame.dlc == len(frame.data) <= MAX_LENGTH:
        return  # nearly all of them
    extended = frame.flags & EXTENDED
    limit = MAX_EXTENDED_ID if extended else MAX_STANDARD_ID
    if not 0 <= frame.can_id <= limit:
        raise ValueError(f"cannot send {frame!r}: CAN-ID 0x{frame.can_id:X} is outside 0..0x{limit:X}")
    if frame.flags & ~(EXTENDED | REMOTE):
        raise ValueError(f"cannot send {frame!r}: unknown flags 0x{frame.flags:X}")
    if len(frame.data) > MAX_LENGTH:
        raise ValueError(f"cannot send {frame!r}: {len(frame.data)} bytes, classical CAN carries at most {MAX_LENGTH}")
    if frame.flags & REMOTE:
        if frame.data or not 0 <= frame.dlc <= MAX_LENGTH:
            raise ValueError(f"cannot send {frame!r}: a remote frame has no data, and a length of 0..{MAX_LENGTH}")
    elif frame.dlc != len(frame.data):
        raise ValueError(f"cannot send {frame!r}: its dlc {frame.dlc} is not the length of its data, {len(frame.data)}")
