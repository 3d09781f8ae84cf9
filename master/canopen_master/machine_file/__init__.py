"""The machine file: one TOML file with the buses, devices, joints and chains of a machine. docs/machine.md has all its keys."""

from canopen_master.machine_file.booting import BootSettings, LossReaction, NetworkSettings, StartOrder
from canopen_master.machine_file.from_chains import machine_of_chains
from canopen_master.machine_file.model import BusEntry, ChainEntry, JointEntry, MachineFile, MasterEntry, NodeEntry
from canopen_master.machine_file.reader import parse_machine, read_machine
from canopen_master.machine_file.writer import machine_text

__all__ = [
    "BootSettings",
    "BusEntry",
    "ChainEntry",
    "JointEntry",
    "LossReaction",
    "MachineFile",
    "MasterEntry",
    "NetworkSettings",
    "NodeEntry",
    "StartOrder",
    "machine_of_chains",
    "machine_text",
    "parse_machine",
    "read_machine",
]
