"""`GoalMotion`: a trajectory under way: its start, its feedback, its tolerances, and how it ends."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence

import trio

from canopen_master.errors import MotionReplacedError, PlanRefusedError, SetPointRefusedError
from canopen_master.motion.chain import Chain
from canopen_master.motion.path_motion import Motion
from canopen_proto.drives.axis.following_error import LAG
from canopen_proto.drives.trajectory import Path, PathClock, PathError, PathPoint
from canopen_ros.goals import (
    Feedback,
    GoalCode,
    GoalOutcome,
    GoalRefusedError,
    GoalResult,
    JointPoint,
    Tolerance,
    TrajectoryGoal,
    TrajectoryPoint,
    path_of,
)
from canopen_ros.reply import COMMAND_ERRORS, text_of

Tell = Callable[[Feedback], object]


class GoalMotion:
    """A goal on its way; see this module's text. goal: what the client asked for. has_begun: the joints follow it. over: is set
    once they follow it no longer.

    All times are those of trio's clock.
    """

    def __init__(
        self,
        chain: Chain,
        goal: TrajectoryGoal,
        scales: Sequence[float],
        goal_time: float,
        start_tolerance: float,
        check: Callable[[], object],
    ) -> None:
        """scales: radians, or metres, in one unit of each joint. goal_time: seconds, for a goal that names none.
        start_tolerance: see `path_of`. check: raises if the chain may not begin to move."""
        self.goal = goal
        self._check = check
        self.over = trio.Event()
        self._chain = chain
        self._names = tuple(device.name for device in chain.devices)
        self._scales = scales
        self._start_tolerance = start_tolerance
        self._goal_time = goal.goal_time_tolerance or goal_time
        self._path_tolerances = _by_place(goal.path_tolerance, self._names)
        self._goal_tolerances = _by_place(goal.goal_tolerance, self._names)
        self._scope = trio.CancelScope()
        self._why: GoalResult | None = None
        self._path: Path | None = None
        self.has_begun = False

    def cancel(self, why: str) -> None:
        """Let the joints brake along the path; `run` returns PREEMPTED. why: for the client."""
        self._end(GoalResult(GoalCode.INVALID_GOAL, f"the trajectory ended before its time: {why}", GoalOutcome.PREEMPTED))

    def _end(self, result: GoalResult) -> None:
        if self._why is None:
            self._why = result
        self._scope.cancel()

    async def run(
        self, points: Sequence[JointPoint], delay: float, tell: Tell | None, begins: Callable[[], object]
    ) -> GoalResult:
        """Follow the points. delay: seconds until then. tell: called in each cycle. begins: called when the motion begins."""
        try:
            with self._scope:
                await trio.sleep(delay)
                async with trio.open_nursery() as nursery:
                    nursery.start_soon(self._look, tell, begins)
                    result = await self._follow(points)
                    if result.outcome is GoalOutcome.SUCCEEDED:
                        result = await self._arrive(points[-1])
                    nursery.cancel_scope.cancel()
                return result
            assert self._why is not None
            return self._why
        finally:
            self.over.set()

    async def _follow(self, points: Sequence[JointPoint]) -> GoalResult:
        chain = self._chain

        def make(start: PathPoint) -> Path:
            self._path = path_of(points, start, self._names, self._scales, self._start_tolerance)
            return self._path

        try:
            self._check()  # a halt may have come since the goal did
            await chain.follow(make)
        except GoalRefusedError as refused:
            return GoalResult(refused.code, str(refused), GoalOutcome.REJECTED)
        except (SetPointRefusedError, PlanRefusedError, PathError) as error:
            outcome = GoalOutcome.ABORTED if self.has_begun else GoalOutcome.REJECTED
            return GoalResult(GoalCode.INVALID_GOAL, text_of(error, chain.name), outcome)
        except MotionReplacedError:
            return GoalResult(GoalCode.INVALID_GOAL, "another motion took over, from where this one was", GoalOutcome.PREEMPTED)
        except COMMAND_ERRORS as error:
            if not self.has_begun:
                return GoalResult(GoalCode.INVALID_GOAL, text_of(error, chain.name), GoalOutcome.REJECTED)
            return GoalResult(GoalCode.PATH_TOLERANCE_VIOLATED, text_of(error, chain.name), GoalOutcome.ABORTED)
        return GoalResult(GoalCode.SUCCESSFUL, "the joints are there", GoalOutcome.SUCCEEDED)

    async def _look(self, tell: Tell | None, begins: Callable[[], object]) -> None:
        """Tell each cycle of the motion, and end it when a joint leaves its tolerance."""
        motion = await self._own_motion()
        self.has_begun = True
        begins()
        before: deque[list[float]] = deque(maxlen=LAG + 1)  # velocities, the oldest first
        while not motion.is_over:
            before.append(motion.point.velocities)
            report = self._feedback(motion, before[0])
            if tell is not None:
                tell(report)
            problem = self._beyond(report, self._path_tolerances)
            if problem:
                text = f"{problem} at {motion.time:.3f} s: the joints brake"
                self._end(GoalResult(GoalCode.PATH_TOLERANCE_VIOLATED, text, GoalOutcome.ABORTED))
            await motion.news.park()

    async def _own_motion(self) -> Motion:
        """Wait until the motion of this goal has begun."""
        chain = self._chain
        while True:
            motion = chain.motion
            if motion is not None and isinstance(motion.generator, PathClock) and motion.generator.path is self._path:
                return motion
            await chain.begun.park()

    def _feedback(self, motion: Motion, velocities: Sequence[float]) -> Feedback:
        """Return where the joints are. velocities: those wanted when the actual ones were measured."""
        scales, devices = self._scales, self._chain.devices
        actual = [scale * position for scale, position in zip(scales, self._chain.positions, strict=True)]
        errors = [scale * device.following_error for scale, device in zip(scales, devices, strict=True)]
        wanted = [scale * velocity for scale, velocity in zip(scales, velocities, strict=True)]
        measured = [
            scale * velocity for scale, device in zip(scales, devices, strict=True) if (velocity := device.velocity) is not None
        ]
        measured = measured if len(measured) == len(devices) else []
        off = [want - value for want, value in zip(wanted, measured, strict=False)]
        desired = [position + error for position, error in zip(actual, errors, strict=True)]
        time = motion.time
        return Feedback(
            self._names,
            TrajectoryPoint(desired, wanted, (), time),
            TrajectoryPoint(actual, measured, (), time),
            TrajectoryPoint(errors, off, (), time),
        )

    def _beyond(self, report: Feedback, tolerances: Mapping[int, Tolerance]) -> str:
        """Return which joint is off by more than its tolerance, and how far; "" if none is."""
        for place, tolerance in tolerances.items():
            for kind, allowed in (("position", tolerance.position), ("velocity", tolerance.velocity)):
                values: Sequence[float] = report.error.positions if kind == "position" else report.error.velocities
                if allowed > 0 and values and abs(values[place]) > allowed:
                    return f"{tolerance.joint} is off by {abs(values[place]):.6g} in {kind}, {allowed:g} are allowed,"
        return ""

    async def _arrive(self, last: JointPoint) -> GoalResult:
        """Wait until the joints are within the tolerances of the goal, for the time that it allows."""
        chain, problem = self._chain, ""
        deadline = trio.current_time() + self._goal_time
        while True:
            problem = self._off_goal(last)
            if not problem:
                return GoalResult(GoalCode.SUCCESSFUL, "the joints are there", GoalOutcome.SUCCEEDED)
            if trio.current_time() >= deadline:
                text = f"{problem} {self._goal_time:g} s behind the end of the trajectory"
                return GoalResult(GoalCode.GOAL_TOLERANCE_VIOLATED, text, GoalOutcome.ABORTED)
            await trio.sleep(chain.settings.cycle_time)

    def _off_goal(self, last: JointPoint) -> str:
        devices = self._chain.devices
        for place, tolerance in self._goal_tolerances.items():
            wanted, device, scale = last.positions[place], devices[place], self._scales[place]
            off = [
                (
                    "position",
                    tolerance.position,
                    None if wanted is None or device.position is None else device.position * scale - wanted,
                ),
                ("velocity", tolerance.velocity, None if device.velocity is None else device.velocity * scale),
            ]
            for kind, allowed, value in off:
                if allowed > 0 and value is not None and abs(value) > allowed:
                    return f"{tolerance.joint} is off by {abs(value):.6g} in {kind}, {allowed:g} are allowed,"
        return ""


def _by_place(tolerances: Sequence[Tolerance], names: Sequence[str]) -> dict[int, Tolerance]:
    return {names.index(tolerance.joint): tolerance for tolerance in tolerances}
