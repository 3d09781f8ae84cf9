"""Make a machine of the manual's chain files."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence

from canopen_master.machine_file.model import BusEntry, ChainEntry, JointEntry, MachineFile, NodeEntry
from canopen_master.motion.chain_file import ChainDescription
from canopen_master.simulation.plant import DeviceEntry


def machine_of_chains(chains: Sequence[ChainDescription], locators: Mapping[str, str] | None = None) -> MachineFile:
    """Return the machine with these chains.

    locators: of buses by the name in the chain file; by default that name is the locator. A bus is named by the end of its
    locator ("pcan32" for /dev/pcan32), a joint as in the chain file, with its chain before it if two chains have one of that
    name. Scale and limits are left to the drives, as a chain file leaves them.
    """
    buses: dict[str, BusEntry] = {}
    named: dict[str, str] = {}  # our name by that of the chain file
    for name in dict.fromkeys(joint.bus for chain in chains for joint in chain.joints):
        locator = (locators or {}).get(name, name)
        ours = _free(bus_name(name), buses)
        named[name], buses[ours] = ours, BusEntry(ours, locator)
    count = Counter(joint.name for chain in chains for joint in chain.joints)
    nodes: dict[str, NodeEntry] = {}
    joints: dict[str, JointEntry] = {}
    made: dict[str, ChainEntry] = {}
    for chain in chains:
        names = []
        for joint in chain.joints:
            name = _free(joint.name if count[joint.name] == 1 else f"{chain.name}_{joint.name}", joints)
            nodes[name] = NodeEntry(name, named[joint.bus], DeviceEntry("", (joint.node_id,)))
            joints[name] = JointEntry(name, name)
            names.append(name)
        made[chain.name] = ChainEntry(chain.name, tuple(names))
    return MachineFile(buses, nodes, joints, made)


def bus_name(locator: str) -> str:
    """Return a name for the bus with this locator: "can0" for socketcan:can0, "PCAN_USBBUS1" for pcan:PCAN_USBBUS1@500k."""
    return re.split("[:/]", locator.partition("@")[0].partition("?")[0])[-1] or locator


def _free(name: str, taken: Mapping[str, object]) -> str:
    """Return a name that is not taken, and no number."""
    name = f"n{name}" if name[:1].isdigit() else name
    number = 2
    free = name
    while free in taken:
        free, number = f"{name}_{number}", number + 1
    return free
