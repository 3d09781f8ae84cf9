"""`Chain`: several joints that move as one. Made by `Master.load_chains` or `Master.chain`.

    await arm.initialise()
    await arm.home()
    await arm.enable_interpolated_position()
    async for cycle in arm.cycles():
        arm.set_positions([...])
    await arm.move([...])                       # and along paths: moving.py

**One command at a time**: initialise, home, enable_interpolated_position, recover and shut_down run one procedure per joint, side
by side. If one fails, the others are cancelled, which halts what they moved, and the error names the joint.

**Cycle.** SYNC is sent, and right behind it one PDO per joint with the set-points of that moment. So a set-point given in cycle n
is sent behind SYNC n+1, acts at SYNC n+2, and is reached at the SYNC after that. If none was given in a cycle, the last one is
repeated, and the cycle counts as missed; after `max_missed_cycles` in a row the chain is halted. It stays halted until
`enable_interpolated_position` or `recover`. A path that is read at `cycle.time` does not jump: the time advances only with SYNCs
that took set-points along, so a late loop makes the path slower (see cycles.py).

**Nothing jumps.** Every motion begins with joints that stand: initialise, home, enable_interpolated_position and recover halt a
chain that follows set-points, and wait for a halt under way. Then the procedure itself halts each joint once more and sees that
it stands (canopen_proto.drives.axis.halt); a joint that does not stand is an error.

**A joint that follows set-points has no other motion command** (`drive.AxisBusyError`). A stop of one joint (`drive.halt` ...)
takes over and halts the chain.

**Supervision** (supervision.py), from the end of `initialise` to `shut_down`: a joint that fails, or does not follow its
set-points, stops its whole chain: the running command is cancelled, all joints are halted, and until `recover` every further
command raises ChainFaultError, which says what the joint did.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import Final, NamedTuple, TypeVar, cast

import trio
from trio.lowlevel import enable_ki_protection

from canopen_master.errors import CHAIN_NOT_READY, ChainError, SetPointRefusedError
from canopen_master.motion.bus_room import make_room
from canopen_master.motion.chain_errors import (
    chain_halted,
    joint_failed,
    joint_fault,
    not_now,
    other_cycle,
    raise_first,
    reference_lost,
)
from canopen_master.motion.chain_settings import ChainSettings as ChainSettings
from canopen_master.motion.chain_view import ChainState as ChainState
from canopen_master.motion.chain_view import ChainView
from canopen_master.motion.cycles import Cycles, SetPointSource
from canopen_master.motion.device import Device
from canopen_master.motion.gap_guard import GapGuard
from canopen_master.motion.joint_procedures import (
    JointError,
    failure_of,
    find,
    follow,
    meet,
    mode_of,
    of_joint,
    power_down,
    prepare,
    reset_and_enable,
    stop,
)
from canopen_master.motion.moving import Moving
from canopen_master.motion.path_motion import Motion
from canopen_master.motion.recording import Recorder, recording
from canopen_master.motion.supervision import Supervision
from canopen_master.participant.dispatch import ProcedureTakenBackError
from canopen_master.participant.participant import Participant, ProcedureSlot
from canopen_proto.drives.axis import home, home_if_needed
from canopen_proto.drives.axis.reasons import Reason
from canopen_proto.drives.cia402.modes import Mode, short_name
from canopen_proto.drives.cia402.states import POWERED
from canopen_proto.machine import SECOND, Time
from canopen_proto.procedures.steps import Procedure, all_of
from canopen_proto.sync import SyncSent

T = TypeVar("T")

_CAN_MOVE: Final = (ChainState.READY, ChainState.FOLLOWING, ChainState.HALTED)
"""The states from which a chain can home, or follow set-points."""


class _Operation(NamedTuple):
    """The command that a chain executes. name: for messages."""

    name: str
    procedure: ProcedureSlot


class Chain(ChainView, Moving):
    """See this module's text; `ChainView` says what is known of it, `Moving` how it moves along paths."""

    def __init__(
        self,
        participant: Participant,
        name: str,
        devices: Sequence[Device],
        settings: ChainSettings,
        heartbeat_timeout: Time = 0,
        chains: Collection[Chain] = (),
    ) -> None:
        """heartbeat_timeout: ns, as given to `open_master`. chains: all chains of the one SYNC; this one may be among them."""
        ChainView.__init__(self, name, devices, settings)
        Moving.__init__(self, (self,))
        self._participant = participant
        self._heartbeat_timeout = heartbeat_timeout
        self._chains = chains
        self.begun = trio.lowlevel.ParkingLot()  # woken when a motion begins
        self._supervision = Supervision(participant, self.devices, self._joint_failed)
        self._followed = False  # set-points, before it was stopped
        self._running: _Operation | None = None
        self._stopping = ProcedureSlot(participant)  # the procedure that halts the joints
        self._culprit: tuple[Device, str, Reason | None] | None = None  # the joint that stopped it, why, and the likely cause
        self._why_halted = ""
        self._stops = 0  # how often `halt` or `shut_down` was called: each of them ends every command before it
        self._shut_downs = 0  # that run: no other command begins beside them
        buses = tuple(dict.fromkeys(participant.bus(device.node.bus) for device in devices))
        self._nodes = tuple(dict.fromkeys(device.node for device in devices))
        participant.watch((SyncSent,), self._on_sync, buses[0])
        participant.guard_sync(GapGuard(self._set_points, self._stop_now))

    # ---- what it does ----

    async def initialise(self) -> None:
        """Make the joints ready to move: PDOs, NMT start, SYNC, fault reset, Operation enabled. Joints that move are halted.

        Raises ChainFaultError if a fault stays, ChainError for a joint that does not answer, does not stand, or refuses, and
        before it sets anything up if the PDOs do not fit on the bus (bus_room.py).
        """
        participant, settings = self._participant, self.settings
        self._require_idle("initialise")
        await self._joints_halted("initialise")
        self._require_idle("initialise")
        if (others := self._others()) and participant.sync_period != round(settings.cycle_time * SECOND):
            raise other_cycle(self.name, settings.cycle_time, participant.sync_period, [chain.name for chain in others])
        self._supervision.is_on = False
        self._end_following(ChainState.OFF)
        self._culprit, self._why_halted = None, ""
        stops = self._stops
        await self._for_all("initialise", lambda device: meet(device, settings))
        make_room(self, self._others(), participant.bus)
        await self._for_all("initialise", lambda device: prepare(device, settings, self._heartbeat_timeout))
        for node in self._nodes:
            await participant.nmt_start(node.node_id, bus=node.bus)
        self._check_not_stopped(stops, "initialise")
        if participant.sync_period != round(settings.cycle_time * SECOND):
            participant.sync_start(settings.cycle_time)
        await self._for_all("initialise", reset_and_enable)
        self.state, self._supervision.is_on = ChainState.READY, True

    async def locate(self, device: Device) -> None:
        """Ask one of its joints where it is, which unit it has and of which make it is, by SDO. It needs no power, and gets none.

        `device.position` has it. A joint that does not answer, or refuses, keeps what was heard last.
        """
        await self._participant.run(failure_of(device, find(device)))

    async def home(self, *, if_needed: bool = False) -> None:
        """Home all joints, side by side, from where they stand. If one fails, or the task is cancelled, all are halted.

        if_needed: joints that have their reference stay where they are, see `drive.home_if_needed`.
        """
        await self._require_standing("home")
        self._end_following(ChainState.READY)
        try:
            await self._for_all("home", lambda device: home_if_needed(device.axis) if if_needed else home(device.axis))
        finally:
            self.interruptions += 1  # the joints stand elsewhere, and count from another zero

    async def enable_interpolated_position(self) -> None:
        """Do as `follow`, for a chain whose mode is ip: the manual's name. Raises ChainError for a chain with another mode."""
        self._require("enable interpolated position", *_CAN_MOVE)
        if self.settings.mode is not Mode.INTERPOLATED_POSITION:
            modes = ", ".join(f"{device.name} in {short_name(mode_of(device, self.settings))}" for device in self.devices)
            failed, seen = f"chain {self.name} cannot enable interpolated position", f"its joints follow set-points: {modes}"
            raise ChainError(CHAIN_NOT_READY, self.name, failed, seen=seen, tries=("await chain.follow()",))
        await self.follow_set_points("enable interpolated position")

    async def follow_set_points(self, what: str) -> None:
        """See `Moving.follow`. what: for error texts."""
        await self._require_standing(what)
        self._end_following(ChainState.READY)
        self._require_reference(what)
        cycle_time = round(self.settings.cycle_time * SECOND)
        if not self.has_sync:  # somebody has stopped it
            self._participant.sync_start(self.settings.cycle_time)
        try:
            name = f"chain {self.name}"
            followed = await self._for_all(what, lambda device: follow(device, name, cycle_time, mode_of(device, self.settings)))
            if self.state is not ChainState.READY:  # a joint failed just now
                raise self.stop_reason()
        except BaseException:
            self._release_joints()
            raise
        self._set_points.begin([each.speed for each in followed])
        self.state, self._followed = ChainState.FOLLOWING, True
        self._supervision.begin_following(followed, self.settings.max_silent_cycles, cycle_time)  # which may stop it at once

    async def halt(self) -> None:
        """Stop all joints and wait until they stand. A running command ends with ChainHaltedError.

        A chain that moves along a path brakes along it first, for LONGEST_STOP at most, and chains that move with it do so, too.
        The joints stay enabled. Raises ChainError, which names a joint that did not confirm that it stands.
        """
        self.begin_halt()
        await self.halted()

    def begin_halt(self) -> None:
        """Tell all joints to stop; `halted` waits until they stand."""
        self._participant.check_open()
        self._stops += 1
        if not self._stopping.is_running:
            self._stop("by halt()")

    async def halted(self) -> None:
        """Wait until the joints stand. Raises as `halt`."""
        raise_first(self.name, "halt", await self._joints_stopped())

    async def recover(self) -> None:
        """Reset and enable all joints after a fault or a halt. A chain that followed set-points follows them again.

        Raises ChainError, with the chain READY, for a joint that was homed and has lost its reference since (by a reset, or
        without power): its positions would mean something else, so it must be homed first. AxisSettings(keeps_reference=True) is
        for drives with an absolute encoder. A chain that was never homed has no reference to lose.
        """
        followed = self._followed
        await self.initialise()
        if followed:
            await self.follow()

    async def shut_down(self) -> None:
        """Halt, engage the brakes, take the power away, and stop the nodes (NMT stop). SYNC ends with the last chain.

        A node on which another drive of this master has power, as another axis, is not stopped. Every joint is tried.
        Raises ChainError, which names a joint that was not shut down.
        """
        self._participant.check_open()
        self._stops += 1
        self._shut_downs += 1
        try:
            await self._shut_down()
        finally:
            self._shut_downs -= 1

    async def _shut_down(self) -> None:
        self._supervision.is_on = self._followed = False
        if self._running is not None or self.motion is not None:
            self._stop("by shut_down()")
        await self._joints_stopped()
        self._end_following(ChainState.OFF)
        failures = await self._for_all("shut down", lambda device: failure_of(device, power_down(device)))
        mine = [device.axis for device in self.devices]
        for node in self._nodes:
            others = [axis for axis in node.axes.values() if axis not in mine]
            if not any(axis.state in POWERED or node.was_axis_enabled(axis.number) for axis in others):
                await self._participant.nmt_stop(node.node_id, bus=node.bus)
        if all(chain.state is ChainState.OFF and chain._running is None for chain in self._chains):  # none begins, either
            self._participant.sync_stop()
        raise_first(self.name, "shut down", failures)

    def cycles(self) -> Cycles:
        """The SYNC cycles from now on, as an async iterator. Read the path at `Cycle.time`. A late loop gets the newest cycle.

        Raises ChainFaultError if a joint fails, ChainHaltedError if the chain is halted; both once the other joints stand.
        """
        self._require("give cycles", ChainState.FOLLOWING)
        return Cycles(self._set_points, self.why_stopped)

    @enable_ki_protection
    def set_positions(self, positions: Sequence[float], *, cycles: int = 1) -> None:
        """Give the next set-points, one per joint, in the user's unit; they are sent behind the next SYNC.

        cycles: how many cycles the way takes, on a straight line from the last set-points; none of them counts as missed. Raises
        SetPointRefusedError, with nothing changed, for a wrong count, a number that is not finite or does not fit, a position or
        a speed beyond the `limits` of the joint, a joint without a scale, or a step beyond `max_step` per cycle. Raises
        ChainFaultError, ChainHaltedError or ChainError if the chain follows no set-points.
        """
        self.require_free("follow set-points")
        self._set_points.give(positions, cycles)

    @enable_ki_protection
    def hold(self) -> None:
        """Stay at the set-points that were sent last. Set-points not sent yet are dropped, also the rest of a path.

        The cycle does not count as missed. `Cycle.time` stands still.
        """
        self.require_free("follow set-points")
        self._set_points.hold()

    def record(self, path: str | Path) -> AbstractAsyncContextManager[Recorder]:
        """Record what the chain does while an `async with` block runs: a row for each SYNC, see record_format.py.

        path: of the file, Parquet if it ends in ".parquet", else CSV; an older one is overwritten. Rows begin once the chain is
        initialised. Raises OSError; PackageMissingError without pyarrow for Parquet; at the end RecordError if rows are missing.
        A block that ends by an error or is cancelled waits for nothing: `Recorder.wait` does.
        """
        return recording(lambda: self.recorder(path))

    def recorder(self, path: str | Path) -> Recorder:
        """Begin to record, until `Recorder.close`; `Recorder.wait` then waits for the file. Else as `record`. path: of the file;
        .csv or .parquet."""
        followed = self._participant, self.name, self.devices, self._set_points
        return Recorder(*followed, lambda: self.state is not ChainState.OFF, lambda: self.motion, path)

    # ---- along a path: see path_motion.py and moving.py ----

    def check_open(self) -> None:
        """Raise BusError if a bus has failed, MasterClosedError if the master has been left."""
        self._participant.check_open()

    def require_following(self, what: str) -> None:
        """Raise unless it follows set-points, whether a loop or a motion gives them. what: what was to be done, for the error
        text."""
        self._require(what, ChainState.FOLLOWING)

    def require_free(self, what: str) -> None:
        """Raise unless it follows set-points that no motion gives. what: what was to be done, for the error text."""
        self.require_following(what)
        if self.motion is not None:
            seen = "it moves along a path, or by a stream of targets"
            raise not_now(self.name, what, seen, "wait for its end, or cancel it")

    def begin_source(self, source: SetPointSource, motion: Motion) -> None:
        """Take the set-points of a motion from now on."""
        self.motion = motion
        self._set_points.begin_source(source)
        self.begun.unpark_all()

    def source_over(self, source: SetPointSource, problem: str) -> None:
        """See `Follower`."""
        if self._set_points.source is not source:
            return
        self.motion = None
        self._set_points.end_source()
        if self.state is ChainState.STOPPING:
            self._stop_now(self._why_halted)
        elif problem:
            self._stop_now(problem)

    def stopping(self, why: str) -> None:
        """See `Follower`."""
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

    # ---- procedures ----

    async def _for_all(self, operation: str, make: Callable[[Device], Procedure[T]]) -> list[T]:
        """Run one procedure for each joint, side by side. A failure is raised as this chain's."""
        procedures = [of_joint(device, make(device)) for device in self.devices]
        running = self._running = _Operation(operation, ProcedureSlot(self._participant))
        try:
            running.procedure.begin(all_of(*procedures))
            results = cast("list[T]", await running.procedure.outcome())
            if self._running is not running:  # it was stopped at the moment of its end
                raise ProcedureTakenBackError
            return results
        except JointError as failed:
            raise joint_failed(self.name, operation, failed) from failed.error
        except ProcedureTakenBackError:
            error = await self.why_stopped()
            raise error or chain_halted(self.name, "while it was stopped") from None
        finally:
            if self._running is running:  # else halt() or shut_down() took over
                self._running = None

    # ---- state ----

    def _require_idle(self, what: str) -> None:
        self._participant.check_open()
        if self._running is not None or self._shut_downs:
            seen = f"it is busy: {'shut down' if self._shut_downs or self._running is None else self._running.name}"
            raise not_now(self.name, what, seen, "wait for its end, or halt() it")

    def _require(self, what: str, *states: ChainState) -> None:
        state = self.state
        if state is ChainState.STOPPING:
            state = ChainState.HALTED if self._culprit is None else ChainState.FAULT
        if state is ChainState.FAULT:
            self._participant.check_open()
            raise self.stop_reason()
        if state is ChainState.HALTED and ChainState.HALTED not in states:
            raise self.stop_reason()
        self._require_idle(what)
        if state not in states:
            if state is ChainState.READY:
                self._require_reference(what)
            step = "await chain.initialise()" if state is ChainState.OFF else "await chain.follow()"
            raise not_now(self.name, what, f"it is {state.value}", step)

    def _require_reference(self, what: str) -> None:
        lost = [device for device in self.devices if device.axis.has_lost_reference]
        if lost:
            raise reference_lost(self.name, what, lost)

    async def _require_standing(self, what: str) -> None:
        """Halt the chain and wait until the joints stand. Raises unless the chain can then do `what`."""
        self._require(what, *_CAN_MOVE)
        await self._joints_halted(what)
        self._require(what, *_CAN_MOVE)  # another task may have been quicker

    @property
    def has_sync(self) -> bool:
        """Whether SYNC is sent."""
        return self._participant.sync_period > 0

    def _others(self) -> list[Chain]:
        """Return the other chains that run."""
        return [chain for chain in self._chains if chain is not self and chain.state is not ChainState.OFF]

    def _end_following(self, state: ChainState) -> None:
        if not (state is self.state is ChainState.READY):  # else it is about to follow set-points, from where it stands
            self.interruptions += 1
        self.state = state
        self._set_points.end()
        self._supervision.end_following()
        self._release_joints()

    def _release_joints(self) -> None:
        for device in self.devices:
            device.release()

    # ---- being stopped ----

    def _stop(self, why: str) -> None:
        """Halt all joints, behind a stop along their path if they move along one, and end the running command."""
        if self.motion is None:
            self._stop_now(why)
        elif self.state is ChainState.FOLLOWING:
            self.motion.halt(why)

    def _stop_now(self, why: str) -> None:
        """Halt all joints, each by its own ramp. May be called in the pump's turn; `_joints_stopped` waits for the halt.

        A joint that another stop took over is left to it: a halt would undo the command that leads the joint down.
        """
        self._why_halted = why
        joints = [device for device in self.devices if not device.taken_over_by]
        state = ChainState.FAULT if self._culprit is not None else ChainState.HALTED
        self._end_following(ChainState.OFF if self.state is ChainState.OFF else state)
        running, self._running = self._running, None
        motion, self.motion = self.motion, None
        self._stopping.begin(all_of(*(failure_of(device, stop(device)) for device in joints)))
        if running is not None:
            running.procedure.take_back()
        if motion is not None:  # other chains move with this one
            motion.end(f"because chain {self.name} was stopped {why}")

    async def _joints_stopped(self) -> list[JointError | None]:
        """Wait until the joints that were told to stop stand. Returns the failures of those that did not confirm it."""
        await trio.lowlevel.checkpoint()
        if self.state is ChainState.STOPPING and self.motion is not None:
            await self.motion.braked()
        await self._stopping.ended()
        return self._stopping.result() or []

    async def _joints_halted(self, what: str) -> None:
        """Halt joints that follow set-points, and wait for a halt under way. The next procedure sees whether each stands."""
        stops = self._stops
        if self.state is ChainState.FOLLOWING:
            self._stop(f"to {what}")
        await self._joints_stopped()
        self._check_not_stopped(stops, what)

    def _check_not_stopped(self, stops: int, what: str) -> None:
        """Raise if `halt` or `shut_down` was called since there were so many stops."""
        if self._stops != stops:
            raise chain_halted(self.name, f"before it could {what}")

    async def why_stopped(self) -> ChainError | None:
        """Why the chain follows no set-points, once the joints stand; None while it follows them."""
        if self.state is ChainState.FOLLOWING:
            return None
        await self._joints_stopped()
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
            self._stop(reason)
        else:  # the others cannot wait for it on the path
            self._stop_now(reason)

    def _on_sync(self, sync: SyncSent) -> None:
        if self.state not in (ChainState.FOLLOWING, ChainState.STOPPING):
            return
        for device in self.devices:
            if device.taken_over_by:
                self._stop_now(f"because another command took over {device.where}: {device.taken_over_by}")
                return
        set_points = self._set_points
        try:
            set_points.on_sync(sync.skipped)
        except SetPointRefusedError as error:
            assert self.motion is not None  # a loop gets this error itself
            self.motion.fail(error)
        if set_points.missed_in_row >= self.settings.max_missed_cycles:
            self._stop(f"because {set_points.missed_in_row} cycles in a row brought no set-points")
