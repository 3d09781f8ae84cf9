"""`read_unsent`: reads the watched objects that drives do not send at SYNCs, beside the cycle; see following.py."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from canopen_proto.drives.axis.following import Following, TurnToRead
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Outcome, Time
from canopen_proto.multiplexer import Mux, index_of, split_mux
from canopen_proto.procedures.objects import ABSENT, value_of
from canopen_proto.procedures.steps import Cancelled, Procedure, ProcedureError, SdoFailed, Wait, act, all_of, current_time, sleep
from canopen_proto.sdo.client import SdoAborted, SdoUploaded

_TURN: Final = (TurnToRead,)
_ANSWERS: Final = (SdoUploaded, SdoAborted)
READ_INTERVAL: Final = 5 * MILLISECOND
"""The least mean time between two requests on a bus: some 5 % of the bus load at 1 Mbit/s."""
UNANSWERED: Final = 3
"""SDO time-outs for which an object may stay unread: an answer may be lost, and another client may disturb the transfer."""


def read_unsent(drives: Sequence[Following]) -> Procedure[None]:
    """Read the watched objects that the drives do not send at SYNCs (`Following.unsent`), until cancelled.

    The drives take turns behind the SYNCs, one request each, at least READ_INTERVAL apart. Without SYNC no drive follows
    set-points, and nothing is read. A change is seen after as many cycles as there are objects to read. Each drive has its own
    request: a drive that does not answer delays no other.

    A request overtakes all that wait for the same drive, but not a transfer under way: an SDO channel serves one at a time. If
    the node has several channels (`RemoteNode.add_sdo_channel`), a free one is used. A drive is lost if an object could not be
    read for UNANSWERED times its SDO time-out. An object that a drive does not have is not read again.
    """
    yield from all_of(*(_watch(drive, number, len(drives)) for number, drive in enumerate(drives, start=1)))


def _watch(drive: Following, turn: int, turns: int) -> Procedure[None]:
    node = drive.axis.node
    not_before = yield from current_time()
    while drive.unsent:
        for mux in sorted(drive.unsent):
            drive.await_turn(turn, not_before)
            yield Wait(None, node, drive.axis.is_told_by, _TURN)
            turn, not_before = turns, (yield from current_time()) + turns * READ_INTERVAL
            if mux in drive.unsent:  # else its first PDO has come meanwhile
                yield from _read(drive, mux)


def _read(drive: Following, mux: Mux) -> Procedure[None]:
    """Read an object, repeatedly until it succeeds; the drive is lost if it does not."""
    node = drive.axis.node
    patience = UNANSWERED * node.sdo.timeout
    deadline = (yield from current_time()) + patience
    why = "another SDO transfer with it is under way"
    while drive.is_on:
        try:
            if (yield from _ask(drive, mux, deadline)):
                return
        except SdoFailed as failed:
            if failed.abort_code in ABSENT:
                drive.unsent.discard(mux)
                return
            why = str(failed)
        except (ProcedureError, LocalProtocolError) as error:
            why = str(error)
        if (yield from current_time()) >= deadline:
            drive.lose(f"cannot be watched: 0x{index_of(mux):04X} could not be read for {patience / SECOND:g} s: {why}")
            return
        yield from sleep(READ_INTERVAL)


def _ask(drive: Following, mux: Mux, deadline: Time) -> Procedure[bool]:
    """Read an object, ahead of the requests that wait for the drive; return False if there is no outcome by the deadline."""
    node = drive.axis.node
    index, subindex = split_mux(node.on_device(mux))
    client = next((each for each in (node.sdo, *node.sdo_channels) if not each.busy), node.sdo)
    request_id = yield from act(lambda now: client.upload(index, subindex, now, urgent=True))
    try:
        left = max(0, deadline - (yield from current_time()))
        outcome = yield Wait(left, node, lambda answer: isinstance(answer, Outcome) and answer.request_id == request_id, _ANSWERS)
    except Cancelled:
        yield from act(lambda now: node.cancel(request_id, now))
        raise
    if isinstance(outcome, SdoAborted):
        raise SdoFailed(outcome, "reading")
    if outcome is None:
        yield from act(lambda now: node.cancel(request_id, now))
        return False
    value_of(node, node.dictionary.variable(mux), outcome)
    return True
