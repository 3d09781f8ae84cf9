"""`WireMember`: one CAN controller on the wire, with its transmit queue. (Its error counters: confinement.py.)

**Transmit queue.** Controller and driver choose which of the waiting frames takes part in the arbitration:

- FIFO: the oldest. Linux's SocketCAN does so (its network queue hands frames over in order, and most drivers use one mailbox or a
  hardware FIFO), as do PEAK's and most other USB adapters, and CANopen stacks with one software queue. A SYNC then waits behind
  an SDO that was queued before it: a priority inversion, which the classic analysis does not consider.
- PRIORITY: the lowest identifier. Controllers with several mailboxes that are sent by identifier do so (bxCAN, FlexCAN, MCAN with
  a queue instead of a FIFO), if the driver fills them that way. The classic analysis presumes this.

A frame that is being sent is never overtaken: it stays at the head until it is sent.
"""

from __future__ import annotations

import heapq
from collections import deque
from enum import Enum
from typing import Final, NamedTuple

from canopen_proto.frame import EXTENDED, REMOTE, Frame
from canopen_proto.machine import LocalProtocolError, Time
from canopen_transports.errors import BusState

TRANSMIT_QUEUE_SIZE: Final = 64
"""Frames: 16 times what a small controller has, and about what a driver's queue holds."""


class QueueOrder(Enum):
    """Which of a member's waiting frames competes for the bus."""

    FIFO = "fifo"
    PRIORITY = "priority"


class QueueFullError(LocalProtocolError):
    """A member's transmit queue has no room for this frame."""


class WaitingFrame(NamedTuple):
    """A frame in a transmit queue. Sorted by arbitration, then by age."""

    arbitration: int
    number: int
    frame: Frame
    queued: Time


def arbitration(frame: Frame) -> int:
    """Return the bits by which the bus decides, as a number: the lower one wins.

    They are the identifier, RTR, SRR and IDE in the order of the wire. With equal first 11 bits, a data frame goes before a
    remote frame, and both before a 29-bit frame.
    """
    remote = frame.flags & REMOTE
    if frame.flags & EXTENDED:
        return ((frame.can_id >> 18) << 2 | 0b11) << 19 | (frame.can_id & 0x3FFFF) << 1 | remote
    return (frame.can_id << 1 | remote) << 20


class WireMember:
    """A place on the wire; made by `Wire.join`. Only the wire changes it; all else reads.

    number: in the order of joining, from 0. state: ACTIVE, WARNING, PASSIVE or BUS_OFF. transmit_errors, receive_errors: the
    counters. sent: how many frames were sent.
    """

    __slots__ = (
        "_heap", "_order", "_queue", "_queued", "babbles_until", "delayed_until", "joined", "number", "receive_errors",
        "recovery", "sending", "sent", "size", "state", "suspended_until", "transmit_errors", "unacknowledged",
    )  # fmt: skip

    def __init__(self, number: int, order: QueueOrder, size: int) -> None:
        if size < 1:
            raise LocalProtocolError(f"a transmit queue of {size} frames can hold nothing")
        self.number = number
        self.size = size
        self.joined = True
        self.state = BusState.ACTIVE
        self.transmit_errors = 0
        self.receive_errors = 0
        self.sent = 0
        self.sending: WaitingFrame | None = None  # stays at the head
        self.suspended_until: Time = 0
        self.delayed_until: Time = 0
        self.babbles_until: Time | None = None
        self.recovery = 0  # runs of 11 recessive bits still to come, at bus-off
        self.unacknowledged = False
        self._order = order
        self._queued = 0
        self._queue: deque[WaitingFrame] = deque()
        self._heap: list[WaitingFrame] = []

    def __repr__(self) -> str:
        counters = f"TEC {self.transmit_errors}, REC {self.receive_errors}"
        return f"<WireMember {self.number}: {self.state.value}, {counters}, {self.queued} queued>"

    @property
    def order(self) -> QueueOrder:
        """Which of its waiting frames competes for the bus."""
        return self._order

    @property
    def queued(self) -> int:
        """How many frames wait, including the one that is being sent."""
        return len(self._queue) + len(self._heap) + (self.sending is not None)

    @property
    def has_room(self) -> bool:
        """Whether one more frame can be queued."""
        return self.queued < self.size

    def put(self, frame: Frame, now: Time) -> None:
        """Queue a frame. Raises QueueFullError if there is no room."""
        if not self.has_room:
            raise QueueFullError(f"the transmit queue of member {self.number} is full: {self.size} frames")
        waiting = WaitingFrame(arbitration(frame), self._queued, frame, now)
        self._queued += 1
        if self._order is QueueOrder.FIFO:
            self._queue.append(waiting)
        else:
            heapq.heappush(self._heap, waiting)

    def head(self) -> WaitingFrame | None:
        """Return the frame that competes for the bus while this member sends nothing, or None."""
        if self._queue:
            return self._queue[0]
        return self._heap[0] if self._heap else None

    def begin(self) -> None:
        """Start to send the head."""
        self.sending = self._queue.popleft() if self._queue else heapq.heappop(self._heap)

    def failed(self) -> None:
        """Put the frame that failed back, to compete again; by priority, it competes with frames that came meanwhile."""
        waiting, self.sending = self.sending, None
        if waiting is None:
            return
        if self._order is QueueOrder.FIFO:
            self._queue.appendleft(waiting)
        else:
            heapq.heappush(self._heap, waiting)

    def clear(self) -> list[WaitingFrame]:
        """Empty the queue and return what was in it."""
        self.failed()
        dropped = sorted([*self._queue, *self._heap], key=lambda waiting: waiting.number)
        self._queue.clear()
        self._heap.clear()
        return dropped
