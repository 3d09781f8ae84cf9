"""`Moving`: how a chain, or several chains as one, move along paths and by targets. `together` makes one of several.

    await arm.move([0.5, -1.0, 0.3])            plan from where it stands, or from how it moves at present (a blend)
    await arm.follow(path)                      a path of your own, checked as a whole before anything moves
    arm.override = 0.3                          at any time; 0 is a pause on the path
    async with arm.jog() as jog: jog.velocity([0.1, 0.0, 0.0])

    both = together(arm, leg)                   one clock, one stop
    await both.move([...])                      the joints of `arm`, then those of `leg`

**Any end is a stop on the path.** If the task that waits is cancelled, or Ctrl-C comes, the joints brake together along the
path, and the call ends when they stand. They go on to follow set-points then. `halt`, the end of the master, and a joint in
trouble that still follows its set-points brake along the path, too, and then halt. Only a joint in fault, or one that is lost,
stops each joint by its own ramp: the others cannot wait for it.
"""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_master.errors import (
    CHAIN_FAILED,
    ChainError,
    ChainFaultError,
    MotionReplacedError,
    PathRefusedError,
    PlanRefusedError,
)
from canopen_master.motion.device import Device
from canopen_master.motion.member import Member
from canopen_master.motion.path_check import cannot_be_followed, check_now, check_path, check_start, find_margin, source_of
from canopen_master.motion.path_motion import LONGEST_STOP, Motion, Torques, TrajectoryGenerator
from canopen_master.motion.target_motion import DEAD_MAN, Jog, Targets
from canopen_master.seconds import check_seconds
from canopen_proto.drives.trajectory import JointLimits, Path, PathClock, PathError, PathPoint
from canopen_proto.drives.trajectory.margin import Margin
from canopen_proto.drives.trajectory.path_clock import check_override
from canopen_proto.machine import LocalProtocolError
from canopen_transports.loop import current_loop, protected

if TYPE_CHECKING:
    from canopen_master.trajectories.target_stream import TargetStream

PathMaker = Callable[[PathPoint], Path]
"""Makes a path from where the joints are and how they move."""

ROUNDING: Final = 1e-9  # in cycles: 0.2 s are 20 cycles of 0.01 s, though 0.2 / 0.01 may be a little more


class Progress(NamedTuple):
    """How far a motion is; each list has a value for each joint, in the user's unit.

    time: seconds since it began. set_points: those that the next SYNC takes along. positions: the actual ones, as last heard.
    following_errors: set-point minus actual position of the same instant. override: the rate of the path at present, 0 to 1; 1
    for targets and jogging.
    """

    time: float
    set_points: list[float]
    positions: list[float]
    following_errors: list[float]
    override: float


class Moving:
    """See this module's text. Positions and velocities are in the user's units of the joints."""

    def __init__(self, members: tuple[Member, ...]) -> None:
        """members: of its chains, in the order of the joints."""
        self._members = members
        self._override = 1.0

    # ---- along a path ----

    async def follow(self, path: Path | PathMaker | None = None, *, torques: Torques | None = None) -> None:
        """Follow a path, from its start, where the joints have to stand, to its end; return when they are there.

        path: with the joints in the order of the chain. It is checked as a whole before anything moves. It runs at the rate of
        `override`, slower if SYNCs are late, and never faster to catch up. torques: called with each point, in every cycle and in
        the middle of the master's work; the torques that it returns go along (0x60B2). Velocities go along by themselves if the
        PDOs of a joint have room for them (0x60B1; see feed_forward.py).

        A function in place of a path is called when the motion can begin, perhaps again, with where the joints are and how they
        move then, and returns a path from there. Like `move` it takes over from another call that moves the joints, without a
        stop; that call raises MotionReplacedError.

        Without a path: let all joints follow set-points from where they stand, each in its mode; then give them, see `cycles`. A
        chain that already follows set-points is halted first. They need not be homed before.

        Raises PathRefusedError for a path that begins elsewhere, exceeds a limit, or leaves too little free for a stop on it.
        Raises ChainError if the chain moves already, if a drive does not stand, lacks the mode, or has lost its reference (see
        `recover`); ChainHaltedError, ChainFaultError if it is stopped on its way.
        """
        _check_function("torques", torques, "a function that returns the torques at a point")
        if path is None:
            for member in self._members:
                await member.follow_set_points("follow set-points")
            return
        if not isinstance(path, Path):
            _check_function("path", path, "a path, as `cubic` of canopen_proto.drives, or a function that returns one")
            await self._take_over("follow a path", path, torques, is_checked=False)
            return
        await self._begin_following("follow a path")
        self._require_free()
        limits = self.path_limits
        await check_path(self._devices, path, self._present(), limits, self._period)
        margin = await find_margin(self._devices, path, limits, self._period)
        self._require_free()  # other tasks ran meanwhile
        start = self._present()
        check_start(self._devices, path, start, limits, self._period)
        await self._run(self._clock(path, limits, margin, is_moving=False), start, torques)

    async def move(self, targets: Sequence[float], *, speed: float = 1.0, torques: Torques | None = None) -> None:
        """Move all joints to their targets, as fast as their limits allow, and to arrive together; return when they are there.

        It is planned from where the joints stand; or, if another call moves them at present, from how they move, without a stop:
        the other call then raises MotionReplacedError. speed: the share of each speed limit that is used, above 0, at most 1.
        Needs the extra `motion` (ruckig). torques, and the errors: as for `follow`; and PlanRefusedError, for a target beyond a
        limit.
        """
        from canopen_master.trajectories.point_to_point import point_to_point
        from canopen_master.trajectories.scaled_joints import check_share

        check_share("speed", speed)

        _check_function("torques", torques, "a function that returns the torques at a point")

        def planned(start: PathPoint) -> Path:
            with self._names_joints():
                return point_to_point(start, targets, self.path_limits, speed_factor=speed)

        await self._take_over("move", planned, torques, is_checked=True)

    @property
    def path_limits(self) -> list[JointLimits]:
        """The limits of each joint on paths. Those of its drive are known once the chain is initialised."""
        return [device.limits.of_paths for device in self._devices]

    # ---- by targets and velocities: see target_motion.py ----

    @asynccontextmanager
    async def jog(self, *, speed: float = 1.0, renew_within: float = DEAD_MAN) -> AsyncIterator[Jog]:
        """Move at velocities that are given while the block runs: `async with arm.jog() as jog: jog.velocity([...])`.

        speed: the share of each speed limit that is used. renew_within: seconds, counted in cycles. If neither a velocity nor
        `renew` comes for so long, the joints brake, and the jog is over. The block is left when the joints stand. It may take
        over from a motion under way, as `move` does. Needs the extra `motion` (ruckig). Raises as `move` does.
        """
        async with self._streaming("jog", speed, renew_within) as (stream, check):
            yield Jog(stream, check)

    @asynccontextmanager
    async def stream(self, *, speed: float = 1.0, renew_within: float | None = None) -> AsyncIterator[Targets]:
        """Move to targets that are given while the block runs: `async with arm.stream() as targets: targets.aim_at([...])`.
        speed: as for `jog`.

        A new target may come at any time. renew_within: as for `jog`; None: the joints go to their last target and rest there,
        whatever becomes of the caller. Else as `jog`.
        """
        async with self._streaming("take targets", speed, renew_within) as (stream, check):
            yield Targets(stream, check)

    @asynccontextmanager
    async def _streaming(
        self, what: str, speed: float, renew_within: float | None
    ) -> AsyncIterator[tuple[TargetStream, Callable[[], None]]]:
        from canopen_master.trajectories.point_to_point import MARGIN
        from canopen_master.trajectories.scaled_joints import check_share
        from canopen_master.trajectories.target_stream import TargetStream

        check_share("speed", speed)
        if renew_within is not None:
            check_seconds("renew_within", renew_within)
        await self._begin_following(what)
        self._require_movable(what)
        renew_cycles = None if renew_within is None else max(1, math.ceil(renew_within / self._period - ROUNDING))
        start = self._present()
        limits = [_less(each, MARGIN) for each in self.path_limits]
        with self._names_joints():
            stream = TargetStream(start, limits, self._period, speed_factor=speed, renew_cycles=renew_cycles)
        motion = self._begin(stream, start, None)
        try:
            with self._names_joints():
                yield stream, lambda: self._check_goes_on(motion, what)
        finally:
            motion.brake()
            with current_loop().cancel_scope(shield=True):
                await motion.braked()
        if not motion.was_replaced:
            await self._check_end(motion)
        with self._names_joints():
            if stream.failure is not None:
                raise stream.failure

    def _check_goes_on(self, motion: Motion, what: str) -> None:
        """Raise if a motion is over that should not be, or if its chains are being halted."""
        if motion.is_over:
            self._raise_own_end(motion)
        for member in self._members:
            member.require_following(what)

    # ---- while it runs ----

    @property
    def override(self) -> float:
        """The rate at which paths run: 0 (a pause on the path) to 1. It may be set at any time, also for the next motion.

        A motion under way goes to that rate within its limits, and stays on its path. Raises PathError for any other value.
        """
        return self._override

    @override.setter
    def override(self, override: float) -> None:
        check_override(override)
        self._override = override
        self._set_rate(override)

    def pause(self) -> None:
        """Stop on the path until `resume`. Does nothing if it follows no path."""
        self._set_rate(0.0)

    def resume(self) -> None:
        """Go on along the path, at the rate of `override`."""
        self._set_rate(self._override)

    async def halt(self) -> None:
        """Stop all joints and wait until they stand. A running command ends with ChainHaltedError.

        Joints that move along a path brake along it first, for LONGEST_STOP at most, and all that move with them do so, too. The
        joints stay enabled. Raises ChainError, which names a joint that did not confirm that it stands.

        Of several chains all are told at once, also if one of them fails. Raises the first error; the others are its notes.
        """
        for member in self._members:
            member.begin_halt()
        errors = []
        for member in self._members:
            try:
                await member.halted()
            except ChainError as error:
                errors.append(error)
        for other in errors[1:]:
            errors[0].add_note(str(other))
        if errors:
            raise errors[0]

    def progress(self) -> Progresses:
        """How far the motion is, cycle by cycle, as an async iterator: the present motion, else the next one, until its end.

        A late loop gets the newest cycle. It goes on if another motion takes over.
        """
        return Progresses(self)

    # ---- for this folder ----

    @property
    def members(self) -> tuple[Member, ...]:
        """The chains, in the order of the joints."""
        return self._members

    @property
    def present_motion(self) -> Motion | None:
        """The motion that moves all of it at present."""
        return self._members[0].motion

    @property
    def _devices(self) -> list[Device]:
        return [device for member in self._members for device in member.devices]

    @property
    def _names(self) -> list[str]:
        return [device.name for device in self._devices]

    @contextmanager
    def _names_joints(self) -> Iterator[None]:
        """Let an error name the joint by its name, and say where its limit comes from."""
        try:
            yield
        except PlanRefusedError as error:
            error.name_joint(self._names)
            if error.joint is not None and error.limit is not None:
                source = source_of(self._devices[error.joint], "position", error.limit)
                error.seen += f": {source}" if source else ""
            raise

    @property
    def _period(self) -> float:
        return self._members[0].settings.cycle_time

    def _set_rate(self, rate: float) -> None:
        motion = self.present_motion
        if motion is not None and isinstance(motion.generator, PathClock):
            motion.generator.override = rate

    async def _begin_following(self, what: str) -> None:
        """Let those chains follow set-points that follow none yet."""
        for member in self._members:
            if not member.desired:
                await member.follow_set_points(what)

    def _require_free(self) -> None:
        for member in self._members:
            member.require_free("follow a path")

    def _require_movable(self, what: str) -> None:
        """Raise unless all chains follow set-points, and nothing else moves any of them than one motion of just these."""
        motion = self.present_motion
        for member in self._members:
            member.require_following(what)
            if member.motion is not motion or (motion is not None and motion.followers != self._members):
                member.require_free(what)

    def _present(self) -> PathPoint:
        """Return the set-points that the next SYNC takes along, and how they move."""
        motion = self.present_motion
        if motion is not None:
            return motion.point
        positions = [position for member in self._members for position in member.desired]
        return PathPoint(positions, [0.0] * len(positions), [0.0] * len(positions))

    async def _take_over(self, what: str, make: PathMaker, torques: Torques | None, *, is_checked: bool) -> None:
        """Follow a path from how the joints move at present, once the clock of a path under way allows it.

        is_checked: `make` keeps the limits by itself. From joints that move, everything happens in one turn.
        """
        await self._begin_following(what)
        while True:
            self._require_movable(what)
            limits, margin = self.path_limits, None
            start, present = self._present(), self.present_motion
            path = make(start)
            if not isinstance(path, Path):
                raise LocalProtocolError(f"the function that was given as a path returned {path!r}, which is no Path")
            is_moving = any(start.velocities) or any(start.accelerations)
            if not is_checked and is_moving:
                check_now(self._devices, path, start, limits, self._period)
            elif not is_checked:
                await check_path(self._devices, path, start, limits, self._period)
            try:
                if not is_moving:
                    margin = await find_margin(self._devices, path, limits, self._period)
                    if self._present() != start:
                        continue  # other tasks ran meanwhile
                clock = self._clock(path, limits, margin, is_moving=is_moving)
                self._require_movable(what)
                break
            except PathRefusedError:
                if present is None or not is_moving:  # from rest it is the path itself, however long one waits
                    raise
                await present.news.park()  # it changes its rate with all that its limits leave free: soon it will not
        await self._run(clock, start, torques)

    def _clock(self, path: Path, limits: Sequence[JointLimits], margin: Margin | None, *, is_moving: bool) -> PathClock:
        """Return the clock of a path. margin: of `find_margin`; None: it is found in this turn."""
        try:
            return PathClock(
                path,
                limits,
                self._period,
                override=self._override,
                moving=is_moving,
                longest_stop=LONGEST_STOP,
                margin=margin,
            )
        except PathError as error:
            raise cannot_be_followed(self._devices, error) from error

    @protected
    async def _run(self, generator: TrajectoryGenerator, start: PathPoint, torques: Torques | None) -> None:
        motion = self._begin(generator, start, torques)
        await motion.wait()
        await self._check_end(motion)

    @protected
    def _begin(self, generator: TrajectoryGenerator, start: PathPoint, torques: Torques | None) -> Motion:
        without = [device for member in self._members for device in member.set_points.without_torque]
        if torques is not None and without:
            name, tries = without[0].name, ("an RPDO with 0x60B2 in its mapping, in the joint's dictionary", "no torques")
            raise PathRefusedError(
                f"{name} takes no torque beside its set-points", name, seen="no RPDO of it has 0x60B2", tries=tries
            )
        motion = Motion(generator, self._members, self._period, start, torques)
        present = self.present_motion
        if present is None:
            motion.begin()
        else:
            present.hand_over(motion)
        return motion

    async def _check_end(self, motion: Motion) -> None:
        """Raise if the end of a motion was not its generator's own: an error, another motion, a halt, a fault."""
        self._raise_own_end(motion)
        errors = [error for member in self._members if (error := await member.why_stopped()) is not None]
        if errors:
            raise next((error for error in errors if isinstance(error, ChainFaultError)), errors[0])

    def _raise_own_end(self, motion: Motion) -> None:
        """Raise if a motion ended by an error, by the end of the master, or by another motion."""
        if motion.error is not None:
            raise motion.error
        self._members[0].check_open()
        if motion.was_replaced:
            names, seen = ", ".join(member.name for member in self._members), "another motion took over, from where it was"
            raise MotionReplacedError(CHAIN_FAILED, names, f"chain {names} did not end its motion", seen=seen)

    async def next_news(self) -> None:
        """Wait until a motion begins, or goes on by a cycle, or ends."""
        self._members[0].check_open()
        await (self._members[0].begun if self.present_motion is None else self.present_motion.news).park()


class Progresses:
    """The iterator that `Moving.progress` returns."""

    def __init__(self, moving: Moving) -> None:
        self._moving = moving
        self._has_begun = False
        self._last: tuple[Motion, int] | None = None

    def __aiter__(self) -> Progresses:
        return self

    async def __anext__(self) -> Progress:
        await current_loop().checkpoint()
        while True:
            motion = self._moving.present_motion
            if motion is None and self._has_begun:
                raise StopAsyncIteration
            if motion is not None:
                self._has_begun = True
                if motion.cycles and (motion, motion.cycles) != self._last:
                    self._last = motion, motion.cycles
                    return self._of(motion)
            await self._moving.next_news()

    def _of(self, motion: Motion) -> Progress:
        members, generator = self._moving.members, motion.generator
        return Progress(
            motion.time,
            [position for member in members for position in member.desired],
            [position for member in members for position in member.positions],
            [device.following_error for member in members for device in member.devices],
            generator.rate if isinstance(generator, PathClock) else 1.0,
        )


class Together(Moving):
    """Several chains that move as one; made by `together`. Their joints stand one after another."""

    def __init__(self, members: tuple[Member, ...]) -> None:
        super().__init__(members)
        periods, joints = {member.settings.cycle_time for member in members}, self._devices
        if not members or len(periods) > 1 or len(set(joints)) < len(joints):
            seen = "no chain" if not members else f"cycles of {periods}" if len(periods) > 1 else "a joint that is in two of them"
            raise LocalProtocolError(f"chains move together if they have one cycle_time and joints of their own; there is {seen}")

    def __repr__(self) -> str:
        return f"<{' and '.join(member.name for member in self._members)}, together>"


def _less(limits: JointLimits, margin: float) -> JointLimits:
    """Return limits with a margin, so that a `move` can take over at any time, and stop on its path."""
    acceleration = None if limits.acceleration is None else limits.acceleration * (1.0 - margin)
    jerk = None if limits.jerk is None else limits.jerk * (1.0 - margin)
    return JointLimits(limits.lowest, limits.highest, limits.speed, acceleration, jerk)


def together(*chains: Moving) -> Together:
    """Return several chains of one master as one, for motions: one path, one clock, one stop. They may be on several buses.

    Raises LocalProtocolError for chains that have another cycle_time or a joint in common.
    """
    return Together(tuple(member for chain in chains for member in chain.members))


def _check_function(name: str, given: object, wanted: str) -> None:
    if given is not None and not callable(given):
        raise LocalProtocolError(f"{name} {given!r} is none; give {wanted}")
