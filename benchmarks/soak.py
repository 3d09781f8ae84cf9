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
  heartbeat by HeartbeatLost; an SDO transfer fails where one of its frames was lost, and only where one was hit. Nothing else is
  missing or comes twice.
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

from soak_stations import AXES, TRANSFER_CYCLES, Axis, Findings, Master, Station

from canopen_proto.frame import ERROR_CONTROL, RPDO1, SDO_CLIENT_TO_SERVER, SDO_SERVER_TO_CLIENT, SYNC, TPDO1, Frame
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Time
from canopen_transports.locator import bitrate_text, parse_bitrate
from canopen_transports.wire import FaultHappened, FaultKind, FaultRates, StateReported, Wire, WireSettings

LOAD = 0.5
RATES = FaultRates(loss=0.0005, corruption=0.0004, repetition=0.0001)
SETTLE = 2 * SECOND
"""At both ends without faults: so that all is under way, and that all which is under way comes to its end."""
SDO = (SDO_CLIENT_TO_SERVER, SDO_SERVER_TO_CLIENT)
SDO_ABORT = 0x80
SCENARIOS = ("1M:3600", "125k:86400")


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
            elif service not in SDO or report.frame.data[0] != SDO_ABORT:  # after an abort nothing more can go wrong
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
        lost, repeated = (
            sum(tally[f"{kind.name} {service:X}"] for service in SDO) for kind in (FaultKind.LOSS, FaultKind.REPETITION)
        )
        if not lost <= findings.aborts <= lost + repeated:
            findings.fail(f"SDO: {findings.aborts} aborts, but {lost} of its frames were lost, and {repeated} repeated")


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
