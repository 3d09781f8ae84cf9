"""The cycle of a chain that follows set-points: which set-points are sent behind which SYNC, and which cycles brought none.

The core builds the PDOs behind each SYNC from images, which hold the set-points; this module keeps track of them over time. A
path of several cycles is put into the images step by step, each step right after the SYNC that took the one before.

**A source** (path_motion.py) gives the set-points by itself: it is asked for the next ones right behind each SYNC, in the pump's
turn. No task is woken for that, so a program that is busy with something else does not disturb the motion.

**The time of a path is not a clock.** It advances by one period for each SYNC that took new set-points along, and stands still
otherwise. So a path that is read at `Cycle.time` is never commanded faster than it is: if the loop or SYNC is late, it takes
longer. A path that is read at a clock would catch up instead, at many times its speed for one cycle.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from typing import NamedTuple, Protocol

from canopen_master.errors import SetPointRefusedError, wrong_values
from canopen_master.motion.device import Device
from canopen_master.motion.feed_forward import FeedForward
from canopen_master.motion.late_sync import WithinReach
from canopen_master.motion.set_point_check import check_set_point, refused
from canopen_proto.datatypes import ValueRangeError
from canopen_proto.machine import SECOND, LocalProtocolError, Time
from canopen_transports.loop import current_loop


class Cycle(NamedTuple):
    """One SYNC cycle, as given to a loop over `Chain.cycles`.

    number: of the turn of the loop, from 0. time: seconds at which to read the path: one period for each SYNC that took new
    set-points along since the first cycle; it stands still after `Chain.hold` and while the loop is late. skipped: periods that
    this loop did not see since its last turn, 0 for a loop in time. late: seconds that the path has lost since the first cycle,
    in periods without new set-points or without a SYNC; `Chain.hold` is not lateness.
    """

    number: int
    time: float
    skipped: int
    late: float


class SourcePoint(NamedTuple):
    """The set-points of one cycle, with a value for each joint, in the user's unit.

    velocities: at these positions, per second. torques: to feed forward, as shares of the rated torques; empty for none.
    """

    positions: Sequence[float]
    velocities: Sequence[float]
    torques: Sequence[float] = ()


class SetPointSource(Protocol):
    """Gives a chain its set-points, cycle by cycle."""

    def next(self, skipped: int) -> SourcePoint | None:
        """Return the set-points to send behind the next SYNC; None: there are no more, and the last ones stay.

        skipped: periods without a SYNC before the present one, because this process was late.
        """

    def stand_at(self, positions: Sequence[float]) -> SourcePoint | None:
        """Go on from where the joints are, behind a gap, and return that; None: they have to come back to its set-points.
        positions: one for each joint, in its unit."""


class SetPoints:
    """The set-points that a chain follows.

    is_followed: whether set-points are followed at present. sync_cycles: SYNCs while it followed. missed_cycles: how many of them
    brought no new set-point. missed_in_row: how many of the last ones in a row. skipped_cycles: periods without a SYNC, because
    this process was late. late_cycles: missed and skipped ones. number: of the current period. taken: SYNCs that took new
    set-points along. given_in: the period in which set-points were last given, or held. sent: the set-points sent last, in the
    user's unit; empty while none are followed. source: gives the set-points at present; None: a loop does.

    cycle_time: s. max_step: the largest step between two set-points, in the user's unit; None: no limit.
    """

    def __init__(self, devices: Sequence[Device], cycle_time: float, max_step: float | None) -> None:
        self.devices = devices
        self._axes = [device.axis for device in devices]
        self.cycle_time = cycle_time
        self._period = round(cycle_time * SECOND)
        self.max_step = max_step
        self.sync_cycles = 0
        self.missed_cycles = 0
        self.skipped_cycles = 0
        self.missed_in_row = 0
        self.is_followed = False
        self.sent: list[float] = []
        self.tick = current_loop().parking_lot()
        self.number = 0
        self.taken = 0
        self.given_in = -1
        self.is_awaited = False  # a loop was handed a cycle: set-points are due from now on
        self._is_new = self._is_held = False  # what the next SYNC takes along
        self._next: list[float] = []
        self._point: SourcePoint | None = None  # of the source, if it gave these
        self._within = WithinReach((), ())  # of no joints while none are followed
        self._path: deque[list[float]] = deque()
        self.source: SetPointSource | None = None
        self._feeds: list[FeedForward] = []

    @property
    def desired(self) -> list[float]:
        """The set-points that the next SYNC takes along, in the user's unit; empty while none are followed."""
        return list(self._next) if self.is_followed else []

    @property
    def late_cycles(self) -> int:
        """See the class."""
        return self.missed_cycles + self.skipped_cycles

    @property
    def on_wire(self) -> Sequence[float]:
        """The set-points that the last SYNC took along; empty while none are followed. See late_sync.py for their difference."""
        return self._within.sent

    @property
    def is_on_path(self) -> bool:
        """Whether the joints are sent where they are wanted: they are not on their way back there."""
        return self._within.is_on_path

    def begin(self, speeds: Sequence[float]) -> None:
        """Begin: from now on each SYNC takes the images along. speeds: the most that each joint may be asked for, or inf."""
        self.end()
        self.is_followed = True
        self._feeds = [FeedForward(axis) for axis in self._axes]
        self._next = self.sent = [device.desired_position for device in self.devices]
        limits = [device.limits.of_paths for device in self.devices]
        ranges = [(each.lowest, each.highest) for each in limits]
        self._within = WithinReach(self.sent, [speed * self.cycle_time for speed in speeds], ranges)

    def end(self) -> None:
        """End: no set-points are followed from now on."""
        self.is_followed = False
        self.source = None
        for feed in self._feeds:
            feed.clear()
        self._feeds = []
        self._within, self._point = WithinReach((), ()), None
        self.sent = []
        self._path.clear()
        self._is_new = self._is_held = self.is_awaited = False
        self.missed_in_row = 0
        self.given_in = -1
        self.tick.unpark_all()

    def begin_source(self, source: SetPointSource) -> None:
        """Let a source give the set-points from now on, in place of a loop, or of another source."""
        self._path.clear()
        self._is_held = self.is_awaited = False
        self.missed_in_row = 0
        self.source = source

    def end_source(self) -> None:
        """Stay at the last set-points of the source."""
        self.source = None
        self.tick.unpark_all()

    @property
    def without_torque(self) -> list[Device]:
        """The joints that take no torque beside their set-points: no RPDO carries 0x60B2."""
        return [device for device, feed in zip(self.devices, self._feeds, strict=True) if not feed.takes_torque]

    def give(self, positions: Sequence[float], cycles: int) -> None:
        """See Chain.set_positions. positions: one for each joint, in its unit. cycles: 1 or more, over which they are reached in
        a straight line."""
        positions = self._check(positions, cycles)
        self._path.clear()
        if cycles == 1:
            self._put(positions)
        else:
            shares = [number / cycles for number in range(1, cycles)]
            self._path.extend([a + (b - a) * share for a, b in zip(self.sent, positions, strict=True)] for share in shares)
            self._path.append(positions)
            self._put_next()
        self.given_in = self.number

    def hold(self) -> None:
        """See Chain.hold. Set-points not sent yet are taken back."""
        self._path.clear()
        if self._is_new:
            self._put(self.sent)
            self._is_new = False
        self._is_held = True
        self.given_in = self.number

    def on_sync(self, skipped: int) -> None:
        """Count a SYNC that was sent, with the images behind it. skipped: periods without a SYNC before it."""
        self.number += 1 + skipped
        self.sync_cycles += 1
        self.skipped_cycles += skipped
        self.sent = self._next
        self._within.on_sent()
        if self._is_new or self._is_held:
            self.missed_in_row = 0
            self.taken += self._is_new
        elif self.is_awaited:
            self.missed_cycles += 1
            self.missed_in_row += 1
        self._is_new = self._is_held = False
        if self._path:
            self._put_next()
        elif self.source is not None and (point := self.source.next(skipped)) is not None:
            self._take(point)
        elif not self.is_on_path:
            self._write()
        if self.tick:
            self.tick.unpark_all()

    def must_look(self, late: Time) -> bool:
        """Return whether a joint has to be asked where it is before a SYNC that is late by so many ns is sent."""
        return self._within.must_look(late / self._period)

    def before_late_sync(self, late: Time) -> None:
        """Shorten the next step: so soon behind this SYNC, which is late by so many ns, the next one is due."""
        self._write(1.0 - late % self._period / self._period)

    @property
    def limited(self) -> dict[Device, float]:
        """The joints whose speed their set-points limit, with the ways that they make in one period at these limits.

        That is all but those without a limit, and those that keep one by themselves.
        """
        return {device: way for device, way in zip(self.devices, self._within.ways, strict=False) if math.isfinite(way)}

    @property
    def period(self) -> Time:
        """ns from SYNC to SYNC."""
        return self._period

    def rest(self) -> None:
        """Take the velocities out of the images: the joints are about to be told to stay where they are."""
        for feed, position in zip(self._feeds, self._within.sent, strict=True):
            feed.put(position, 0.0, feed.torque)

    def stand_at_images(self) -> None:
        """Go on from the set-points in the images: the joints are there, and have been told so."""
        limited = self.limited
        each = zip(self.devices, self._within.sent, strict=True)
        at = [device.desired_position if device in limited else position for device, position in each]
        if self.source is not None and (point := self.source.stand_at(at)) is not None:
            self.sent = self._next = at
            self._point = point
        self._within.stand_at(at, self.sent)

    def _take(self, point: SourcePoint) -> None:
        """Put the set-points of the source into the images. Raises SetPointRefusedError; some images may have changed then."""
        self._next, self._point, self._is_new = self._check(point.positions, 1), point, True
        self._write()

    def _put_next(self) -> None:
        self._put(self._path.popleft())

    def _put(self, positions: list[float]) -> None:
        self._next, self._point, self._is_new = positions, None, True
        self._write()

    def _write(self, share: float = 1.0) -> None:
        """Put the set-points into the images. share: of a period, until the SYNC behind which they are taken."""
        within, point = self._within, self._point
        positions = within.next(self._next, share)
        if point is None:
            for axis, position in zip(self._axes, positions, strict=True):
                axis.set_points.set_position_counts(axis.scale.to_counts(position))
            return
        torques = point.torques or [0.0] * len(self.devices)
        velocities = point.velocities
        if positions is not self._next:
            velocities = [(to - at) / self.cycle_time for to, at in zip(positions, within.sent, strict=True)]
        values = zip(self.devices, self._feeds, positions, velocities, torques, strict=True)
        for device, feed, position, velocity, torque in values:
            try:
                feed.put(position, velocity, torque)
            except (LocalProtocolError, ValueRangeError) as error:
                raise refused(device, position, str(error)) from error

    def _check(self, positions: Sequence[float], cycles: int) -> list[float]:
        """Return set-points as floats: they may be numbers of numpy. Raises as `Chain.set_positions` does."""
        if isinstance(cycles, bool) or not isinstance(cycles, int) or cycles < 1:
            raise LocalProtocolError(f"set-points are reached in 1 cycle or more, a whole number, not {cycles!r}")
        if wrong := wrong_values(positions, len(self.devices)):
            names = ", ".join(device.name for device in self.devices)
            failed = "the set-points are not one number for each joint"
            raise SetPointRefusedError(failed, "", f"{wrong}; the joints are {names}", ("[0.1, 0.2, ...]",))
        time, max_step = cycles * self._period, self.max_step
        targets = [*map(float, positions)]
        for device, given, target, start in zip(self.devices, positions, targets, self.sent, strict=True):
            if not device.limits.allows(start, target, time):  # this says why not, or lets a joint come back to its limits:
                check_set_point(device, start, given if isinstance(given, int) else target, time)
            if max_step is not None and abs(target - start) / cycles > max_step * (1 + 1e-9):  # no refusal for a rounding error
                step = abs(target - start) / cycles
                seen = f"from {start:g} that is a step of {step:g} per cycle, more than max_step = {max_step:g}"
                raise refused(device, given, seen, ("a finer path, more `cycles`, or a larger max_step",))
        return targets


class Cycles:
    """The iterator that `Chain.cycles` returns. A cycle is given out once: right behind its SYNC, or later to a late loop.

    A loop that has given its set-points waits for the SYNC that takes them, so that none is overwritten before it was sent.
    """

    def __init__(self, set_points: SetPoints, stopped: Callable[[], Awaitable[Exception | None]]) -> None:
        """stopped: why the chain follows no set-points, once the joints stand; None while it follows them."""
        self._set_points = set_points
        self._stopped = stopped
        self._last = set_points.number
        self._handed_out = 0
        self._taken_before = self._late_before = 0  # when the first one was handed out

    def __aiter__(self) -> Cycles:
        return self

    async def __anext__(self) -> Cycle:
        set_points = self._set_points
        if set_points.number not in (self._last, set_points.given_in):  # else it parks below
            await current_loop().checkpoint()
        while True:
            if not set_points.is_followed and (error := await self._stopped()) is not None:
                raise error
            if set_points.number not in (self._last, set_points.given_in):
                break
            await set_points.tick.park()
        if not self._handed_out:
            self._last = set_points.number - 1
            self._taken_before, self._late_before = set_points.taken, set_points.late_cycles
        set_points.is_awaited = True
        number, skipped = self._handed_out, set_points.number - self._last - 1
        self._last = set_points.number
        self._handed_out += 1
        period = set_points.cycle_time
        time, late = set_points.taken - self._taken_before, set_points.late_cycles - self._late_before
        return Cycle(number, time * period, skipped, late * period)
