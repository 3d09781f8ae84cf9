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

**Of what it is made.** A `Chain` is the front: its commands, and what is known of it. Its `Member` (member.py) is stopped, and
follows set-points (`SetPoints`, cycles.py); `Supervision` tells it which joint has failed; `Moving` moves it along paths.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from pathlib import Path

from canopen_master.errors import CHAIN_NOT_READY, ChainError
from canopen_master.motion.bus_room import make_room
from canopen_master.motion.chain_errors import other_cycle, raise_first
from canopen_master.motion.chain_settings import ChainSettings as ChainSettings
from canopen_master.motion.cycles import Cycles
from canopen_master.motion.device import Device
from canopen_master.motion.joint_procedures import contact, failure_of, locate, mode_of, power_down, prepare, reset_and_enable
from canopen_master.motion.member import CAN_MOVE, Member
from canopen_master.motion.member import ChainState as ChainState
from canopen_master.motion.moving import Moving
from canopen_master.motion.path_motion import Motion
from canopen_master.motion.recording import Recorder, recording
from canopen_master.participant.participant import Participant
from canopen_proto.drives.axis import home, home_if_needed
from canopen_proto.drives.cia402.modes import Mode, short_name
from canopen_proto.drives.cia402.states import POWERED
from canopen_proto.machine import Time
from canopen_transports.loop import protected


class Chain(Moving):
    """See this module's text. name: of the chain. devices: its joints, in the order of the file. settings: as it was made with.

    changed: woken when `state` or `motion` changes. begun: woken when a motion begins.
    """

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
        member = self._member = Member(participant, name, devices, settings)
        super().__init__((member,))
        self.name, self.devices, self.settings = name, member.devices, settings
        self.changed, self.begun = member.changed, member.begun
        self._set_points = member.set_points
        self._participant = participant
        self._heartbeat_timeout = heartbeat_timeout
        self._chains = chains
        self._nodes = tuple(dict.fromkeys(device.node for device in devices))
        self._initialising = 0

    def __repr__(self) -> str:
        return f"<Chain {self.name}: {', '.join(device.name for device in self.devices)}; {self.state.value}>"

    # ---- what is known of it: this may be read at any time, and sends nothing ----

    @property
    def state(self) -> ChainState:
        """The state of a chain decides which commands it takes."""
        return self._member.state

    @property
    def is_busy(self) -> bool:
        """Whether a command is under way: one that may give its joints power, though it is OFF yet; or one that moves them."""
        return self._initialising > 0 or bool(self._member.command.busy_with)

    @property
    def motion(self) -> Motion | None:
        """That along a path, or by a stream of targets, at present; None: it stands, or a loop gives the set-points."""
        return self._member.motion

    @property
    def interruptions(self) -> int:
        """How often it was initialised, homed, halted, shut down or stopped by a fault.

        Once this number has changed, set-points that were thought of before may be far from the joints.
        """
        return self._member.interruptions

    @property
    def joints(self) -> Mapping[str, Device]:
        """The joints by their names."""
        return {device.name: device for device in self.devices}

    @property
    def positions(self) -> list[float]:
        """The actual positions, as last heard. Raises ChainError for a joint that was not heard since its last boot."""
        return self._member.positions

    @property
    def desired_positions(self) -> list[float]:
        """The positions that the next PDOs command."""
        return [device.desired_position for device in self.devices]

    @property
    def velocities(self) -> list[float]:
        """The actual velocities, per second. Raises ChainError for a joint of which none is known yet."""
        return self._member.velocities

    @property
    def is_homed(self) -> bool:
        """Whether all joints are homed."""
        return all(device.is_homed for device in self.devices)

    @property
    def is_on_path(self) -> bool:
        """Whether its joints are sent where they are wanted; behind a gap of SYNC they come back to their path (late_sync.py)."""
        return self._set_points.is_on_path

    @property
    def sync_cycles(self) -> int:
        """SYNCs sent while it followed set-points."""
        return self._set_points.sync_cycles

    @property
    def missed_cycles(self) -> int:
        """How many of these cycles brought no new set-point, though a loop over `cycles` was running."""
        return self._set_points.missed_cycles

    @property
    def skipped_cycles(self) -> int:
        """Periods in which no SYNC was sent while it followed set-points, because this process was late."""
        return self._set_points.skipped_cycles

    @property
    def desired(self) -> list[float]:
        """The set-points that the next SYNC takes along; empty while it follows none."""
        return self._set_points.desired

    @property
    def has_sync(self) -> bool:
        """Whether SYNC is sent."""
        return self._member.has_sync

    def check_open(self) -> None:
        """Raise BusError if a bus has failed, MasterClosedError if the master has been left."""
        self._participant.check_open()

    def stop_reason(self) -> ChainError:
        """Return why the chain was stopped."""
        return self._member.stop_reason()

    # ---- what it does ----

    async def initialise(self) -> None:
        """Make the joints ready to move: PDOs, NMT start, SYNC, fault reset, Operation enabled. Joints that move are halted.

        Raises ChainFaultError if a fault stays, ChainError for a joint that does not answer, does not stand, or refuses, and
        before it sets anything up if the PDOs do not fit on the bus (bus_room.py).
        """
        self._initialising += 1
        try:
            await self._initialise()
        finally:
            self._initialising -= 1

    async def _initialise(self) -> None:
        participant, member, settings = self._participant, self._member, self.settings
        cycle, period = settings.cycle_time, member.set_points.period
        member.require_idle("initialise")
        await member.joints_halted("initialise")
        member.require_idle("initialise")
        if (others := self._others()) and participant.sync_period != period:
            raise other_cycle(self.name, cycle, participant.sync_period, [other.name for other in others])
        for node in self._nodes:
            node.begin_use()
        member.forget_stop()
        stops = member.command.stops
        await member.for_all("initialise", lambda device: contact(device, settings))
        make_room(member, self._others(), participant.bus)
        await member.for_all("initialise", lambda device: prepare(device, settings, self._heartbeat_timeout))
        for node in self._nodes:
            await participant.nmt_start(node.node_id, bus=node.bus)
        member.require_not_stopped(stops, "initialise")
        if participant.sync_period != period:
            participant.sync_start(cycle)
        await member.for_all("initialise", reset_and_enable)
        member.state, member.supervision.is_on = ChainState.READY, True

    def _others(self) -> list[Member]:
        """Return the members of the other chains that run."""
        return [chain._member for chain in self._chains if chain is not self and chain.state is not ChainState.OFF]

    async def locate(self, device: Device) -> None:
        """Ask one of its joints where it is, which unit it has and of which make it is, by SDO. It needs no power, and gets none.

        `device.position` has it. A joint that does not answer, or refuses, keeps what was heard last.
        """
        await self._participant.run(failure_of(device, locate(device)))

    async def home(self, *, if_needed: bool = False) -> None:
        """Home all joints, side by side, from where they stand. If one fails, or the task is cancelled, all are halted.

        if_needed: joints that have their reference stay where they are, see `drive.home_if_needed`.
        """
        await self._member.require_standing("home")
        self._member.end_following(ChainState.READY)
        try:
            await self._member.for_all("home", lambda device: home_if_needed(device.axis) if if_needed else home(device.axis))
        finally:
            self._member.interruptions += 1  # the joints stand elsewhere, and count from another zero

    async def enable_interpolated_position(self) -> None:
        """Do as `follow`, for a chain whose mode is ip: the manual's name. Raises ChainError for a chain with another mode."""
        self._member.require("enable interpolated position", *CAN_MOVE)
        if self.settings.mode is not Mode.INTERPOLATED_POSITION:
            modes = ", ".join(f"{device.name} in {short_name(mode_of(device, self.settings))}" for device in self.devices)
            failed, seen = f"chain {self.name} cannot enable interpolated position", f"its joints follow set-points: {modes}"
            raise ChainError(CHAIN_NOT_READY, self.name, failed, seen=seen, tries=("await chain.follow()",))
        await self._member.follow_set_points("enable interpolated position")

    async def recover(self) -> None:
        """Reset and enable all joints after a fault or a halt. A chain that followed set-points follows them again.

        Raises ChainError, with the chain READY, for a joint that was homed and has lost its reference since (by a reset, or
        without power): its positions would mean something else, so it must be homed first. AxisSettings(keeps_reference=True) is
        for drives with an absolute encoder. A chain that was never homed has no reference to lose.
        """
        followed = self._member.followed
        await self.initialise()
        if followed:
            await self.follow()

    async def shut_down(self) -> None:
        """Halt, engage the brakes, take the power away, and stop the nodes (NMT stop). SYNC ends with the last chain.

        A node on which another drive of this master has power, as another axis, is not stopped. Every joint is tried.
        Raises ChainError, which names a joint that was not shut down.
        """
        self.check_open()
        command = self._member.command
        command.stops += 1
        command.shut_downs += 1
        try:
            await self._shut_down()
        finally:
            command.shut_downs -= 1

    async def _shut_down(self) -> None:
        member = self._member
        member.supervision.is_on = member.followed = False
        if member.command.is_running or member.motion is not None:
            member.stop("by shut_down()")
        await member.joints_stopped()
        member.end_following(ChainState.OFF)
        failures = await member.for_all("shut down", lambda device: failure_of(device, power_down(device)))
        mine = [device.axis for device in self.devices]
        for node in self._nodes:
            others = [axis for axis in node.axes.values() if axis not in mine]
            if not any(axis.state in POWERED or node.was_axis_enabled(axis.number) for axis in others):
                await self._participant.nmt_stop(node.node_id, bus=node.bus)
        if all(chain.state is ChainState.OFF and not chain._member.command.is_running for chain in self._chains):  # none begins
            self._participant.sync_stop()
        raise_first(self.name, "shut down", failures)

    def cycles(self) -> Cycles:
        """The SYNC cycles from now on, as an async iterator. Read the path at `Cycle.time`. A late loop gets the newest cycle.

        Raises ChainFaultError if a joint fails, ChainHaltedError if the chain is halted; both once the other joints stand.
        """
        self._member.require_following("give cycles")
        return Cycles(self._set_points, self._member.why_stopped)

    @protected
    def set_positions(self, positions: Sequence[float], *, cycles: int = 1) -> None:
        """Give the next set-points, one per joint, in the user's unit; they are sent behind the next SYNC.

        cycles: how many cycles the way takes, on a straight line from the last set-points; none of them counts as missed. Raises
        SetPointRefusedError, with nothing changed, for a wrong count, a number that is not finite or does not fit, a position or
        a speed beyond the `limits` of the joint, a joint without a scale, or a step beyond `max_step` per cycle. Raises
        ChainFaultError, ChainHaltedError or ChainError if the chain follows no set-points.
        """
        self._member.require_free("follow set-points")
        self._set_points.give(positions, cycles)

    @protected
    def hold(self) -> None:
        """Stay at the set-points that were sent last. Set-points not sent yet are dropped, also the rest of a path.

        The cycle does not count as missed. `Cycle.time` stands still.
        """
        self._member.require_free("follow set-points")
        self._set_points.hold()

    def record(self, path: str | Path) -> AbstractAsyncContextManager[Recorder]:
        """Record what the chain does while an `async with` block runs: a row for each SYNC, see record_files.py.

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
