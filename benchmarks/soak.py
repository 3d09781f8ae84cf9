"""A soak in virtual time: a master and twelve axes for hours on a bus with the physics of copper, half loaded, with faults.

    python benchmarks/soak.py                       both: 1 h at 1 Mbit/s, and 24 h at 125 kbit/s
    python benchmarks/soak.py 1M:60 125k:600        so many simulated seconds of each
    python benchmarks/soak.py 1M:3600 --seed 7

In each cycle: SYNC, an RPDO to each axis, a TPDO from each axis; besides heartbeats, and SDO transfers all the time. The cycle is
as long as makes half a load. Of a thousand frames one is hit: half of these are lost at one receiver, most of the others
corrupted and sent again, the rest repeated.

Checked, and the exit status is 1 where one of it is not so:

- No wrong value: each PDO carries a number and a check sum of it and its node; what SDO writes is read back.
- Every fault is noticed by whom it concerns: a TPDO that is missing or comes twice shows in its cycle, an RPDO by its number, a
  heartbeat by HeartbeatLost; an SDO transfer fails only where one of its frames was hit. Nothing else is missing or comes twice.
- No drift: each SYNC is queued at start + n * period, to the nanosecond.
- No growth: the interpreter's memory blocks at the end are those after the first twentieth.

Devices see the frames that their acceptance filter lets through (`Network.can_ids`), as with a real controller; the master sees
all.
"""

from __future__ import annotations

import argparse
import gc
import heapq
import sys
import time
from collections import Counter
from dataclasses import dataclass, field

from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.frame import ERROR_CONTROL, RPDO1, SDO_CLIENT_TO_SERVER, SDO_SERVER_TO_CLIENT, SYNC, TPDO1, Frame
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
from canopen_transports.locator import bitrate_text, parse_bitrate
from canopen_transports.wire import FaultHappened, FaultKind, FaultRates, StateReported, Wire, WireSettings

AXES = 12
LOAD = 0.5
RATES = FaultRates(loss=0.0005, corruption=0.0004, repetition=0.0001)
HEARTBEAT = 500 * MILLISECOND
SETTLE = 2 * SECOND
"""At both ends without faults: so that all is under way, and that all which is under way comes to its end."""
TRANSFER_CYCLES = 4
"""From one SDO transfer (a text written and read back, in 12 frames) to the next."""
TARGET, TARGET_CHECK, ACTUAL, ACTUAL_CHECK, TEXT = 0x2000 << 8, 0x2001 << 8, 0x2100 << 8, 0x2101 << 8, 0x2200 << 8
SCENARIOS = ("1M:3600", "125k:86400")


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


class Soak:
    """The whole of it. bitrate: bit/s; the cycle follows from the load."""

    def __init__(self, bitrate: int, seed: int) -> None:
        self.findings = Findings()
        self.wire = Wire(WireSettings(bitrate=bitrate, seed=seed))
        frames = 2 * AXES + 12 / TRANSFER_CYCLES  # in each cycle, of 8 bytes and as a rule 118 bits; besides SYNC and heartbeats
        cyclic = round(frames * 118 + 60 + 12)
        self.period = round(self.wire.time_of(cyclic) / LOAD / 100_000) * 100_000
        self.master = Master(self.wire, self.period, self.findings)
        self.stations: list[Station] = [self.master, *(Axis(self.wire, number, self.findings) for number in range(1, AXES + 1))]
        self._heap: list[tuple[Time, int]] = []
        self.now: Time = 0
        self._hit_targets: dict[int, tuple[bytes, int]] = {}  # by node-ID: the last one, and how often it comes in all
        for station in self.stations:
            self._settle(station)
        for station in self.stations[1:]:
            station.wanted = frozenset(station.network.can_ids())

    def start(self) -> None:
        """The nodes have booted: start them, and the cycle."""
        self.master.start(self.now)
        self._settle(self.master)

    def run(self, until: Time) -> None:
        """Let time pass."""
        wire, heap, stations = self.wire, self._heap, self.stations
        while True:
            due = wire.next_deadline()
            if heap and heap[0][0] <= due:
                due, number = heap[0]
                if due > until:
                    break
                heapq.heappop(heap)
                station = stations[number]
                if station.wake != due:
                    continue  # it was woken for another reason meanwhile
                self.now = due
                station.wake = NEVER
                station.network.handle_timeout(due)
                self._settle(station)
                continue
            if due > until:
                break
            self.now = due
            wire.handle_timeout(due)
            deliveries, reports = wire.drain()
            for report in reports:
                self._on_report(report)
            for delivery in deliveries:
                self._deliver(delivery.frame, [member.number for member in delivery.receivers], delivery.at - delivery.queued)
        self.now = until

    def _deliver(self, frame: Frame, receivers: list[int], latency: Time) -> None:
        key = frame.key
        if key == SYNC:
            self.findings.longest_sync = max(self.findings.longest_sync, latency)
        for number in receivers:
            station = self.stations[number]
            if station.wanted is None or key in station.wanted:
                station.network.receive(frame, self.now)
                self._settle(station)

    def _settle(self, station: Station) -> None:
        network, now = station.network, self.now
        frames, events = network.drain(now)
        while frames or events:
            for frame in frames:
                self.wire.send(station.member, frame, now)
            if not events:
                break
            station.on_events(events, now)
            frames, events = network.drain(now)
        wake = network.next_deadline()
        if wake < station.wake:
            station.wake = wake
            heapq.heappush(self._heap, (wake, station.number))

    def _on_report(self, report: FaultHappened | StateReported) -> None:
        if isinstance(report, StateReported):
            self.findings.faults[f"member {report.member.number} {report.state.value}"] += 1
            return
        can_id, who, kind = report.frame.can_id, report.member.number, report.kind
        service, node_id = can_id & 0x780, can_id & 0x7F
        tally, expected = self.findings.faults, self.master.expected
        tally[kind.value] += 1
        step = {FaultKind.LOSS: -1, FaultKind.REPETITION: 1}.get(kind, 0)
        if kind is FaultKind.NOT_SENT or not step:
            return
        if can_id == SYNC:
            for number in expected if step > 0 else (who,):
                expected[number] += step
        elif service == TPDO1 and (step > 0 or who == 0):
            expected[node_id] += step
        if step > 0 or who == (node_id if service in (RPDO1, SDO_CLIENT_TO_SERVER) else 0):
            if service == RPDO1:
                self._on_target_hit(node_id, report.frame.data, step)
            else:
                tally[f"{kind.name} {service:X}"] += 1

    def _on_target_hit(self, node_id: int, data: bytes, step: int) -> None:
        """A target was lost, or came once more. What hits one target twice may cancel out: a copy that is lost is no fault."""
        known, count = self._hit_targets.get(node_id, (b"", 1))
        if known != data:
            self._count_target(count)
            count = 1
        self._hit_targets[node_id] = data, count + step

    def _count_target(self, count: int) -> None:
        tally = self.findings.faults
        tally[f"LOSS {RPDO1:X}"] += count <= 0
        tally[f"REPETITION {RPDO1:X}"] += max(count - 1, 0)

    # ---- the report ----

    def check(self) -> None:
        """What has to hold in the end."""
        findings, tally = self.findings, self.findings.faults
        for _, count in self._hit_targets.values():
            self._count_target(count)
        for what, seen, expected in (
            ("targets missing", findings.gaps, tally[f"LOSS {RPDO1:X}"]),
            ("targets twice", findings.repeats, tally[f"REPETITION {RPDO1:X}"]),
            ("heartbeats missing", findings.heartbeats_lost, tally[f"LOSS {ERROR_CONTROL:X}"]),
        ):
            if seen != expected:
                findings.fail(f"{what}: {seen} were noticed, {expected} there were")
        sdo = (f"{SDO_CLIENT_TO_SERVER:X}", f"{SDO_SERVER_TO_CLIENT:X}")
        hits = sum(tally[f"{kind} {service}"] for kind in ("LOSS", "REPETITION") for service in sdo)
        if findings.aborts > hits:
            findings.fail(f"SDO: {findings.aborts} aborts, but only {hits} of its frames were hit")


def soak(text: str, seed: int) -> bool:
    """Run one scenario ("1M:3600"); whether all was as it should be."""
    rate, _, seconds = text.partition(":")
    bitrate, length = parse_bitrate(rate), round(float(seconds) * SECOND)
    run, begun = Soak(bitrate, seed), time.perf_counter()
    run.run(SECOND)
    run.start()
    run.run(run.now + SETTLE)
    start, wire = run.now, run.wire
    run.master.judging, wire.rates = True, RATES
    wire.begin_load(start)
    blocks = []
    for part in range(1, 21):
        run.run(start + length * part // 20)
        gc.collect()
        blocks.append(sys.getallocatedblocks())
    load = wire.load(run.now)
    wire.rates = FaultRates()
    run.run(run.now + SETTLE)
    run.check()
    findings, took = run.findings, time.perf_counter() - begun
    growth = blocks[-1] - blocks[0]
    if growth > 0.01 * blocks[0]:
        findings.fail(f"{growth} memory blocks more than at the beginning ({blocks[0]})")
    print(f"{bitrate_text(bitrate)}bit/s, {length / SECOND:g} s simulated, seed {seed}")
    print(f"  took       {took:.1f} s, {length / SECOND / took:.1f} times real time, {took / wire.frames * 1e6:.0f} us per frame")
    print(f"  traffic    {wire.frames} frames, load {load:.1%}, cycle {run.period / MILLISECOND:g} ms, {findings.cycles} cycles")
    kinds = {kind.value for kind in FaultKind}
    faults = [f"{count} {kind}" for kind, count in findings.faults.items() if kind in kinds or kind.startswith("member")]
    print(f"  faults     {', '.join(faults)}")
    print(f"  noticed    TPDO {findings.absent} missing, {findings.twice} twice; RPDO {findings.gaps} missing,", end="")
    print(f" {findings.repeats} twice; {findings.heartbeats_lost} heartbeats")
    print(f"  SDO        {findings.transfers} texts written and read back, {findings.aborts} aborts")
    print(f"  SYNC       no drift; the latest was out {findings.longest_sync / MILLISECOND:.3f} ms after its time")
    print(f"  memory     {blocks[0]} blocks after a twentieth, {blocks[-1]} at the end ({growth:+d})")
    for wrong in findings.wrong:
        print(f"  WRONG      {wrong}")
    print(f"  verdict    {'FAILED' if findings.wrong else 'as it should be'}", flush=True)
    return not findings.wrong


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description="a soak in virtual time")
    parser.add_argument("scenarios", nargs="*", default=SCENARIOS, metavar="BITRATE:SECONDS")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    outcomes = [soak(text, arguments.seed) for text in arguments.scenarios]
    return 0 if all(outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
