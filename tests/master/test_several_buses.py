"""One master, two buses; the same node-ID on both."""

import pytest

from canopen_master import ChainFaultError, SdoTimeoutError, open_master
from canopen_proto.emcy import EmcyReceived
from canopen_proto.machine import LocalProtocolError
from canopen_proto.procedures.objects import read
from canopen_proto.procedures.steps import all_of
from canopen_transports import open_transport
from tests.loops import loop
from tests.master.world import assert_all_halted, assert_all_stand, drives, position_of, simulated, virtual_time

BUSES = {"can0": "virtual:one", "can1": "virtual:two"}


@virtual_time
async def test_a_node_is_a_bus_and_an_id() -> None:
    async with simulated(3, bus="virtual:one") as one, simulated(3, bus="virtual:two") as two, open_master(buses=BUSES) as master:
        with pytest.raises(LocalProtocolError, match="several buses .can0, can1.: say which"):
            master.node(3)
        first, second = master.node(3, bus="can0"), master.node(3, bus="can1")
        assert first is not second
        await first.write("ip_time_units", 11)
        await second.write("ip_time_units", 22)
        assert [host.nodes[0].values.store[0x60C2_01] for host in (one, two)] == [11, 22]
        assert await master.run(all_of(read(first.remote, "ip_time_units"), read(second.remote, "ip_time_units"))) == [11, 22]
        with first.events(EmcyReceived) as of_first, master.events(EmcyReceived, bus="can1") as of_second:
            two.nodes[0].raise_error(0x3220, 4, b"", two.now())
            two.pump()
            await of_second.receive()
            called: list[EmcyReceived] = []
            first.watch((EmcyReceived,), called.append)  # events are no longer handed over in lists alone
            two.nodes[0].clear_error(0x3220, two.now())
            two.pump()
            await of_second.receive()
            assert of_first.take() == called == []
        await master.nmt_start()
        await loop.sleep(0.001)
        assert [host.nodes[0].state.name for host in (one, two)] == ["OPERATIONAL", "OPERATIONAL"]
        await second.nmt(2)  # type: ignore[arg-type]  # a plain number will do
        with pytest.raises(LocalProtocolError, match="3 is not an NMT command; these are: 1 START, 2 STOP"):
            await second.nmt(3)  # type: ignore[arg-type]
        await loop.sleep(0.001)
        assert [host.nodes[0].state.name for host in (one, two)] == ["OPERATIONAL", "STOPPED"]
        with pytest.raises(SdoTimeoutError):
            await second.read("statusword")


@virtual_time
async def test_a_chain_over_two_buses_has_one_sync_on_both() -> None:
    async with (
        simulated(3, bus="virtual:one") as one,
        simulated(3, 4, bus="virtual:two") as two,
        open_master(buses=BUSES) as master,
        await open_transport("virtual:one") as spy,
    ):
        arm = master.load_chains(text="arm j1 can0 3 j2 can1 3 j3 can1 4")["arm"]
        await arm.initialise()
        await arm.home()
        await arm.enable_interpolated_position()
        async with await open_transport("virtual:two") as other_spy:
            async for cycle in arm.cycles():
                arm.set_positions([0.001 * cycle.number * factor for factor in (1, 2, 3)])
                if cycle.number == 50:
                    break
            stamps = []
            for each in (spy, other_spy):
                syncs = []
                with loop.move_on_after(0.0001):
                    while True:
                        frame, stamp = await each.receive()
                        if frame.can_id == 0x80:
                            syncs.append(stamp)
                stamps.append(syncs)
        assert len(stamps[1]) > 50
        assert stamps[0][-50:] == stamps[1][-50:]
        await loop.sleep(0.06)
        found = [position_of(host, node) for host in (one, two) for node in drives(host)]
        assert found == pytest.approx([2865, 5730, 8594], abs=1)
        await arm.shut_down()


@virtual_time
async def test_a_fault_on_one_bus_halts_the_joints_on_the_other() -> None:
    async with simulated(3, bus="virtual:one") as one, simulated(3, bus="virtual:two") as two, open_master(buses=BUSES) as master:
        arm = master.load_chains(text="arm j1 can0 3 j2 can1 3")["arm"]
        await arm.initialise()
        await arm.enable_interpolated_position()
        start = arm.positions
        with pytest.raises(ChainFaultError, match=r"j1 \(node 3 on can0\)"):
            async for cycle in arm.cycles():
                arm.set_positions([position + 0.001 * cycle.number for position in start])
                if cycle.number == 30:
                    drives(one)[0].raise_fault(0x3220, one.now())
                    one.pump()
        assert_all_halted(two)
        await assert_all_stand(two)


@virtual_time
async def test_cancelled_both_buses_are_halted() -> None:
    async with simulated(3, bus="virtual:one") as one, simulated(3, bus="virtual:two") as two:
        with loop.move_on_after(0.5):
            async with open_master(buses=BUSES) as master:
                arm = master.load_chains(text="arm j1 can0 3 j2 can1 3")["arm"]
                await arm.initialise()
                await arm.home()
        for host in (one, two):
            assert_all_halted(host)
            await assert_all_stand(host)
