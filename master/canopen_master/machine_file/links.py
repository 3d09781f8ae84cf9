"""The linked PDOs of a machine, from its file and those of its devices: `plan_bus` for one bus, `linked_writes` for a boot.

The state from which the links change a device is that of its file, with the configuration that a boot writes (`boot`) laid over.
PDOs that the chains of the machine use, and those that they may switch off, are left to them. No link feeds a mode, a controlword
or a set-point of a drive that a chain moves, also if the chain does not use it: the drive would obey two masters.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from canopen_data import text_of
from canopen_data.configured import configure
from canopen_data.findings import DictionaryError, Finding, Severity
from canopen_data.toml_file import places_of
from canopen_master.machine_file.boot_entries import network_of
from canopen_master.machine_file.dictionaries import Dictionaries
from canopen_master.machine_file.link_entries import LINKS, name_of
from canopen_master.machine_file.model import ChainEntry, JointEntry, MachineFile, NodeEntry
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.download_order import Write
from canopen_proto.dictionary.roles import SET_POINTS
from canopen_proto.drives.axis.motion_plan import NoMotionPlanError, plan_motion
from canopen_proto.drives.cia402.axes import swapped
from canopen_proto.drives.cia402.objects import CONTROLWORD, MODES_OF_OPERATION
from canopen_proto.manager.linking import KnownNode, LinkError, LinkPlan, plan_links
from canopen_proto.multiplexer import mux
from canopen_proto.pdo.settings import EACH_SYNC, PdoSettings

_DIGITAL_OUTPUTS: Final = 0x60FE
"""Of a drive: they move nothing, and may serve something else."""
_COMMANDS: Final = (
    CONTROLWORD,
    MODES_OF_OPERATION,
    *(mux(index, each) for index, subindices in SET_POINTS.items() if index != _DIGITAL_OUTPUTS for each in subindices),
)
"""Of the first axis."""


def linked_buses(machine: MachineFile) -> list[str]:
    """Return the buses that have links, in the order of the file."""
    nodes = {end.node for link in machine.links for end in (*link.sources, *link.targets)}
    found = {node.bus for node in machine.nodes.values() if node.name in nodes}
    return [bus for bus in machine.buses if bus in found]


def plan_bus(machine: MachineFile, bus: str, dictionaries: Dictionaries) -> LinkPlan:
    """Return the PDOs for the links on a bus. Raises DictionaryError with each link that cannot be, and its line; as
    `network_of` for files that cannot be used. bus: its name in the machine file."""
    on_bus = [node for node in machine.nodes.values() if node.bus == bus]
    names = {node.name for node in on_bus}
    links = [link for link in machine.links if {end.node for end in (*link.sources, *link.targets)} & names]
    configured = configured_dictionaries(machine, bus, dictionaries)
    members = []
    for node in on_bus:
        description = dictionaries.description_of(node)
        if description is None:
            continue
        members.append(
            KnownNode(
                node.name,
                node.node_id,
                configured[node.name],
                description.device_info.granularity,
                frozenset(each for each, is_usable in (description.dummies or {}).items() if is_usable),
                tuple(_used_by_chains(machine, node, description.dictionary, dictionaries.names)),
                frozenset(swapped(key, joint.axis) for _, joint in _axes(machine, node) for key in _COMMANDS),
            )
        )
    try:
        return plan_links(members, links, [node.node_id for node in on_bus])
    except LinkError as error:
        raise DictionaryError(list(_findings(machine, error))) from error


def configured_dictionaries(machine: MachineFile, bus: str, dictionaries: Dictionaries) -> dict[str, ObjectDictionary]:
    """Return the dictionaries of the nodes on a bus that have a file, by name: with the values that a boot writes, links apart.

    Raises as `network_of`. bus: its name in the machine file.
    """
    booted = network_of(machine, bus, dictionaries).entry.nodes
    found = {}
    for node in machine.nodes.values():
        if node.bus == bus and (description := dictionaries.description_of(node)) is not None:
            entry = booted.get(node.node_id)
            writes = () if entry is None else entry.configuration
            found[node.name] = _configured(description.dictionary, writes, node.node_id)
    return found


def linked_writes(machine: MachineFile, bus: str, dictionaries: Dictionaries) -> dict[str, list[Write]]:
    """Return the writes that set up the linked PDOs of a bus, by the name of the node. Raises as `plan_bus`. bus: its name in the
    machine file."""
    if bus not in linked_buses(machine):
        return {}
    plan = plan_bus(machine, bus, dictionaries)
    return {node: plan.writes_of(node) for node in plan.changed}


def _configured(dictionary: ObjectDictionary, writes: Iterable[Write], node_id: int) -> ObjectDictionary:
    """Return a dictionary with the values that a boot writes."""
    values = {}
    for index, subindex, data in writes:
        variable = dictionary.get(index, subindex)
        if variable is not None and (variable.size is None or variable.size == len(data)):
            values[mux(index, subindex)] = variable.decode(data)
    return configure(dictionary, values, node_id) if values else dictionary


def _used_by_chains(
    machine: MachineFile, node: NodeEntry, dictionary: ObjectDictionary, names: ObjectDictionary
) -> Iterator[PdoSettings]:
    """Return the PDOs of a node that its chains set up, exchange or switch off. names: has the PDOs of PDOs.csv."""
    for chain, joint in _axes(machine, node):
        settings = chain.settings
        if not settings.own_pdos and settings.mode is not None:
            for pdo in (names.pdo(settings.rpdo), names.pdo(settings.tpdo)):
                if pdo.number is not None:
                    yield PdoSettings.from_description(pdo, node.node_id, EACH_SYNC)
            continue
        for lean in (False, True):  # lean: what it switches off if the bus has no room
            try:
                plan = plan_motion(
                    dictionary,
                    node.node_id,
                    machine.master.cycle,
                    wish=settings.mode,
                    axis=joint.axis,
                    lean=lean,
                    feed_forward=settings.feed_forward,
                )
            except NoMotionPlanError:
                break
            yield from (*plan.pdos, *plan.destroyed, *plan.spare)


def _axes(machine: MachineFile, node: NodeEntry) -> list[tuple[ChainEntry, JointEntry]]:
    joints = [(chain, machine.joints[name]) for chain in machine.chains.values() for name in chain.joints]
    return [(chain, joint) for chain, joint in joints if joint.node == node.name]


def _findings(machine: MachineFile, error: LinkError) -> Iterator[Finding]:
    text = text_of(Path(machine.source), machine.source) if machine.folder is not None else None
    places = places_of(text or "")
    numbers = {name_of(number): number for number in range(1, len(machine.links) + 1)}
    for problem in error.problems:
        number = numbers.get(problem.link.partition(" ")[0], 0)
        yield Finding(Severity.ERROR, "links", str(problem), machine.source, *places.get((LINKS, str(number)), (0, 0)))
