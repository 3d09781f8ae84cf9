"""A model of ros2_control over topics, and of MoveIt's execution of trajectories, that drives a bridge without ROS.

ros2_control and MoveIt are not to be had here, so this is not a test of them. It is written after their sources as they were
stored publicly, with defaults of parameters unless a docstring says otherwise. "From memory": no source was at hand.
What is left out: chained controllers, limiters of commands, efforts, PID adapters, mimic joints, collisions, and real time.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, Protocol

import trio

from canopen_ros.goals import GoalOutcome, TrajectoryGoal, TrajectoryPoint
from canopen_ros.samples import Sample
from tests.ros.ros_world import Cell, wall

THRESHOLD: Final = 1e-5
"""`trigger_joint_command_threshold` by default."""


class PlugIn(NamedTuple):
    """What the versions of the topic plug-in differ in. initial: of states and commands, before anything wrote them.

    copies_first: the parameter `use_initial_states_as_initial_commands`.
    """

    initial: float
    copies_first: bool = False


PLUG_INS: Final = {
    "zeros": PlugIn(0.0),
    "first states": PlugIn(0.0, copies_first=True),
    "NaN": PlugIn(math.nan),
}
"""zeros: topic_based_ros2_control, TopicBasedSystem::on_init, and joint_state_topic_hardware_interface 0.2 (its comment says NaN,
its code 0.0). NaN: JointStateTopicSystem with the handles of the framework, whose values are NaN at first (from memory). None of
them copies states to commands when it is activated: they have no on_activate."""


class Controller(Protocol):
    """A controller of a system. It claims all its joints."""

    def on_activate(self) -> None: ...

    def on_deactivate(self) -> None: ...

    def update(self, now: float) -> None: ...


class TopicSystem:
    """ros2_control, JointStateTopicSystem (topic_based_ros2_control: TopicBasedSystem) beneath a controller_manager.

    Each cycle of `update_rate`: read() takes the latest JointState, whose joints may be some; the active controllers write the
    commands; write() publishes them, unless all are within THRESHOLD of the states. It does so without a controller, too:
    commands stay what was written last.
    """

    def __init__(
        self,
        world: Cell,
        plug_in: PlugIn,
        publish: Callable[[Sequence[str], Sequence[float]], object],
        rate: float = 50.0,
        *,
        of_velocities: bool = False,
        threshold: float = THRESHOLD,
    ) -> None:
        """of_velocities: the command interface of all joints is the velocity. publish: called with names and commands."""
        self.names = world.arm.joints
        self.positions = [plug_in.initial] * len(self.names)
        self.velocities = list(self.positions)
        self.commands = list(self.positions)
        self.active: Controller | None = None
        self.of_velocities = of_velocities
        self._world = world
        self._publish = publish
        self._period = 1 / rate
        self._threshold = threshold
        self._copies = plug_in.copies_first
        self._latest: Sample | None = None

    def switch(self, controller: Controller | None) -> None:
        """Deactivate the active controller and activate this one, as controller_manager's switch_controllers does."""
        if self.active is not None:
            self.active.on_deactivate()
        self.active = controller
        if controller is not None:
            controller.on_activate()

    async def run(self) -> None:
        """Listen to /joint_states, and run the cycles, until it is cancelled."""
        self._world.nursery.start_soon(self._listen)
        while True:
            self._read()
            if self.active is not None:
                self.active.update(trio.current_time())
            self._write()
            await trio.sleep(self._period)

    async def _listen(self) -> None:
        async for sample in self._world.bridge.samples():
            self._latest = sample

    def _read(self) -> None:
        if self._latest is not None:
            for place, name in enumerate(self._latest.names):
                joint = self.names.index(name)
                self.positions[joint] = self._latest.positions[place]
                if self._latest.velocities:
                    self.velocities[joint] = self._latest.velocities[place]
        if self._copies:  # at the first read, even before a JointState came
            self._copies = False
            self.commands = list(self.velocities if self.of_velocities else self.positions)

    def _write(self) -> None:
        states = self.velocities if self.of_velocities else self.positions
        if sum(abs(state - command) for state, command in zip(states, self.commands, strict=True)) <= self._threshold:
            return  # with NaN it is published
        self._publish(self.names, tuple(self.commands))


class JtcGoal:
    """A goal of a JointTrajectoryController. outcome: None while it runs."""

    def __init__(self, trajectory: TrajectoryGoal) -> None:
        self.trajectory = trajectory
        self.outcome: GoalOutcome | None = None
        self.over = trio.Event()

    def end(self, outcome: GoalOutcome) -> None:
        if self.outcome is None:
            self.outcome = outcome
            self.over.set()


class JointTrajectoryController:
    """ros2_controllers, JointTrajectoryController with position commands, position and velocity states.

    - on_activate: it holds the last commands if none is NaN and `set_last_command_interface_value_as_state_on_activation` is
      true, which is the default; else the states. Before pull request 2294 (2026) it took the states also where there is a
      state interface without its command interface, as velocity here.
    - A trajectory begins at the state, not at the last command (`interpolate_from_desired_state` is false), and goes on whether
      the joints follow or not: without `constraints` no tolerance is checked, and it ends with success.
    - cancel: it holds the state. Success: it holds the last point. on_deactivate: the goal is aborted, commands stay.
    """

    def __init__(self, system: TopicSystem, *, from_commands: bool) -> None:
        """from_commands: `set_last_command_interface_value_as_state_on_activation`."""
        self._system = system
        self._from_commands = from_commands
        self._goal: JtcGoal | None = None
        self._begun: float | None = None
        self._points: list[TrajectoryPoint] = []
        self.is_active = False

    def on_activate(self) -> None:
        system = self._system
        has_commands = self._from_commands and not any(map(math.isnan, system.commands))
        self._hold(system.commands if has_commands else system.positions)
        self.is_active = True

    def on_deactivate(self) -> None:
        self._end(GoalOutcome.ABORTED)
        self._points = []
        self.is_active = False

    def accept(self, trajectory: TrajectoryGoal) -> JtcGoal:
        """goal_received_callback and goal_accepted_callback; a goal that is rejected is over. All joints have to be in it."""
        goal = JtcGoal(trajectory)
        times = [point.time_from_start for point in trajectory.points]
        is_rising = all(later > earlier for earlier, later in itertools.pairwise(times))
        rests = not any(trajectory.points[-1].velocities)
        if not self.is_active or set(trajectory.joint_names) != set(self._system.names) or not is_rising or not rests:
            goal.end(GoalOutcome.REJECTED)
            return goal
        self._end(GoalOutcome.PREEMPTED)
        self._goal, self._begun, self._points = goal, None, list(trajectory.points)
        return goal

    def cancel(self, goal: JtcGoal) -> None:
        if goal is self._goal:
            self._end(GoalOutcome.PREEMPTED)
            self._hold(self._system.positions)

    def update(self, now: float) -> None:
        system = self._system
        if not self._points:
            return
        if self._begun is None:
            self._begun = now
            before = TrajectoryPoint(tuple(system.positions), tuple(system.velocities))
            self._points = [before, *(point for point in self._points if point.time_from_start > 0)]
        time = now - self._begun
        later = next((number for number, point in enumerate(self._points) if point.time_from_start > time), None)
        if later is not None:
            system.commands = _between(self._points[later - 1], self._points[later], time)
            return
        system.commands = list(self._points[-1].positions)
        self._end(GoalOutcome.SUCCEEDED)

    def _hold(self, positions: Sequence[float]) -> None:
        self._begun, self._points = 0.0, [TrajectoryPoint(tuple(positions))]

    def _end(self, outcome: GoalOutcome) -> None:
        if self._goal is not None:
            self._goal.end(outcome)
            self._goal = None


def _between(begin: TrajectoryPoint, end: TrajectoryPoint, time: float) -> list[float]:
    """Return the positions on the cubic polynomial between two points: "splines" of joint_trajectory_controller."""
    h = end.time_from_start - begin.time_from_start
    s = (time - begin.time_from_start) / h
    curve = zip(begin.positions, begin.velocities, end.positions, end.velocities, strict=True)
    return [
        (1 + 2 * s) * (1 - s) ** 2 * p + s * (1 - s) ** 2 * h * v + s * s * (3 - 2 * s) * q - s * s * (1 - s) * h * w
        for p, v, q, w in curve
    ]


class ForwardCommandController:
    """ros2_controllers, ForwardControllersBase; of velocities: JointGroupVelocityController.

    The last message of its topic is written in each cycle; it is forgotten when the controller is activated or deactivated. With
    velocities, 0.0 is written when it is deactivated (JointGroupVelocityController::on_deactivate).
    """

    def __init__(self, system: TopicSystem) -> None:
        self._system = system
        self._given: tuple[float, ...] | None = None

    def take(self, values: Sequence[float]) -> None:
        """Take a message of its topic; one of another size is ignored."""
        if len(values) == len(self._system.names):
            self._given = tuple(values)

    def on_activate(self) -> None:
        self._given = None

    def on_deactivate(self) -> None:
        self._given = None
        if self._system.of_velocities:
            self._system.commands = [0.0] * len(self._system.names)

    def update(self, now: float) -> None:
        if self._given is not None:
            self._system.commands = list(self._given)


# ---- MoveIt ----

ALLOWED_START_TOLERANCE: Final = 0.01
"""MoveIt, TrajectoryExecutionManager: `allowed_start_tolerance_ = 0.01`; 0 checks nothing."""
SCALING, MARGIN = 1.1, 0.5
"""MoveIt, TrajectoryExecutionManager: DEFAULT_CONTROLLER_GOAL_DURATION_SCALING, and _MARGIN in seconds."""
STEP: Final = 0.1
"""Seconds between two points: the default of `resample_dt` of MoveIt's TimeOptimalTrajectoryGeneration."""


class Executor(Protocol):
    """Where MoveIt sends its goals to."""

    async def execute(self, goal: TrajectoryGoal) -> GoalOutcome: ...

    def cancel(self) -> None: ...


class Controllers:
    """An Executor: the action of a JointTrajectoryController."""

    def __init__(self, controller: JointTrajectoryController) -> None:
        self._controller = controller
        self._goal: JtcGoal | None = None

    async def execute(self, goal: TrajectoryGoal) -> GoalOutcome:
        self._goal = own = self._controller.accept(goal)
        await own.over.wait()
        assert own.outcome is not None
        return own.outcome

    def cancel(self) -> None:
        if self._goal is not None:
            self._controller.cancel(self._goal)


class MoveIt:
    """MoveIt, TrajectoryExecutionManager and MoveItSimpleControllerManager, with a planner for joints alone."""

    def __init__(self, world: Cell, executor: Executor, tolerance: float = ALLOWED_START_TOLERANCE) -> None:
        self._world = world
        self._executor = executor
        self._tolerance = tolerance
        self.is_stopped = False

    def plan(self, by: Sequence[float], seconds: float) -> TrajectoryGoal:
        """Plan from the last joint state: each joint goes so far, on a curve of degree 5 from rest to rest. A point each STEP."""
        sample = self._world.bridge.sample()
        points = []
        for number in range(round(seconds / STEP) + 1):
            s = number * STEP / seconds
            way = s**3 * (10 - 15 * s + 6 * s * s)
            speed = 30 * s * s * (1 - s) ** 2 / seconds
            bend = 60 * s * (1 - s) * (1 - 2 * s) / seconds**2
            points.append(
                TrajectoryPoint(
                    [here + each * way for here, each in zip(sample.positions, by, strict=True)],
                    [each * speed for each in by],
                    [each * bend for each in by],
                    number * STEP,
                )
            )
        return TrajectoryGoal(sample.names, points)

    async def execute(self, plan: TrajectoryGoal) -> str:
        """Validate a plan, send it, and watch its time. Return MoveIt's word for how it ended.

        TrajectoryExecutionManager::validate: a joint state from now on has to come within 1 s, and the first point has to be
        within the tolerance of it. A goal that takes longer than it should is cancelled (execution_duration_monitoring).
        """
        self.is_stopped = False
        if not await self._is_valid(plan):
            return "INVALID"
        limit = plan.points[-1].time_from_start * SCALING + MARGIN
        outcome: list[GoalOutcome] = []

        async def send() -> None:
            outcome.append(await self._executor.execute(plan))
            scope.cancel()

        with trio.move_on_after(limit) as scope:
            self._world.nursery.start_soon(send)
            await trio.sleep_forever()
        if not outcome:
            self._executor.cancel()
            return "TIMED_OUT"
        return "PREEMPTED" if self.is_stopped else outcome[0].name

    def stop(self) -> None:
        """TrajectoryExecutionManager::stopExecution: cancel the goals of all controllers."""
        self.is_stopped = True
        self._executor.cancel()

    async def _is_valid(self, plan: TrajectoryGoal) -> bool:
        if not self._tolerance:
            return True
        asked = wall()
        with trio.move_on_after(1.0):
            async for sample in self._world.bridge.samples():
                here = dict(zip(sample.names, sample.positions, strict=True))
                if sample.stamp >= asked and here.keys() >= set(plan.joint_names):
                    first = zip(plan.joint_names, plan.points[0].positions, strict=True)
                    return all(abs(position - here[name]) <= self._tolerance for name, position in first)
        return False
