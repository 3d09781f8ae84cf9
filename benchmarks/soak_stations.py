"""Who takes part in a soak (soak.py): twelve axes and their master, each with its book-keeping of what was right."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.frame import RPDO1, TPDO1
from canopen_proto.heartbeat import HeartbeatLost
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Event, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtMaster
from canopen_proto.pdo.consumer import PdoReceived
from canopen_proto.pdo.mapping import MappedEntry, Mapping
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.client import SdoDownloaded, SdoUploaded
from canopen_proto.sdo.events import SdoAborted
from canopen_proto.sync import SyncProducer, SyncReceived, SyncSent
from canopen_transports.wire import Wire

AXES = 12
HEARTBEAT = 500 * MILLISECOND
TRANSFER_CYCLES = 4
"""From one SDO transfer (a text written and read back, in 12 frames) to the next."""
TARGET, TARGET_CHECK, ACTUAL, ACTUAL_CHECK, TEXT = 0x2000 << 8, 0x2001 << 8, 0x2100 << 8, 0x2101 << 8, 0x2200 << 8


def check_of(number: int, node_id: int) -> int:
    """What goes beside a number, so that no other number and no other node's is taken for it."""
    return (number * 2_654_435_761 ^ node_id * 0x9E37_79B1) & 0xFFFF_FFFF


def dictionary_of(node_id: int) -> ObjectDictionary:
    """A device with one RPDO that acts at once, one TPDO that answers each SYNC, and a text for SDO."""

    def pair(first: int, second: int) -> dict[int, int]:
        return {0: 2, 1: first << 8 | 32, 2: second << 8 | 32}

    def own(mux: int, name: str, data_type: DataType) -> Object:
        return Object.of(name, [Variable(mux >> 8, 0, name, data_type, Access.RW, pdo_mappable=data_type is DataType.UNSIGNED32)])

    return ObjectDictionary(
        [
            standard_object(0x1000, 0),
            standard_object(0x1001),
            standard_object(0x1005),
            standard_object(0x1017, HEARTBEAT // MILLISECOND),
            standard_object(0x1018, highest=1, defaults={1: 1}),
            standard_object(0x1400, highest=2, defaults={1: RPDO1 + node_id, 2: 255}),
            standard_object(0x1600, highest=2, defaults=pair(TARGET, TARGET_CHECK)),
            standard_object(0x1800, highest=2, defaults={1: 0x4000_0000 | TPDO1 + node_id, 2: 1}),
            standard_object(0x1A00, highest=2, defaults=pair(ACTUAL, ACTUAL_CHECK)),
            own(TARGET, "target", DataType.UNSIGNED32),
            own(TARGET_CHECK, "target check", DataType.UNSIGNED32),
            own(ACTUAL, "actual", DataType.UNSIGNED32),
            own(ACTUAL_CHECK, "actual check", DataType.UNSIGNED32),
            own(TEXT, "text", DataType.VISIBLE_STRING),
        ]
    )


def mapping_of(first: int, second: int) -> Mapping:
    """Both numbers of a PDO, as the master has them."""
    return Mapping(MappedEntry(mux >> 8, 0, 32, DataType.UNSIGNED32, f"{mux >> 8:X}") for mux in (first, second))


@dataclass
class Findings:
    """What was noticed, and what was wrong."""

    cycles: int = 0
    absent: int = 0
    twice: int = 0
    gaps: int = 0
    repeats: int = 0
    heartbeats_lost: int = 0
    transfers: int = 0
    aborts: int = 0
    longest_sync: Time = 0
    wrong: list[str] = field(default_factory=list)
    faults: Counter[str] = field(default_factory=Counter)

    def fail(self, text: str) -> None:
        """Something is not as it should be."""
        if len(self.wrong) < 20:
            self.wrong.append(text)


class Station:
    """One participant: its Network, and its place on the wire."""

    def __init__(self, wire: Wire, number: int) -> None:
        self.number = number
        self.network = Network()
        self.member = wire.join(0)
        self.wake: Time = NEVER
        self.wanted: frozenset[int] | None = None

    def on_events(self, events: list[Event], now: Time) -> None:
        """What the Network reports."""


class Axis(Station):
    """A device. It counts the SYNCs that it heard, and sends the count by its TPDO."""

    def __init__(self, wire: Wire, number: int, findings: Findings) -> None:
        super().__init__(wire, number)
        self.findings = findings
        self.node = LocalNode(self.network.out, number, dictionary_of(number))
        self.network.attach(self.node)
        self.store = self.node.values.store
        self.syncs = 0
        self.last = -1
        self._show()
        self.node.boot(0)

    def _show(self) -> None:
        self.store[ACTUAL] = self.syncs
        self.store[ACTUAL_CHECK] = check_of(self.syncs, self.number)

    def on_events(self, events: list[Event], now: Time) -> None:
        for event in events:
            if isinstance(event, SyncReceived):
                self.syncs += 1
                self._show()
            elif isinstance(event, PdoReceived):
                self._check(*event.components)  # type: ignore[arg-type]

    def _check(self, number: int, check: int) -> None:
        if check != check_of(number, self.number) or (self.store[TARGET], self.store[TARGET_CHECK]) != (number, check):
            self.findings.fail(f"axis {self.number} took the target {number}, {check:08X}")
        if self.last >= 0:
            step = number - self.last
            if step < 0:
                self.findings.fail(f"axis {self.number} got the target {number} behind {self.last}")
            self.findings.gaps += max(step - 1, 0)
            self.findings.repeats += step == 0
        self.last = number


class Master(Station):
    """SYNC, RPDOs, SDO transfers one after the other, and the book-keeping of each cycle."""

    def __init__(self, wire: Wire, period: Time, findings: Findings) -> None:
        super().__init__(wire, 0)
        self.findings = findings
        self.period = period
        out = self.network.out
        self.sync, self.nmt = SyncProducer(out), NmtMaster(out)
        self.nodes = {}
        for machine in (self.sync, self.nmt):
            self.network.attach(machine)
        for number in range(1, AXES + 1):
            node = RemoteNode(out, number, dictionary_of(number), heartbeat_timeout=HEARTBEAT * 3 // 2)
            self.network.attach(node)
            node.add_tpdo(1, TPDO1 + number, mapping_of(ACTUAL, ACTUAL_CHECK), 0)
            node.add_rpdo(1, RPDO1 + number, mapping_of(TARGET, TARGET_CHECK))
            self.nodes[number] = node
        self.number_sent = 0
        self.heard = dict.fromkeys(self.nodes, 0)
        self.expected = dict.fromkeys(self.nodes, 1)
        self.last = dict.fromkeys(self.nodes, -1)
        self.next_sync: Time = 0
        self.judging = False
        self._transfer: tuple[int, str, bool] | None = None
        self._turn = 0

    def start(self, now: Time) -> None:
        """All nodes are there: begin."""
        self.nmt.start(0, now)
        for node in self.nodes.values():
            node.enable_rpdo(1, now)
        self._set_targets()
        self.next_sync = now
        self.sync.start(self.period, now)

    def _set_targets(self) -> None:
        self.number_sent += 1
        for number, node in self.nodes.items():
            node.values.store[TARGET] = self.number_sent
            node.values.store[TARGET_CHECK] = check_of(self.number_sent, number)

    def on_events(self, events: list[Event], now: Time) -> None:
        for event in events:
            match event:
                case PdoReceived():
                    self._on_tpdo(event.node_id, *event.components)  # type: ignore[arg-type]
                case SyncSent():
                    self._on_cycle(event.skipped, now)
                case HeartbeatLost():
                    self.findings.heartbeats_lost += 1
                case SdoDownloaded() | SdoUploaded() | SdoAborted():
                    self._on_transfer(event, now)

    def _on_tpdo(self, node_id: int, number: int, check: int) -> None:
        store = self.nodes[node_id].values.store
        if check != check_of(number, node_id) or (store[ACTUAL], store[ACTUAL_CHECK]) != (number, check):
            self.findings.fail(f"the master took {number}, {check:08X} from axis {node_id}")
        if number < self.last[node_id]:
            self.findings.fail(f"the master got {number} from axis {node_id} behind {self.last[node_id]}")
        self.last[node_id] = number
        self.heard[node_id] += 1

    def _on_cycle(self, skipped: int, now: Time) -> None:
        findings = self.findings
        if now != self.next_sync or skipped:
            findings.fail(f"SYNC at {now} ns, not at {self.next_sync}; {skipped} skipped")
        self.next_sync = now + self.period
        if self.judging:
            findings.cycles += 1
            for number, heard in self.heard.items():
                findings.absent += heard == 0
                findings.twice += max(heard - 1, 0)
                if heard != self.expected[number]:
                    text = f"cycle at {now / SECOND:.3f} s: {heard} TPDOs of axis {number}, not {self.expected[number]}"
                    findings.fail(text)
        for number in self.nodes:
            self.heard[number], self.expected[number] = 0, 1
        self._set_targets()
        if self._transfer is None and findings.cycles % TRANSFER_CYCLES == 0:
            self._begin_transfer(now)

    def _begin_transfer(self, now: Time) -> None:
        number = self._turn % AXES + 1
        text = f"{self._turn:08}/{number:02}"  # two segments
        self.nodes[number].write((TEXT >> 8, 0), text, now)
        self._transfer = (number, text, False)
        self._turn += 1

    def _on_transfer(self, event: SdoDownloaded | SdoUploaded | SdoAborted, now: Time) -> None:
        assert self._transfer is not None
        number, text, _ = self._transfer
        self._transfer = None
        if isinstance(event, SdoAborted):
            self.findings.aborts += 1
        elif isinstance(event, SdoDownloaded):
            self._transfer = (number, text, True)
            self.nodes[number].read((TEXT >> 8, 0), now)
        else:
            self.findings.transfers += 1
            if event.data != text.encode():
                self.findings.fail(f"axis {number} gave {event.data!r}, not {text!r}")
