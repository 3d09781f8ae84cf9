"""The machine file: one TOML file with the buses, devices, joints and chains of a machine. docs/machine.md has all its keys."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_master.machine_file.from_chains import machine_of_chains as machine_of_chains
    from canopen_master.machine_file.model import BootSettings as BootSettings
    from canopen_master.machine_file.model import BusEntry as BusEntry
    from canopen_master.machine_file.model import ChainEntry as ChainEntry
    from canopen_master.machine_file.model import JointEntry as JointEntry
    from canopen_master.machine_file.model import LossReaction as LossReaction
    from canopen_master.machine_file.model import MachineFile as MachineFile
    from canopen_master.machine_file.model import MasterEntry as MasterEntry
    from canopen_master.machine_file.model import NetworkSettings as NetworkSettings
    from canopen_master.machine_file.model import NodeEntry as NodeEntry
    from canopen_master.machine_file.model import StartOrder as StartOrder
    from canopen_master.machine_file.toml_text import machine_text as machine_text
    from canopen_master.machine_file.toml_text import parse_machine as parse_machine
    from canopen_master.machine_file.toml_text import read_machine as read_machine
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
