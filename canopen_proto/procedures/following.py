"""Procedures beside `canopen_proto.cia402.following.Following`: the limit that counts, and reading what no PDO brings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from canopen_proto.cia402.axis import Axis
from canopen_proto.cia402.following import Following
from canopen_proto.cia402.limits import DEFAULT_SPEED, Limit, SetPointLimits
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.procedures.objects import ABSENT, read, read_if_present
from canopen_proto.procedures.steps import Procedure, ProcedureError, SdoFailed, Wait, sleep
from canopen_proto.sync import SyncReceived, SyncSent

READ_INTERVAL: Final = 5 * MILLISECOND
"""From an answer to the next request, at least: some 5 % of a bus at 1 Mbit/s, if the drives answer at once."""
UNANSWERED: Final = 3
"""Reads in a row of one drive that may fail: an answer may be lost, and another client may disturb it."""
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
    """Read, one drive after the other, what they do not send at SYNCs by themselves (`Following.unsent`), until cancelled.

    One request goes out behind a SYNC, and none while one is under way; without SYNC nothing is followed, and nothing is read. So
    a change is seen after as many cycles as there are objects to read, and READ_INTERVALs at least. A drive that does not answer
    holds the others up for its SDO time-out, and is lost after UNANSWERED of them in a row. An object that a drive does not have
    is left out from then on.
    """
    failures = dict.fromkeys(drives, 0)
    while any(drive.unsent for drive in drives):
        for drive in drives:
            for mux in sorted(drive.unsent):
                yield Wait(None, drive.axis.node, lambda report: isinstance(report, SyncSent | SyncReceived))
                if mux in drive.unsent:  # else its first PDO has come meanwhile
                    yield from _read(drive, mux, failures)
                    yield from sleep(READ_INTERVAL)


def _read(drive: Following, mux: int, failures: dict[Following, int]) -> Procedure[None]:
    try:
        yield from read(drive.axis.node, (mux >> 8, mux & 0xFF))
    except ProcedureError as error:
        if isinstance(error, SdoFailed) and error.abort_code in ABSENT:
            drive.unsent.discard(mux)
            return
        failures[drive] += 1
        if failures[drive] >= UNANSWERED:
            drive.lose(f"cannot be watched: {error}, {UNANSWERED} times in a row")
    else:
        failures[drive] = 0
