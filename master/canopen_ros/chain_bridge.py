"""`ChainBridge`: one chain as ROS sees it: services, state, velocities, positions and trajectories. In trio's thread.

Every motion goes through the chain (canopen_master.motion), with all of its checks. In addition:

**A halt stays in force.** After `halt`, and after any other stop of the chain, commands to move are refused until `recover`,
`init`, `home` or a mode service. Else the next message of a joystick would undo the halt.

**Taking over.** Behind a halt, a service or the motion of another source, a source that streams moves nothing before it was
where the joints are (take_over.py). Else a controller that goes on sending would move the arm by `init` or `recover` alone.

**One motion at a time.** A goal takes over from whatever moves the joints, without a stop. So does a velocity other than 0.
Positions (`command_positions`) are refused while a goal or velocities move the joints.

**Silence.** Velocities have a watchdog: if none comes in time, the joints brake. Positions have none: ros2_control stops sending
once the arm is there, so the joints go to the last ones and hold.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from typing import Final

import trio

from canopen_master.errors import ChainError, SetPointRefusedError
from canopen_master.motion.chain import Chain, ChainState
from canopen_master.motion.chain_errors import not_now
from canopen_master.motion.device import Device
from canopen_master.node import Node
from canopen_proto.drives.cia402.modes import short_name
from canopen_proto.machine import SECOND
from canopen_proto.nmt import NmtState
from canopen_ros.goal_motion import GoalMotion, Tell
from canopen_ros.goals import START, GoalCode, GoalOutcome, GoalRefusedError, GoalResult, TrajectoryGoal, checked
from canopen_ros.names import COMMANDS, MODE_SERVICES, OTHER_MODES
from canopen_ros.reply import COMMAND_ERRORS, Reply, text_of
from canopen_ros.samples import is_unit_missing, si_per_unit
from canopen_ros.take_over import MotionSource, TakeOver
from canopen_ros.topic_motions import Jogging, Streaming, braking_way

WATCHDOG: Final = 0.1
"""Seconds within which the next velocity has to come."""
ROUNDED: Final = 1e-9
"""By which share a velocity may exceed its limit: conversions of units round."""
GOAL_TIME: Final = 1.0
"""Seconds behind the end of a trajectory until the joints have to be within the tolerances of the goal."""


class ChainBridge:
    """See this module's text. name: of the chain. joints: their names, in its order. services: what `call` takes.

    chain: of the master. watchdog: seconds, of velocities. goal_time: seconds, the default of `goal_time_tolerance`.
    start_tolerance: rad or m that a joint may be off where a source of motion begins.
    """

    def __init__(
        self,
        chain: Chain,
        nursery: trio.Nursery,
        report: Callable[[str, str, bool], object],
        wall: Callable[[], int],
        wake: Callable[[Node], Awaitable[object]],
        *,
        watchdog: float = WATCHDOG,
        goal_time: float = GOAL_TIME,
        start_tolerance: float = START,
    ) -> None:
        """nursery: for what moves the chain on behalf of topics. report: called with the name of the chain, the text of an error
        of a command that has no answer, and whether it is news though the same was told lately. wall: the time in ns since
        1970. wake: lets a node be pre-operational.
        """
        self.chain = chain
        self.name = chain.name
        self.joints = tuple(device.name for device in chain.devices)
        self.watchdog = watchdog
        self.goal_time = goal_time
        self.start_tolerance = start_tolerance
        self._take_over = TakeOver(chain, start_tolerance)
        self.failure: Exception | None = None
        self._services = 0  # that run
        self._nursery = nursery
        self._is_down = False  # shut down by this bridge, and nothing was asked of it since
        self._report = report
        self._wall = wall
        self._wake = wake
        self._goals: list[GoalMotion] = []  # that wait for their start, or run
        self._jogging: Jogging | None = None
        self._streaming: Streaming | None = None
        modes = {service: self._mode(mode) for service, mode in MODE_SERVICES.items()}
        self._commands: dict[str, Callable[[], Awaitable[str]]] = {
            "init": self._init,
            "home": self._home,
            "homing": self._home,
            "recover": self._recover,
            "halt": self._halt,
            "shutdown": self._shut_down,
            "IPmode": self._mode("ip"),
            **modes,
        }
        assert set(COMMANDS) <= set(self._commands)

    @property
    def services(self) -> tuple[str, ...]:
        """The services that this chain has: those of every chain, and the mode services that it can have."""
        return tuple(name for name in self._commands if name in COMMANDS or self._may_have(MODE_SERVICES[name]))

    # ---- state ----

    @property
    def state(self) -> str:
        """One word: off, ready, following, moving, stopping, halted, fault, or failed, if the bus or the master is gone."""
        if self.failure is not None:
            return "failed"
        if self.chain.state is ChainState.FOLLOWING and self.chain.motion is not None:
            return "moving"
        return self.chain.state.value

    def states(self) -> States:
        """The present state, and then each other one, as an async iterator. A slow reader gets the newest."""
        return States(self)

    def fail(self, error: Exception) -> None:
        """Note that the master has ended by an error: from now on everything is refused with it."""
        self.failure = error
        self.chain.changed.unpark_all()

    async def locate(self, device: Device) -> None:
        """Ask a joint of a chain without power where it is (0x6064), once. With power PDOs tell it.

        While a service runs nothing comes in between. A joint that does not answer is left out of the samples.
        """
        if self.failure is None and self.chain.state is ChainState.OFF and not self._services:
            try:
                await self.chain.locate(device)
            except COMMAND_ERRORS:
                return  # the diagnostics of the bus and the joint tell of it

    # ---- services ----

    async def call(self, service: str) -> Reply:
        """Execute a service. A failure, or a refusal, is a Reply, too; its message is the text of the error.

        `halt` waits for nothing: it ends what runs. Every other service is refused while one of them runs. A service that is
        cancelled halts what it moved.
        """
        command = self._commands.get(service)
        if command is None or service not in self.services:
            return Reply(False, self._no_service(service))
        try:
            self._check_open()
            self._drop_waiting_goals(service)
            self._services += 1
            try:
                return Reply(True, await command())
            finally:
                self._services -= 1
        except COMMAND_ERRORS as error:
            return Reply(False, text_of(error, self.name))
        finally:
            self._take_over.look()

    def _drop_waiting_goals(self, service: str) -> None:
        """A service ends what the chain does; that includes trajectories that wait for their start."""
        for goal in self._goals:
            if not goal.has_begun:
                goal.cancel(f"{service} was called")

    async def _init(self) -> str:
        for device in self.chain.devices:
            if is_unit_missing(device.axis.settings):  # that is certain before the drive is asked for its scale
                si_per_unit(device)
        self._is_down = False
        await self.chain.initialise()
        self._scales()
        return f"chain {self.name} is ready"

    async def _home(self) -> str:
        if self.chain.state is not ChainState.OFF:
            self._scales()
        await self.chain.home()
        return f"chain {self.name} is homed"

    async def _recover(self) -> str:
        if self.chain.state is ChainState.OFF:
            raise self._refused("recover", "it is off", "{chain}/init")
        await self.chain.recover()
        return f"chain {self.name} is {self.chain.state.value}"

    async def _halt(self) -> str:
        if self._has_no_power():
            return f"chain {self.name} is off: its joints have no power"
        await self.chain.halt()
        return f"chain {self.name} stands"

    async def _shut_down(self) -> str:
        if self._has_no_power():
            return f"chain {self.name} is off already"
        await self.chain.shut_down()
        for node in dict.fromkeys(device.node for device in self.chain.devices):
            if node.nmt_state is NmtState.STOPPED:  # it answers nothing there, and its position is still asked for
                await self._wake(node)
        self._is_down = True
        return f"chain {self.name} is off"

    def _has_no_power(self) -> bool:
        """Return whether it was shut down, and no drive has been given power since."""
        return self._is_down and self.chain.state is ChainState.OFF and not any(each.may_move for each in self.chain.devices)

    def _mode(self, mode: str) -> Callable[[], Awaitable[str]]:
        async def follow() -> str:
            if not self._may_have(mode):
                raise self._refused(f"follow set-points in {mode}", f"its mode is {self._mode_word()}", f'mode = "{mode}"')
            if self.chain.state is ChainState.FOLLOWING:
                return f"chain {self.name} follows set-points in {mode} already"
            self._take_over.interrupt()  # before: else what comes as the chain begins to follow would move it
            await self.chain.follow()
            return f"chain {self.name} follows set-points in {mode}"

        return follow

    def _mode_word(self) -> str:
        mode = self.chain.settings.mode
        return "auto" if mode is None else short_name(mode)

    def _may_have(self, mode: str) -> bool:
        """Return whether the joints follow set-points in a mode, or may do so: that a drive chooses is known after `init`."""
        if self.chain.settings.mode is not None:
            return short_name(self.chain.settings.mode) == mode
        plans = [device.plan for device in self.chain.devices]
        return any(plan is None or short_name(plan.mode) == mode for plan in plans)

    def _no_service(self, service: str) -> str:
        mode = {**MODE_SERVICES, **OTHER_MODES}.get(service)
        if mode is None:
            return f"chain {self.name} has no service {service!r}; it has {', '.join(self.services)}"
        if service in OTHER_MODES:
            return f"chain {self.name} has no {service}: a chain leads its joints by positions. Try: {self.name}/command_vel"
        return f'chain {self.name} has no {service}: its mode is {self._mode_word()}. Try: mode = "{mode}" in the machine file'

    def _refused(self, what: str, seen: str, step: str) -> ChainError:
        return not_now(self.name, what, seen, step.format(chain=self.name))

    def _check_open(self) -> None:
        if self.failure is not None:
            raise self.failure
        self.chain.check_open()

    def _require_movable(self, what: str) -> None:
        """Raise unless the chain may begin a motion: see this module's text."""
        self._check_open()
        if self.chain.state in (ChainState.HALTED, ChainState.STOPPING):
            raise self._refused(what, "it was halted, and the halt is in force", "{chain}/recover")
        if self.chain.state is ChainState.OFF:
            raise self._refused(what, "it is off", "{chain}/init")
        if self.chain.state is ChainState.FAULT:
            raise self.chain.stop_reason()

    def _scales(self) -> list[float]:
        """Return the radians, or metres, in one unit of each joint. Raises ChainError for a joint without a unit."""
        return [si_per_unit(device) for device in self.chain.devices]

    # ---- velocities ----

    def command_velocities(self, values: Sequence[float]) -> None:
        """Move at these velocities (rad/s or m/s, one for each joint), until the next ones, or until the watchdog.

        Never raises or waits: a refusal is reported (`Bridge.reports`). Zeros begin no motion.
        """
        what = "take velocities"
        self._take_over.hear(MotionSource.VELOCITIES)
        try:
            self._require_movable(what)
            velocities = self._in_units("velocity", values)
            self._check_speeds(velocities, values)
        except COMMAND_ERRORS as error:
            self._tell(error)
            return
        if self._is_refused(MotionSource.VELOCITIES, self._take_over.of_velocities(velocities)):
            return
        if self._jogging is not None and not self._jogging.is_over:
            self._jogging.give(velocities)
        elif any(velocities):
            self._take_over.begins(MotionSource.VELOCITIES)
            self._jogging = Jogging(self.chain, self._tell, partial(self._require_movable, what), velocities, self.watchdog)
            self._nursery.start_soon(self._jogging.run)

    def command_positions(self, names: Sequence[str], positions: Sequence[float], velocities: Sequence[float] = ()) -> None:
        """Go to these positions (rad or m, by the names of the joints), as fast as the limits allow, and hold them.

        names: in any order; joints that are not named stay at their last ones. velocities: with which the
        controller goes through them; without, the joints lag behind it by their way of braking. Never raises or waits: a
        refusal is reported. Unknown names, arrays that are too short, and values that are no finite numbers are refused, as a
        whole.
        """
        what = "take positions"
        self._take_over.hear(MotionSource.POSITIONS)
        try:
            self._require_movable(what)
            if self._goals:
                raise self._refused(what, "it follows a trajectory", "one source of commands at a time")
            if self._jogging is not None and not self._jogging.is_over:
                raise self._refused(what, "velocities move it", "one source of commands at a time")
            targets = self._targets(names, positions)
            speeds = self._targets(names, velocities) if velocities else {}
            limits = self.chain.path_limits
            aims = {place: target + braking_way(speeds.get(place, 0.0), limits[place]) for place, target in targets.items()}
            refusal = self._take_over.of_positions(aims, self._scales())
        except COMMAND_ERRORS as error:
            self._tell(error)
            return
        if self._is_refused(MotionSource.POSITIONS, refusal):
            return
        if self._streaming is not None and not self._streaming.is_over:
            self._streaming.give(targets, speeds)
        else:
            self._take_over.begins(MotionSource.POSITIONS)
            self._streaming = Streaming(self.chain, self._tell, partial(self._require_movable, what), targets, speeds)
            self._nursery.start_soon(self._streaming.run)

    def _check_speeds(self, velocities: Sequence[float], values: Sequence[float]) -> None:
        """Raise SetPointRefusedError for a velocity beyond the limit of its joint. values: the same in rad/s or m/s."""
        for name, velocity, value, limits in zip(self.joints, velocities, values, self.chain.path_limits, strict=True):
            if limits.speed is not None and abs(velocity) > limits.speed * (1 + ROUNDED):
                limit = abs(value) * limits.speed / abs(velocity)
                raise SetPointRefusedError(f"the velocity of {name} is beyond its limit of {limit:.6g}", name, f"{value:.6g}")

    def _is_refused(self, source: MotionSource, error: ChainError | None) -> bool:
        """Return whether a source is not taken over; tell so, once."""
        if error is not None and self._take_over.is_news(source):
            self._report(self.name, text_of(error, self.name), True)
        return error is not None

    def _tell(self, error: Exception) -> None:
        self._report(self.name, text_of(error, self.name), False)

    def _in_units(self, kind: str, values: Sequence[float]) -> list[float]:
        """Return values in the joints' own units. Raises SetPointRefusedError for a wrong count, and for what is no finite
        number."""
        if len(values) != len(self.joints):
            failed = f"{len(values)} values of {kind} were given, not {len(self.joints)}"
            raise SetPointRefusedError(failed, "", f"the joints are {', '.join(self.joints)}")
        for name, value in zip(self.joints, values, strict=True):
            if not math.isfinite(value):
                raise SetPointRefusedError(f"the {kind} of {name} is no finite number", name, f"{value!r}")
        return [value / scale for value, scale in zip(values, self._scales(), strict=True)]

    def _targets(self, names: Sequence[str], values: Sequence[float]) -> dict[int, float]:
        """Return values in the joints' own units, by the places of the joints."""
        if len(names) != len(values):
            raise SetPointRefusedError(
                f"{len(values)} values were given for {len(names)} joints", "", f"the joints are {list(names)}"
            )
        scales = self._scales()
        targets: dict[int, float] = {}
        for name, value in zip(names, values, strict=True):
            if name not in self.joints:
                raise SetPointRefusedError(f"there is no joint {name!r}", name, f"the joints are {', '.join(self.joints)}")
            place = self.joints.index(name)
            if place in targets:
                raise SetPointRefusedError(f"joint {name!r} is named twice", name, f"{list(names)}")
            if not math.isfinite(value):
                raise SetPointRefusedError(f"the value of {name} is no finite number", name, f"{value!r}")
            targets[place] = value / scales[place]
        return targets

    # ---- trajectories ----

    async def follow(
        self, goal: TrajectoryGoal, feedback: Tell | None = None, accepted: Callable[[], object] | None = None
    ) -> GoalResult:
        """Follow a trajectory to its end; see goals.py for its times, joints and tolerances. Never raises for a refusal.

        feedback: called in each cycle; it must not block. accepted: called once, when the goal has been checked and the motion
        begins; without this call nothing has moved. A goal takes over from the present motion, without a stop; the goal before
        ends PREEMPTED. A goal that is refused changes nothing. If the task is cancelled, or by `cancel`, the joints brake along
        the path; `cancel` lets this return PREEMPTED. A trajectory without points stops the present motion.
        """
        return await self._follow(goal, MotionSource.ACTION, feedback, accepted)

    async def command_trajectory(self, goal: TrajectoryGoal) -> None:
        """Do as `follow` for a trajectory of the topic: a source that has to be taken over. One that fails is reported."""
        self._take_over.hear(MotionSource.TRAJECTORIES)
        if self._is_refused(MotionSource.TRAJECTORIES, self._not_taken(goal)):
            return
        result = await self._follow(goal, MotionSource.TRAJECTORIES)
        if result.outcome is not GoalOutcome.SUCCEEDED:
            self._report(self.name, f"the trajectory was {result.outcome.value}: {result.text}", False)

    def _not_taken(self, goal: TrajectoryGoal) -> ChainError | None:
        """Return why a trajectory of the topic is not taken over; None also for one that `follow` refuses."""
        try:
            self._require_movable("follow a trajectory")
            points, scales = checked(goal, self.joints, self._wall()), self._scales()
        except (GoalRefusedError, *COMMAND_ERRORS):
            return None
        if not points:
            return None
        aims = {place: value / scales[place] for place, value in enumerate(points[0].positions) if value is not None}
        age = (self._wall() - goal.start) / SECOND if goal.start else 0.0
        return self._take_over.of_trajectory(aims, scales, age)

    async def _follow(
        self,
        goal: TrajectoryGoal,
        source: MotionSource,
        feedback: Tell | None = None,
        accepted: Callable[[], object] | None = None,
    ) -> GoalResult:
        what = "follow a trajectory"
        try:
            self._require_movable(what)
            points = checked(goal, self.joints, self._wall())
            motion = GoalMotion(
                self.chain, goal, self._scales(), self.goal_time, self.start_tolerance, partial(self._require_movable, what)
            )
        except GoalRefusedError as refused:
            return GoalResult(refused.code, str(refused), GoalOutcome.REJECTED)
        except COMMAND_ERRORS as error:
            return GoalResult(GoalCode.INVALID_GOAL, text_of(error, self.name), GoalOutcome.REJECTED)
        if not points:
            if accepted is not None:
                accepted()
            stands = await self.stop("an empty trajectory")
            try:
                self._require_movable(what)  # a joint may have failed as they braked
            except COMMAND_ERRORS as error:
                return GoalResult(GoalCode.PATH_TOLERANCE_VIOLATED, text_of(error, self.name), GoalOutcome.ABORTED)
            if not stands:
                text = "another motion took over as the joints braked"
                return GoalResult(GoalCode.INVALID_GOAL, text, GoalOutcome.PREEMPTED)
            return GoalResult(GoalCode.SUCCESSFUL, "the joints stand", GoalOutcome.SUCCEEDED)

        def begins() -> None:
            self._take_over.begins(source)
            for other in self._goals[: self._goals.index(motion)]:  # a later one takes over from this one by itself
                if not other.has_begun:
                    other.cancel("another trajectory came")
            if accepted is not None:
                accepted()

        delay = max(0.0, (goal.start - self._wall()) / 1e9) if goal.start else 0.0
        self._goals.append(motion)
        try:
            return await motion.run(points, delay, feedback, begins)
        finally:
            self._goals.remove(motion)

    def cancel(self, goal: TrajectoryGoal) -> None:
        """Let the joints brake along the path of this goal, if it runs; its `follow` then returns PREEMPTED."""
        for motion in self._goals:
            if motion.goal is goal:
                motion.cancel("it was cancelled")

    async def stop(self, why: str) -> bool:
        """Let the present motion brake, along its path if it has one, and wait until the joints stand. They stay enabled. why:
        the command that stops it, for texts.

        Each source that streams has to be taken over again: else its next message would undo the stop. Return False if a goal, or
        a source that was taken over meanwhile, moves the joints on.
        """
        self._take_over.interrupt()
        goals, motion = tuple(self._goals), self.chain.motion
        for goal in goals:
            goal.cancel(f"{why} came")
        for other in (self._jogging, self._streaming):
            if other is not None:
                other.cancel()
        while motion is not None and not motion.is_over:
            await motion.news.park()
        for goal in goals:
            await goal.over.wait()
        return self.chain.motion is None


class States:
    """The iterator that `ChainBridge.states` returns."""

    def __init__(self, bridge: ChainBridge) -> None:
        self._bridge = bridge
        self._last = ""

    def __aiter__(self) -> States:
        return self

    async def __anext__(self) -> str:
        await trio.lowlevel.checkpoint()
        while self._bridge.state == self._last:
            await self._bridge.chain.changed.park()
        self._last = self._bridge.state
        return self._last
