"""`urgent_request`: a request that waits for no other transfer of its node, as a stop must not.

An SDO channel carries one transfer at a time (CiA 301 v4.2.0, 7.2.4). One of a long object takes minutes on a slow bus, and one
whose answer is lost takes its whole time-out, which its caller has chosen.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol

from canopen_proto.machine import MILLISECOND, Outbox, Outcome, RequestId, Time
from canopen_proto.procedures.steps import Cancelled, Procedure, Wait, act

GIVES_WAY: Final = 50 * MILLISECOND
"""How long an urgent request waits for the transfer under way: one of a few frames is over by then."""


class MakesWay(Protocol):
    """A node whose requests can be ended for an urgent one: a RemoteNode, or a view of one."""

    out: Outbox

    def cancel(self, request_id: RequestId, now: Time) -> bool:
        """See RemoteNode."""

    def make_way(self, now: Time) -> None:
        """See RemoteNode."""


def urgent_request(node: MakesWay, submit: Callable[[Time], RequestId]) -> Procedure[Outcome]:
    """Make an urgent request and return its outcome. The transfer that it waits for is ended if it is not over within GIVES_WAY.

    submit: makes the request, with urgent=True.
    """
    request_id = yield from act(submit)
    try:
        while True:
            outcome = yield Wait(GIVES_WAY, node, lambda each: isinstance(each, Outcome) and each.request_id == request_id)
            if isinstance(outcome, Outcome):
                return outcome
            yield from act(node.make_way)
    except Cancelled:
        yield from act(lambda now: node.cancel(request_id, now))
        raise
