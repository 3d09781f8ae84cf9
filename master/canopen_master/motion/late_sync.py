"""What is done about a late SYNC, so that no joint jumps, nor goes faster than it may.

Each set-point is one step of the path from the last one, and a drive has one period of SYNC for it. A process that stalls breaks
that in two ways:

    a drive gets less than a period    a late SYNC is followed by the next one in less than a period, since SYNC keeps its phase.
                                       The step that is under way then is made as much shorter
    a drive is not where it was sent   without SYNC drives do what their makers chose: some stop at the last set-point, others go
                                       on beyond it, and brake. The next set-point, which waits in the drive, may lie far behind
                                       such a drive then: at five steps' distance it asks for five times the speed

**`WithinReach`** keeps the set-points of each joint within the way that its speed allows. A drive that was told to go at the
speed v is somewhere on the way that it makes at v in the time of the gap. If the set-point that waits is within one period's way
at the joint's speed limit from all of it, SYNC may be sent. Else the master has to ask the drive where it is, and make that its
set-point, before (`must_look`, `stand_at`).

A joint that is off its set-points then comes back to them by RETURN of its speed, while they go on. On its way it is not sent
beyond its position limits; a joint that has left them is not sent any further.

**`GapGuard`** asks such joints before the SYNC is sent: each by SDO, all at once. Its position becomes the set-point that waits
in it: so it stays there at the SYNC, and comes back to its path from there. Meanwhile SYNC waits, on all buses, so nothing may
take long. A joint that does not tell its position within LONGEST halts its chain.

A joint that brakes has gone on since it was asked. So if the answers of all joints of all chains took more than a period, those
that told it are asked again, until the answers were quick, or no joint moved from one to the next. One that still moves at the
last of MOST_LOOKS halts its chain, too.

A gap of more than TOO_LATE halts the chain in any case, whether its joints moved or not: the computer slept, or was held.

**`our_lateness`** is the reason to name for a drive that does not follow because its SYNC, or our heartbeat, came late.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, Protocol, TypeAlias

from canopen_master.motion.device import Device
from canopen_master.motion.joint_procedures import failure_of
from canopen_proto.communication_errors import EMCY_CONNECTION_LOST
from canopen_proto.drives.axis.reasons import Reason
from canopen_proto.drives.axis.synchronous import align_position
from canopen_proto.error_codes import error_text
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Time
from canopen_proto.procedures.steps import Procedure, ProcedureError, all_of, sleep

RETURN: Final = 0.2
"""The share of a joint's speed limit at which it comes back to its path: slow enough to begin and end it at once."""

Range: TypeAlias = tuple[float | None, float | None]
"""The lowest and the highest position of a joint; None: no limit."""

RECENT: Final = 1 * SECOND
"""What happened within this time may be the reason why a joint does not follow."""

_EXACT: Final = 1 + 1e-6
"""No drive is asked because of a rounding error."""

LONGEST: Final = 200 * MILLISECOND
"""A drive answers within some ms. Another transfer with it may be under way, but joints must not wait long for it."""

MOST_LOOKS: Final = 10
"""Drives that brake have come to rest by then."""

TOO_LATE: Final = 1 * SECOND
"""Behind a longer gap no chain goes on by itself: nobody expects that any more, and somebody may stand in its way. Drives that
watch this master have stopped by then (500 ms, see `Watchdog`)."""


class WithinReach:
    """The set-points of several joints, as they go out; see this module's text. sent: the last ones. ways: see `__init__`."""

    __slots__ = ("_acted_on", "_before", "_next", "_next_off", "_off", "_ranges", "sent", "ways")

    def __init__(self, start: Sequence[float], ways: Sequence[float], ranges: Sequence[Range] = ()) -> None:
        """start: where the joints stand. ways: of each joint in one period, at its speed limit; inf: it has none. ranges: of
        their positions; none: they have no limits."""
        self.ways = ways
        self._ranges = [_within(each) for each in ranges] or [(-math.inf, math.inf)] * len(start)
        self.stand_at(start, start)

    @property
    def is_on_path(self) -> bool:
        """Whether all joints are sent where they are wanted."""
        return not any(self._off)

    def stand_at(self, positions: Sequence[float], wanted: Sequence[float]) -> None:
        """Go on from where the joints are. wanted: where they should be. positions: one for each joint, in its unit."""
        self._before = self._acted_on = self.sent = self._next = positions
        self._off = self._next_off = [at - each for at, each in zip(positions, wanted, strict=True)]

    def must_look(self, periods: float) -> bool:
        """Return whether a joint may be out of reach of its set-point. periods: how late the present SYNC is."""
        return _must_look(self._before, self._acted_on, self.sent, self.ways, periods)

    def must_look_ahead(self, periods: float) -> bool:
        """As `must_look`, if the next set-points are taken at the present SYNC, since they are sent right before it. periods: how
        late it is."""
        return _must_look(self._acted_on, self.sent, self._next, self.ways, periods)

    def next(self, wanted: Sequence[float], share: float = 1.0) -> Sequence[float]:
        """Return what to send in place of these set-points. share: of a period, until the SYNC behind which they are taken.
        wanted: one for each joint, in its unit.

        It may be called again, with other set-points, until `on_sent`.
        """
        if share >= 1.0 and self.is_on_path:
            self._next, self._next_off = wanted, self._off
            return wanted
        self._next, self._next_off = [], []
        each = zip(wanted, self._off, self.sent, self.ways, self._ranges, strict=True)
        for position, off, sent, way, (lowest, highest) in each:
            way *= share
            back = min(abs(off), RETURN * way)
            step = position + off - math.copysign(back, off) - sent if back < abs(off) else position - sent
            to = position if back == abs(off) and abs(step) <= way else sent + math.copysign(min(abs(step), way), step)
            to = min(max(to, min(lowest, sent)), max(highest, sent))
            self._next.append(to)
            self._next_off.append(to - position)
        return self._next

    def on_sent(self) -> None:
        """Note that the next ones were sent, and that the drives act on those before."""
        self._before, self._acted_on, self.sent = self._acted_on, self.sent, self._next
        self._off = self._next_off


def _must_look(
    before: Sequence[float], acted_on: Sequence[float], sent: Sequence[float], ways: Sequence[float], periods: float
) -> bool:
    each = zip(before, acted_on, sent, ways, strict=True)
    return any(abs(to - at - (at - came_from) * periods) > way * _EXACT for came_from, at, to, way in each)


def _within(limits: Range) -> tuple[float, float]:
    lowest, highest = limits
    return -math.inf if lowest is None else lowest, math.inf if highest is None else highest


class Guarded(Protocol):
    """The set-points that a GapGuard guards: `SetPoints`, and `HandSync` of the direct half. See there."""

    @property
    def is_followed(self) -> bool: ...

    @property
    def period(self) -> Time: ...

    @property
    def limited(self) -> dict[Device, float]: ...

    def must_look(self, late: Time) -> bool: ...

    def rest(self) -> None: ...

    def stand_at_images(self) -> None: ...

    def before_late_sync(self, late: Time) -> None: ...


class GapGuard:
    """The `SyncGuard` of one chain; see this module's text."""

    def __init__(self, set_points: Guarded, stop: Callable[[str], None], too_late: Time = NEVER) -> None:
        """stop: halts the chain; it is told why. too_late: ns; a longer gap stops it in any case."""
        self._too_late = too_late
        self._set_points = set_points
        self._stop = stop
        self._looks = 0  # how often the joints were asked
        self._problem = ""  # why one of them is not known to be where its set-point is
        self._seen: list[float] = []
        self._moves: Device | None = None  # a joint that was elsewhere when it was asked before

    def look_before_sync(self, late: Time) -> Procedure[object] | None:
        """See `SyncGuard`."""
        if not self._set_points.must_look(late) and (late <= self._too_late or not self._set_points.is_followed):
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
        if late > self._too_late:
            self._stop(f"because no SYNC was sent for {late / SECOND:.1f} s: this program, or its computer, stood still")
            return
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
        joints = set_points.limited  # with the ways that they make in one period
        asked = yield from all_of(*(failure_of(device, _in_time(align_position(device.axis))) for device in joints))
        failed = next((each for each in asked if each is not None), None)
        self._problem = "" if failed is None else f"{failed.device.name} did not tell where it is: {failed}"
        before, self._seen = self._seen, [device.desired_position for device in joints]
        self._moves = None
        for (device, way), at, was in zip(joints.items(), self._seen, before, strict=False):
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


def our_lateness(device: Device, beside: str = "") -> Reason | None:
    """Return the reason for a drive that does not follow because our SYNC or our heartbeat was late. None if both were in time.

    beside: another likely reason, for people; "" for none.
    """
    late, missed_at, now = device.following.late_sync, device.heartbeat_missed_at, device.node.now()
    busy, longer = "this program, or its computer, was busy", "a longer cycle"
    said = [f"our own SYNC was {late / MILLISECOND:.0f} ms late"] if late else []
    if missed_at is not None and now - missed_at <= RECENT:
        is_ours = device.node.is_held(device.axis.number)
        whose = "our heartbeat" if is_ours else "a heartbeat, or a guarding request, that it watches,"
        age, text = f"{(now - missed_at) / MILLISECOND:.0f} ms ago", error_text(EMCY_CONNECTION_LOST)
        said.insert(0, f"{whose} came late: it sent EMCY 0x{EMCY_CONNECTION_LOST:04X} ({text}) {age}")
        busy, longer = f"{busy}, or frames were lost", "a longer timeout of its Watchdog"
    if not said:
        return None
    what = f"{' and '.join(said)}: {busy}"
    return Reason(f"{what}; or {beside}" if beside else what, f"see canopen doctor; {longer}, fewer programs beside it")
