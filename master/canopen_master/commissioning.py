"""Commission a new drive: from the box to the first move, in the order of docs/first-move.md. `canopen drive commission NODE`
asks a person between the steps; a program decides them itself.

    work = DriveCommissioning(master, master.node(5))
    await work.look()
    units = await work.read_units()
    work.set_unit(Unit.DEGREE, units.counts_per(Unit.DEGREE))
    await work.read_limits()
    work.set_limits(-90, 90, 20)
    await work.small_move(5)                    # IT MOVES; did it go the right way? else work.reverse()
    work.set_homing_method(19)
    await work.home()
    await work.move_to(0, 5)
    machine = commissioned_machine(None, "socketcan:can0", 5, "elbow", work.settings)

The drive has power only during a motion, which gives power, moves, and takes the power away. The profile velocity (0x6081) of
these motions is slow; the drive's own value is written back behind each. A cancelled step halts the drive.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import chain, count
from typing import Final, NamedTuple, TypeVar

from canopen_master.machine_file import JointEntry, MachineFile, NodeEntry, machine_of_chains
from canopen_master.master import Master
from canopen_master.motion.chain_file import ChainDescription, JointDescription
from canopen_master.motion.device import Device
from canopen_master.motion.joint_procedures import ensure_answers
from canopen_master.motion.single_drive import at_profile_velocity, ends_unpowered, look_at_drive
from canopen_master.node import Node
from canopen_master.simulation.plant import DeviceEntry
from canopen_proto.drives import axis as procedures
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.identity import identify, learn_units
from canopen_proto.drives.axis.limits import SetPointLimits, read_limits
from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.drives.axis.units import COUNTS, DriveUnits, Unit
from canopen_proto.drives.axis.view import DriveView
from canopen_proto.drives.axis.watchdog import DEFAULT_WATCHDOG
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.machine import SECOND, LocalProtocolError
from canopen_proto.procedures.objects import read_if_present
from canopen_proto.procedures.steps import Procedure

T = TypeVar("T")

LONGEST: Final = 300 * SECOND
"""For one of these moves, which are slow."""
SMALL_MOVE_TIME: Final = 2.0
"""Seconds that the small move takes at its speed: long enough to see which way it goes, and to stop it."""
SMALL_MOVES: Final = {Unit.DEGREE: 5.0, Unit.RADIAN: 0.1, Unit.TURN: 0.02, Unit.MILLIMETRE: 2.0, None: 1000.0}
"""The small move by default: far enough to be seen, and hardly enough to hit something. For counts it is anybody's guess."""
_NO_SETTINGS: Final = AxisSettings()


class HomingMethods(NamedTuple):
    """listed: the methods that the drive lists, None if it lists none. own: the value of its 0x6098, None if it has none."""

    listed: tuple[int, ...] | None
    own: int | None


class DriveCommissioning:
    """One drive on its way. settings: of its joint, as they go into a machine file. done: what was done so far, for people.

    Each step raises what its procedure raises (ProcedureError); a move before `set_limits` is a LocalProtocolError.
    """

    def __init__(self, master: Master, node: Node, settings: AxisSettings = _NO_SETTINGS, done: list[str] | None = None) -> None:
        self.master, self.node = master, node
        self.settings = settings
        self.done = [] if done is None else done
        self.has_moved = self.is_homed = False
        self._device: Device | None = None

    @property
    def axis(self) -> Axis:
        """The axis. Raises NotInDictionaryError if what describes the node lacks an object of a drive."""
        if self._device is None:
            # Its scale is chosen later, so that it is not refused for lack of one
            given = replace(self.settings, counts_per_unit=self.settings.counts_per_unit or 1.0)
            known = self.master.devices.get((self.node, 0))
            if known is None or known.axis.settings != self.settings:
                known = self.master.device(self.node, settings=given)
            self._device, self._began = known, known.axis.settings
            known.axis.settings = given
        return self._device.axis

    @property
    def unit_name(self) -> str:
        """The unit of its positions in the plural: "degrees", "counts"."""
        return COUNTS if self.settings.unit is None else f"{self.settings.unit.value}s"

    def leave(self) -> None:
        """Give the axis back the settings with which it began; what was found is in `settings`. For a program that goes on with
        the drive, and may have it in a chain."""
        if self._device is not None:
            self._device.axis.settings = self._began

    async def _run(self, procedure: Procedure[T]) -> T:
        return await self.master.run(procedure)

    def _set(self, **changes: object) -> None:
        self.settings = replace(self.settings, **changes)  # type: ignore[arg-type]
        self.axis.settings = replace(self.axis.settings, **changes)  # type: ignore[arg-type]

    # ---- nothing moves ----

    async def look(self) -> DriveView:
        """Return what the drive shows. Raises NodeIsNoDriveError."""
        return await self._run(look_at_drive(self.node.remote, self.settings))

    async def reset_fault(self) -> DriveView:
        """Reset a fault, and return what the drive shows then."""
        await self._run(ensure_answers(self.node))
        await self._run(procedures.reset_fault(self.axis))
        self.done.append("its fault was reset")
        return await self.look()

    async def read_units(self) -> DriveUnits:
        """Identify the drive, and return what it tells about its units."""
        await self._run(ensure_answers(self.node))
        await self._run(identify(self.axis))
        return await self._run(learn_units(self.axis))

    def set_unit(self, unit: Unit | None, counts_per_unit: float | None) -> None:
        """Choose the unit of its positions. None, None: counts. counts_per_unit: above 0."""
        self._set(unit=unit, counts_per_unit=counts_per_unit or 1.0)
        self.done.append(f"its positions are in {self.unit_name}, {counts_per_unit or 1.0:.10g} counts each")

    async def read_limits(self) -> tuple[SetPointLimits, float]:
        """Return the limits that the drive tells, and its position, in the chosen unit."""
        limits = await self._run(read_limits(self.axis, Mode.PROFILE_POSITION))
        return limits, await self._run(procedures.read_position(self.axis))

    def set_limits(self, lowest: float | None, highest: float | None, speed: float | None) -> None:
        """Choose the limits of the joint. None: none but the drive's own. lowest, highest: positions, in the chosen unit. speed:
        per second."""
        self._set(min_position=lowest, max_position=highest, max_speed=speed)
        self.done.append("its limits are asked for")

    async def read_homing_methods(self) -> HomingMethods:
        """Return what the drive tells of its homing methods."""
        listed = await self._run(procedures.read_homing_methods(self.node.remote))
        own = await self._run(read_if_present(self.node.remote, objects.HOMING_METHOD))
        return HomingMethods(None if listed is None else tuple(listed), own if isinstance(own, int) else None)

    def set_homing_method(self, method: int | None) -> None:
        """Choose the method that `home` writes to 0x6098. None: the drive's own stays. Schunk's joints have none."""
        self._set(homing_method=method)

    async def speed_text(self, speed: float) -> str:
        """Return in words how fast a move at this speed, or the joint's greatest, is going to be, wherever that is known."""
        speed = min(speed, self._most())
        if self.axis.scale.velocity_unit is not None:
            return f"at {speed:.6g} {self.unit_name} per second"
        own = await self._run(read_if_present(self.node.remote, objects.PROFILE_VELOCITY))
        return f"at its own profile velocity (0x6081 = {own!r}), whose unit it does not tell"

    # ---- it moves ----

    def small_speed(self, way: float) -> float:
        """The speed of a small move: it takes SMALL_MOVE_TIME, if the joint may go so fast. way: in the chosen unit."""
        return min(abs(way) / SMALL_MOVE_TIME, self._most())

    def usual_speed(self) -> float:
        """A slow speed for the first move."""
        return min(SMALL_MOVES[self.settings.unit], self._most())

    def _most(self) -> float:
        if self.settings.max_speed is None:
            raise LocalProtocolError("a drive is moved within a greatest speed: set_limits(lowest, highest, speed) comes first")
        return self.settings.max_speed

    async def small_move(self, way: float) -> tuple[float, float]:
        """Move a little way from where the drive stands. IT MOVES. Return the positions before and after."""
        speed = self.small_speed(way)
        before = await self._run(procedures.read_position(self.axis))
        after = await self._motion("the small move", self._move(way, relative=True), speed)
        self.has_moved = True
        return before, after

    def reverse(self) -> None:
        """Turn the direction of the joint round: the small move went the other way."""
        self._set(direction=-self.settings.direction)

    async def home(self) -> float:
        """Home the drive. IT MOVES. Return where it stands."""
        position = await self._motion("homing", procedures.home(self.axis))
        self.is_homed = True
        return position

    async def move_to(self, target: float, speed: float) -> float:
        """Move to a position, in the chosen unit, at a speed of at most the joint's. IT MOVES. Return where it stands. target:
        that position. speed: per second."""
        return await self._motion("the first move", self._move(target, relative=False), min(speed, self._most()))

    def _move(self, position: float, *, relative: bool) -> Procedure[None]:
        return procedures.move_to(self.axis, position, timeout=LONGEST, relative=relative)

    async def _motion(self, name: str, procedure: Procedure[None], speed: float | None = None) -> float:
        """Run a procedure that moves the drive, and take its power away. Return where it stands then. speed: of its profile."""
        self.done.append(f"{name} was begun")
        motion = ends_unpowered(self.axis, procedure)
        await self._run(motion if speed is None else at_profile_velocity(self.axis, speed, motion))
        position = await self._run(procedures.read_position(self.axis))
        self.done[-1] = f"{name}: done, and it stands at {position:.6g} {self.unit_name}"
        return position


def commissioned_machine(
    machine: MachineFile | None,
    bus: str,
    node_id: int,
    name: str,
    settings: AxisSettings,
    *,
    file: str = "",
    master_id: int | None = None,
) -> MachineFile:
    """Return a machine with a joint as it was commissioned.

    machine: None for a new one, with a chain of this joint; bus is a locator then, else the name of a bus of the machine. name:
    what is asked for; the joint's is `commissioned_name`. file: of the drive, if the machine names none. master_id: the node-ID
    of the master's heartbeat, which drives watch; None: as the machine has it.
    """
    if machine is None:
        machine = machine_of_chains([ChainDescription(name, (JointDescription(name, bus, node_id),))])
        bus = next(iter(machine.buses))
    known = machine.node_at(bus, node_id)
    name = commissioned_name(machine, bus, node_id, name)
    node = known or NodeEntry(name, bus, DeviceEntry("", (node_id,)))
    if file and not node.device.file:
        node = replace(node, device=replace(node.device, file=file))
    joint = machine.joint_on(node) or JointEntry(name, node.name)
    watchdog = machine.master.watchdog
    if master_id is not None:
        watchdog = replace(watchdog or DEFAULT_WATCHDOG, node_id=master_id)
    return replace(
        machine,
        nodes={**machine.nodes, node.name: node},
        joints={**machine.joints, joint.name: replace(joint, settings=settings)},
        master=replace(machine.master, watchdog=watchdog),
    )


def commissioned_name(machine: MachineFile | None, bus: str, node_id: int, name: str) -> str:
    """Return the name that a joint has once it is commissioned: that of the machine, if it has a joint there. name: what is asked
    for otherwise; with a number from 2 on if another node or joint has it, which stays as it is. bus: its name in the machine."""
    if machine is None:
        return name
    known = machine.node_at(bus, node_id)
    joint = None if known is None else machine.joint_on(known)
    if joint is not None:
        return joint.name
    taken = {*machine.nodes, *machine.joints} - {"" if known is None else known.name}
    return next(each for each in chain((name,), (f"{name}-{number}" for number in count(2))) if each not in taken)
