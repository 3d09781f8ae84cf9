"""`Motion`: one motion of the joints of one or several chains: one generator, one clock, one stop.

A *generator* (`TrajectoryGenerator`) gives the points of the motion, a period after a period: a path with its clock
(`canopen_proto.drives.trajectory.PathClock`), or a stream of targets. A motion asks it behind each SYNC, in the pump's turn. Each
chain takes its joints' part of the point (`Lane`). SYNC is one for all buses, so all chains are at the same point.

**Late cycles.** A period without a SYNC is a period in which the generator stands still. Drives brake by themselves then, so
behind it the generator goes on from rest, where it is; joints that have left it come back to it (late_sync.py). A stream of
targets goes on from where the joints are.

**The end of a motion** comes when its generator is finished, or is at rest after `brake`, and the joints had the time to get
there. The joints then stand at the last set-points, and their chains go on to follow these. A generator that is not at rest
LONGEST_STOP after `brake` ends its motion all the same, and the chains are halted, each joint by its own ramp. So does one that
gets no SYNC for WITHOUT_SYNC while it brakes, or because SYNC was stopped; a process that is late still sends it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final, Protocol, TypeAlias

from canopen_master.errors import PathRefusedError
from canopen_master.motion.cycles import SetPointSource, SourcePoint
from canopen_master.motion.device import Device
from canopen_proto.drives.axis.following_error import LAG
from canopen_proto.drives.trajectory import PathClock, PathPoint
from canopen_transports.loop import current_loop, protected

if TYPE_CHECKING:
    from canopen_master.trajectories.target_stream import TargetStream

LONGEST_STOP: Final = 5.0
"""Seconds that joints may take to brake along their path. A path that needs longer is refused."""

WITHOUT_SYNC: Final = 0.5
"""Seconds without a SYNC after which a motion ends that brakes, or that nobody sends SYNCs for: its points reach no drive."""

SYNCS_LOST: Final = 10
"""... and so many periods of SYNC."""

NO_SYNC: Final = f"because no SYNC came for {WITHOUT_SYNC:g} s or more, so its points reached no drive"

SHORT_GAP: Final = 2
"""Periods without a SYNC after which a motion goes on at its speed: drives have hardly slowed down, and would be thrown back.
After more it goes on from rest."""

TOO_LONG: Final = f"because it did not come to rest along its path within {LONGEST_STOP:g} s"

Torques = Callable[[PathPoint], Sequence[float]]
"""Gives the torques to feed forward at a point of a path, one for each joint, as shares of the rated torques."""


TrajectoryGenerator: TypeAlias = "PathClock | TargetStream"
"""Gives the points of a motion, one after another. The joints are at rest before the first and after the last one."""


class FollowingChain(Protocol):
    """A chain, as far as a motion needs it."""

    @property
    def devices(self) -> tuple[Device, ...]:
        """Its joints."""

    @property
    def has_sync(self) -> bool:
        """Whether SYNC is sent."""

    @property
    def is_on_path(self) -> bool:
        """Whether its joints are sent where they are wanted; they come back to their path behind a gap (late_sync.py)."""

    def begin_source(self, source: SetPointSource, motion: Motion) -> None:
        """Follow the set-points of this source, for this motion, from now on. The chain follows set-points already."""

    def source_over(self, source: SetPointSource, problem: str) -> None:
        """The source gives no more set-points. problem: why the joints may still move; "" if they stand at the last ones."""

    def stopping(self, why: str) -> None:
        """The motion brakes along its path, and the chain is to be halted behind that. why: for the text of ChainHaltedError."""


class Lane:
    """The part of one chain in a motion; it is the source of the chain's set-points. cycles: how many it has given."""

    __slots__ = ("_begin", "_end", "_motion", "cycles", "follower")

    def __init__(self, motion: Motion, follower: FollowingChain, begin: int) -> None:
        """begin: the place of its first joint among those of the motion."""
        self._motion = motion
        self.follower = follower
        self._begin, self._end = begin, begin + len(follower.devices)
        self.cycles = 0

    def next(self, skipped: int) -> SourcePoint | None:
        """See `SetPointSource`."""
        self.cycles += 1
        motion = self._motion
        if self.cycles > motion.cycles:  # the first chain that this SYNC is reported to
            motion.advance(skipped)
        if motion.is_over:
            return None
        return self._part(motion)

    def stand_at(self, positions: Sequence[float]) -> SourcePoint | None:
        """See `SetPointSource`."""
        return self._part(self._motion) if self._motion.stand_at(self._begin, positions) else None

    def _part(self, motion: Motion) -> SourcePoint:
        point, torques, begin, end = motion.point, motion.torques, self._begin, self._end
        return SourcePoint(point.positions[begin:end], point.velocities[begin:end], torques[begin:end])


class Motion:
    """See this module's text. Made at rest, or at `point`; `begin` begins it.

    point: the one given last. torques: fed forward there. cycles: how many points were given. is_braking: it was told to.
    is_over: it gives no more points. was_replaced: another motion took over. error: it ended because of that, and the chains were
    halted. news: woken each cycle, and at the end.
    """

    def __init__(
        self,
        generator: TrajectoryGenerator,
        followers: Sequence[FollowingChain],
        period: float,
        point: PathPoint,
        torques: Torques | None = None,
    ) -> None:
        """period: of SYNC, in seconds. torques: what is fed forward; None for no torques."""
        self.generator = generator
        self.followers = tuple(followers)
        self.lanes: list[Lane] = []
        begin = 0
        for follower in followers:
            self.lanes.append(Lane(self, follower, begin))
            begin += len(follower.devices)
        self._period = period
        self._torques = torques
        self.point = point
        self.torques: Sequence[float] = ()
        self.cycles = 0
        self.is_braking = False
        self.is_over = False
        self.was_replaced = False
        self.error: Exception | None = None
        self._at_rest = 0  # cycles since the generator is at its end, or at rest
        self._braked = 0  # cycles
        self.news = current_loop().parking_lot()
        self._end = current_loop().parking_lot()  # woken at the end only
        self._clock = current_loop().clock()
        self._went_on = self._clock()  # seconds: when it last gave a point, or was told to brake

    @property
    def time(self) -> float:
        """Seconds since it began, in cycles."""
        return self.cycles * self._period

    def begin(self) -> None:
        """Give the set-points of the chains from the next SYNC on."""
        for lane in self.lanes:
            lane.follower.begin_source(lane, self)

    def brake(self) -> None:
        """Brake along the path; the motion is over once the joints stand. Does nothing if it brakes already."""
        if not self.is_braking:
            self.is_braking = True
            self.generator.stop()
            self._went_on = self._clock()
            self.news.unpark_all()

    def halt(self, why: str) -> None:
        """Brake along the path, and then halt the chains. why: for the text of ChainHaltedError."""
        for lane in self.lanes:
            lane.follower.stopping(why)
        self.brake()

    def end(self, problem: str = "") -> None:
        """Give no more points. problem: why the joints may still move; the chains are halted then."""
        if not self.is_over:
            self.is_over = True
            for lane in self.lanes:
                lane.follower.source_over(lane, problem)
            self._tell_end()

    def fail(self, error: Exception) -> None:
        """End because of an error, which is then the caller's."""
        if not self.is_over:
            self.error = error
            self.end(f"because of an error: {str(error).partition(chr(10))[0]}")

    def abandon(self) -> None:
        """End without a word to the chains: the master ends, and halts all drives by itself."""
        self.is_over = True
        self._tell_end()

    def hand_over(self, motion: Motion) -> None:
        """Let another motion of the same joints go on from the present point."""
        self.is_over = self.was_replaced = True
        motion.begin()
        self._tell_end()

    def _tell_end(self) -> None:
        self.news.unpark_all()
        self._end.unpark_all()

    def advance(self, skipped: int) -> None:
        """Go on to the next point, behind a SYNC. skipped: periods without a SYNC before it."""
        self.cycles += 1
        self._went_on = self._clock()
        if self._at_rest:
            self._at_rest += 1
            if not all(lane.follower.is_on_path for lane in self.lanes):
                self._at_rest = 1
            if self._at_rest > LAG + 1:
                self.end()
            self.news.unpark_all()
            return
        generator = self.generator
        try:
            if skipped:
                generator.after_gap(skipped, from_rest=skipped > SHORT_GAP)
            self.point = generator.advance(self._period) if isinstance(generator, PathClock) else generator.step()
            if self._torques is not None:
                self.torques = self._checked(self._torques(self.point))
        except Exception as error:  # noqa: BLE001 - of a generator or a torque function that is the user's
            self.fail(error)
            return
        self._braked += self.is_braking
        if generator.is_finished or (self.is_braking and generator.is_at_rest):
            self._at_rest = 1
        elif self._braked * self._period > LONGEST_STOP:
            self.end(TOO_LONG)
        if self.news:  # a look at it costs less than the call, in each cycle
            self.news.unpark_all()

    def stand_at(self, first: int, positions: Sequence[float]) -> bool:
        """Go on from where the joints are behind a gap, from joint `first` on, unless they have to come back to a path.

        Return whether it does.
        """
        if isinstance(self.generator, PathClock):
            return False
        self.generator.stand_at(first, positions)
        self.point = self.generator.point
        return True

    @protected
    async def wait(self) -> None:
        """Wait until it is over. If the task is cancelled, or a Ctrl-C comes, brake along the path first."""
        try:
            await self.over()
        except BaseException:
            self.brake()
            with current_loop().cancel_scope(shield=True):
                await self.braked()
            raise

    async def braked(self) -> None:
        """Wait until it is over, after `brake`. It ends in any case, with the chains halted if the joints may still move."""
        with current_loop().move_on_after(LONGEST_STOP + self._period):
            await self.over()
        self.end(TOO_LONG)

    async def over(self) -> None:
        """Wait until it is over. It ends if no SYNC comes: a motion counts its time in SYNCs.

        The task is not woken in each cycle: it looks when the last point that it knows of is too old.
        """
        await current_loop().checkpoint()
        patience = max(WITHOUT_SYNC, SYNCS_LOST * self._period)
        since = self._clock()
        while not self.is_over:
            with current_loop().move_on_at(since + patience) as scope:  # which may be over, behind a stall
                await self._end.park()
            if not scope.cancelled_caught or self._went_on > since:
                since = max(since, self._went_on)
            elif self.is_braking or not all(lane.follower.has_sync for lane in self.lanes):
                self.end(NO_SYNC)
            else:
                since = self._clock()

    def _checked(self, torques: Sequence[float]) -> list[float]:
        """Return the torques as numbers, one for each joint. Raises PathRefusedError, as whatever a function of the user's
        returns."""
        try:
            numbers = [float(torque) for torque in torques]
        except (TypeError, ValueError) as error:
            raise _torques_refused(f"it returned {torques!r}") from error
        count = sum(len(lane.follower.devices) for lane in self.lanes)
        if len(numbers) != count or not all(map(math.isfinite, numbers)):
            raise _torques_refused(f"it returned {numbers} for {count} joint{'s' * (count != 1)}")
        return numbers


def _torques_refused(seen: str) -> PathRefusedError:
    return PathRefusedError(
        "the torque function gave no torques", seen=seen, tries=("one finite number for each joint, each time",)
    )
