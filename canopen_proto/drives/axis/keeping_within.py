"""`keep_within`: the watch on a drive that follows velocities or torques, together with its consequence: it is halted.

Run it beside the loop that gives the set-points; it ends only by an error, or when it is cancelled:

    bounds = yield from bounds_of(axis, max_speed)
    yield from start_cyclic_torque(axis, cycle_time)
    yield from keep_within(following, bounds, Mode.CYCLIC_SYNCHRONOUS_TORQUE, cyclic=cyclic)

Either way the drive is halted, and its set-point is 0 then, so that no later command finds the old one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NoReturn

from canopen_proto.drives.axis.bounds import MAX_MISSED, Bounds
from canopen_proto.drives.axis.failures import DriveError
from canopen_proto.drives.axis.following import SILENT_SYNCS, Following, FollowingLost
from canopen_proto.drives.axis.halting import halt_after
from canopen_proto.drives.axis.set_points import SET_POINT_OF
from canopen_proto.drives.axis.unsent import read_unsent
from canopen_proto.machine import Event
from canopen_proto.multiplexer import Mux
from canopen_proto.procedures.steps import Cancelled, Procedure, Wait, act, all_of


class OutOfBounds(DriveError):
    """The watch on a drive that follows velocities or torques found something: a limit that was left, silence, another mode."""


def keep_within(
    following: Following,
    bounds: Bounds,
    mode: int,
    *,
    cyclic: Mapping[Mux, int],
    silent_syncs: int = SILENT_SYNCS,
    max_missed: int = MAX_MISSED,
) -> Procedure[NoReturn]:
    """Watch a drive in csv or cst until it has to be stopped, and halt it then.

    following: of its axis. The rest is as of `Following.begin_within`. Raises OutOfBounds, which says what was found. Halts the
    drive too if it is cancelled. If the halt fails, a note says so.
    """
    axis = following.axis

    def forget() -> Procedure[None]:
        return act(lambda now: axis.put(SET_POINT_OF[mode], 0, now))

    following.begin_within(bounds, mode, cyclic=cyclic, silent_syncs=silent_syncs, max_missed=max_missed)
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
    raise OutOfBounds(axis, lost.cause)
