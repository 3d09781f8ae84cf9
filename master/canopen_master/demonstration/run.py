"""`Demonstration`: boot, home, swing, move by a plan, shut down.

    demonstration = Demonstration(DemonstrationTask(seconds=2), print)
    await demonstration.run()

Without a bus, each bus name of the chain becomes a virtual bus with simulated drives at the node-IDs of the chain; with a bus,
all names mean that one. The rest is the same code: a simulated drive is a device on a CAN bus like any other.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from typing import Final, TypeAlias

from canopen_master.demonstration.recording import JointTrack, Recording
from canopen_master.demonstration.swing import SwingPath
from canopen_master.demonstration.task import DemonstrationTask
from canopen_master.errors import ChainFileError, DemonstrationRefusedError
from canopen_master.master import SDO_TIMEOUT, Master
from canopen_master.motion.chain import Chain, ChainSettings, ChainState
from canopen_master.motion.chain_file import same_nodes
from canopen_master.motion.device import Device
from canopen_master.motion.halting import Halt
from canopen_master.session import open_master
from canopen_master.simulation.drive_files import joint_maker
from canopen_master.simulation.host import DeviceMaker, patient_cycles
from canopen_master.simulation.serving import SimulatedDevices, simulated_drives
from canopen_proto.drives.axis.limits import Limit
from canopen_proto.drives.axis.units import Unit
from canopen_proto.drives.cia402.modes import Mode, mode_name
from canopen_proto.machine import SECOND, LocalProtocolError
from canopen_proto.pdo.consumer import PdoReceived
from canopen_transports.loop import current_loop
from canopen_transports.loop.beside import beside

HARDWARE_DELAY: Final = 3
"""Seconds before real drives begin to move: time to take one's hands away, or to press Ctrl-C."""

SETTLING_TIME: Final = 0.1
"""Seconds during which the last set-point is held."""
MAX_LATE_SHARE: Final = 0.05
"""The greatest share of late periods. A computer with other work loses single ones, well below this. Beyond it the joints stand
still in every twentieth period, and the motion takes that much longer: the cycle is too short for this computer."""
LATE_SHARE: Final = 0.5
"""Of the speed at which a single late SYNC makes a joint lose all of its permitted following error."""
_RADIANS: Final = {Unit.RADIAN: 1.0, Unit.DEGREE: math.pi / 180, Unit.TURN: 2 * math.pi}
PLANNED_SHARE: Final = 0.5
"""Of the swing, for the planned motion."""
PLANNED_FROM: Final = 1.0
"""Seconds: a shorter demonstration has no planned motion."""
PLANNED_TIME: Final = 10.0
"""Seconds that the planned motion may take. A path waits for a late computer, so a busy one could take minutes."""
DEMO_FAULT: Final = 0x2310
"""Continuous over-current: the error code of a joint that hits something."""


@dataclass
class JointResult:
    """The last line about one joint. error: degrees."""

    name: str
    node_id: int
    state: str
    homed: bool
    error: float
    round_trips: int


@dataclass
class CycleCounts:
    """How well the cycle was kept. sent: SYNCs; missed: SYNCs without a new set-point; skipped: periods without a SYNC."""

    sent: int = 0
    missed: int = 0
    skipped: int = 0

    @property
    def late_share(self) -> float:
        """The share of all periods in which the path stood still, because this computer was late."""
        return (self.missed + self.skipped) / max(1, self.sent + self.skipped)

    @property
    def was_kept(self) -> bool:
        """Whether the share of late cycles is that of an ordinary computer, or less."""
        return self.late_share <= MAX_LATE_SHARE


@dataclass(frozen=True)
class BootBegun:
    """The drives are booted, made ready and enabled from now on."""

    devices: tuple[Device, ...]


@dataclass(frozen=True)
class JointsEnabled:
    """All drives are in Operation enabled. seconds: how long that took. modes: each way in which joints follow set-points by
    their own files, in words, and the names of these joints."""

    count: int
    seconds: float
    modes: dict[str, list[str]]


@dataclass(frozen=True)
class MovesSoon:
    """Real drives are going to move in so many seconds."""

    seconds: float


@dataclass(frozen=True)
class HomingBegun:
    """The joints look for their reference from now on."""


@dataclass(frozen=True)
class HomingDone:
    """count: joints that were homed; without: joints that have no homing."""

    count: int
    without: int
    seconds: float


@dataclass(frozen=True)
class SwingCycle:
    """A cycle of the path. time: seconds since its first one; number: of the cycle; sync_cycles: SYNCs so far."""

    time: float
    number: int
    sync_cycles: int


@dataclass(frozen=True)
class SwingDone:
    """The path is done."""

    cycles: CycleCounts


@dataclass(frozen=True)
class PlannedMoveBegun:
    """The joints move out and back from now on, as fast as their limits allow."""


@dataclass(frozen=True)
class PlannedMoveDone:
    """The planned move is over: the joints are back. seconds: the time that it took. was_cut: the joints were stopped on the
    path, because this computer was too busy."""

    seconds: float
    was_cut: bool


DemonstrationEvent: TypeAlias = (
    BootBegun | JointsEnabled | MovesSoon | HomingBegun | HomingDone | SwingCycle | SwingDone | PlannedMoveBegun | PlannedMoveDone
)


class Demonstration:
    """One run. recording: commanded and actual positions; it is filled while the joints move. results, cycles: once it is done.

    devices: the joints, once the buses are open. description: the chain. stood_still: seconds for which the simulated world
    waited for this computer (`PatientClock`); was_busy: whether that is worth a word.
    """

    def __init__(
        self,
        task: DemonstrationTask,
        tell: Callable[[DemonstrationEvent], object] = lambda event: None,
        around: Callable[[Chain], contextlib.AbstractAsyncContextManager[object]] = lambda chain: contextlib.nullcontext(),
    ) -> None:
        """tell: is called with each event, and must not block. around: a block around all that the chain does: a recorder, a
        picture.

        Raises UnknownChainError, ChainFileError, DataError; LocalProtocolError for a fault of a node that is not in the chain.
        """
        self.task = task
        self._tell = tell
        self._around = around
        self.recording = Recording([])
        self.results: list[JointResult] = []
        self.cycles = CycleCounts()
        self.stood_still = 0.0
        self.was_busy = False
        self.description = task.chosen_chain()
        if task.fault is not None and task.fault[0] not in (joint.node_id for joint in self.description.joints):
            raise LocalProtocolError(f"fault: {self.description.name} has no node {task.fault[0]}")
        self._stage = "the drives were booting, and nothing had moved"
        self._has_begun = False  # to move
        self._drives: SimulatedDevices | None = None
        self.devices: tuple[Device, ...] = ()
        self._arm: Chain | None = None  # once it follows set-points
        self._halts: Sequence[Halt] = ()
        self._latest: list[tuple[float, float]] = []  # of each joint: actual and commanded position

    # ---- the run ----

    @property
    def places(self) -> list[tuple[str, float | None]]:
        """The state of each joint, and its position in degrees, None before it is known."""
        return [
            (str(device.state), None if device.position is None else math.degrees(_radians(device, device.position)))
            for device in self.devices
        ]

    async def run(self) -> None:
        """Run the whole demonstration. THE JOINTS MOVE. If it fails or is cancelled, every drive that still listens was halted.

        Raises MasterError, ProcedureError, TransportError.
        """
        locators = self.task.locators(self.description)
        async with contextlib.AsyncExitStack() as stack:
            if self.task.bus is None:
                joints = [(locators[joint.bus], joint.node_id) for joint in self.description.joints]
                self._drives = await stack.enter_async_context(simulated_drives(joints, make=self._maker))
            master = await stack.enter_async_context(self._open_master(locators))
            await self._demonstrate(self._chain(master, locators))
            if current_loop().name == "trio":
                self._note_what_was_lost()

    def _note_what_was_lost(self) -> None:
        from canopen_master.participant.patient_clock import present_patient_clock  # only here: it needs trio

        clock = present_patient_clock()
        if clock is not None:
            self.stood_still = clock.lost
            self.was_busy = clock.lost > MAX_LATE_SHARE * (clock.current_time() + clock.lost)

    def _maker(self, number: int, node_id: int) -> DeviceMaker:
        return joint_maker(number, node_id, self.task.file_of(self.description.joints[number]))

    def _open_master(self, locators: dict[str, str]) -> contextlib.AbstractAsyncContextManager[Master]:
        timeout = SDO_TIMEOUT if self.task.timeout is None else self.task.timeout / SECOND
        heartbeat = 0 if self.task.machine is None else self.task.machine.master.heartbeat_timeout
        buses = dict.fromkeys(locators.values())
        return open_master(*buses, sdo_timeout=timeout, heartbeat_timeout=heartbeat / SECOND, watchdog=self.task.watchdog)

    def _chain(self, master: Master, locators: dict[str, str]) -> Chain:
        joints = tuple(replace(joint, bus=locators[joint.bus]) for joint in self.description.joints)
        description = replace(self.description, joints=joints)
        doubles = same_nodes([description])
        if doubles:
            raise ChainFileError(description.source, doubles)
        axes = {}
        for joint in joints:
            axes[joint.name] = self.task.axis_of(joint)
            if (file := self.task.file_of(joint)) is not None:
                master.node(joint.node_id, file.dictionary, bus=joint.bus)
        machine = self.task.machine
        settings = ChainSettings(mode=None) if self.task.files else ChainSettings()
        if machine is not None:
            settings = machine.chains[description.name].settings
        settings = replace(settings, cycle_time=self.task.cycle / SECOND)
        if self.task.bus is None:
            settings = replace(settings, max_missed_cycles=patient_cycles(settings.cycle_time))
        chain = master.chain(description, settings, axes=axes)
        self.devices, self._halts = chain.devices, master.halts
        self._latest = [(0.0, 0.0)] * len(chain.devices)
        for number, device in enumerate(chain.devices):
            master.watch((PdoReceived,), partial(self._on_position, number), master.bus(device.node.bus), device.node.node_id)
        return chain

    async def _demonstrate(self, arm: Chain) -> None:
        async with self._around(arm):
            await self._boot(arm)
            await self._home(arm)
            await self._swing(arm)
            self.cycles = CycleCounts(arm.sync_cycles, arm.missed_cycles, arm.skipped_cycles)
            await self._move_by_plan(arm)
            self._stage = "all was done, and the drives were being shut down"
            await arm.shut_down()
        self.results = [
            JointResult(
                device.name,
                device.node.node_id,
                str(device.state),
                device.is_homed,
                math.degrees(_radians(device, device.largest_following_error)),
                device.sdo_round_trips,
            )
            for device in self.devices
        ]

    async def _boot(self, arm: Chain) -> None:
        self._tell(BootBegun(arm.devices))
        start = current_loop().current_time()
        await arm.initialise()
        for device in arm.devices:
            if device.axis.settings.counts_per_unit is None:
                seen, tries = "only Schunk's joints tell it", ("DemonstrationTask.scale = math.degrees(1000), or whatever it is",)
                if self.task.machine is not None:
                    tries = (f'unit = "degree" in [joints.{device.name}]',)
                raise DemonstrationRefusedError(f"{device.where}: the scale of the drive is not known", seen=seen, tries=tries)
        self._tell(JointsEnabled(len(arm.devices), current_loop().current_time() - start, _modes(arm)))

    async def _home(self, arm: Chain) -> None:
        if self.task.bus is not None:
            self._tell(MovesSoon(HARDWARE_DELAY))
            await current_loop().sleep(HARDWARE_DELAY)
        self._stage, self._has_begun = "the joints were homing", True
        self._tell(HomingBegun())
        start = current_loop().current_time()
        without = [] if self.task.bus is not None else [each for each in arm.devices if each.axis.settings.keeps_reference]
        await arm.home(if_needed=bool(without))
        self._tell(HomingDone(len(arm.devices) - len(without), len(without), current_loop().current_time() - start))

    async def _swing(self, arm: Chain) -> None:
        """Send the path: one set-point for each joint in each cycle."""
        task = self.task
        await arm.follow()
        for device in arm.devices:
            device.following.largest_error = 0.0
        self._tell(SwingCycle(0.0, 0, arm.sync_cycles))
        self.recording.joints = [JointTrack(device.name, device.node.node_id) for device in arm.devices]
        units = [1 / _radians(device, 1.0) for device in arm.devices]  # in a radian
        speeds = [_radians(device, _speed_of(device)) for device in arm.devices]
        accelerations = [limit and limit.value / unit for unit, limit in zip(units, map(_acceleration, arm.devices), strict=True)]
        start = [position / unit for unit, position in zip(units, arm.desired_positions, strict=True)]
        path = SwingPath(start, math.radians(task.swing), task.seconds, speeds, accelerations)
        fault = task.fault
        self._arm = arm
        async for cycle in arm.cycles():
            self._record(cycle.time)
            self._stage = f"the arm had been moving for {cycle.time:.1f} s"
            if fault is not None and cycle.time >= fault[1]:
                self._break(fault[0])
                fault = None
            arm.set_positions([unit * position for unit, position in zip(units, path.at(cycle.time), strict=True)])
            if cycle.time > task.seconds + SETTLING_TIME:
                break
            self._tell(SwingCycle(cycle.time, cycle.number, arm.sync_cycles))  # right after a SYNC: there is time to draw now
        self._tell(SwingDone(CycleCounts(arm.sync_cycles, arm.missed_cycles, arm.skipped_cycles)))

    async def _move_by_plan(self, arm: Chain) -> None:
        """Move simulated joints out and back, as fast as their limits allow; left out without ruckig, for slow joints, and in a
        short demonstration."""
        slow = any(device.plan is not None and device.plan.mode is Mode.PROFILE_POSITION for device in arm.devices)
        if self.task.bus is not None or self.task.seconds < PLANNED_FROM or slow or find_spec("ruckig") is None:
            return
        self._tell(PlannedMoveBegun())
        began = current_loop().current_time()
        self._stage = "the arm was moving by a plan"
        self.recording.planned_from = self.recording.times[-1]
        start, way = arm.desired_positions, math.radians(self.task.swing) * PLANNED_SHARE
        out = [at + way / _radians(device, 1.0) for at, device in zip(start, arm.devices, strict=True)]
        with current_loop().move_on_after(PLANNED_TIME) as scope:
            await self._move_to(arm, out)
            await self._move_to(arm, start)
        self._tell(PlannedMoveDone(current_loop().current_time() - began, scope.cancelled_caught))

    async def _move_to(self, arm: Chain, targets: Sequence[float]) -> None:
        """Move to a target by a plan, and record that behind what was recorded so far."""
        begin = self.recording.times[-1]

        async def record() -> None:
            async for progress in arm.progress():
                self._record(begin + progress.time)

        async with beside(current_loop().open_nursery()) as nursery:
            nursery.start_soon(record)
            await arm.move(targets)

    def _break(self, node_id: int) -> None:
        assert self._drives is not None
        self._drives.raise_fault(node_id, DEMO_FAULT)

    def _record(self, time: float) -> None:
        self.recording.times.append(time)
        for track, (actual, commanded) in zip(self.recording.joints, self._latest, strict=True):
            track.actual.append(math.degrees(actual))
            track.commanded.append(math.degrees(commanded))

    def _on_position(self, number: int, report: PdoReceived) -> None:
        """Record a joint's position when its PDO comes in: only then position and command belong to the same instant."""
        device = self.devices[number]
        position = device.position
        if position is not None:
            self._latest[number] = _radians(device, position), _radians(device, position + device.following_error)
        if number == len(self.devices) - 1 and self._arm is not None and self._arm.state is ChainState.FAULT:
            self._record_stopping()

    def _record_stopping(self) -> None:
        """Record how the joints brake after a fault has stopped the chain. Nothing is commanded."""
        recording = self.recording
        if recording.broken is None:
            faulty = next((device.name for device in self.devices if device.has_fault), "")
            recording.broken = recording.times[-1], faulty
        self._latest = [(actual, math.nan) for actual, _ in self._latest]
        self._record(recording.times[-1] + self.task.cycle / SECOND)

    def story(self) -> list[str]:
        """Tell what happened to the drives if the run did not end as planned. Each joint is named once.

        For a simulated drive, what it really does counts more than what it confirmed.
        """
        if not self.devices:
            return []
        told = [self._stage]
        moving = () if self._drives is None else self._drives.moving
        unconfirmed = [halt.device for halt in self._halts if halt.problem]
        fates: dict[str, list[str]] = {"in fault, without power": [], "halted": [], "told to halt": [], "STILL MOVING": []}
        for device in self.devices:
            if device.node.node_id in moving:
                fate = "STILL MOVING"
            elif device.has_fault:
                fate = "in fault, without power"
            else:
                fate = "told to halt" if device in unconfirmed else "halted"
            fates[fate].append(device.name)
        if not self._has_begun:
            fates["halted"] = fates["told to halt"] = []
        return told + [f"{fate}: {', '.join(names)}" for fate, names in fates.items() if names]


def _modes(arm: Chain) -> dict[str, list[str]]:
    """Return each way in which joints follow set-points by their own files, and these joints."""
    modes: dict[str, list[str]] = {}
    for device in arm.devices:
        if device.plan is not None:
            changed = ", ".join(f"{pdo.direction} {pdo.number}" for pdo in (*device.plan.written, *device.plan.destroyed))
            text = f"{mode_name(device.plan.mode)}: {device.plan.reason}"
            text += f"; set up unlike the file: {changed}" if changed else ""
            modes.setdefault(text, []).append(device.name)
    return modes


def _radians(device: Device, amount: float) -> float:
    """Return a position or a speed of a joint in radians; without a named unit it is in radians already."""
    unit = device.axis.settings.unit
    return amount if unit is None else amount * _RADIANS[unit]


def _acceleration(device: Device) -> Limit | None:
    return device.limits.acceleration


def _speed_of(device: Device) -> float:
    """Return how fast a joint may go.

    After a late SYNC, a joint that limits its acceleration falls behind by v² / 2a, while it gathers speed again. That has to be
    well within the following error that it may have.
    """
    speed, acceleration = device.limits.speed.value, device.limits.acceleration
    if acceleration is None or not math.isfinite(device.following.limit.value):
        return speed
    return min(speed, LATE_SHARE * math.sqrt(2 * acceleration.value * device.following.limit.value))
