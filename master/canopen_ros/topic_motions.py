"""`Jogging` and `Streaming`: motions that topics feed, message by message. Each is a task that begins with the first message."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import trio

from canopen_master.errors import MotionReplacedError
from canopen_master.motion.chain import Chain
from canopen_master.motion.target_motion import Jog, Targets
from canopen_master.trajectories.point_to_point import MARGIN
from canopen_proto.drives.trajectory import JointLimits
from canopen_ros.reply import COMMAND_ERRORS

QUIET: Final = 0.5
"""Seconds without a new position after which joints that stand are no longer led. The next position leads them again."""


SILENT: Final = 0.1
"""Seconds without a new position after which its velocity counts as 0: the joints then hold the position itself."""


def braking_way(velocity: float, limits: JointLimits) -> float:
    """Return the way, with its sign, on which a joint brakes from a velocity to rest, within the limits of a stream."""
    speed = abs(velocity)
    if not speed:
        return 0.0
    acceleration = (limits.acceleration or math.inf) * (1 - MARGIN)
    jerk = (limits.jerk or math.inf) * (1 - MARGIN)
    if speed * jerk <= acceleration * acceleration:
        return math.copysign(speed * math.sqrt(speed / jerk), velocity)
    return math.copysign(0.5 * speed * (speed / acceleration + acceleration / jerk), velocity)


class _TopicMotion:
    """A motion under way. is_over: it takes no more messages."""

    def __init__(self, chain: Chain, report: Callable[[Exception], object], check: Callable[[], object]) -> None:
        """report: called with the error that ended it, if one did. check: raises if the chain may not begin to move."""
        self.chain = chain
        self._check = check
        self._given_at = trio.current_time()
        self.is_over = False
        self._report = report
        self._scope = trio.CancelScope()

    def cancel(self) -> None:
        """Let the joints brake, and end."""
        self.is_over = True
        self._scope.cancel()

    async def run(self) -> None:
        """Move until it is over."""
        try:
            with self._scope:
                self._check()  # a halt may have come since the message did
                await self._move()
        except MotionReplacedError:
            return
        except COMMAND_ERRORS as error:
            self._report(error)
        finally:
            self.is_over = True

    async def _move(self) -> None:
        raise NotImplementedError


class Jogging(_TopicMotion):
    """Moves at the velocities that were given last, in the joints' units, until `watchdog` seconds pass without new ones. report:
    called with each error. check: raises if the chain may not begin to move."""

    def __init__(
        self,
        chain: Chain,
        report: Callable[[Exception], object],
        check: Callable[[], object],
        velocities: Sequence[float],
        watchdog: float,
    ) -> None:
        super().__init__(chain, report, check)
        self._velocities = velocities
        self._watchdog = watchdog
        self._jog: Jog | None = None

    def give(self, velocities: Sequence[float]) -> None:
        """Move at these velocities from now on. While the joints brake behind the watchdog, this does nothing."""
        self._velocities, self._given_at = velocities, trio.current_time()
        motion = self.chain.motion
        if self._jog is not None and motion is not None and not motion.is_braking and not motion.generator.is_finished:
            try:
                self._jog.velocity(velocities)
            except COMMAND_ERRORS as error:
                self._report(error)

    async def _move(self) -> None:
        async with self.chain.jog(renew_within=self._watchdog) as jog:
            if trio.current_time() - self._given_at > self._watchdog:
                return  # the chain needed longer to begin; the client may be gone
            self._jog = jog
            jog.velocity(self._velocities)
            motion = self.chain.motion
            if motion is not None:
                await motion.over()


class Streaming(_TopicMotion):
    """Goes to the positions that were given last, in the joints' units; see QUIET. report: called with each error. check: raises
    if the chain may not begin to move."""

    def __init__(
        self,
        chain: Chain,
        report: Callable[[Exception], object],
        check: Callable[[], object],
        targets: Mapping[int, float],
        velocities: Mapping[int, float],
    ) -> None:
        """targets: by the places of the joints; the others stay where they are. velocities: see `give`."""
        super().__init__(chain, report, check)
        self._given = dict(targets)
        self._velocities = dict(velocities)
        self._positions: list[float] = []
        self._targets: Targets | None = None

    def give(self, targets: Mapping[int, float], velocities: Mapping[int, float]) -> None:
        """Go to these positions from now on. velocities: with which the controller goes through them, as far as it says so.
        targets: by the joint's number, in its unit."""
        self._given.update(targets)
        self._velocities = dict(velocities)
        self._given_at = trio.current_time()
        if self._targets is not None:
            try:
                self._aim(self._targets)
            except COMMAND_ERRORS as error:
                self._report(error)

    def _aim(self, targets: Targets) -> None:
        """Aim at the positions; with velocities, at where joints that brake there come to rest, so that none lags behind."""
        aims = [self._given.get(place, position) for place, position in enumerate(self._positions)]
        for place, velocity in self._velocities.items():
            aims[place] += braking_way(velocity, self.chain.path_limits[place])
        targets.aim_at(aims)

    async def _move(self) -> None:
        async with self.chain.stream() as targets:
            self._positions = self.chain.desired
            self._targets = targets
            self._aim(targets)
            begun = trio.current_time()  # a chain may take longer than QUIET to follow set-points
            motion = self.chain.motion
            while motion is not None and not motion.is_over:
                if self._velocities and trio.current_time() - self._given_at > SILENT:
                    self._velocities = {}
                    self._aim(targets)
                if motion.generator.is_at_rest and trio.current_time() - max(begun, self._given_at) > QUIET:
                    break
                with trio.move_on_after(QUIET) as silence:
                    await motion.news.park()
                if silence.cancelled_caught and not self.chain.has_sync:
                    break
            self.is_over = True  # a position that comes from now on begins another one
