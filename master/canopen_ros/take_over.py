"""`TakeOver`: a source of motion is taken only from where the joints are.

A controller, a joystick or a program that goes on sending while an arm is initialised, homed or recovered does not know where
the joints are now. Its next message would move the arm, and nobody has asked for that. So behind each interruption, and behind
each motion of another source, a source has to be taken over once before it may move the joints:

- **positions**: the message has to be within `tolerance` of where each of its joints is (where it comes to rest, if the message
  has velocities). A joint that was in no message yet is taken over by the first message that names it.
- **velocities**: the message has to be all zeros: the stick is let go once.
- **trajectories of the topic**: the first point has to be within `tolerance`; or nothing came on the topic for PAUSE, so that the
  message is a request of its own and not one more of a stream. It must not be stamped before the interruption.

A goal of the action is a request of its own: it has an answer. A service drops a goal that waits for its start.

An **interruption** is one of the chain (`Chain.interruptions`: initialised, homed, halted, shut down, stopped by a fault), a
mode service, a trajectory without points, or a joint that was not heard for a while, as behind a bus that was down.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Final

import trio

from canopen_master.errors import CHAIN_NOT_READY, ChainError
from canopen_master.motion.chain import Chain
from canopen_master.motion.device import Device
from canopen_proto.drives.cia402.objects import POSITION_ACTUAL_VALUE
from canopen_proto.machine import SECOND
from canopen_ros.goals import START
from canopen_ros.samples import STALE

PAUSE: Final = 2.0
"""Seconds of silence behind which a trajectory is a request of its own, and not one more of a stream."""
SILENT_CYCLES: Final = 5
"""Cycles without a position, at least, until a joint counts as not heard: one with a long cycle is heard less often."""


class MotionSource(Enum):
    """What moves the joints. The value is for people."""

    VELOCITIES = "the velocities of command_vel"
    POSITIONS = "the positions of joint_commands"
    TRAJECTORIES = "the trajectory of joint_trajectory"
    ACTION = "a goal"


class TakeOver:
    """See this module's text. tolerance: in rad or m."""

    def __init__(self, chain: Chain, tolerance: float = START) -> None:
        self.tolerance = tolerance
        self._chain = chain
        self._interruptions = chain.interruptions
        self._is_silent = True  # nothing was heard yet
        self._interrupted_at = -math.inf  # all times are those of trio's clock
        self._velocities = False
        self._joints: set[int] = set()  # by their places: those that the source of positions may move
        self._trajectories = False
        self._heard: dict[MotionSource, float] = {}  # when the last message of a source came
        self._pauses: dict[MotionSource, float] = {}  # how long it was silent before that
        self._refused: set[MotionSource] = set()  # whose refusal has been told

    def interrupt(self) -> None:
        """Let every source be taken over again."""
        self._forget(None)

    def begins(self, source: MotionSource) -> None:
        """Let every other source be taken over again: this one begins to move the joints."""
        self.look()
        self._forget(source)

    def look(self) -> None:
        """Notice an interruption. Every other method does so, too."""
        was_silent, self._is_silent = self._is_silent, not all(map(self._is_heard, self._chain.devices))
        if self._chain.interruptions != self._interruptions:
            self._interruptions = self._chain.interruptions
            self._forget(None)
        elif self._is_silent and not was_silent:
            self.interrupt()

    # ---- one message ----

    def hear(self, source: MotionSource) -> None:
        """Note that a message came, before it is looked at: also one that is refused for another reason."""
        self.look()
        now = trio.current_time()
        self._pauses[source] = now - self._heard.get(source, -math.inf)
        self._heard[source] = now
        if self._pauses[source] > PAUSE:
            self._refused.discard(source)

    def of_velocities(self, velocities: Sequence[float]) -> ChainError | None:
        """Return why these velocities move nothing, or None."""
        if not any(velocities):
            self._velocities = True
        if self._velocities:
            self._refused.discard(MotionSource.VELOCITIES)
            return None
        place = next(place for place, velocity in enumerate(velocities) if velocity)
        joint = self._chain.devices[place].name
        seen = f"since the chain was stopped, made ready or moved by something else, that of {joint} was never 0 with all others"
        return self._error(
            MotionSource.VELOCITIES, "they have to be 0 once", joint, seen, "let the joystick go: zeros for all joints"
        )

    def of_positions(self, aims: Mapping[int, float], scales: Sequence[float]) -> ChainError | None:
        """Return why these positions move nothing, or None. aims: where each joint comes to rest, by its place, in its own unit.

        scales: radians, or metres, in one unit of each joint.
        """
        error = None if self._joints.issuperset(aims) else self._off(MotionSource.POSITIONS, aims, scales)
        if error is None:
            self._joints.update(aims)
            self._refused.discard(MotionSource.POSITIONS)
        return error

    def of_trajectory(self, first: Mapping[int, float], scales: Sequence[float], age: float) -> ChainError | None:
        """Return why this trajectory moves nothing, or None. first: its first point, as the aims of `of_positions`. scales:
        radians, or metres, in one unit of each joint.

        age: seconds since its stamp; negative for a start to come; 0 without a stamp.
        """
        if self._trajectories:
            self._refused.discard(MotionSource.TRAJECTORIES)
            return None
        since = trio.current_time() - self._interrupted_at
        if age > since:
            seen = f"its stamp is {age:.3g} s old, and the chain was stopped, made ready or homed {since:.3g} s ago"
            return self._error(
                MotionSource.TRAJECTORIES, "it is older than that", "", seen, "a trajectory from where the joints are"
            )
        error = None if self._pauses[MotionSource.TRAJECTORIES] > PAUSE else self._off(MotionSource.TRAJECTORIES, first, scales)
        if error is None:
            self._trajectories = True
            self._refused.discard(MotionSource.TRAJECTORIES)
            return None
        return error

    def is_news(self, source: MotionSource) -> bool:
        """Return whether the refusal of a source is to be told: once until the source is taken, pauses, or is interrupted."""
        is_news = source not in self._refused
        self._refused.add(source)
        return is_news

    # ---- for this module ----

    def _is_heard(self, device: Device) -> bool:
        heard = device.axis.node.heard_at.get(POSITION_ACTUAL_VALUE)
        limit = max(STALE, round(SILENT_CYCLES * self._chain.settings.cycle_time * SECOND))
        return heard is not None and device.node.now() - heard <= limit

    def _forget(self, besides: MotionSource | None) -> None:
        if besides is None:
            self._interrupted_at = trio.current_time()
        if besides is not MotionSource.VELOCITIES:
            self._velocities = False
        if besides is not MotionSource.POSITIONS:
            self._joints.clear()
        if besides is not MotionSource.TRAJECTORIES:
            self._trajectories = False
        self._refused.clear()

    def _off(self, source: MotionSource, aims: Mapping[int, float], scales: Sequence[float]) -> ChainError | None:
        """Return the error for the joint that is farthest from its aim, unless all are near."""
        worst: tuple[float, str, str] | None = None
        for place, aim in aims.items():
            device, scale = self._chain.devices[place], scales[place]
            if device.position is None or not self._is_heard(device):
                why = f"it is not known where {device.name} is"
                return self._error(source, why, device.name, "no position came from the drive lately", "look at the bus")
            here = device.position * scale
            distance = abs(aim * scale - here)
            if not distance <= self.tolerance and (worst is None or distance > worst[0]):
                worst = distance, device.name, f"{device.name} is at {here:.6g}, and they begin at {aim * scale:.6g}"
        if worst is None:
            return None
        distance, joint, seen = worst
        seen += f"; {self.tolerance:g} are allowed (start_tolerance)"
        step = "let the controller begin where the joints are (/joint_states): restart it, for example"
        return self._error(source, f"they begin {distance:.3g} away from {joint}", joint, seen, step)

    def _error(self, source: MotionSource, why: str, joint: str, seen: str, step: str) -> ChainError:
        failed = f"chain {self._chain.name} does not take {source.value} over: {why}"
        return ChainError(CHAIN_NOT_READY, self._chain.name, failed, joint=joint, seen=seen, tries=(step,))
