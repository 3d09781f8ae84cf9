"""The requests of an SDO client that wait for their turn, and what keeps the next one waiting.

The order is first come, first served, whoever asks: any number of tasks, each waiting for its outcome, take turns. Urgent
requests go before the others, among themselves in their order; after MAX_URGENT_RUN of them one of the others has its turn.
A request waits longer while another answer could be taken for its own: see `copy_guard`, `late_guard` and "A question" in
client.py.
"""

from __future__ import annotations

from collections import deque
from typing import Final, TypeVar

from canopen_proto.indices import DEVICE_TYPE, ERROR_REGISTER, IDENTITY_OBJECT
from canopen_proto.machine import NEVER, RequestId, Time
from canopen_proto.sdo.codec import (
    ABORT,
    EXPEDITED_BIT,
    INITIATE_DOWNLOAD,
    INITIATE_DOWNLOAD_RESPONSE,
    INITIATE_UPLOAD,
    INITIATE_UPLOAD_RESPONSE,
    SPECIFIER,
)
from canopen_proto.sdo.segmented_client import question_about
from canopen_proto.sdo.transfer import Transfer

MAX_OVERDUE: Final = 16
"""Answers that are remembered as overdue, the latest ones: LATE_GUARD is over before more than a few can be."""
MAX_URGENT_RUN: Final = 64
"""Urgent requests that may go one after the other while others wait: more than any clean-up needs, and a caller that is always in
a hurry cannot starve the rest."""
_ASKED: Final = (DEVICE_TYPE, ERROR_REGISTER, IDENTITY_OBJECT)
QUESTIONS: Final = tuple((first, first[1:4]) for first in map(question_about, _ASKED))
"""The initiate frames of questions, and by which name these have their objects. Every device has them, and reading them does
nothing. CiA 301 v4.2.0, 7.5.2.1, .2 and .21."""

_IN_ONE_FRAME: Final = SPECIFIER | EXPEDITED_BIT
_WRITE: Final = INITIATE_DOWNLOAD | EXPEDITED_BIT
_VALUE: Final = INITIATE_UPLOAD_RESPONSE | EXPEDITED_BIT
_REFUSAL: Final = bytes((ABORT,))
"""The first byte of a refusal."""


class RequestQueue:
    """See this module's text.

    unsettled: a transfer ended without its last response, and the server has not answered a later one. overdue: by the object's
    name in a frame, until when late answers are waited for, each by itself; empty if not unsettled. left: by that name, until
    when the server may answer a request that we gave up before the time-out, or beside a stranger. answered: by that name, the
    object of the last transfer that the server answered. doubted: a request that was refused, perhaps by an answer to another
    one, and is made again behind a question. held_until: when to ask `take` again.
    """

    __slots__ = (
        "_answered_at", "_answered_by", "_ended", "_first", "_last", "_urgent_run", "answered", "doubted", "held_until", "left",
        "others", "overdue", "unsettled", "urgent",
    )  # fmt: skip

    def __init__(self) -> None:
        self.urgent: deque[Transfer] = deque()
        self.others: deque[Transfer] = deque()
        self.held_until: Time = NEVER
        self.unsettled = False
        self.overdue: dict[bytes, list[Time]] = {}
        self._urgent_run = 0  # urgent requests that went while others waited, since one of those did
        self._first = bytes(8)  # the initiate frame of the transfer before
        self._ended: Time = -NEVER
        self.left: dict[bytes, Time] = {}
        self.doubted: Transfer | None = None
        self.answered = bytes(3)
        self._answered_by = bytes(8)  # its initiate frame
        self._answered_at: Time = -NEVER
        self._last = b""  # what the server said last in it

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
        self.left.clear()
        return waiting

    def take(self, now: Time, copy_guard: Time, timeout: Time) -> Transfer | bytes | None:
        """Return the request whose turn it is, and take it out of the queue; or the initiate frame of the question that comes
        before it. None: look at `held_until`. copy_guard, timeout: ns, see client.py."""
        self.held_until = NEVER
        queue = self.urgent or self.others
        if not queue:
            return None
        if self._urgent_run == MAX_URGENT_RUN and self.others and now >= self._hold(self.others[0], False, copy_guard):
            queue = self.others
        is_urgent = queue is self.urgent
        if copy_guard or self.overdue:  # else nothing holds it
            held_until = self._hold(queue[0], is_urgent, copy_guard)
            if now < held_until:
                self.held_until = held_until
                return None
        first = queue[0]
        is_near = self.left or first.name == self.answered  # a look that saves most calls
        if first is self.doubted or (is_near and self.wants_question(first, now, timeout)):
            self.doubted = None
            return self.question_before(first)
        self._urgent_run = min(self._urgent_run + 1, MAX_URGENT_RUN) if is_urgent and self.others else 0
        return queue.popleft()

    def _hold(self, transfer: Transfer, is_urgent: bool, copy_guard: Time) -> Time:
        """Return until when a request has to wait for the sake of those before it."""
        first, before = transfer.first, self._first
        held_until = -NEVER
        if self.unsettled or (first[1:4] == before[1:4] and first[0] >> 5 == before[0] >> 5):  # answers look the same
            held_until = self._ended + copy_guard
        if self.overdue and not is_urgent:  # what is urgent (a halt) matters more than its confirmation
            held_until = max(held_until, self.late_until(transfer.name))
        return held_until

    def wants_question(self, transfer: Transfer, now: Time, timeout: Time) -> bool:
        """Return whether a question has to come before this request: its one answer could not be told from another one. timeout:
        as of `take`."""
        command = transfer.first[0]
        if command & _IN_ONE_FRAME == _WRITE:
            return self.may_meet_another(transfer, now, timeout)
        return command == INITIATE_UPLOAD and bool(self.left) and self._is_left(transfer, now)

    def may_meet_another(self, transfer: Transfer, now: Time, timeout: Time) -> bool:
        """Return whether the server may still confirm or refuse something else in a frame that names the object of this request:
        one that was given up, or the transfer before, if a frame of it came twice. timeout: as of `take`."""
        if self.left and self._is_left(transfer, now):
            return True
        if transfer.name != self.answered or transfer.is_urgent or now >= self._answered_at + timeout:
            return False
        if self._answered_by[0] != INITIATE_UPLOAD:
            return True
        is_value = bool(self._last) and self._last[0] & _IN_ONE_FRAME == _VALUE
        return transfer.is_download and not is_value  # of two reads the second may get the first one's answer: docs/limits.md

    def _is_left(self, transfer: Transfer, now: Time) -> bool:
        return not transfer.is_urgent and now < self.left.get(transfer.name, -NEVER)

    def question_before(self, transfer: Transfer) -> bytes:
        """Return the initiate frame of the question that comes before a request: about an object that nothing else names which
        the server may say."""
        own, answered = transfer.name, self.answered
        for first, name in QUESTIONS:
            if name != own and name != answered and name not in self.left and name not in self.overdue:
                return first
        return QUESTIONS[-1][0]

    # ---- what is remembered of the transfers before ----

    def remember(self, transfer: Transfer, last: bytes, now: Time) -> None:
        """Remember a transfer that has ended. last: the last frame of the server that was accepted."""
        self._first = transfer.first
        self._ended = now
        if transfer.is_answered:  # the server has nothing more to say about those before
            self.unsettled = transfer.is_given_up
            if self.overdue:
                self.overdue.clear()
            if self.left:
                self.left.clear()
        else:
            self.unsettled |= transfer.is_given_up
            if last[:1] != _REFUSAL or last[1:4] != transfer.name:
                return
        self.answered = transfer.name
        self._answered_by = transfer.first
        self._answered_at = now
        self._last = last

    def expect_late(self, multiplexer: bytes, now: Time, until: Time) -> None:
        """Hold requests for this object until its late answer has come, or until then. multiplexer: the three bytes of a frame
        that name the object."""
        before = self.overdue.get(multiplexer, ())  # of urgent requests one may time out behind another, and each is answered
        _note(self.overdue, multiplexer, [*(each for each in before if each > now), until][-MAX_OVERDUE:])

    def late_until(self, multiplexer: bytes) -> Time:
        """Return until when a late answer about this object is waited for; -NEVER if none is. multiplexer: as of
        `expect_late`."""
        return max(self.overdue.get(multiplexer, ()), default=-NEVER)

    def leave(self, multiplexer: bytes, until: Time) -> None:
        """Remember that a request for this object was given up, and may be answered until then. multiplexer: as of
        `expect_late`."""
        _note(self.left, multiplexer, until)

    def may_be_answered_until(self, multiplexer: bytes) -> Time:
        """Return until when the server may still answer a request for this object that has ended; -NEVER if there is none.
        multiplexer: as of `expect_late`."""
        return max(self.late_until(multiplexer), self.left.get(multiplexer, -NEVER))

    def is_overdue(self, specifier: int, multiplexer: bytes) -> bool:
        """Return whether a response is the late one to a request that timed out; if so, stop waiting for it. specifier,
        multiplexer: as the response has them."""
        times = self.overdue.get(multiplexer)
        if times is None or specifier not in (INITIATE_UPLOAD_RESPONSE, INITIATE_DOWNLOAD_RESPONSE, ABORT):
            return False
        del times[0]
        if not times:
            del self.overdue[multiplexer]
        return True


_T = TypeVar("_T")


def _note(noted: dict[bytes, _T], multiplexer: bytes, what: _T) -> None:
    noted.pop(multiplexer, None)
    noted[multiplexer] = what
    if len(noted) > MAX_OVERDUE:
        del noted[next(iter(noted))]
