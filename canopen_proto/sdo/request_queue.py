"""The requests of an SDO client: they wait in line, one at a time is served, each ends in exactly one outcome.

`RequestQueue` is the part of SdoClient (client.py) that does not depend on how a transfer goes: commands that take requests back,
the order, and the pauses that `copy_guard` and `late_guard` want between two transfers.

The order is first come, first served, whoever asks: any number of tasks, each waiting for its outcome, take turns. Urgent
requests go before the others, among themselves in their order; after MAX_URGENT_RUN of them one of the others has its turn.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.frame import SDO_CLIENT_TO_SERVER, SDO_SERVER_TO_CLIENT, Frame
from canopen_proto.machine import (
    MILLISECOND,
    NEVER,
    FrameIgnored,
    LocalProtocolError,
    Machine,
    Outbox,
    Outcome,
    RequestId,
    Time,
    check_node_id,
)
from canopen_proto.sdo.codec import ABORT, INITIATE, INITIATE_DOWNLOAD_RESPONSE, INITIATE_UPLOAD_RESPONSE
from canopen_proto.sdo.events import SdoAborted
from canopen_proto.sdo.request import Request

TIMEOUT: Final = 500 * MILLISECOND
"""How long a server may take for each response: devices that write flash on the way take 100 ms and more."""
LATE_GUARD: Final = 500 * MILLISECOND
"""How long after a time-out its answer is waited for before the same object is asked for again: a server that is twice as slow as
expected is still understood, and a dead one costs no more than another time-out."""
MAX_OVERDUE: Final = 16
"""Answers that are remembered as overdue, the latest ones: LATE_GUARD is over before more than a few can be."""
MAX_QUEUE: Final = 256
"""Requests that may wait, urgent ones counted apart (at least 1): enough to configure all PDOs of a node at once."""
MAX_URGENT_RUN: Final = 64
"""Urgent requests that may go one after the other while others wait: more than any clean-up needs, and a caller that is always in
a hurry cannot starve the rest."""

IDLE: Final = 0
"""The state in which no transfer is under way."""
UPLOAD_INITIATED: Final = 1
"""The state in which the response to a normal upload is due. SdoClient has the other states."""


class RequestQueue(Machine):
    """See this module's text."""

    __slots__ = (
        "_ended", "_last", "_overdue", "_queue", "_request", "_response_key", "_send_can_id", "_send_flags", "_state",
        "_unsettled", "_urgent", "_urgent_run", "copy_guard", "late_guard", "max_queue", "node_id", "timeout",
    )  # fmt: skip

    def __init__(
        self,
        out: Outbox,
        node_id: int,
        request_key: int | None,
        response_key: int | None,
        timeout: Time,
        max_queue: int,
        copy_guard: Time,
        late_guard: Time,
    ) -> None:
        super().__init__(out)
        self.node_id = check_node_id(node_id)
        self.timeout = timeout
        self.max_queue = max_queue
        self.copy_guard = copy_guard
        self.late_guard = late_guard
        request_key = SDO_CLIENT_TO_SERVER + node_id if request_key is None else request_key
        self._response_key = SDO_SERVER_TO_CLIENT + node_id if response_key is None else response_key
        self._send_can_id = request_key & 0x1FFFFFFF
        self._send_flags = request_key >> 29
        self._urgent: deque[Request] = deque()
        self._queue: deque[Request] = deque()
        self._urgent_run = 0  # urgent requests that went while others waited, since one of those did
        self._state = IDLE
        self._request = Request(0, 0, bytes(8))  # while idle: the one before
        # What is remembered of responses and of the transfer before
        self._last = b""  # the last accepted response; empty once its copy was seen
        self._unsettled = False  # the transfer before ended without its last response
        self._ended: Time = -NEVER
        self._overdue: dict[bytes, Time] = {}  # multiplexer -> until when its answer is waited for

    # ---- commands ----

    def cancel(self, request_id: RequestId, now: Time) -> bool:
        """Give a request up: SdoAborted with origin CANCELLED follows at once. False if it is not open (any more).

        Of a request that waits nothing was sent and nothing is. A running transfer is aborted on the wire with 0x08000000, and
        the next request goes out at once.
        """
        if self._state != IDLE and self._request.request_id == request_id:
            self._fail(AbortCode.GENERAL_ERROR, AbortOrigin.CANCELLED, now)
            return True
        for queue in (self._urgent, self._queue):
            for request in queue:
                if request.request_id == request_id:
                    queue.remove(request)
                    self.out.events.append(self._aborted(request, AbortCode.GENERAL_ERROR, AbortOrigin.CANCELLED))
                    if self._state == IDLE:
                        self._begin_next(now)  # copy_guard may have held back the one that is gone
                    return True
        return False

    def abort_all(self, abort_code: int, now: Time) -> None:
        """End all requests (the server is gone): SdoAborted with origin LOCAL for each; the running one is aborted on the bus."""
        if not 0 <= abort_code <= 0xFFFFFFFF:
            raise LocalProtocolError(f"node {self.node_id}: {abort_code} is no abort code (0..0xFFFFFFFF)")
        waiting = [*self._urgent, *self._queue]
        self._urgent.clear()
        self._queue.clear()
        if self._state != IDLE:
            self._fail(abort_code, AbortOrigin.LOCAL, now)
        for request in waiting:
            self.out.events.append(self._aborted(request, abort_code, AbortOrigin.LOCAL))
        self._overdue.clear()
        self.deadline = NEVER

    # ---- getters ----

    @property
    def busy(self) -> bool:
        """Whether any request is running or waiting."""
        return self._state != IDLE or bool(self._queue or self._urgent)

    @property
    def waiting(self) -> int:
        """The number of requests that wait."""
        return len(self._queue) + len(self._urgent)

    def can_ids(self) -> tuple[int, ...]:
        return (self._response_key,)

    # ---- inside ----

    def _submit(self, request: Request, urgent: bool, now: Time) -> RequestId:
        queue = self._urgent if urgent else self._queue
        if len(queue) >= self.max_queue:
            raise LocalProtocolError(f"{request}, node {self.node_id}: {len(queue)} requests are waiting already")
        request.request_id = request_id = self.out.next_request_id()
        if self._state == IDLE and not queue and not self._urgent and not self.copy_guard and not self._overdue:
            self._begin(request, now)
        else:
            queue.append(request)
            if self._state == IDLE:
                self._begin_next(now)
        return request_id

    def _find(self, request_id: RequestId) -> Request | None:
        """The request, if it is open."""
        if self._state != IDLE and self._request.request_id == request_id:
            return self._request
        return next((request for request in (*self._urgent, *self._queue) if request.request_id == request_id), None)

    def _begin_next(self, now: Time) -> None:
        """Begin the transfer whose turn it is, if there is one."""
        queue = self._urgent or self._queue
        if not queue:
            self.deadline = NEVER
            return
        if self._urgent_run == MAX_URGENT_RUN and self._queue and now >= self._held_until(self._queue[0], False):
            queue = self._queue
        is_urgent = queue is self._urgent
        held_until = self._held_until(queue[0], is_urgent)
        if now < held_until:
            self._arm(held_until)
            return
        self._urgent_run = min(self._urgent_run + 1, MAX_URGENT_RUN) if is_urgent and self._queue else 0
        self._begin(queue.popleft(), now)

    def _held_until(self, request: Request, is_urgent: bool) -> Time:
        """Until when a request has to wait for the sake of those before it."""
        held_until = -NEVER
        if self._unsettled or self._request.is_like(request):
            held_until = self._ended + self.copy_guard
        if self._overdue and not is_urgent:  # what is urgent (a halt) matters more than its confirmation
            held_until = max(held_until, self._overdue.get(request.first[1:4], -NEVER))
        return held_until

    def _begin(self, request: Request, now: Time) -> None:
        raise NotImplementedError

    def _fail(self, abort_code: int, origin: AbortOrigin, now: Time) -> None:
        """Abort the running transfer on the wire (CiA 301 v4.2.0, 7.2.4.3.17) and begin the next one."""
        request = self._request
        is_silent = origin is AbortOrigin.TIMEOUT and abort_code != AbortCode.CANNOT_TRANSFER  # that was our own side
        aborted = self._aborted(request, abort_code, origin, self._is_all_sent(), self._patience() if is_silent else 0)
        if origin is AbortOrigin.TIMEOUT and self._is_answer_ambiguous():
            overdue, multiplexer = self._overdue, request.first[1:4]
            overdue.pop(multiplexer, None)
            overdue[multiplexer] = now + self.late_guard
            if len(overdue) > MAX_OVERDUE:
                del overdue[next(iter(overdue))]
        self._send(INITIATE.pack(ABORT, request.index, request.subindex, abort_code))
        self._unsettled = True
        self._end(aborted, now)

    def _patience(self) -> Time:
        """How long the server may be silent in the transfer under way, in ns."""
        raise NotImplementedError

    def _is_all_sent(self) -> bool:
        """Whether the transfer under way is a download of which everything has been sent: the server may execute it."""
        raise NotImplementedError

    def _is_answer_ambiguous(self) -> bool:
        """Whether the answer that is due may be a whole one: if it comes late, it looks like that to the next such request."""
        raise NotImplementedError

    def _end(self, outcome: Outcome, now: Time) -> None:
        raise NotImplementedError

    def _aborted(
        self, request: Request, abort_code: int, origin: AbortOrigin, not_confirmed: bool = False, waited: Time = 0
    ) -> SdoAborted:
        index, subindex = request.index, request.subindex
        return SdoAborted(self.node_id, request.request_id, index, subindex, abort_code, origin, not_confirmed, waited)

    def _settle(self) -> None:
        """The server has answered the transfer under way: it has nothing more to say about those before."""
        self._unsettled = False
        if self._overdue:
            self._overdue.clear()

    def _is_overdue(self, specifier: int, multiplexer: bytes) -> bool:
        """Whether a response is the late one to a request that timed out. It is not waited for any more then."""
        bears_it = specifier in (INITIATE_UPLOAD_RESPONSE, INITIATE_DOWNLOAD_RESPONSE, ABORT)
        return bears_it and self._overdue.pop(multiplexer, None) is not None

    def _send(self, payload: bytes) -> None:
        self.out.frames.append(Frame(self._send_can_id, payload, self._send_flags, 8))

    def _ignore(self, frame: Frame, reason: str) -> None:
        self.out.events.append(FrameIgnored(self.node_id, frame, reason))
