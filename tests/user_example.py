"""What somebody writes who installed these packages. It runs as it stands, and `mypy --strict` has nothing to say about it.

First the core in a loop of one's own, with a machine, an event and a sequence of one's own; then a script for the master.
"""

from __future__ import annotations

from collections.abc import Iterable

import trio

from canopen_data import load_dictionary
from canopen_master import AxisSettings, Master, SdoError, open_master, powerballs, simulate
from canopen_proto import (
    MILLISECOND,
    NEVER,
    SECOND,
    Event,
    Frame,
    Machine,
    Network,
    NodeBooted,
    Outbox,
    ProcedureFailed,
    ProcedureFinished,
    RemoteNode,
    RoutingKey,
    Time,
    powerball,
    routing_key,
)
from canopen_proto.procedures import Procedure, read_int, sleep, write
from canopen_transports import open_transport

# ---- a machine of one's own: a sensor that speaks no CANopen, on CAN-ID 0x123 ----


class TooHot(Event):
    __slots__ = ("degrees",)
    __match_args__ = ("node_id", "degrees")

    def __init__(self, degrees: float) -> None:
        self.node_id = 0
        self.degrees = degrees


class SensorSilent(Event):
    __slots__ = ()


class Thermometer(Machine):
    """Reports each value above `limit`, and a sensor that says nothing for a second."""

    def __init__(self, out: Outbox, limit: float, now: Time) -> None:
        super().__init__(out)
        self.limit = limit
        self._arm(now + SECOND)

    def can_ids(self) -> Iterable[RoutingKey]:
        return (routing_key(0x123),)

    def receive(self, frame: Frame, now: Time) -> None:
        self._arm(now + SECOND)
        degrees = int.from_bytes(frame.data[:2], "little", signed=True) / 10
        if degrees > self.limit:
            self.out.events.append(TooHot(degrees))

    def handle_timeout(self, now: Time) -> None:
        if now >= self.deadline:
            self.deadline = NEVER
            self.out.events.append(SensorSilent(0))


# ---- a sequence of one's own ----


def watch_over(node: RemoteNode, period: Time) -> Procedure[str]:
    """Let the node send its heartbeat, and say what it is."""
    yield from write(node, "producer_heartbeat_time", period // MILLISECOND)
    yield from sleep(2 * period)
    device_type = yield from read_int(node, "device_type")
    return f"a device of profile {device_type & 0xFFFF}, {node.nmt_state}"


# ---- the loop: two participants on one cable, in a time of its own ----


def embedded() -> list[str]:
    device, host = Network(), Network()
    drive = powerball(device.out, 12)
    device.attach(drive)
    node = RemoteNode(host.out, 12, load_dictionary()[0])
    host.attach(node)
    host.attach(Thermometer(host.out, 40.0, 0))
    drive.boot(0)

    now: Time = 0
    told: list[str] = []
    while now < 2 * SECOND:
        moved = True
        while moved:  # until neither has anything to say
            moved = False
            for sender, receiver in ((device, host), (host, device)):
                frames, events = sender.drain(now)
                moved = moved or bool(frames or events)
                for frame in frames:
                    receiver.receive(frame, now)
                for event in events:
                    match event:
                        case NodeBooted(node_id=12):
                            host.run(watch_over(node, 100 * MILLISECOND), now)
                        case ProcedureFinished(result=result):
                            told.append(str(result))
                            host.receive(Frame(0x123, (415).to_bytes(2, "little")), now)  # as if a sensor had sent it
                        case ProcedureFailed(error=error):
                            raise error
                        case TooHot(degrees=degrees):
                            told.append(f"{degrees} degrees")
                        case SensorSilent():
                            told.append("the sensor is silent")
        now = min(device.next_deadline(), host.next_deadline())
        device.handle_timeout(now)
        host.handle_timeout(now)
    return told


# ---- a script for the master ----


async def name_of(master: Master, node_id: int) -> str:
    try:
        return await master.node(node_id).read_str("manufacturer_device_name")
    except SdoError as error:
        return f"{error.code}: {error.failed}"


async def scripted() -> list[str]:
    told: list[str] = []
    async with trio.open_nursery() as nursery:
        await nursery.start(simulate, await open_transport("virtual:user"), powerballs(12))
        async with open_master(buses={"/dev/pcan32": "virtual:user"}) as master:
            told.append(await name_of(master, 12))
            arm = master.load_chains("single_device.csv", axes=AxisSettings(counts_per_unit=57_295.8))["chain1"]
            await arm.initialise()
            await arm.home()
            await arm.enable_interpolated_position()
            async for cycle in arm.cycles():
                arm.set_positions([0.1 * cycle.time])
                if cycle.time >= 0.1:
                    break
            await arm.halt()
            told += [f"{name} at {joint.position:.2f}" for name, joint in arm.joints.items()]
            await arm.shut_down()
        nursery.cancel_scope.cancel()
    return told
