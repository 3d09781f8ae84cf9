"""The nodes of a bus, as its NMT master has to know them, by the machine file: `network_of` (CiA 302-2).

The expected identity is that of the node's file, unless `boot` says another one. The configuration of a node is that of its DCF,
in an order in which a device takes it, or its concise DCF as it is; then come the writes that the caller adds (links), then the
heartbeat or the guarding that `boot` names. Commands, set-points and outputs of a DCF are left out, as `canopen restore` leaves
them out: a boot must not move anything.

A node that stores its configuration gets a stamp in 0x1020, where other tools have date and time. It is made of the writes, so it
differs as soon as one of them does; no clock and no memory of this computer is needed to see whether a node is configured.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from canopen_data import DataError, content_of
from canopen_data.describing import identified
from canopen_data.description import DeviceDescription
from canopen_data.descriptions import load_description
from canopen_data.findings import first_of
from canopen_master.machine_file.dictionaries import Dictionaries
from canopen_master.machine_file.model import MAX_MILLISECONDS, BootSettings, LossReaction, MachineFile, NodeEntry, StartOrder
from canopen_proto import indices
from canopen_proto.dictionary.concise import ConciseError, from_concise, pack_concise
from canopen_proto.dictionary.download_order import Write, download_order, settings_of
from canopen_proto.dictionary.roles import Role, roles_in
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.manager.boot.assignment import Assignment, Startup
from canopen_proto.manager.boot.entry import CONSUMER_FACTOR, BootEntry, NetworkEntry
from canopen_proto.multiplexer import mux_text, split_mux

CONCISE: Final = (".cdcf", ".bin")
"""Endings of concise DCFs; dcfgen writes `.bin`."""
_DAYS: Final = 1 << 15
_MILLISECONDS_A_DAY: Final = 86_400_000


@dataclass(frozen=True, slots=True)
class Program:
    """The program that a node has to have. confirm: it runs on trial until it is confirmed (MCUboot)."""

    path: str
    image: bytes
    confirm: bool = False


@dataclass(frozen=True, slots=True)
class BusNetwork:
    """One bus, as its master knows it. names, programs: of its nodes, by node-ID. notes: what is not written of their DCFs, for
    people."""

    bus: str
    entry: NetworkEntry
    names: Mapping[int, str]
    programs: Mapping[int, Program]
    notes: tuple[str, ...]


def network_of(
    machine: MachineFile, bus: str, dictionaries: Dictionaries, links: Mapping[str, Sequence[Write]] | None = None
) -> BusNetwork:
    """Return what the machine file says of the network of a bus: the nodes that have `boot`.

    links: more writes, by the name of the node; they come behind those of its DCF. Raises DataError, DictionaryError for a file
    that cannot be used, DataError for settings that a node cannot have.
    """
    notes: list[str] = []
    nodes: dict[int, BootEntry] = {}
    names: dict[int, str] = {}
    programs: dict[int, Program] = {}
    for node in machine.nodes.values():
        if node.boot is None or node.bus != bus:
            continue
        names[node.node_id] = node.name
        if node.boot.program:
            programs[node.node_id] = _program_of(machine, node.name, node.boot)
        made = _EntryOfNode(machine, node, node.boot, dictionaries.description_of(node), notes)
        nodes[node.node_id] = made.entry((links or {}).get(node.name, ()))
    told = machine.network
    startup = Startup(
        start_all=told.start is StartOrder.ALL,
        application_starts=told.start is StartOrder.NONE,
        reset_all_on_loss=told.mandatory_lost is LossReaction.RESET_ALL,
        stop_all_on_loss=told.mandatory_lost is LossReaction.STOP_ALL,
    )
    return BusNetwork(bus, NetworkEntry(startup, nodes, told.boot_time, told.nmt_pause), names, programs, tuple(notes))


def _program_of(machine: MachineFile, name: str, boot: BootSettings) -> Program:
    path = machine.path(boot.program)
    image = content_of(Path(path), path)
    if not image:
        raise DataError(f"{machine.source}: nodes.{name}.boot: {path!r} is no program", "check the path")
    return Program(path, image, boot.confirm_program)


def stamp_of(writes: Sequence[Write]) -> tuple[int, int]:
    """Return the stamp of a configuration: two numbers in the range of the date and time of 0x1020, neither of them 0. writes:
    the configuration."""
    digest = hashlib.sha256(pack_concise(writes)).digest()
    days, milliseconds = int.from_bytes(digest[:4], "little"), int.from_bytes(digest[4:8], "little")
    return 1 + days % _DAYS, 1 + milliseconds % (_MILLISECONDS_A_DAY - 1)


class _EntryOfNode:
    """Makes the entry of one node. description: of its own file, or None."""

    def __init__(
        self, machine: MachineFile, node: NodeEntry, boot: BootSettings, description: DeviceDescription | None, notes: list[str]
    ) -> None:
        self._machine = machine
        self._node = node
        self._boot = boot
        self._notes = notes
        self._dictionary = None if description is None else identified(description)

    def entry(self, links: Sequence[Write]) -> BootEntry:
        boot = self._boot
        writes = (*self._configured(), *links)
        writes += tuple(each for each in self._error_control() if each not in writes)
        if boot.store:  # the stamp takes the place of the date of a DCF
            writes = tuple(each for each in writes if each[0] != indices.VERIFY_CONFIGURATION)
        if boot.store and self._dictionary is not None and self._dictionary.get(indices.VERIFY_CONFIGURATION, 1) is None:
            raise self._wrong(
                "store needs 0x1020, which its file does not have: without it each boot would configure and store again",
                "store = false",
            )
        return BootEntry(
            self._node.node_id,
            self._assignment(),
            device_type=self._expected(boot.device_type, indices.DEVICE_TYPE, 0),
            vendor=self._expected(boot.vendor, indices.IDENTITY_OBJECT, 1),
            product=self._expected(boot.product, indices.IDENTITY_OBJECT, 2),
            revision=boot.revision or None,
            serial=boot.serial or None,
            consumer_time=self._consumer_time(writes),
            restore_subindex=boot.restore,
            configuration=writes,
            date=stamp_of(writes) if boot.store else None,
            software=boot.software or None,
            save=boot.store,
            learns=boot.heartbeat_timeout != 0,
        )

    def _assignment(self) -> Assignment:
        boot = self._boot
        return Assignment(
            boots=boot.start,
            is_mandatory=boot.mandatory,
            keep_alive=boot.keep_alive,
            check_software=bool(boot.software),
            update_software=bool(boot.program),
            restore=bool(boot.restore),
            retry_factor=boot.life_time_factor if boot.guard_time else 0,
            guard_time=boot.guard_time,
        )

    def _expected(self, said: int | None, index: int, subindex: int) -> int | None:
        """Return the number that an object has to be, by `boot`, else by the node's file; None: any."""
        if said is None:
            variable = None if self._dictionary is None else self._dictionary.get(index, subindex)
            value = None if variable is None else variable.initial_of(self._node.node_id)
            said = value if isinstance(value, int) else None
        return said or None

    def _configured(self) -> tuple[Write, ...]:
        """Return what the file of the configuration writes."""
        name = self._boot.configuration
        if not name:
            return ()
        path = self._machine.path(name)
        if path.lower().endswith(CONCISE):
            content = content_of(Path(path), path)
            if content is None:
                raise self._wrong(f"there is no file {path!r}", "check the path")
            try:
                return tuple(from_concise(content))
            except ConciseError as error:
                raise self._wrong(f"{path} is no concise DCF: {error}", "canopen eds to-cdcf    makes one") from error
        return self._of_dcf(path)

    def _of_dcf(self, path: str) -> tuple[Write, ...]:
        node_id = self._node.node_id
        description = load_description(path)
        dictionary = description.dictionary
        if description.lost_settings:
            lost = first_of([str(each) for each in description.lost_settings])
            raise self._wrong(f"a setting of {path} cannot be read: {lost}", f"canopen eds lint {path}")
        if description.node_id is not None and description.node_id != node_id:
            raise self._wrong(
                f"{path} is of node {description.node_id}, not of node {node_id}",
                f"canopen eds to-dcf {path} --id {node_id} -o new.dcf",
            )
        values = settings_of(dictionary, node_id)
        if not values:
            raise self._wrong(f"{path} sets nothing: it has no ParameterValue", "configuration has to be a DCF or an XDC")
        roles = roles_in(dictionary, values)
        process = {key: "a set-point, an output or an actual value" for key in values if roles[key] is Role.PROCESS}
        order = download_order(dictionary, {key: value for key, value in values.items() if key not in process}, node_id)
        left_out = {**order.left_out, **process}
        self._notes += [
            f"{self._node.name}: {mux_text(key)} of {path} is not written: {left_out[key]}"
            for key in sorted(left_out)
            if (variable := dictionary.get(*split_mux(key))) is not None and variable.access.writable
        ]
        return order.writes

    def _error_control(self) -> Iterator[Write]:
        boot = self._boot
        if boot.heartbeat is not None:
            yield _number(indices.PRODUCER_HEARTBEAT_TIME, boot.heartbeat // MILLISECOND, 2)
        if boot.guard_time and (self._dictionary is None or self._dictionary.get(indices.GUARD_TIME) is not None):
            yield _number(indices.GUARD_TIME, boot.guard_time // MILLISECOND, 2)
            yield _number(indices.LIFE_TIME_FACTOR, boot.life_time_factor, 1)

    def _consumer_time(self, writes: Sequence[Write]) -> Time:
        """Return within which time the node's heartbeats have to come, ns; 0: they are not watched."""
        written = [data for index, _, data in writes if index == indices.PRODUCER_HEARTBEAT_TIME]
        if written:
            heartbeat = int.from_bytes(written[-1], "little") * MILLISECOND
        else:
            variable = None if self._dictionary is None else self._dictionary.get(indices.PRODUCER_HEARTBEAT_TIME)
            value = None if variable is None else variable.initial_of(self._node.node_id)
            heartbeat = value * MILLISECOND if isinstance(value, int) else 0
        said = self._boot.heartbeat_timeout
        if said is None:
            return 0 if self._boot.guard_time else min(CONSUMER_FACTOR * heartbeat, MAX_MILLISECONDS * MILLISECOND)
        if 0 < said <= heartbeat:
            raise self._wrong(
                f"its heartbeat comes each {heartbeat // MILLISECOND} ms, which is not within heartbeat_timeout",
                f'heartbeat_timeout = "{CONSUMER_FACTOR * heartbeat // MILLISECOND}ms"',
            )
        return said

    def _wrong(self, what: str, *tries: str) -> DataError:
        source = f"{self._machine.source}: " if self._machine.source else ""
        return DataError(f"{source}nodes.{self._node.name}.boot: {what}", *tries)


def _number(index: int, value: int, size: int) -> Write:
    return index, 0, value.to_bytes(size, "little")
