"""Procedures beside `canopen_proto.cia402.following.Following`: the limit that counts, and reading what no PDO brings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from canopen_proto.cia402.axis import Axis
from canopen_proto.cia402.following import Following
from canopen_proto.cia402.limits import DEFAULT_SPEED, Limit, SetPointLimits
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Outcome, Time
from canopen_proto.procedures.objects import ABSENT, read_if_present, value_of
from canopen_proto.procedures.steps import (
    Cancelled,
    Procedure,
    ProcedureError,
    SdoFailed,
    Wait,
    act,
    all_of,
    current_time,
    sleep,
)
from canopen_proto.sdo.client import SdoAborted
from canopen_proto.sync import SyncReceived, SyncSent

READ_INTERVAL: Final = 5 * MILLISECOND
"""From one request to the next on a bus, on average, at least: some 5 % of it at 1 Mbit/s."""
UNANSWERED: Final = 3
"""SDO time-outs of a drive for which one object may stay unread: an answer may be lost, and another client may disturb it."""
DEFAULT_TIME: Final = 100 * MILLISECOND
"""So far behind a drive may be by default, at its largest speed: position controllers without feed-forward lag by 10 to 50 ms."""
OFF: Final = 0x7FFF_FFFF
"""A window of 0x6065 that no INTEGER32 can leave; 0xFFFFFFFF switches the drive's own watch off."""


def following_limit(axis: Axis, limits: SetPointLimits) -> Procedure[Limit]:
    """How far off its set-points a drive may be: by its settings, else by its own window 0x6065, else by its speed limit.

    The drive's time-out 0x6066 is not waited for: by then it would stop by itself. limits: of its set-points; by default a drive
    may be off by its way in DEFAULT_TIME at that speed (where the user lifted it, at DEFAULT_SPEED). Raises SdoFailed.
    """
    limit = axis.settings.following_error_limit
    if limit is not None:
        return Limit(limit, "the settings (following_error_limit)")
    window = yield from read_if_present(axis.node, "0x6065")
    if isinstance(window, int) and 0 < window < OFF:
        return Limit(axis.amount_from_counts(window), "0x6065 of the drive")
    speed = limits.speed.value if math.isfinite(limits.speed.value) else axis.amount_from_counts(DEFAULT_SPEED)
    way = f"its way in {DEFAULT_TIME / SECOND:g} s at {speed:.4g} per second"
    source = f"default, {way}; following_error_limit of its settings raises it"
    return Limit(speed * DEFAULT_TIME / SECOND, source)


def read_unsent(drives: Sequence[Following]) -> Procedure[None]:
    """Read what the drives do not send at SYNCs by themselves (`Following.unsent`), until cancelled.

    The drives take turns behind the SYNCs, one request each, and READ_INTERVAL apart at least; without SYNC nothing is followed,
    and nothing is read. So a change is seen after as many cycles as there are objects to read. Each drive has a request of its
    own: one that does not answer holds up no other.

    A request goes before all that wait for the same drive, but not before an SDO transfer that is under way with it: a channel
    serves one at a time. So an SDO channel that is free is used, if the node has several (`RemoteNode.add_sdo_channel`). A drive
    is lost if an object could not be read for UNANSWERED times its SDO time-out. An object that a drive does not have is left out
    from then on.
    """
    yield from all_of(*(_watch(drive, number, len(drives)) for number, drive in enumerate(drives, start=1)))


def _watch(drive: Following, turn: int, turns: int) -> Procedure[None]:
    not_before = yield from current_time()
    while drive.unsent:
        for mux in sorted(drive.unsent):
            while turn > 0 or (yield from current_time()) < not_before:
                yield Wait(None, drive.axis.node, lambda report: isinstance(report, SyncSent | SyncReceived))
                turn -= 1
            turn, not_before = turns, (yield from current_time()) + turns * READ_INTERVAL
            if mux in drive.unsent:  # else its first PDO has come meanwhile
                yield from _read(drive, mux)


def _read(drive: Following, mux: int) -> Procedure[None]:
    """Read an object until that succeeds once; the drive is lost if it does not."""
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
            drive.lose(f"cannot be watched: 0x{mux >> 8:04X} could not be read for {patience / SECOND:g} s: {why}")
            return
        yield from sleep(READ_INTERVAL)


def _ask(drive: Following, mux: int, deadline: Time) -> Procedure[bool]:
    """Read an object, before all that waits for the drive; False if there is no outcome until the deadline."""
    node, index, subindex = drive.axis.node, mux >> 8, mux & 0xFF
    client = next((each for each in (node.sdo, *node.sdo_channels) if not each.busy), node.sdo)
    request_id = yield from act(lambda now: client.upload(index, subindex, now, urgent=True))
    try:
        left = max(0, deadline - (yield from current_time()))
        outcome = yield Wait(left, node, lambda report: isinstance(report, Outcome) and report.request_id == request_id)
    except Cancelled:
        yield from act(lambda now: node.cancel(request_id, now))
        raise
    if isinstance(outcome, SdoAborted):
        raise SdoFailed(outcome, "reading")
    if outcome is None:
        yield from act(lambda now: node.cancel(request_id, now))
        return False
    value_of(node, node.dictionary.variable((index, subindex)), outcome)
    return True
