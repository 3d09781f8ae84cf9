"""`assemble`: make what a machine file names on an open master: its nodes, joints and chains. Nothing is sent."""

from __future__ import annotations

from canopen_master.machine_file import ChainEntry, MachineFile
from canopen_master.machine_file.dictionaries import Dictionaries
from canopen_master.master import Master
from canopen_master.motion.chain_file import ChainDescription, JointDescription


def assemble(master: Master, machine: MachineFile, dictionaries: Dictionaries | None = None) -> None:
    """Make the nodes, joints and chains of a machine, in `master.nodes`, `master.joints` and `master.chains`; the
    machine itself in `master.machine`.

    A node that has a file and is no joint exchanges its PDOs (`Node.keep_pdos`). Raises DataError, DictionaryError for a file
    that cannot be used, UnknownChainError for a bus that this master does not have.
    """
    master.machine = machine
    files = Dictionaries(machine, master.dictionary) if dictionaries is None else dictionaries
    for bus in machine.buses.values():
        if (opened := master.bus(bus.name)).bitrate is None:  # else its transport knows better
            opened.bitrate = bus.bitrate
    drives = {joint.node for joint in machine.joints.values()}
    for entry in machine.nodes.values():
        pdos = bool(entry.device.file) and entry.name not in drives
        node = master.node(entry.node_id, files.of(entry), bus=entry.bus, pdos=pdos)
        node.name = entry.name
        master.nodes[entry.name] = node
    for joint in machine.joints.values():
        device = master.device(master.nodes[joint.node], joint.name, joint.settings, axis=joint.axis)
        device.entry = f"joints.{joint.name}", machine.source or "the machine file"
        master.joints[joint.name] = device
    for chain in machine.chains.values():
        axes = {name: machine.joints[name].settings for name in chain.joints}
        master.chain(described(chain, machine), chain.settings, axes=axes)


def described(chain: ChainEntry, machine: MachineFile) -> ChainDescription:
    """Return a chain of a machine as a chain file would describe it."""
    places = {name: (machine.nodes[(joint := machine.joints[name]).node], joint.axis) for name in chain.joints}
    joints = tuple(JointDescription(name, node.bus, node.node_id, axis=axis) for name, (node, axis) in places.items())
    return ChainDescription(chain.name, joints, machine.source)
