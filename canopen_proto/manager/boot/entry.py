"""The nodes that an NMT master boots, as it knows them: `BootEntry`, and `entries_of` for a master's object dictionary.

A master keeps this in objects whose subindex is the node-ID (CiA 302-2; concise DCF and dates: CiA 302-3):

    0x1F81  assignment                 0x1F84  device type       0x1F85..0x1F88  vendor-ID, product, revision, serial number
    0x1F22  concise DCF                0x1F26  configuration date, days since 1984-01-01; 0x1F27 time, ms after midnight
    0x1F55  software identification    0x1F8A  subindex of the node's 0x1011 to restore; 0 for none
    0x1F53  date, 0x1F54 time of the program: older than 0x1F55, which goes before them

and in 0x1016, in any subindex, the consumer heartbeat time of each node. Expected numbers of 0 are not checked.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

from canopen_proto import indices
from canopen_proto.dictionary import Values
from canopen_proto.dictionary.concise import ConciseError, from_concise
from canopen_proto.dictionary.download_order import Write
from canopen_proto.frame import ALL_NODE_IDS
from canopen_proto.machine import MICROSECOND, MILLISECOND, LocalProtocolError, Time, check_node_id
from canopen_proto.manager.boot.assignment import Assignment, Startup
from canopen_proto.multiplexer import mux

CONSUMER_FACTOR: Final = 3
"""A node is lost after so many heartbeats that did not come."""
NMT_INHIBIT_TIME: Final = 0x102A
PAUSE_UNIT: Final = 100 * MICROSECOND
"""The unit of 0x102A."""
MAX_RESTORE: Final = 0x7F
"""The highest subindex of 0x1011."""


@dataclass(frozen=True, slots=True)
class BootEntry:
    """A node, as the master knows it.

    device_type, vendor, product, revision, serial: what 0x1000 and 0x1018:01 to :04 have to be; None: any. consumer_time: ns
    within which its heartbeats have to come; 0: none has to come. learns: heartbeats that it sends all the same are watched, for
    CONSUMER_FACTOR times its 0x1017. restore_subindex: of its 0x1011; 0: none.

    configuration: what is written to it, in this order. date: days since 1984-01-01 and ms after midnight of this configuration;
    a node that shows it in 0x1020 is not configured again; None: it is configured each time, as is a node without 0x1020. After
    the configuration the date is written, unless the configuration writes 0x1020 itself. save: the node stores its parameters at
    the end (0x1010:01).

    software: what 0x1F56:01 has to be; None: not known. software_date: for devices of an older edition, without 0x1F56: days and
    ms that 0x1F52:01 and :02 have to show; it counts only without `software`.
    """

    node_id: int
    assignment: Assignment = field(default_factory=Assignment)
    device_type: int | None = None
    vendor: int | None = None
    product: int | None = None
    revision: int | None = None
    serial: int | None = None
    consumer_time: Time = 0
    restore_subindex: int = 0
    configuration: tuple[Write, ...] = ()
    date: tuple[int, int] | None = None
    software: int | None = None
    save: bool = False
    software_date: tuple[int, int] | None = None
    learns: bool = True

    def __post_init__(self) -> None:
        """Raises LocalProtocolError for numbers that no node can have."""
        check_node_id(self.node_id)
        if not 0 <= self.restore_subindex <= MAX_RESTORE:
            raise LocalProtocolError(f"node {self.node_id}: 0x1011 has no subindex {self.restore_subindex}")
        if self.consumer_time and self.consumer_time < MILLISECOND:
            raise LocalProtocolError(f"node {self.node_id}: a consumer heartbeat time is 0, or 1 ms or more")

    @property
    def identity(self) -> tuple[int | None, int | None, int | None, int | None]:
        """The expected 0x1018:01 to :04."""
        return self.vendor, self.product, self.revision, self.serial

    @property
    def program(self) -> tuple[tuple[int, int, int], ...]:
        """The objects that show the expected program: index, subindex, number. Empty: the master does not know."""
        if self.software:
            return ((indices.PROGRAM_SOFTWARE, 1, self.software),)
        if self.software_date is not None:
            date, time = self.software_date
            return (indices.PROGRAM_DATE, 1, date), (indices.PROGRAM_DATE, 2, time)
        return ()


@dataclass(frozen=True, slots=True)
class NetworkEntry:
    """A network, as the master's dictionary has it.

    nodes: the listed nodes, by node-ID. boot_time: ns that mandatory nodes have to answer (0x1F89); 0: without limit. pause: ns
    between two NMT commands (0x102A).
    """

    startup: Startup
    nodes: Mapping[int, BootEntry]
    boot_time: Time = 0
    pause: Time = 0


def entries_of(values: Values, files: Mapping[tuple[int, int], bytes] | None = None) -> NetworkEntry:
    """Return what a master's own dictionary says about its network: Startup, and a BootEntry for each listed node.

    values: of the master, for instance of the DCF that dcfgen writes. files: contents of its domains (0x1F22), by index and
    subindex, that stand in files of their own. A dictionary without 0x1F81 lists no nodes.

    Raises LocalProtocolError for reserved bits, for a concise DCF that is not valid, and for a DCF as text (0x1F20): it is to be
    made into a concise DCF with the node's EDS.
    """
    held = _Held(values, files or {})
    times = dict(held.consumer_times())
    nodes = {}
    for node_id in ALL_NODE_IDS:
        assignment = Assignment.from_value(held.number(indices.SLAVE_ASSIGNMENT, node_id))
        if assignment.is_listed:
            nodes[node_id] = held.entry(node_id, assignment, times.get(node_id, 0))
    return NetworkEntry(
        Startup.from_value(held.number(indices.NMT_STARTUP, 0)),
        nodes,
        held.number(indices.BOOT_TIME, 0) * MILLISECOND,
        held.number(NMT_INHIBIT_TIME, 0) * PAUSE_UNIT,
    )


class _Held:
    """A master's values, with 0 and nothing for objects that it does not have."""

    def __init__(self, values: Values, files: Mapping[tuple[int, int], bytes]) -> None:
        self._store = values.store
        self._files = files

    def number(self, index: int, subindex: int) -> int:
        value = self._store.get(mux(index, subindex), 0)
        return value if isinstance(value, int) else 0

    def data(self, index: int, subindex: int) -> bytes:
        value = self._files.get((index, subindex)) or self._store.get(mux(index, subindex), b"")
        return value if isinstance(value, bytes) else b""

    def consumer_times(self) -> Iterator[tuple[int, Time]]:
        """The nodes of 0x1016 and their consumer times."""
        for subindex in ALL_NODE_IDS:
            value = self.number(indices.CONSUMER_HEARTBEAT_TIME, subindex)
            if value:
                yield value >> 16 & 0xFF, (value & 0xFFFF) * MILLISECOND

    def entry(self, node_id: int, assignment: Assignment, consumer_time: Time) -> BootEntry:
        def expected(index: int) -> int | None:
            return self.number(index, node_id) or None

        if self.data(indices.STORE_DCF, node_id):
            raise LocalProtocolError(
                f"0x1F20:{node_id:02X} holds a DCF as text. Try: make it into a concise DCF (0x1F22) with the node's EDS"
            )
        try:
            configuration = tuple(from_concise(self.data(indices.CONCISE_DCF, node_id)))
        except ConciseError as error:
            raise LocalProtocolError(f"0x1F22:{node_id:02X}: {error}") from error
        date, time = expected(indices.CONFIGURATION_DATE), expected(indices.CONFIGURATION_TIME)
        program = expected(indices.EXPECTED_PROGRAM_DATE), expected(indices.EXPECTED_PROGRAM_TIME)
        return BootEntry(
            node_id,
            assignment,
            device_type=expected(indices.DEVICE_TYPE_IDENTIFICATION),
            vendor=expected(indices.VENDOR_IDENTIFICATION),
            product=expected(indices.PRODUCT_CODE),
            revision=expected(indices.REVISION_NUMBER),
            serial=expected(indices.SERIAL_NUMBER),
            consumer_time=consumer_time,
            restore_subindex=self.number(indices.RESTORE_CONFIGURATION, node_id),
            configuration=configuration,
            date=None if date is None or time is None else (date, time),
            software=expected(indices.EXPECTED_SOFTWARE),
            software_date=(program[0] or 0, program[1] or 0) if any(program) else None,
        )
