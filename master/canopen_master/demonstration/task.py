"""`DemonstrationTask`: which chain moves, on which buses, with which drives and settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from canopen_master.assembly import described
from canopen_master.demonstration.swing import MAX_SPEED
from canopen_master.errors import UNKNOWN_CHAIN, DemonstrationRefusedError, UnknownChainError
from canopen_master.machine_file import MachineFile
from canopen_master.motion.chain_file import ChainDescription, JointDescription, read_chains
from canopen_master.simulation.drive_files import DriveFile
from canopen_master.simulation.serving import virtual_buses
from canopen_proto.drives.axis.axis import MILLIDEGREES_PER_RADIAN, AxisSettings
from canopen_proto.drives.axis.units import Unit
from canopen_proto.drives.axis.watchdog import DEFAULT_WATCHDOG, Watchdog
from canopen_proto.machine import MILLISECOND, Time

CHAINS: Final = "multiple_devices.csv"
"""The chain file of the demonstration, unless another one is named."""


@dataclass(frozen=True)
class DemonstrationTask:
    """What is to be shown. bus: None simulates. seconds: of motion; cycle: ns; swing: degrees; fault: node-ID, seconds.
    scale: of real drives, counts per radian; None: as their vendor-ID says.

    files: the drives' files, by node-ID (None: all others); without a file they are Powerball joints with the PDOs of PDOs.csv.
    machine: in place of the chain file; drives: the files of its joints, by name; real drives move as it says.
    """

    bus: str | None = None
    chains: str = CHAINS
    chain: str | None = None
    seconds: float = 5.0
    cycle: Time = 10 * MILLISECOND
    swing: float = 15.0
    fault: tuple[int, float] | None = None
    timeout: Time | None = None
    files: Mapping[int | None, DriveFile] = field(default_factory=dict)
    scale: float | None = None
    watchdog: Watchdog | None = DEFAULT_WATCHDOG
    machine: MachineFile | None = None
    drives: Mapping[str, DriveFile] = field(default_factory=dict)

    def file_of(self, joint: JointDescription) -> DriveFile | None:
        """Return the file that describes the drive of a joint, or None."""
        if self.machine is not None:
            return self.drives.get(joint.name)
        return self.files.get(joint.node_id, self.files.get(None))

    def _chains_of_file(self) -> tuple[ChainDescription, ...]:
        """Return the chains of the machine file or the chain file. Raises UnknownChainError for a machine without chains."""
        machine = self.machine
        if machine is None:
            return read_chains(self.chains)
        if not machine.chains:
            tries = ('[chains.arm] with joints = ["shoulder", "elbow"]',)
            raise UnknownChainError(UNKNOWN_CHAIN, f"{machine.source} has no chain, and a demonstration moves one", tries=tries)
        return tuple(described(chain, machine) for chain in machine.chains.values())

    def chosen_chain(self) -> ChainDescription:
        """Return the chain that is to move. Raises UnknownChainError, ChainFileError, DataError."""
        chains = self._chains_of_file()
        if self.chain is None:
            return chains[0]
        for each in chains:
            if each.name == self.chain:
                return each
        names = ", ".join(each.name for each in chains)
        raise UnknownChainError(
            UNKNOWN_CHAIN,
            f"{chains[0].source} has no chain {self.chain!r}",
            seen=f"its chains are: {names}",
            tries=(f"DemonstrationTask.chain = {chains[0].name}",),
        )

    def locators(self, description: ChainDescription) -> dict[str, str]:
        """Return the locator of each bus by its name in the file."""
        machine = self.machine
        if machine is not None and self.bus in machine.buses:
            return {name: machine.buses[name].locator for name in description.buses}
        if self.bus is not None:
            return dict.fromkeys(description.buses, self.bus)
        return virtual_buses(description.buses)

    def axis_of(self, joint: JointDescription) -> AxisSettings:
        """Return the settings of a joint. Raises DemonstrationRefusedError for a real joint of a machine that does not turn."""
        file, machine = self.file_of(joint), self.machine
        if self.bus is None:
            # Every simulated drive sends millidegrees, whatever its file says.
            axis = AxisSettings() if file is None else file.simulated_axis
            return replace(axis, counts_per_unit=MILLIDEGREES_PER_RADIAN, max_speed=MAX_SPEED)
        if machine is None:
            axis = AxisSettings() if file is None else file.axis
            return replace(axis, counts_per_unit=self.scale or axis.counts_per_unit, max_speed=None)
        axis = machine.joints[joint.name].settings
        if axis.unit is Unit.MILLIMETRE or (axis.unit is None and axis.counts_per_unit is not None):
            seen = "its unit is not known" if axis.unit is None else f"its unit is the {axis.unit}"
            raise DemonstrationRefusedError(
                f"{joint.name} cannot swing by an angle", seen=seen, tries=("canopen drive move NODE",)
            )
        return axis
