"""The chain that a command moves: of a machine file; with `-b demo` simulated in this process, by default a six-joint arm."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field, replace
from functools import partial

from canopen_cli.drive_files import DriveFile, drives_of
from canopen_cli.fleet import drive_maker, simulated_fleet
from canopen_cli.options import DEMO, Settings
from canopen_cli.problem import usage
from canopen_master.machine_file import MachineFile, NodeEntry, machine_of_chains
from canopen_master.master import Master
from canopen_master.motion.chain import Chain
from canopen_master.motion.chain_file import read_chains
from canopen_master.session import open_master
from canopen_master.simulation import DeviceMaker
from canopen_proto.drive.settings import AxisSettings
from canopen_proto.drive.units import Unit
from canopen_proto.machine import SECOND
from canopen_proto.procedures.grip import DEFAULT_GRIP

ARM = "multiple_devices.csv"
"""The chain of `-b demo` without a machine file."""


@dataclass(frozen=True)
class ChosenChain:
    """A chain of a machine. buses: locators in place of those of the file, by name. files: of simulated joints, by name."""

    machine: MachineFile
    name: str
    buses: Mapping[str, str] = field(default_factory=dict)
    is_simulated: bool = False
    files: Mapping[str, DriveFile] = field(default_factory=dict)

    @property
    def joints(self) -> tuple[str, ...]:
        """The names of its joints."""
        return self.machine.chains[self.name].joints

    def node_of(self, joint: str) -> NodeEntry:
        """Return the node of a joint."""
        return self.machine.nodes[self.machine.joints[joint].node]

    def locator_of(self, joint: str) -> str:
        """Return the locator of the bus of a joint."""
        bus = self.node_of(joint).bus
        return self.buses.get(bus, self.machine.buses[bus].locator)

    def maker(self, number: int, node_id: int) -> DeviceMaker:
        """Return the maker of the simulated drive of a joint, by its place in the chain."""
        file = self.files.get(self.joints[number])
        return drive_maker(number, node_id) if file is None else drive_maker(number, node_id, file.shape, file.dictionary)


def choose_chain(settings: Settings, name: str | None) -> ChosenChain:
    """Return the chain that the options mean. name: None for the first one. Raises a Problem, DataError, DictionaryError."""
    machine, is_simulated = settings.machine_file(), settings.bus == DEMO
    if machine is None:
        if not is_simulated:
            first = ("-m cell.toml    the machine file, see docs/machine.md", "-b demo         a simulated arm with six joints")
            raise usage("CO121", "no machine was named", tries=first)
        machine = _demo_machine()
    if not machine.chains:
        tries = ('[chains.arm] with joints = ["shoulder", "elbow"]',)
        raise usage("CO322", f"{machine.source} has no chain", tries=tries)
    chosen = next(iter(machine.chains)) if name is None else name
    if chosen not in machine.chains:
        names = ", ".join(machine.chains)
        raise usage("CO322", f"{machine.source} has no chain {chosen!r}", seen=f"its chains are: {names}")
    if is_simulated:
        buses = {bus: f"virtual:demo{number or ''}" for number, bus in enumerate(machine.buses)}
        return ChosenChain(machine, chosen, buses, True, drives_of(machine, False))
    if settings.bus is None or settings.bus in machine.buses:
        return ChosenChain(machine, chosen)
    used = {machine.nodes[machine.joints[joint].node].bus for joint in machine.chains[chosen].joints}
    if len(used) > 1:
        raise usage("CO121", f"-b: {chosen} is on the buses {', '.join(sorted(used))}", tries=("the same without -b",))
    return ChosenChain(machine, chosen, {used.pop(): settings.bus})


def _demo_machine() -> MachineFile:
    machine = machine_of_chains(read_chains(ARM)[:1])
    settings = AxisSettings(unit=Unit.DEGREE)
    joints = {name: replace(each, settings=settings) for name, each in machine.joints.items()}
    return replace(machine, joints=joints, source="-b demo")


@asynccontextmanager
async def open_chain(settings: Settings, chosen: ChosenChain) -> AsyncIterator[tuple[Master, Chain]]:
    """Open the buses of a machine while the block runs; for a simulated one with its drives. Nothing is sent yet."""
    async with AsyncExitStack() as stack:
        if chosen.is_simulated:
            drives = [(chosen.locator_of(joint), chosen.node_of(joint).node_id) for joint in chosen.joints]
            await stack.enter_async_context(simulated_fleet(drives, make=partial(chosen.maker)))
        grip = DEFAULT_GRIP if settings.master_id is None else settings.grip
        timeout = None if settings.timeout is None else settings.timeout / SECOND
        opened = open_master(machine=chosen.machine, buses=chosen.buses, sdo_timeout=timeout, grip=grip)
        master = await stack.enter_async_context(opened)
        yield master, master.chains[chosen.name]
