"""The requests of an SDO client that wait for their turn, and what keeps the next one waiting.

The order is first come, first served, whoever asks: any number of tasks, each waiting for its outcome, take turns. Urgent
requests go before the others, among themselves in their order; after MAX_URGENT_RUN of them one of the others has its turn.
A request waits longer while a late answer could be taken for its own: see `copy_guard` and `late_guard` in client.py.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from canopen_proto.machine import NEVER, RequestId, Time
from canopen_proto.sdo.codec import ABORT, INITIATE_DOWNLOAD_RESPONSE, INITIATE_UPLOAD_RESPONSE
from canopen_proto.sdo.transfer import Transfer

MAX_OVERDUE: Final = 16
"""Answers that are remembered as overdue, the latest ones: LATE_GUARD is over before more than a few can be."""
MAX_URGENT_RUN: Final = 64
"""Urgent requests that may go one after the other while others wait: more than any clean-up needs, and a caller that is always in
a hurry cannot starve the rest."""


class RequestQueue:
    """See this module's text.

    unsettled: a transfer ended without its last response, and the server has not answered a later one. overdue: by the object's
    name in a frame, until when a late answer is waited for; empty if not unsettled. held_until: when to ask `take` again.
    """

    __slots__ = ("_ended", "_first", "_urgent_run", "held_until", "others", "overdue", "unsettled", "urgent")

    def __init__(self) -> None:
        self.urgent: deque[Transfer] = deque()
        self.others: deque[Transfer] = deque()
        self.held_until: Time = NEVER
        self.unsettled = False
        self.overdue: dict[bytes, Time] = {}
        self._urgent_run = 0  # urgent requests that went while others waited, since one of those did
        self._first = bytes(8)  # the initiate frame of the transfer before
        self._ended: Time = -NEVER

    def __len__(self) -> int:
        return len(self.others) + len(self.urgent)

    @property
    def waits(self) -> bool:
        """Whether any request waits."""
        return bool(self.urgent or self.others)

    def find(self, request_id: RequestId) -> Transfer | None:
        """Return the request of that id, if it waits."""
        return next((transfer for transfer in (*self.urgent, *self.others) if transfer.request_id == request_id), None)

    def remove(self, transfer: Transfer) -> None:
        """Take a request that waits out of its turn."""
        (self.urgent if transfer in self.urgent else self.others).remove(transfer)

    def clear(self) -> list[Transfer]:
        """Empty the queue, and forget what is overdue; return the requests that waited."""
        waiting = [*self.urgent, *self.others]
        self.urgent.clear()
        self.others.clear()
        self.overdue.clear()
        return waiting

    def take(self, now: Time, copy_guard: Time) -> Transfer | None:
        """Return the request whose turn it is, and take it out of the queue. None: look at `held_until`. copy_guard: ns, see
        client.py."""
        self.held_until = NEVER
        queue = self.urgent or self.others
        if not queue:
            return None
        if self._urgent_run == MAX_URGENT_RUN and self.others and now >= self._hold(self.others[0], False, copy_guard):
            queue = self.others
        is_urgent = queue is self.urgent
        held_until = self._hold(queue[0], is_urgent, copy_guard)
        if now < held_until:
            self.held_until = held_until
            return None
        self._urgent_run = min(self._urgent_run + 1, MAX_URGENT_RUN) if is_urgent and self.others else 0
        return queue.popleft()

    def _hold(self, transfer: Transfer, is_urgent: bool, copy_guard: Time) -> Time:
        """Return until when a request has to wait for the sake of those before it."""
        first = transfer.first
        held_until = -NEVER
        if self.unsettled or (first[1:4] == self._first[1:4] and first[0] >> 5 == self._first[0] >> 5):  # answers look the same
            held_until = self._ended + copy_guard
        if self.overdue and not is_urgent:  # what is urgent (a halt) matters more than its confirmation
            held_until = max(held_until, self.overdue.get(first[1:4], -NEVER))
        return held_until

    # ---- what is remembered of the transfers before ----

    def remember(self, transfer: Transfer, now: Time) -> None:
        """Remember a transfer that has ended."""
        self._first = transfer.first
        self._ended = now
        if transfer.is_answered:  # the server has nothing more to say about those before
            self.unsettled = transfer.is_given_up
            if self.overdue:
                self.overdue.clear()
        elif transfer.is_given_up:
            self.unsettled = True

    def expect_late(self, multiplexer: bytes, until: Time) -> None:
        """Hold requests for this object until its late answer has come, or until then. multiplexer: the three bytes of a frame
        that name the object."""
        self.overdue.pop(multiplexer, None)
        self.overdue[multiplexer] = until
        if len(self.overdue) > MAX_OVERDUE:
            del self.overdue[next(iter(self.overdue))]

    def is_overdue(self, specifier: int, multiplexer: bytes) -> bool:
        """Return whether a response is the late one to a request that timed out; if so, stop waiting for it. specifier,
        multiplexer: as the response has them."""
        names_it = specifier in (INITIATE_UPLOAD_RESPONSE, INITIATE_DOWNLOAD_RESPONSE, ABORT)
        return names_it and self.overdue.pop(multiplexer, None) is not None
