"""`GapGuard`: what a chain does before a late SYNC: it asks joints that may be out of reach (late_sync.py).

Each joint is asked by SDO, all at once, and its position becomes the set-point that waits in it: so it stays there at the SYNC,
and comes back to its path from there. Meanwhile SYNC waits, on all buses, so nothing may take long. A joint that does not tell
its position within LONGEST halts its chain.

A joint that brakes has gone on since it was asked. So if the answers of all joints of all chains took more than a period, those
that told it are asked again, until the answers were quick, or no joint moved from one to the next. One that still moves at the
last of MOST_LOOKS halts its chain, too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol

from canopen_master.motion.device import Device
from canopen_master.motion.joint_procedures import failure_of
from canopen_proto.drives.axis.synchronous import align_position
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.procedures.steps import Procedure, ProcedureError, all_of, sleep

LONGEST: Final = 200 * MILLISECOND
"""A drive answers within some ms. Another transfer with it may be under way, but joints must not wait long for it."""

MOST_LOOKS: Final = 10
"""Drives that brake have come to rest by then."""


class Guarded(Protocol):
    """The set-points that a GapGuard guards: `SetPoints`, and `HandSync` of the direct half. See there."""

    @property
    def is_followed(self) -> bool: ...

    @property
    def period(self) -> Time: ...

    @property
    def limited(self) -> list[Device]: ...

    @property
    def limited_ways(self) -> list[float]: ...

    def must_look(self, late: Time) -> bool: ...

    def rest(self) -> None: ...

    def stand_at_images(self) -> None: ...

    def before_late_sync(self, late: Time) -> None: ...


class GapGuard:
    """The `SyncGuard` of one chain; see this module's text."""

    def __init__(self, set_points: Guarded, stop: Callable[[str], None]) -> None:
        """stop: halts the chain; it is told why."""
        self._set_points = set_points
        self._stop = stop
        self._looks = 0  # how often the joints were asked
        self._problem = ""  # why one of them is not known to be where its set-point is
        self._seen: list[float] = []
        self._moves: Device | None = None  # a joint that was elsewhere when it was asked before

    def look_before_sync(self, late: Time) -> Procedure[object] | None:
        """See `SyncGuard`."""
        if not self._set_points.must_look(late):
            return None
        self._looks, self._seen = 0, []
        return self._look()

    def look_again(self, took: Time) -> Procedure[object] | None:
        """See `SyncGuard`."""
        if not self._looks or self._problem or not self._set_points.is_followed or took <= self._set_points.period:
            return None
        if self._looks > 1 and self._moves is None:
            return None
        if self._looks == MOST_LOOKS:
            assert self._moves is not None
            self._problem = f"{self._moves.name} still moved"
            return None
        return self._look()

    def before_late_sync(self, late: Time) -> None:
        """See `SyncGuard`."""
        looks, problem = self._looks, self._problem
        self._looks, self._problem = 0, ""
        if not self._set_points.is_followed:
            return
        if problem:
            self._stop(f"because SYNC was {late / MILLISECOND:.0f} ms late, and {problem}")
            return
        if looks:
            self._set_points.stand_at_images()
        self._set_points.before_late_sync(late)

    def before_ordered_sync(self, late: Time) -> None:
        """See `SyncGuard`."""
        if self._set_points.must_look(late):
            self._stop(f"because no SYNC was sent for {late / MILLISECOND:.0f} ms while it moved")

    def _look(self) -> Procedure[None]:
        self._looks += 1
        self._problem = "its joints could not be asked where they are"  # until they were
        set_points = self._set_points
        set_points.rest()
        joints = set_points.limited
        asked = yield from all_of(*(failure_of(device, _in_time(align_position(device.axis))) for device in joints))
        failed = next((each for each in asked if each is not None), None)
        self._problem = "" if failed is None else f"{failed.device.name} did not tell where it is: {failed}"
        before, self._seen = self._seen, [device.desired_position for device in joints]
        self._moves = None
        for device, way, at, was in zip(joints, set_points.limited_ways, self._seen, before, strict=False):
            if abs(at - was) > way:
                self._moves = device


class _Done(Exception):
    """The procedure is at its end: what waits beside it has to end, too."""


def _in_time(procedure: Procedure[object]) -> Procedure[None]:
    """Run a procedure for LONGEST at most. Raises ProcedureError."""

    def run() -> Procedure[None]:
        yield from procedure
        raise _Done

    def limit() -> Procedure[None]:
        yield from sleep(LONGEST)
        raise ProcedureError(f"no answer within {LONGEST / MILLISECOND:g} ms")

    try:
        yield from all_of(run(), limit())
    except _Done:
        return
