"""Boot the networks of a machine file on an open master (CiA 302-2): `boot_network`, and `network_boot` for one bus."""

from __future__ import annotations

from pathlib import Path

from canopen_master.machine_file import MachineFile, read_machine
from canopen_master.machine_file.boot_entries import BusNetwork, network_of
from canopen_master.machine_file.dictionaries import Dictionaries
from canopen_master.machine_file.links import linked_writes
from canopen_master.master import Master
from canopen_master.motion.chain import ChainState
from canopen_master.motion.chain_errors import not_now
from canopen_proto.manager.boot.entry import BootEntry
from canopen_proto.manager.boot.network_boot import BootReport, NetworkBoot
from canopen_proto.manager.programs.download import updating
from canopen_proto.procedures.steps import Procedure, all_of
from canopen_proto.remote_node import RemoteNode


async def boot_network(master: Master, machine: MachineFile | str | Path) -> dict[str, BootReport]:
    """Reset, check, configure and start the nodes of a machine that have `boot`; return how it went, by the name of the bus.

    master: opened with this machine, or with buses of the same names. A node that fails is not started, and is no exception: see
    `BootReport.missing`. If the task is cancelled, nodes that run go on running. Raises DataError, DictionaryError for a file
    that cannot be used; ChainError, with nothing sent, if a chain of this master has been initialised: its drives would be reset.
    """
    for chain in master.chains.values():
        if chain.state is not ChainState.OFF:
            raise not_now(chain.name, "be booted", f"it is {chain.state.value}", "await chain.shut_down()")
    if not isinstance(machine, MachineFile):
        machine = read_machine(machine)
    dictionaries = Dictionaries(machine, master.dictionary)
    buses = dict.fromkeys(node.bus for node in machine.nodes.values() if node.boot is not None)
    networks = [network_of(machine, bus, dictionaries, linked_writes(machine, bus, dictionaries)) for bus in buses]
    boots = [network_boot(master, machine, each, dictionaries) for each in networks]
    reports = await master.run(all_of(*(boot.start() for boot in boots)))
    return {network.bus: report for network, report in zip(networks, reports, strict=True)}


def network_boot(master: Master, machine: MachineFile, network: BusNetwork, dictionaries: Dictionaries) -> NetworkBoot:
    """Return the boot of one bus, with its nodes on the master. Nothing is sent."""
    bus = master.bus(network.bus)
    nodes = {}
    for node_id, name in network.names.items():
        node = master.nodes.get(name)
        if node is None:
            node = master.node(node_id, dictionaries.of(machine.nodes[name]), bus=network.bus)
        nodes[node_id] = node.remote
    nmt, programs = master.nmt_master(bus), network.programs
    images = {node_id: each.image for node_id, each in programs.items()}
    updates = {confirm: updating(nmt, images.get, confirm=confirm) for confirm in (False, True)}

    def update(node: RemoteNode, entry: BootEntry) -> Procedure[None]:
        yield from updates[programs[node.node_id].confirm](node, entry)

    return NetworkBoot(bus.network, nmt, network.entry, nodes, update=update)
