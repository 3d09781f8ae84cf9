"""Plans the traffic of a bus before it is built: a worst-case analysis, and a run of the bus machine.

There is one bus, one master, and one device for each joint. In each cycle the master sends SYNC and then one RPDO for each joint;
each device answers the SYNC by its TPDO. There are also heartbeats, one SDO transfer in the background, and EMCYs. Each of these
is a `Stream` with its identifier, size and period:

- The deadline of SYNC is its period. The deadline of an RPDO and of a TPDO is the next SYNC. The jitter of a TPDO is the delay of
  its SYNC; the device's own time is added.
- A device sends an event-driven TPDO at most once per inhibit time, or once per event timer: its period and its deadline.
- SDO: the client waits for each answer, so there is one request and one answer per `sdo` time, counted as those of the
  highest node-ID; the deadline of each is SDO_DEADLINE.
- EMCY: a device may send one per EMCY_INTERVAL, at worst all devices at once. The deadline is the period, as for heartbeats.

`bus_timing` bounds each stream's latency (canopen_transports.wire.response_time) with the most stuff bits possible. It also
runs the bus machine for some cycles, with random phases of the streams that are not cyclic. Its latencies are never above the
bound, and show usual values. With `OtherTraffic.errors` the bound has room for errors on the bus, each with an error frame and
a repeated frame; the machine has no errors. A latency lasts from queueing the frame (for a TPDO, the SYNC) to the end of the
intermission.

Left out: NMT and TIME (rare), LSS, guarding, frames to devices that are not joints.
"""

from __future__ import annotations

import heapq
import random
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from canopen_proto.frame import EMCY, ERROR_CONTROL, SDO_CLIENT_TO_SERVER, SDO_SERVER_TO_CLIENT, SYNC, Frame
from canopen_proto.machine import MICROSECOND, MILLISECOND, NEVER, LocalProtocolError, Time
from canopen_transports.wire import (
    PeriodicMessage,
    QueueOrder,
    ResponseTime,
    Wire,
    WireMember,
    WireSettings,
    response_times,
    worst_bits,
)
from canopen_transports.wire.response_time import utilisation

EMCY_INTERVAL: Final = 100 * MILLISECOND
"""The least time between two EMCYs of a device: drives have an inhibit time, or few errors."""
SDO_DEADLINE: Final = 100 * MILLISECOND
"""The deadline of one frame; clients wait 300 ms or more for an answer."""
SIMULATED_CYCLES: Final = 200
"""The least number of cycles; the run also goes on until each stream has come once."""
SIMULATED_FRAMES: Final = 20_000
"""The most frames of a run: about a second of computing, whatever the periods are."""
CYCLES: Final = (
    *range(100 * MICROSECOND, 25_600 * MICROSECOND, 100 * MICROSECOND),
    *range(26 * MILLISECOND, 256 * MILLISECOND, MILLISECOND),
)
"""Cycle times that 0x60C2 can hold in its one byte: in tenths of a millisecond up to 25.5 ms, then in milliseconds."""
MASTER: Final = "master"
STUFFING: Final = 0x3C
"""A byte with many stuff bits: the machine's frames are nearly as long as frames can be."""


@dataclass(frozen=True, slots=True)
class Stream:
    """A frame that is sent repeatedly.

    kind: "SYNC", "RPDO", "TPDO", "event" (an event-driven TPDO), "heartbeat", "EMCY" or "SDO". node_id: 0 for SYNC. name: for
    people. size: bytes. period, deadline: ns. reaction: the time that the device takes from SYNC to its TPDO, ns.
    """

    kind: str
    name: str
    node_id: int
    can_id: int
    size: int
    period: Time
    deadline: Time
    reaction: Time = 0

    @property
    def is_from_master(self) -> bool:
        """Whether the master sends it; else its node does."""
        return self.kind in ("SYNC", "RPDO") or (self.kind == "SDO" and self.can_id >= SDO_CLIENT_TO_SERVER)

    @property
    def answers_sync(self) -> bool:
        """Whether its node sends it at a SYNC."""
        return self.kind == "TPDO"


@dataclass(frozen=True, slots=True)
class StreamTiming:
    """The latencies of a stream, ns. worst: the bound, or NEVER. simulated: the longest in the machine; None if none was sent."""

    stream: Stream
    worst: Time
    simulated: Time | None

    @property
    def fits(self) -> bool:
        """Whether the stream always meets its deadline."""
        return self.worst <= self.stream.deadline

    @property
    def margin(self) -> Time:
        """The time left until the deadline, ns; below 0 if the stream does not fit."""
        return self.stream.deadline - self.worst


@dataclass(frozen=True, slots=True)
class BusTiming:
    """The timing of one bus. load: the greatest share of the bus in use; simulated_load: the share in the machine.

    shortest_cycle: the shortest of CYCLES that fits; None if none does.
    """

    bus: str
    bitrate: int
    cycle: Time
    streams: tuple[StreamTiming, ...]
    load: float
    simulated_load: float
    shortest_cycle: Time | None

    @property
    def fits(self) -> bool:
        """Whether all streams always meet their deadlines."""
        return all(each.fits for each in self.streams)


@dataclass(frozen=True, slots=True)
class Exchange:
    """The PDOs exchanged with one joint in each cycle. rpdo, tpdo: (CAN-ID, bytes). events: event-driven TPDOs, as (CAN-ID,
    bytes, shortest distance in ns)."""

    name: str
    node_id: int
    rpdo: tuple[tuple[int, int], ...]
    tpdo: tuple[tuple[int, int], ...]
    events: tuple[tuple[int, int, Time], ...] = ()


@dataclass(frozen=True, slots=True)
class OtherTraffic:
    """The other traffic. heartbeat: period of each device; sdo: time between two requests; emcy: between two of one device;
    each 0 for none. reaction: ns that a device takes to answer a SYNC. order: of the transmit queues. sync_counter: whether SYNC
    carries its counter. errors: the shortest time between two errors on the bus; NEVER: none."""

    heartbeat: Time = 500 * MILLISECOND
    sdo: Time = 10 * MILLISECOND
    emcy: Time = EMCY_INTERVAL
    reaction: Time = 100 * MICROSECOND
    order: QueueOrder = QueueOrder.PRIORITY
    sync_counter: bool = False
    errors: Time = NEVER


def streams_of(joints: Sequence[Exchange], cycle_time: Time, background: OtherTraffic) -> tuple[Stream, ...]:
    """Return all streams on a bus with these joints. Raises LocalProtocolError if two have the same identifier. cycle_time: ns.
    background: what else is on the bus."""
    streams = [Stream("SYNC", "SYNC", 0, SYNC, int(background.sync_counter), cycle_time, cycle_time)]
    for joint in joints:
        for kind, pdos in (("RPDO", joint.rpdo), ("TPDO", joint.tpdo)):
            reaction = background.reaction if kind == "TPDO" else 0
            for can_id, size in pdos:
                streams.append(
                    Stream(kind, f"{kind} {joint.name}", joint.node_id, can_id, size, cycle_time, cycle_time, reaction)
                )
        for can_id, size, period in joint.events:
            streams.append(Stream("event", f"TPDO {joint.name} (event)", joint.node_id, can_id, size, period, period))
        rare = (("heartbeat", ERROR_CONTROL, 1, background.heartbeat), ("EMCY", EMCY, 8, background.emcy))
        for kind, base, size, period in rare:
            if period:
                name = f"{kind} {joint.name}"
                streams.append(Stream(kind, name, joint.node_id, base + joint.node_id, size, period, period))
    if background.sdo and joints:
        node_id = max(joint.node_id for joint in joints)
        for name, base in (("SDO request", SDO_CLIENT_TO_SERVER), ("SDO answer", SDO_SERVER_TO_CLIENT)):
            streams.append(Stream("SDO", name, node_id, base + node_id, 8, background.sdo, SDO_DEADLINE))
    by_id: dict[int, Stream] = {}
    for stream in streams:
        other = by_id.setdefault(stream.can_id, stream)
        if other is not stream:
            raise LocalProtocolError(f"{other.name} and {stream.name} both have the CAN-ID 0x{stream.can_id:X}")
    return tuple(streams)


def bounds(streams: Sequence[Stream], bitrate: int, order: QueueOrder, errors: Time = NEVER) -> list[ResponseTime]:
    """Return the worst-case response time of each stream. errors: the shortest time between two, ns. bitrate: bit/s. order: in
    which a node's queue sends."""
    messages = [_message(stream, bitrate, order) for stream in streams]
    # A TPDO is late by the delay of its SYNC and the device's own time.
    late = response_times(messages, bitrate, error_interval=errors)[0].worst
    if late >= NEVER:
        return [ResponseTime(message, NEVER, 0, 0, 0) for message in messages]
    messages = [
        replace(message, jitter=late + stream.reaction) if stream.answers_sync else message
        for stream, message in zip(streams, messages, strict=True)
    ]
    return response_times(messages, bitrate, error_interval=errors)


def _message(stream: Stream, bitrate: int, order: QueueOrder) -> PeriodicMessage:
    time = Wire(WireSettings(bitrate=bitrate)).time_of(worst_bits(stream.size))
    sender = MASTER if stream.is_from_master else str(stream.node_id)
    queue = sender if order is QueueOrder.FIFO else None
    return PeriodicMessage(stream.name, stream.can_id, time, stream.period, deadline=stream.deadline, queue=queue)


def bus_timing(
    bus: str, joints: Sequence[Exchange], cycle_time: Time, bitrate: int, background: OtherTraffic = OtherTraffic()
) -> BusTiming:
    """Analyse a bus with these joints: whether all streams fit, and their latencies. cycle_time: ns. bitrate: bit/s. background:
    what else is on the bus."""
    streams = streams_of(joints, cycle_time, background)
    found = bounds(streams, bitrate, background.order, background.errors)
    worst, load = simulate(streams, bitrate, background.order)
    plans = tuple(StreamTiming(stream, each.worst, worst.get(stream.can_id)) for stream, each in zip(streams, found, strict=True))
    return BusTiming(
        bus,
        bitrate,
        cycle_time,
        plans,
        utilisation([each.message for each in found]),
        load,
        shortest_cycle(joints, bitrate, background),
    )


def shortest_cycle(joints: Sequence[Exchange], bitrate: int, background: OtherTraffic) -> Time | None:
    """Return the shortest of CYCLES that fits, ns; None if none does. bitrate: bit/s. background: what else is on the bus."""
    # By halves: streams that fit into a cycle also fit into each longer one
    place = bisect_left(CYCLES, True, key=lambda cycle: fits(streams_of(joints, cycle, background), bitrate, background))
    return CYCLES[place] if place < len(CYCLES) else None


def fits(streams: Sequence[Stream], bitrate: int, background: OtherTraffic) -> bool:
    """Return whether all streams always meet their deadlines. bitrate: bit/s. background: what else is on the bus."""
    return all(each.fits for each in bounds(streams, bitrate, background.order, background.errors))


def simulate(
    streams: Sequence[Stream], bitrate: int, order: QueueOrder, cycles: int = SIMULATED_CYCLES, seed: int = 0
) -> tuple[dict[int, Time], float]:
    """Run the bus machine. Returns the longest latency of each CAN-ID that was sent, and the load. bitrate: bit/s. order: in
    which a node's queue sends. seed: of the phases.

    Frames without room in their queue are left out. cycles: the least number; each stream comes at least once, within
    SIMULATED_FRAMES.
    """
    wire = Wire(WireSettings(bitrate=bitrate))
    members: dict[int, WireMember] = {0: wire.join(0, order=order)}
    for stream in streams:
        if stream.node_id not in members:
            members[stream.node_id] = wire.join(0, order=order)
    wire.join(0)  # acknowledges the frames of the last one
    frames = {stream.can_id: Frame(stream.can_id, bytes((STUFFING,)) * stream.size) for stream in streams}
    phases = random.Random(seed)
    end = max(cycles * streams[0].period, *(stream.period for stream in streams))
    end = min(end, round(SIMULATED_FRAMES / sum(1 / stream.period for stream in streams)))
    # Frames to queue: (time, place in the list of streams), so that a SYNC goes before its RPDOs.
    due = [
        (0 if stream.kind in ("SYNC", "RPDO") else phases.randrange(stream.period), place)
        for place, stream in enumerate(streams)
        if not stream.answers_sync
    ]
    heapq.heapify(due)
    worst: dict[int, Time] = {}
    answers = {stream.can_id: place for place, stream in enumerate(streams) if stream.answers_sync}
    while due and due[0][0] < end:
        time, place = due[0]
        ready = wire.next_deadline()
        if ready < time:
            wire.handle_timeout(ready)
            for delivery in wire.drain()[0]:
                can_id = delivery.frame.can_id
                since = delivery.queued
                if can_id == SYNC:
                    for number in answers.values():
                        heapq.heappush(due, (delivery.at + streams[number].reaction, number))
                elif can_id in answers:
                    since -= since % streams[0].period  # from the SYNC on
                worst[can_id] = max(worst.get(can_id, 0), delivery.at + wire.time_of(3) - since)
            continue
        stream = streams[place]
        heapq.heappop(due)
        if not stream.answers_sync:
            heapq.heappush(due, (time + stream.period, place))
        member = members[0 if stream.is_from_master else stream.node_id]
        if member.has_room:
            wire.send(member, frames[stream.can_id], time)
    return worst, wire.load(end)


def milliseconds(time: Time) -> str:
    """Return a time for people: "0.27 ms"."""
    return "no bound" if time >= NEVER else f"{time / MILLISECOND:.2f} ms"
