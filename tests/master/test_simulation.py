"""Simulated devices as a participant of a bus."""

from contextlib import AbstractAsyncContextManager
from functools import partial
from typing import Any

import pytest

from canopen_master import BusError, Host, open_master, powerballs, simulate, standard_drives
from canopen_master.simulation import simulated_devices, simulated_drives
from canopen_master.simulation.parameter_keeper import ParameterKeeper
from canopen_proto.frame import Frame
from canopen_proto.heartbeat import NodeBooted
from canopen_proto.local_node import LocalNode
from canopen_proto.lss.assign import LssAssignment, assign_all, in_order
from canopen_proto.lss.messages import UNCONFIGURED
from canopen_proto.lss.scan import LssTool
from canopen_proto.machine import Event, LocalProtocolError, Outbox
from canopen_proto.nmt import NmtState
from canopen_proto.sdo.server import ObjectWritten
from canopen_proto.simulation.drive.node import powerball
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from canopen_transports import BusState, BusStateChanged, Report, TransportError, open_transport
from tests.core.devices import io_device
from tests.loops import loop
from tests.master.test_pump_abilities import Able
from tests.master.world import BUS, Breakable, virtual_time


@virtual_time
async def test_devices_boot_and_are_served_until_cancelled() -> None:
    events: list[Event] = []
    async with open_master(BUS) as master, loop.open_nursery() as nursery:
        with master.node(3).events(NodeBooted) as boots:
            host: Host = await nursery.start(simulate, await open_transport(BUS), powerballs(3))
            assert (await boots.receive()).node_id == 3
        nursery.cancel_scope.cancel()
        assert [node.node_id for node in host.nodes] == [3]
    transport = await open_transport(BUS)
    async with loop.open_nursery() as nursery:
        nursery.start_soon(_simulate, transport, events)
        async with open_master(BUS) as master:
            await loop.sleep(0.01)
            await master.node(5).write("controlword", 6)
        nursery.cancel_scope.cancel()
    assert any(isinstance(event, ObjectWritten) and event.index == 0x6040 for event in events)
    with pytest.raises(loop.ClosedResourceError):
        await transport.receive()


async def _simulate(transport, events: list[Event]) -> None:  # type: ignore[no-untyped-def]
    settings = DriveSettings(shape=Shape.STANDARD, position=0)
    await simulate(transport, standard_drives(5, settings=settings), on_event=events.append)


@virtual_time
async def test_two_devices_of_one_node_id_on_one_bus_are_refused_by_their_names() -> None:
    double = [*standard_drives(5), partial(powerball, node_id=6), partial(powerball, node_id=5)]
    told = (
        "'Simulated CiA 402 drive' and 'Simulated Schunk Powerball joint' both have node-ID 5 on virtual:test; give each its own"
    )
    with pytest.raises(LocalProtocolError, match=told):
        async with simulated_devices({BUS: double}):
            pytest.fail("they were served")
    with pytest.RaisesGroup(pytest.RaisesExc(LocalProtocolError, match=told)):
        async with loop.open_nursery() as nursery:
            await nursery.start(simulate, await open_transport(BUS), double)
    async with simulated_devices({BUS: double[:2], "virtual:other": double[2:]}) as served:  # on two buses it is no fault
        assert served.node_ids == [5, 6]
    nobody = partial(powerball, node_id=UNCONFIGURED)
    async with simulated_devices({BUS: [nobody, nobody]}) as served:
        assert served.node_ids == [UNCONFIGURED]


@virtual_time
async def test_a_failing_bus_ends_the_simulation() -> None:
    cable = Breakable()
    with pytest.RaisesGroup(pytest.RaisesExc(BusError, match="cable was cut")):
        async with loop.open_nursery() as nursery:
            await nursery.start(simulate, cable, powerballs(3))
            cable.cut()
    assert cable.closed == 1


@pytest.mark.both_loops
@pytest.mark.parametrize("end", [SystemExit(3), KeyboardInterrupt()])
@virtual_time
async def test_what_ends_a_program_leaves_the_block_of_simulated_drives_as_it_is(end: BaseException) -> None:
    with pytest.raises(type(end)) as raised:
        async with simulated_drives([(BUS, 3)]), open_master(BUS) as master:
            await master.node(3).read("statusword")
            raise end
    assert raised.value is end


NO_DEVICES: list[tuple[Any, str]] = [
    ({BUS: [5]}, "5 makes no device"),
    ({BUS: [*powerballs(3), None]}, "None makes no device"),
    ({BUS: powerballs(3)[0]}, "are no list"),
    ({None: powerballs(3)}, "locator None is no text"),
    ([BUS], "give the devices of each locator"),
    ({BUS: powerballs(0)}, "node-ID 0 is outside 1..127"),
]


@pytest.mark.both_loops
@virtual_time
async def test_whatever_prevents_simulated_devices_it_comes_out_as_one_error_and_not_as_a_group() -> None:
    for makers, seen in NO_DEVICES:
        with pytest.raises(LocalProtocolError, match=seen):
            await _enter(simulated_devices(makers))
    for drives in (3, [3], [(BUS, 3, 5)]):
        with pytest.raises(LocalProtocolError, match="give pairs of a locator and a node-ID"):
            await _enter(simulated_drives(drives))  # type: ignore[arg-type]
    with pytest.raises(LocalProtocolError, match="node-ID 0 is outside"):
        await _enter(simulated_drives([(BUS, 0)]))
    with pytest.raises(TransportError, match="no interface 'nosuch'") as raised:
        await _enter(simulated_drives([(BUS, 3), ("nosuch:bus", 3)]))
    assert raised.value.__context__ is None
    async with simulated_drives([(BUS, 3)]), open_master(BUS) as master:  # nothing of the others is left on the bus
        await master.node(3).read("statusword")


async def _enter(devices: AbstractAsyncContextManager[object]) -> None:
    async with devices:
        pass


@pytest.mark.parametrize("ended_by", [BusStateChanged("able", BusState.ACTIVE, "it is back"), Frame.parse("080#")])
@virtual_time
async def test_devices_hear_that_their_controller_went_off_the_bus(ended_by: Frame | Report) -> None:
    bus = Able()
    async with loop.open_nursery() as nursery:
        host: Host = await nursery.start(simulate, bus, powerballs(12))
        bus.feed(Frame.parse("000#010C"))
        await loop.sleep(0.1)
        assert host.nodes[0].state is NmtState.OPERATIONAL
        bus.feed(BusStateChanged("able", BusState.BUS_OFF, "too many errors"))
        await loop.sleep(0.1)
        assert host.nodes[0].state is NmtState.PRE_OPERATIONAL  # 0x1029:01
        assert not any(frame.startswith("08C#") for frame in bus.sent)
        bus.feed(ended_by)
        await loop.sleep(0.1)
        assert [frame[:8] for frame in bus.sent if frame.startswith("08C#")] == ["08C#4081", "08C#0000"]  # bus-off recovered
        nursery.cancel_scope.cancel()


@virtual_time
async def test_event_driven_tpdos_go_once_on_entering_operational() -> None:
    bus = Able()
    async with loop.open_nursery() as nursery:
        await nursery.start(simulate, bus, [lambda out: LocalNode(out, 5, io_device())])
        for _ in range(2):
            bus.sent.clear()
            bus.feed(Frame.parse("000#0105"))
            await loop.sleep(0.1)
        assert not bus.sent  # it was Operational already
        bus.feed(Frame.parse("000#8005"))
        bus.feed(Frame.parse("000#0105"))
        await loop.sleep(0.1)
        assert [frame for frame in bus.sent if frame.startswith("185#")] == ["185#0000"]
        nursery.cancel_scope.cancel()


@virtual_time
async def test_a_node_id_that_lss_stored_is_there_when_the_power_comes_back() -> None:
    keeper = ParameterKeeper()
    for expected in ([UNCONFIGURED, UNCONFIGURED], [10, 11]):
        transport = await open_transport(BUS)
        host = Host(transport, [partial(powerball_of, serial=2), partial(powerball_of, serial=7)], keeper=keeper)
        async with loop.open_nursery() as nursery:
            await nursery.start(host.serve)
            assert [node.node_id for node in host.nodes] == expected
            async with open_master(BUS) as master:
                tool = LssTool(master.bus().network.out)
                master.bus().network.attach(tool)
                known = (*host.nodes[0].lss.address[:3], None)
                result = await master.run(assign_all(LssAssignment(tool, in_order([10, 11]), known=known)))
                assert [given.is_complete for given in result.done] == ([True, True] if expected[0] == UNCONFIGURED else [])
                assert await master.node(11).read("device_type") == 0x20192
            nursery.cancel_scope.cancel()
        await transport.aclose()


def powerball_of(out: Outbox, serial: int) -> LocalNode:
    node = powerball(out, UNCONFIGURED)
    node.lss.address = node.lss.address._replace(serial=serial)
    return node
