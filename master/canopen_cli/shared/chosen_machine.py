"""The options -m and CANOPEN_MACHINE: the machine file of a command, and the one bus of it that the command is about.

The bus is that of the nodes or joints that the command line names, or that of -b NAME, or the machine's only one. With -m, a -b
that is no name of a bus in the file is another bus in that one's place, such as a simulated one. A machine of CANOPEN_MACHINE
gives way to such a -b; CANOPEN_BUS gives way to every machine. Behind the variables comes the configuration file
(configuration.py), whose machine gives way to CANOPEN_BUS, too.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_cli.shared.importing import importing
from canopen_cli.shared.problem import CommandError, usage

if TYPE_CHECKING:
    from canopen_cli.shared.configuration import Configuration
    from canopen_master.machine_file import MachineFile

BUS_VARIABLE: Final = "CANOPEN_BUS"
MACHINE_VARIABLE: Final = "CANOPEN_MACHINE"
NUMBER: Final = re.compile(r"\s*[0-9].*")
"""A text that is meant as a node-ID: names do not begin with a digit."""


class ChosenMachine:
    """The machine of one command. bus: the name of its bus that the command is about, "" while that is not known."""

    def __init__(self) -> None:
        self.bus = ""
        self._file: MachineFile | None = None
        self._path: Path | None = None
        self._configuration: Configuration | None = None

    @property
    def configuration(self) -> Configuration:
        """What the configuration file says; read once. Raises a CommandError."""
        if self._configuration is None:
            from canopen_cli.shared.configuration import read_configuration  # not for `canopen --help`

            self._configuration = read_configuration()
        return self._configuration

    @property
    def has_several(self) -> bool:
        """Whether the machine is read, and has several buses."""
        return self._file is not None and len(self._file.buses) > 1

    def path(self, option: Path | None) -> Path | None:
        """Return which machine file the user means, or None. option: of -m."""
        path = option or (Path(os.environ[MACHINE_VARIABLE]) if os.environ.get(MACHINE_VARIABLE) else None)
        return self.configuration.machine if path is None and not os.environ.get(BUS_VARIABLE) else path

    def file(self, option: Path | None, bus: str | None) -> MachineFile | None:
        """Return the machine, or None. option: of -m; bus: of -b. Raises DataError, DictionaryError."""
        path = self.path(option)
        if path is None:
            return None
        if self._file is None or self._path != path:
            with importing():
                from canopen_master.machine_file import read_machine
            self._file, self._path = read_machine(path), path
        is_other = bus is not None and bus not in self._file.buses
        return None if option is None and is_other and not self.bus else self._file

    def node_id(self, machine: MachineFile, name: str, *, any_axis: bool = False) -> int:
        """Return the node-ID of a joint or node, and choose its bus. Raises a CommandError.

        any_axis: the command is about one drive. Others take no joint on a further axis: they would be about the first one.
        """
        from canopen_proto.dictionary.model import did_you_mean

        node = machine.node_of(name)
        if node is None:
            known = [*machine.joints, *machine.nodes]
            meant = did_you_mean(name, known).removeprefix("; ")
            failed = f"{name!r} is neither a node-ID nor a name in {machine.source}"
            raise usage("CO120", failed, seen=meant, tries=("a joint or a node of the machine file", "a node-ID: 1 to 127"))
        joint = machine.joints.get(name)
        if joint is not None and joint.axis and not any_axis:
            failed = f"{name} is axis {joint.axis} of node {node.name}, and this command is about whole nodes"
            tries = (f"canopen drive state {name}", f"the node: {node.node_id}, and objects as controlword_axis_{joint.axis}")
            raise usage("CO120", failed, tries=tries)
        self.choose(machine, node.bus, name)
        return node.node_id

    def choose(self, machine: MachineFile, bus: str, why: str) -> None:
        """Choose the bus. why: the name that it is chosen for. Raises a CommandError if another one is chosen already."""
        if self.bus and self.bus != bus:
            raise usage(
                "CO121",
                f"{why} is on bus {bus!r} of {machine.source}, and this command is about bus {self.bus!r}",
                tries=("one command for each bus",),
            )
        self.bus = bus

    def locator(self, machine: MachineFile, bus: str | None) -> str | None:
        """Return the locator of the bus that the command is about, and choose it; None if it is not clear. bus: of -b."""
        if bus is not None and bus in machine.buses:
            self.choose(machine, bus, "-b")
        elif not self.bus and len(machine.buses) == 1:
            self.bus = next(iter(machine.buses))
        if not self.bus:
            return None
        return machine.buses[self.bus].locator if bus is None or bus in machine.buses else bus

    def unclear(self, machine: MachineFile) -> CommandError:
        """Return the CommandError of a command whose bus is not clear."""
        names = ", ".join(machine.buses)
        tries = (f"-b {next(iter(machine.buses))}", "the name of a joint or a node in place of its node-ID")
        return usage("CO121", f"which bus of {machine.source}?", seen=f"its buses are {names}", tries=tries)
