"""`Member`: the joints of one chain as they follow set-points, and how they are stopped. `ChainState`: which commands they take.

`Chain` (chain.py) is the front that a user commands. Motions (path_motion.py), SYNC and failures of joints reach its `Member`,
which keeps one thing true: what gives the set-points, the state, and the halt under way fit each other in every turn of the pump.
Several members move as one (moving.py).

`OneCommand`: the command that it executes.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Sequence
from typing import Final, TypeVar, cast

from canopen_master.errors import CHAIN_NOT_READY, ChainError, SetPointRefusedError
from canopen_master.motion.chain_errors import (
    chain_halted,
    joint_failed,
    joint_fault,
    not_now,
    raise_first,
    reference_lost,
)
from canopen_master.motion.chain_settings import ChainSettings
from canopen_master.motion.cycles import SetPoints, SetPointSource
from canopen_master.motion.device import Device
from canopen_master.motion.joint_procedures import JointError, failure_of, follow, mode_of, of_joint, stop
from canopen_master.motion.late_sync import TOO_LATE, GapGuard
from canopen_master.motion.path_motion import Motion
from canopen_master.motion.supervision import Supervision
from canopen_master.participant.dispatch import ProcedureTakenBackError
from canopen_master.participant.participant import Participant, ProcedureSlot
from canopen_proto.drives.axis.reasons import Reason
from canopen_proto.explained import counted
from canopen_proto.procedures.steps import Procedure, all_of
from canopen_proto.sync import SyncSent
from canopen_transports.loop import current_loop

T = TypeVar("T")


class ChainState(enum.Enum):
    """The state of a chain: which commands it can take."""

    OFF = "off"
    """Not initialised, or shut down."""
    READY = "ready"
    """All joints are in Operation enabled."""
    FOLLOWING = "following"
    """Set-points are sent behind each SYNC; a slow joint is given the newest one as its target."""
    STOPPING = "stopping"
    """It brakes along its path; HALTED or FAULT follows."""
    HALTED = "halted"
    """Halted; it follows no set-points."""
    FAULT = "fault"
    """Stopped because a joint failed."""


LEADING: Final = (ChainState.FOLLOWING, ChainState.STOPPING)
"""The states of a chain that sends set-points to its drives."""
CAN_MOVE: Final = (ChainState.READY, ChainState.FOLLOWING, ChainState.HALTED)
"""The states from which a chain can home, or follow set-points."""


class OneCommand:
    """The command that a chain executes: one at a time, until its end or a stop.

    name: for messages; "" if none runs. stops: how often `halt` or `shut_down` was called: each of them ends every command before
    it. shut_downs: how many run: no other command begins beside them.
    """

    def __init__(self, participant: Participant) -> None:
        self._participant = participant
        self._procedure: ProcedureSlot | None = None
        self.name = ""
        self.stops = 0
        self.shut_downs = 0

    @property
    def is_running(self) -> bool:
        """Whether it has begun and was not ended."""
        return self._procedure is not None

    @property
    def busy_with(self) -> str:
        """What runs, in words; "" if a command may begin."""
        return "shut down" if self.shut_downs else self.name

    async def run(self, name: str, procedure: Procedure[T]) -> T:
        """Run the procedure of a command, and return its result. name: of the command, for messages.

        Raises its error; ProcedureTakenBackError if it was ended.
        """
        running = self._procedure = ProcedureSlot(self._participant)
        self.name = name
        try:
            running.begin(procedure)
            result = cast("T", await running.outcome())
            if self._procedure is not running:  # it was stopped at the moment of its end
                raise ProcedureTakenBackError
            return result
        finally:
            if self._procedure is running:  # else a stop took over
                self.end()

    def end(self) -> ProcedureSlot | None:
        """Let another command begin. Return the procedure of this one, which is to be taken back; None if none runs."""
        running, self._procedure, self.name = self._procedure, None, ""
        return running


class Member:
    """See this module's text. name: of the chain. devices: its joints, in the order of the file.

    changed: woken when `state` or `motion` changes. begun: woken when a motion begins. interruptions: how often the chain was
    initialised, homed, halted, shut down or stopped by a fault. followed: whether it followed set-points before it was stopped.
    """

    def __init__(self, participant: Participant, name: str, devices: Sequence[Device], settings: ChainSettings) -> None:
        self.name = name
        self.devices = tuple(devices)
        self.settings = settings
        self.changed = current_loop().parking_lot()
        self.begun = current_loop().parking_lot()
        self.interruptions = 0
        self.followed = False
        self.set_points = SetPoints(self.devices, settings.cycle_time, settings.max_step)
        self.supervision = Supervision(participant, self.devices, self._joint_failed)
        self.command = OneCommand(participant)
        self._participant = participant
        self._state = ChainState.OFF
        self._motion: Motion | None = None
        self._halt = ProcedureSlot(participant)  # of the joints
        self._culprit: tuple[Device, str, Reason | None] | None = None  # the joint that stopped it, why, and the likely cause
        self._why_halted = ""
        participant.watch((SyncSent,), self._on_sync, participant.bus(self.devices[0].node.bus))
        participant.guard_sync(GapGuard(self.set_points, self.stop_now, TOO_LATE))

    # ---- what is known of it ----

    @property
    def state(self) -> ChainState:
        """The state of a chain decides which commands it takes."""
        return self._state

    @state.setter
    def state(self, state: ChainState) -> None:
        if state is not self._state:
            self._state = state
            self.changed.unpark_all()

    @property
    def motion(self) -> Motion | None:
        """That along a path, or by a stream of targets, at present; None: it stands, or a loop gives the set-points."""
        return self._motion

    @motion.setter
    def motion(self, motion: Motion | None) -> None:
        if motion is not self._motion:
            self._motion = motion
            self.changed.unpark_all()

    @property
    def positions(self) -> list[float]:
        """The actual positions, as last heard. Raises ChainError for a joint that was not heard since its last boot."""
        return self._known("position", [device.position for device in self.devices])

    @property
    def velocities(self) -> list[float]:
        """The actual velocities, per second. Raises ChainError for a joint of which none is known yet."""
        return self._known("velocity", [device.velocity for device in self.devices])

    @property
    def desired(self) -> list[float]:
        """The set-points that the next SYNC takes along; empty while it follows none."""
        return self.set_points.desired

    @property
    def is_on_path(self) -> bool:
        """See `FollowingChain`."""
        return self.set_points.is_on_path

    @property
    def has_sync(self) -> bool:
        """Whether SYNC is sent."""
        return self._participant.sync_period > 0

    def _known(self, what: str, values: Sequence[float | None]) -> list[float]:
        """The values, one for each joint. Raises ChainError if one is not known."""
        known = []
        for device, value in zip(self.devices, values, strict=True):
            if value is None:
                failed = f"chain {self.name} has no {what} of {device.where}"
                seen = f"{device.name} was not heard since its last boot" if device.position is None else "it was heard once"
                raise ChainError(CHAIN_NOT_READY, self.name, failed, seen=seen, tries=("await chain.initialise()",))
            known.append(value)
        return known

    # ---- what it can do now ----

    def check_open(self) -> None:
        """Raise BusError if a bus has failed, MasterClosedError if the master has been left."""
        self._participant.check_open()

    def require_idle(self, what: str) -> None:
        """Raise if a command runs. what: what was to be done, for the error text."""
        self.check_open()
        if self.command.busy_with:
            raise not_now(self.name, what, f"it is busy: {self.command.busy_with}", "wait for its end, or halt() it")

    def require(self, what: str, *states: ChainState) -> None:
        """Raise unless it is in one of these states, and no command runs. what: what was to be done, for the error text."""
        state = self.state
        if state is ChainState.STOPPING:
            state = ChainState.HALTED if self._culprit is None else ChainState.FAULT
        if state is ChainState.FAULT:
            self.check_open()
            raise self.stop_reason()
        if state is ChainState.HALTED and ChainState.HALTED not in states:
            raise self.stop_reason()
        self.require_idle(what)
        if state not in states:
            if state is ChainState.READY:
                self._require_reference(what)
            step = "await chain.initialise()" if state is ChainState.OFF else "await chain.follow()"
            raise not_now(self.name, what, f"it is {state.value}", step)

    def require_following(self, what: str) -> None:
        """Raise unless it follows set-points, whether a loop or a motion gives them. what: as of `require`."""
        self.require(what, ChainState.FOLLOWING)

    def require_free(self, what: str) -> None:
        """Raise unless it follows set-points that no motion gives. what: as of `require`."""
        self.require_following(what)
        if self.motion is not None:
            seen = "it moves along a path, or by a stream of targets"
            raise not_now(self.name, what, seen, "wait for its end, or cancel it")

    def _require_reference(self, what: str) -> None:
        lost = [device for device in self.devices if device.axis.has_lost_reference]
        if lost:
            raise reference_lost(self.name, what, lost)

    async def require_standing(self, what: str) -> None:
        """Halt the chain and wait until the joints stand. Raises unless the chain can then do `what`."""
        self.require(what, *CAN_MOVE)
        await self.joints_halted(what)
        self.require(what, *CAN_MOVE)  # another task may have been quicker

    def require_not_stopped(self, stops: int, what: str) -> None:
        """Raise if `halt` or `shut_down` was called since there were so many `stops`. what: as of `require`."""
        if self.command.stops != stops:
            raise chain_halted(self.name, f"before it could {what}")

    # ---- commands to all joints ----

    async def for_all(self, operation: str, make: Callable[[Device], Procedure[T]]) -> list[T]:
        """Run one procedure for each joint, side by side. operation: its name, for messages.

        A failure is raised as this chain's.
        """
        try:
            return await self.command.run(operation, all_of(*(of_joint(device, make(device)) for device in self.devices)))
        except JointError as failed:
            raise joint_failed(self.name, operation, failed) from failed.error
        except ProcedureTakenBackError:
            error = await self.why_stopped()
            raise error or chain_halted(self.name, "while it was stopped") from None

    async def follow_set_points(self, what: str) -> None:
        """Let all joints follow set-points from where they stand. what: as of `require`. Raises as `Moving.follow`."""
        await self.require_standing(what)
        self.end_following(ChainState.READY)
        self._require_reference(what)
        name, period, settings = f"chain {self.name}", self.set_points.period, self.settings
        if not self.has_sync:  # somebody has stopped it
            self._participant.sync_start(settings.cycle_time)
        try:
            followed = await self.for_all(what, lambda device: follow(device, name, period, mode_of(device, settings)))
            if self.state is not ChainState.READY:  # a joint failed just now
                raise self.stop_reason()
        except BaseException:
            self._release_joints()
            raise
        self.set_points.begin([each.speed for each in followed])
        self.state, self.followed = ChainState.FOLLOWING, True
        self.supervision.begin_following(followed, settings.max_silent_cycles, period)  # which may stop it at once

    def end_following(self, state: ChainState) -> None:
        """Follow no set-points from now on. state: the next one."""
        if not (state is self.state is ChainState.READY):  # else it is about to follow set-points, from where it stands
            self.interruptions += 1
        self.state = state
        self.set_points.end()
        self.supervision.end_following()
        self._release_joints()

    def forget_stop(self) -> None:
        """Begin anew: no joint has failed, and nobody has stopped it."""
        self.supervision.is_on = False
        self.end_following(ChainState.OFF)
        self._culprit, self._why_halted = None, ""

    def _release_joints(self) -> None:
        for device in self.devices:
            device.release()

    # ---- along a path: see path_motion.py ----

    def begin_source(self, source: SetPointSource, motion: Motion) -> None:
        """See `FollowingChain`."""
        self.motion = motion
        self.set_points.begin_source(source)
        self.begun.unpark_all()

    def source_over(self, source: SetPointSource, problem: str) -> None:
        """See `FollowingChain`."""
        if self.set_points.source is not source:
            return
        self.motion = None
        self.set_points.end_source()
        if self.state is ChainState.STOPPING:
            self.stop_now(self._why_halted)
        elif problem:
            self.stop_now(problem)

    def stopping(self, why: str) -> None:
        """See `FollowingChain`."""
        if self.state is ChainState.FOLLOWING:
            self.state, self._why_halted = ChainState.STOPPING, why

    def brake_along_path(self) -> bool:
        """Brake along the path, if it moves along one; return whether it does."""
        if self.motion is not None:
            self.motion.brake()
        return self.motion is not None

    def abandon(self) -> None:
        """End a motion without a halt: the master ends, and halts all drives."""
        motion, self.motion = self.motion, None
        if motion is not None:
            motion.abandon()
        self.begun.unpark_all()

    # ---- being stopped ----

    def begin_halt(self) -> None:
        """Tell all joints to stop; `halted` waits until they stand."""
        self.check_open()
        self.command.stops += 1
        if not self._halt.is_running:
            self.stop("by halt()")

    async def halted(self) -> None:
        """Wait until the joints stand. Raises ChainError for a joint that did not confirm it."""
        raise_first(self.name, "halt", await self.joints_stopped())

    def stop(self, why: str) -> None:
        """Halt all joints, behind a stop along their path if they move along one, and end the running command.

        why: for error texts, such as "by halt()".
        """
        if self.motion is None:
            self.stop_now(why)
        elif self.state is ChainState.FOLLOWING:
            self.motion.halt(why)

    def stop_now(self, why: str) -> None:
        """Halt all joints, each by its own ramp. May be called in the pump's turn; `joints_stopped` waits for the halt.

        A joint that another stop took over is left to it: a halt would undo the command that leads the joint down. why: as of
        `stop`.
        """
        self._why_halted = why
        joints = [device for device in self.devices if not device.taken_over_by]
        state = ChainState.FAULT if self._culprit is not None else ChainState.HALTED
        self.end_following(ChainState.OFF if self.state is ChainState.OFF else state)
        running = self.command.end()
        motion, self.motion = self.motion, None
        self._halt.begin(all_of(*(failure_of(device, stop(device)) for device in joints)))
        if running is not None:
            running.take_back()
        if motion is not None:  # other chains move with this one
            motion.end(f"because chain {self.name} was stopped {why}")

    async def joints_stopped(self) -> list[JointError | None]:
        """Wait until the joints that were told to stop stand. Returns the failures of those that did not confirm it."""
        await current_loop().checkpoint()
        if self.state is ChainState.STOPPING and self.motion is not None:
            await self.motion.braked()
        await self._halt.ended()
        return self._halt.result() or []

    async def joints_halted(self, what: str) -> None:
        """Halt joints that follow set-points, and wait for a halt under way. The next procedure sees whether each stands.

        what: as of `require`.
        """
        stops = self.command.stops
        if self.state is ChainState.FOLLOWING:
            self.stop(f"to {what}")
        await self.joints_stopped()
        self.require_not_stopped(stops, what)

    async def why_stopped(self) -> ChainError | None:
        """Why the chain follows no set-points, once the joints stand; None while it follows them."""
        if self.state is ChainState.FOLLOWING:
            return None
        await self.joints_stopped()
        return self.stop_reason()

    def stop_reason(self) -> ChainError:
        """Return why the chain was stopped."""
        if self._culprit is not None:
            return joint_fault(self.name, *self._culprit)
        return chain_halted(self.name, self._why_halted or "by another command")

    # ---- in the pump's turn ----

    def _joint_failed(self, device: Device, reason: str, cause: Reason | None, follows: bool) -> None:
        if self._participant.is_closed and not follows:
            self.abandon()  # the master ends, and halts all drives
        if self.state is ChainState.FAULT or self._participant.is_closed:
            return
        if self._culprit is None:
            self._culprit = device, reason, cause
        if follows:
            self.stop(reason)
        else:  # the others cannot wait for it on the path
            self.stop_now(reason)

    def _on_sync(self, sync: SyncSent) -> None:
        if self.state not in LEADING:
            return
        for device in self.devices:
            if device.taken_over_by:
                self.stop_now(f"because another command took over {device.where}: {device.taken_over_by}")
                return
        set_points = self.set_points
        try:
            set_points.on_sync(sync.skipped)
        except SetPointRefusedError as error:
            assert self.motion is not None  # a loop gets this error itself
            self.motion.fail(error)
        if set_points.missed_in_row >= self.settings.max_missed_cycles:
            self.stop(f"because {counted(set_points.missed_in_row, 'cycle')} in a row brought no set-points")
