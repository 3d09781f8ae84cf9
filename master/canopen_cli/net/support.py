"""Shared by the commands of `canopen net`: the network that a command is about, and its open buses."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from canopen_cli.shared.named_machine import named_machine
from canopen_cli.shared.options import DEMO, Settings
from canopen_cli.shared.problem import usage
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_cli.shared.withholding import withheld
from canopen_cli.simulation.devices import teller
from canopen_master.machine_file import MachineFile
from canopen_master.machine_file.boot_entries import BusNetwork, network_of
from canopen_master.machine_file.dictionaries import Dictionaries
from canopen_master.machine_file.links import linked_writes
from canopen_master.master import Master
from canopen_master.session import BusSource, open_master
from canopen_master.simulated_machine import devices_of_machine
from canopen_master.simulation.parameter_keeper import ParameterKeeper
from canopen_master.simulation.serving import simulated_devices, virtual_buses
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.remote_node import RemoteNode
from canopen_transports import open_transport


@dataclass(frozen=True)
class ChosenNetwork:
    """The networks of a machine's buses that a command is about. locators: of these buses, by name."""

    machine: MachineFile
    networks: tuple[BusNetwork, ...]
    locators: Mapping[str, str]
    dictionaries: Dictionaries
    is_simulated: bool = False

    def dictionary_of(self, network: BusNetwork, node_id: int) -> ObjectDictionary:
        """Return the dictionary of a node."""
        return self.dictionaries.of(self.machine.nodes[network.names[node_id]])

    def place(self, network: BusNetwork, node_id: int) -> str:
        """Return the name of a node, for people: with its bus if there are several."""
        name = network.names[node_id]
        return name if len(self.networks) == 1 else f"{name} on {network.bus}"


@dataclass
class OpenNetwork:
    """The networks with their buses open. nodes: by the name of the bus and the node-ID."""

    master: Master
    nodes: dict[tuple[str, int], RemoteNode] = field(default_factory=dict)


def choose_network(settings: Settings, screen: Screen, path: Path | None) -> ChosenNetwork:
    """Return the networks that the options mean. Raises a CommandError, DataError, DictionaryError."""
    machine = named_machine(settings, path)
    listed = dict.fromkeys(node.bus for node in machine.nodes.values() if node.boot is not None)
    if not listed:
        tries = ("boot = {} in [defaults.nodes], or in [nodes.NAME]",)
        raise usage("CO322", f"{machine.source} has no node with boot, so nobody is in the network list", tries=tries)
    dictionaries = Dictionaries(machine)
    locators = _locators(settings, machine, tuple(listed))
    networks = tuple(network_of(machine, bus, dictionaries, linked_writes(machine, bus, dictionaries)) for bus in locators)
    notes = [note for each in networks for note in each.notes]
    for note in notes:
        screen.detail(escape(note))
    if notes and screen.verbosity < 1:
        screen.say(f"[dim]{counted(len(notes), 'value')} of DCFs will not be written; -v shows why[/]")
    return ChosenNetwork(machine, networks, locators, dictionaries, settings.bus == DEMO)


def _locators(settings: Settings, machine: MachineFile, listed: Sequence[str]) -> dict[str, str]:
    if settings.bus == DEMO:
        return virtual_buses(listed)
    if settings.bus is None:
        return {bus: machine.buses[bus].locator for bus in listed}
    if settings.bus in listed:
        return {settings.bus: machine.buses[settings.bus].locator}
    if settings.bus in machine.buses:
        raise usage("CO322", f"no node on {settings.bus} has boot", seen=f"nodes on {', '.join(listed)} have it")
    if len(listed) > 1:
        raise usage("CO121", f"-b: the nodes are on the buses {', '.join(listed)}", tries=("the same without -b",))
    return {listed[0]: settings.bus}


def _dictionary_on(chosen: ChosenNetwork, network: BusNetwork, node_id: int) -> ObjectDictionary | None:
    return chosen.dictionary_of(network, node_id) if node_id in network.names else None


@asynccontextmanager
async def open_network(settings: Settings, screen: Screen, chosen: ChosenNetwork) -> AsyncIterator[OpenNetwork]:
    """Open the buses while the block runs; for `-b demo` with the simulated devices of the machine. Nothing is sent."""
    async with AsyncExitStack() as stack:
        if chosen.is_simulated:
            made = devices_of_machine(chosen.machine, chosen.locators, settings.overlays, teller(screen))
            state = chosen.machine.beside(chosen.machine.state)
            keeper = ParameterKeeper(Path(state) if state else None)
            await stack.enter_async_context(simulated_devices(dict(made.values()), keeper=keeper))
        buses: dict[str, BusSource] = dict(chosen.locators)
        if settings.dry_run:
            for network in chosen.networks:
                transport = await open_transport(chosen.locators[network.bus])
                buses[network.bus] = withheld(transport, partial(_dictionary_on, chosen, network), network.bus)
        opened = OpenNetwork(await stack.enter_async_context(open_master(buses=buses, sdo_timeout=settings.sdo_timeout)))
        for network in chosen.networks:
            for node_id in network.names:
                node = opened.master.node(node_id, chosen.dictionary_of(network, node_id), bus=network.bus)
                opened.nodes[network.bus, node_id] = node.remote
        yield opened
