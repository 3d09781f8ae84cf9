"""`MotionBounds`: a drive that is commanded no position: its actual position and speed against the limits of the axis.

In velocity and torque modes nothing says where the drive should be, so there is no following error. The drive's own limits may
not act there (0x607D, 0x607F, 0x6080: makers differ), and no limit stops a drive that is pushed. So the master compares each
value that comes with its own limits (limits.py), and stops the drive when one is left. The stop takes its way: a limit is passed
by the way of one look and of the ramp.

The speed is the drive's 0x606C if its velocity unit is known; else it is computed from positions (0x6064) of SPEED_TIME.

In csv and cst an RPDO repeats the last set-point for ever if none is given. So a set-point other than 0 that was not given again
for some SYNCs in a row is out of bounds, too.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Final

from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.failures import DriveError, as_drive_errors, require_reference
from canopen_proto.drives.axis.identity import learn_units
from canopen_proto.drives.axis.limits import BY_DEFAULT, Limit, SetPointLimits, read_limits
from canopen_proto.drives.axis.set_points import SET_POINT_OF
from canopen_proto.drives.cia402 import objects
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, LocalProtocolError, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.procedures.steps import Procedure

SPEED_TIME: Final = 100 * MILLISECOND
"""Between the two positions that give a speed: adapters hold frames back by up to 16 ms."""

MAX_MISSED: Final = 10
"""SYNCs in a row without a new set-point, as in a chain."""

_TOLERANCE: Final = 1 + 1e-6


class MotionBounds:
    """The bounds of one axis. limits: as they were read. Its judgement begins with the first value that it sees."""

    def __init__(self, axis: Axis, limits: SetPointLimits) -> None:
        self.limits = limits
        self._axis = axis
        dictionary = axis.node.dictionary
        self._has_speed = axis.scale.velocity_unit is not None and objects.VELOCITY_ACTUAL_VALUE in dictionary
        self._has_position = objects.POSITION_ACTUAL_VALUE in dictionary
        self._start: float | None = None
        self._judged_at: Time = -NEVER  # the last value of each object that was judged came then
        self._speed_judged_at: Time = -NEVER
        self._looks: deque[tuple[Time, int]] = deque()
        self._set_point: Mux | None = None
        self._given = self._missed = self._max_missed = 0

    def expect_set_points(self, mode: int, max_missed: int) -> None:
        """Expect set-points of a cyclic mode from now on. max_missed: SYNCs in a row that may pass without a new one."""
        self._set_point, self._max_missed = SET_POINT_OF.get(mode), max_missed
        self._given, self._missed = self._axis.set_points.given, 0

    def on_sync(self) -> str:
        """Return what is out of bounds at a SYNC, in words; "" if nothing is."""
        axis = self._axis
        if self._set_point is None or axis.set_points.given != self._given or not axis.node.values.store.get(self._set_point):
            self._given, self._missed = axis.set_points.given, 0
            return ""
        self._missed += 1
        if self._missed <= self._max_missed:
            return ""
        return f"got no new set-point for {self._missed} SYNCs, and the last one, which it repeats, is not 0"

    @property
    def watched(self) -> tuple[Mux, ...]:
        """The objects whose values are judged."""
        has = (
            (objects.POSITION_ACTUAL_VALUE, self._has_position),
            (objects.VELOCITY_ACTUAL_VALUE, self._has_speed),
        )
        return tuple(mux for mux, is_there in has if is_there)

    def judge(self) -> str:
        """Return what is out of bounds, in words, as "is too fast: ..."; "" if nothing is. Call it when a value has come."""
        return self._of_speed() or self._of_position()

    def _of_speed(self) -> str:
        heard_at = self._axis.node.heard_at.get(objects.VELOCITY_ACTUAL_VALUE, -NEVER)
        if not self._has_speed or heard_at == self._speed_judged_at:
            return ""
        self._speed_judged_at = heard_at
        return self._too_fast(self._axis.velocity or 0.0)

    def _too_fast(self, velocity: float) -> str:
        limit = self.limits.speed
        if abs(velocity) <= limit.value * _TOLERANCE:
            return ""
        return f"is too fast: {abs(velocity):.4g} per second; the limit is {limit.value:.4g}, by {limit.source}"

    def _of_position(self) -> str:
        axis = self._axis
        heard_at = axis.node.heard_at.get(objects.POSITION_ACTUAL_VALUE, -NEVER)
        position, counts = axis.position, axis.position_counts
        if position is None or counts is None or heard_at == self._judged_at:
            return ""
        self._judged_at = heard_at
        if self._start is None:
            self._start = position
        limit = self.limits.position_excess(self._start, position)
        if limit is not None:
            return f"is beyond its limit: it is at {position:.4g}; the limit is {limit.value:.4g}, by {limit.source}"
        return "" if self._has_speed else self._of_way(heard_at, counts)

    def _of_way(self, heard_at: Time, counts: int) -> str:
        looks = self._looks
        looks.append((heard_at, counts))
        while len(looks) > 2 and heard_at - looks[1][0] >= SPEED_TIME:
            looks.popleft()
        began_at, began = looks[0]
        if heard_at - began_at < SPEED_TIME:
            return ""
        return self._too_fast(self._axis.scale.way_from_counts(counts - began) * SECOND / (heard_at - began_at))


@as_drive_errors
def bounds_of(axis: Axis, max_speed: float | None = None) -> Procedure[MotionBounds]:
    """Read the units and the limits of a drive, and return the bounds for a motion without commanded positions.

    max_speed: in the user's unit per second; it counts if it is lower than the other limits of the speed; math.inf: there need be
    no limit. Raises ReferenceLostError if the axis has position limits, and has lost its reference; DriveError if nothing limits
    its speed (neither max_speed, nor the settings, nor the drive), or if neither speed nor position can be watched;
    SdoTransferError.
    """
    if max_speed is not None and not max_speed > 0:
        raise LocalProtocolError(f"max_speed must be above 0, inf for no limit; it is {max_speed!r}")
    yield from learn_units(axis)
    limits = yield from read_limits(axis)
    if limits.lowest is not None or limits.highest is not None:
        require_reference(axis)
    if max_speed is not None and (limits.speed.source == BY_DEFAULT or max_speed < limits.speed.value):
        limits = replace(limits, speed=Limit(max_speed, "what was asked for (max_speed)"))
    if limits.speed.source == BY_DEFAULT:
        raise DriveError(
            axis,
            "is not moved",
            reason="nothing limits its speed: neither the settings nor the drive (0x607F, 0x6080) say how fast it may go",
            remedy="max_speed (--max-speed); inf (--any-speed) allows any speed",
        )
    bounds = MotionBounds(axis, limits)
    if not bounds.watched and not math.isinf(limits.speed.value):
        raise DriveError(axis, "is not moved", reason="it shows neither its position (0x6064) nor its speed (0x606C)")
    return bounds
