"""`Jog` and `Targets`: what a program says to joints while they move. Made by `Moving.jog` and `Moving.stream`.

    async with arm.jog() as jog:
        while key_is_held():
            jog.velocity([0.1, 0.0, 0.0])       # again and again: this is the dead man's switch
            await trio.sleep(0.05)

    async with arm.stream() as targets:
        async for seen in camera:
            targets.aim_at(place_of(seen))

Each cycle takes the joints on towards what was said last, within their limits of position, speed, acceleration and jerk
(canopen_master.trajectories.target_stream). The joints are independent of each other: there is no path to stay on.

**It ends** with its block: if its caller comes to the end, fails, or is cancelled, the joints brake, and the block is left when
they stand. It also ends if its caller hangs: a jog that is not renewed in time brakes, and takes no more velocities.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from canopen_master.trajectories.target_stream import TargetStream

DEAD_MAN: Final = 0.2
"""Seconds within which a jog has to be renewed: a program that reads a joystick or a key does so every 20 to 50 ms."""


class _StreamInput:
    """What a program says to a stream of targets while its block runs."""

    def __init__(self, stream: TargetStream, check: Callable[[], None]) -> None:
        """check: raises if the motion is over."""
        self._stream = stream
        self._check = check

    def renew(self) -> None:
        """Hold the dead man's switch, if there is one: the caller is still there, and wants what it said last."""
        self._check()
        self._stream.renew()


class Targets(_StreamInput):
    """Takes targets while its block runs. Each method raises PlanRefusedError for values that are no numbers or not one for each
    joint, and once it has ended; ChainHaltedError, ChainFaultError, MotionReplacedError if they were stopped, or something else
    moves them."""

    def aim_at(self, targets: Sequence[float]) -> None:
        """Go to these positions, each joint as fast as its limits allow, and rest there until others are given.

        A target beyond a position limit counts as that limit.
        """
        self._check()
        self._stream.aim_at(targets)


class Jog(_StreamInput):
    """Takes velocities while its block runs. Raises as `Targets` does."""

    def velocity(self, velocities: Sequence[float]) -> None:
        """Move at these velocities, in the user's unit per second, and hold the dead man's switch.

        A velocity beyond a speed limit counts as that limit. A joint that comes to a position limit brakes in time, and rests.
        """
        self._check()
        self._stream.move_at(velocities)
