"""The procedures beside the watch on whether a drive follows (following.py): its limit, what no PDO carries, and its consequence.

**The limit** of the following error: `following_limit` finds it.

**Values that no PDO carries** (`Following.unsent`) must be read: `read_unsent` does that.

    limit = yield from following_limit(axis, (yield from read_limits(axis)))
    yield from start_interpolation(axis, cycle_time)
    following.begin(limit, Mode.INTERPOLATED_POSITION, cyclic={STATUSWORD: 1, POSITION_ACTUAL_VALUE: 1})
    network.run(read_unsent([following]), now)

**Velocities and torques.** `watch_bounds` is the watch together with its consequence: the drive is halted. Run it beside the loop
that gives the set-points; it ends only by an error, or when it is cancelled:

    bounds = yield from bounds_of(axis, max_speed)
    yield from start_cyclic_torque(axis, cycle_time)
    yield from watch_bounds(following, bounds, Mode.CYCLIC_SYNCHRONOUS_TORQUE, cyclic=cyclic)

Source: IEC 61800-7-201 (CiA 402-2): following error, following error window 6065h.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NoReturn

from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.bounds import MAX_MISSED, MotionBounds
from canopen_proto.drives.axis.controlword import put
from canopen_proto.drives.axis.failures import DriveError, as_drive_errors
from canopen_proto.drives.axis.following import SILENT_SYNCS, Following, FollowingLost, TurnToRead
from canopen_proto.drives.axis.halting import halt_after
from canopen_proto.drives.axis.limits import DEFAULT_SPEED, Limit, SetPointLimits
from canopen_proto.drives.axis.set_points import SET_POINT_OF
from canopen_proto.drives.cia402 import objects
from canopen_proto.machine import MILLISECOND, SECOND, Event, LocalProtocolError, Outcome, Time
from canopen_proto.multiplexer import Mux, index_of, split_mux
from canopen_proto.procedures.objects import ABSENT, read_if_present, value_of
from canopen_proto.procedures.steps import (
    Cancelled,
    Procedure,
    ProcedureError,
    SdoTransferError,
    Wait,
    act,
    all_of,
    current_time,
    sleep,
)
from canopen_proto.sdo.client import SdoAborted, SdoUploaded

READ_INTERVAL: Final = 5 * MILLISECOND
"""The least mean time between two requests on a bus: some 5 % of the bus load at 1 Mbit/s."""
UNANSWERED: Final = 3
"""SDO time-outs for which an object may stay unread: an answer may be lost, and another client may disturb the transfer."""

DEFAULT_TIME: Final = 100 * MILLISECOND
"""How far behind a drive may be by default, at its top speed: position controllers without feed-forward lag by 10 to 50 ms."""
OFF: Final = 0x7FFF_FFFF
"""A window of 0x6065 that no INTEGER32 can leave; 0xFFFFFFFF switches the drive's own watch off."""

_TURN: Final = (TurnToRead,)
_ANSWERS: Final = (SdoUploaded, SdoAborted)


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
        except SdoTransferError as failed:
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
    client = next((each for each in (node.sdo, *drive.axis.remote.sdo_channels) if not each.busy), node.sdo)
    request_id = yield from act(lambda now: client.upload(index, subindex, now, urgent=True))
    try:
        left = max(0, deadline - (yield from current_time()))
        outcome = yield Wait(left, node, lambda answer: isinstance(answer, Outcome) and answer.request_id == request_id, _ANSWERS)
    except Cancelled:
        yield from act(lambda now: node.cancel(request_id, now))
        raise
    if isinstance(outcome, SdoAborted):
        raise SdoTransferError(outcome, "reading")
    if outcome is None:
        yield from act(lambda now: node.cancel(request_id, now))
        return False
    value_of(node, node.dictionary.variable(mux), outcome)
    return True


class OutOfBoundsError(DriveError):
    """The watch on a drive that follows velocities or torques found something: a limit that was left, silence, another mode."""


def watch_bounds(
    following: Following,
    bounds: MotionBounds,
    mode: int,
    *,
    cyclic: Mapping[Mux, int],
    silent_syncs: int = SILENT_SYNCS,
    max_missed: int = MAX_MISSED,
) -> Procedure[NoReturn]:
    """Watch a drive in csv or cst until it has to be stopped, and halt it then.

    following: of its axis. bounds, mode, cyclic, silent_syncs, max_missed: as of `Following.begin_with_bounds`. Raises
    OutOfBoundsError, which says what was found. Halts the drive too if it is cancelled. If the halt fails, a note says so.
    """
    axis = following.axis

    def forget() -> Procedure[None]:
        return act(lambda now: put(axis, SET_POINT_OF[mode], 0, now))

    following.begin_with_bounds(bounds, mode, cyclic=cyclic, silent_syncs=silent_syncs, max_missed=max_missed)
    try:
        yield from all_of(_until_lost(following), read_unsent([following]))
        raise AssertionError("the watch ends by an error")
    except (Cancelled, Exception) as cause:
        following.end()
        yield from halt_after(axis, cause, forget)
        raise


def _until_lost(following: Following) -> Procedure[None]:
    axis = following.axis

    def concerns(report: Event) -> bool:
        return isinstance(report, FollowingLost) and axis.is_told_by(report)

    lost = yield Wait(None, axis.node, concerns, (FollowingLost,))
    assert isinstance(lost, FollowingLost)
    raise OutOfBoundsError(axis, lost.cause)


@as_drive_errors
def following_limit(axis: Axis, limits: SetPointLimits) -> Procedure[Limit]:
    """Return how far off its set-points a drive may be: by its settings, else by its window 0x6065, else by its speed limit.

    The drive's time-out 0x6066 is not awaited: after it, the drive would stop by itself. limits: of its set-points. By default a
    drive may be off by its way in DEFAULT_TIME at its speed limit (at DEFAULT_SPEED if the user lifted the limit). Raises
    SdoTransferError.
    """
    limit = axis.settings.following_error_limit
    if limit is not None:
        return Limit(limit, "the settings (following_error_limit)")
    window = yield from read_if_present(axis.node, objects.FOLLOWING_ERROR_WINDOW)
    if isinstance(window, int) and 0 < window < OFF:
        return Limit(axis.scale.amount_from_counts(window), "0x6065 of the drive")
    speed = limits.speed.value if math.isfinite(limits.speed.value) else axis.scale.amount_from_counts(DEFAULT_SPEED)
    way = f"its way in {DEFAULT_TIME / SECOND:g} s at {speed:.4g} per second"
    source = f"default, {way}; following_error_limit of its settings raises it"
    return Limit(speed * DEFAULT_TIME / SECOND, source)
