"""The chains that a command moves: of a machine file; with `-b demo` simulated in this process, by default a six-joint arm."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field, replace

from canopen_cli.shared.options import DEMO, Settings
from canopen_cli.shared.problem import usage
from canopen_master.machine_file import MachineFile, NodeEntry, machine_of_chains
from canopen_master.master import Master
from canopen_master.motion.chain import Chain
from canopen_master.motion.chain_file import read_chains
from canopen_master.motion.moving import Moving, together
from canopen_master.session import open_master
from canopen_master.simulated_machine import drives_of_machine
from canopen_master.simulation.drive_files import DriveFile, joint_maker
from canopen_master.simulation.host import DeviceMaker
from canopen_master.simulation.serving import simulated_drives, virtual_buses
from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.drives.axis.units import Unit
from canopen_proto.drives.axis.watchdog import DEFAULT_WATCHDOG
from canopen_proto.machine import SECOND

ARM = "multiple_devices.csv"
"""The chain of `-b demo` without a machine file."""


@dataclass(frozen=True)
class ChosenChains:
    """Chains of a machine. buses: locators in place of those of the file, by name. files: of simulated joints, by name."""

    machine: MachineFile
    names: tuple[str, ...]
    buses: Mapping[str, str] = field(default_factory=dict)
    is_simulated: bool = False
    files: Mapping[str, DriveFile] = field(default_factory=dict)

    @property
    def joints(self) -> tuple[str, ...]:
        """The names of their joints."""
        return tuple(joint for name in self.names for joint in self.machine.chains[name].joints)

    def node_of(self, joint: str) -> NodeEntry:
        """Return the node of a joint."""
        return self.machine.nodes[self.machine.joints[joint].node]

    def locator_of(self, joint: str) -> str:
        """Return the locator of the bus of a joint."""
        bus = self.node_of(joint).bus
        return self.buses.get(bus, self.machine.buses[bus].locator)

    def maker(self, number: int, node_id: int) -> DeviceMaker:
        """Return the maker of the simulated drive of a joint, by its place among them. number: that place, from 0."""
        return joint_maker(number, node_id, self.files.get(self.joints[number]))


class ChainGroup:
    """The chains of a command, which move as one: what it needs of a `Chain`, for one or several. moving: moves them all."""

    def __init__(self, chains: Sequence[Chain]) -> None:
        self.chains = tuple(chains)
        self.moving: Moving = self.chains[0] if len(self.chains) == 1 else together(*self.chains)
        self.name = " and ".join(chain.name for chain in self.chains)
        self.devices = [device for chain in self.chains for device in chain.devices]
        self.cycle_time = self.chains[0].settings.cycle_time

    @property
    def positions(self) -> list[float]:
        """The actual positions."""
        return [position for chain in self.chains for position in chain.positions]

    @property
    def desired_positions(self) -> list[float]:
        """The positions that the next PDOs command."""
        return [position for chain in self.chains for position in chain.desired_positions]

    async def initialise(self) -> None:
        """Make all joints ready to move."""
        for chain in self.chains:
            await chain.initialise()

    async def home(self) -> None:
        """Home the joints that have no reference, one chain after the other."""
        for chain in self.chains:
            await chain.home(if_needed=True)

    async def shut_down(self) -> None:
        """Take the power away."""
        for chain in self.chains:
            await chain.shut_down()


def choose_chains(settings: Settings, *names: str) -> ChosenChains:
    """Return the chains that the options mean. names: none for the first one. Raises a CommandError, DataError,
    DictionaryError."""
    machine, is_simulated = settings.machine_file(), settings.bus == DEMO
    if machine is None:
        if not is_simulated:
            first = ("-m cell.toml    the machine file, see docs/machine.md", "-b demo         a simulated arm with six joints")
            raise usage("CO121", "no machine was named", tries=first)
        machine = _demo_machine()
    if not machine.chains:
        tries = ('[chains.arm] with joints = ["shoulder", "elbow"]',)
        raise usage("CO322", f"{machine.source} has no chain", tries=tries)
    chosen = tuple(dict.fromkeys(names)) or (next(iter(machine.chains)),)
    for name in chosen:
        if name not in machine.chains:
            known = ", ".join(machine.chains)
            raise usage("CO322", f"{machine.source} has no chain {name!r}", seen=f"its chains are: {known}")
    if is_simulated:
        return ChosenChains(machine, chosen, virtual_buses(machine.buses), True, drives_of_machine(machine))
    if settings.bus is None or settings.bus in machine.buses:
        return ChosenChains(machine, chosen)
    used = {machine.nodes[machine.joints[joint].node].bus for name in chosen for joint in machine.chains[name].joints}
    if len(used) > 1:
        raise usage(
            "CO121", f"-b: {' and '.join(chosen)} is on the buses {', '.join(sorted(used))}", tries=("the same without -b",)
        )
    return ChosenChains(machine, chosen, {used.pop(): settings.bus})


def _demo_machine() -> MachineFile:
    machine = machine_of_chains(read_chains(ARM)[:1])
    settings = AxisSettings(unit=Unit.DEGREE)
    joints = {name: replace(each, settings=settings) for name, each in machine.joints.items()}
    return replace(machine, joints=joints, source="-b demo")


@asynccontextmanager
async def open_chains(settings: Settings, chosen: ChosenChains) -> AsyncIterator[tuple[Master, ChainGroup]]:
    """Open the buses of a machine while the block runs; for a simulated one with its drives. Nothing is sent yet."""
    async with AsyncExitStack() as stack:
        if chosen.is_simulated:
            drives = [(chosen.locator_of(joint), chosen.node_of(joint).node_id) for joint in chosen.joints]
            await stack.enter_async_context(simulated_drives(drives, make=chosen.maker))
        watchdog = DEFAULT_WATCHDOG if settings.master_id is None else settings.watchdog
        timeout = None if settings.timeout is None else settings.timeout / SECOND
        opened = open_master(machine=chosen.machine, buses=chosen.buses, sdo_timeout=timeout, watchdog=watchdog)
        master = await stack.enter_async_context(opened)
        yield master, ChainGroup([master.chains[name] for name in chosen.names])
