"""Reading and writing objects of a node, and what becomes of it when it fails or is cancelled."""

import dataclasses

import pytest

from canopen_master import (
    BusError,
    MasterClosedError,
    SdoError,
    SdoGivenUpError,
    SdoRefusedError,
    SdoTimeoutError,
    UnexpectedAnswerError,
    UnknownChainError,
    open_master,
    standard_drives,
)
from canopen_proto.datatypes import DataType, ValueRangeError
from canopen_proto.dictionary import Message, ObjectNotFoundError
from canopen_proto.dictionary.model import Object
from canopen_proto.machine import Event, LocalProtocolError
from canopen_proto.nmt import NmtState
from canopen_proto.procedures.objects import read, write
from canopen_proto.procedures.steps import Cancelled, ProcedureError, sleep
from canopen_transports import open_transport
from tests.master.loops import loop, settled
from tests.master.world import BUS, simulated, value, virtual_time


@virtual_time
async def test_read_and_write_by_name_number_and_constant() -> None:
    async with simulated(12) as host, open_master(BUS) as master:
        node = master.node(12)
        assert await node.read("statusword") == await node.read(0x6041) == await node.read("6041:00") == 0x240
        await node.write("controlword", "sm_shutdown")
        assert value(host.nodes[0], 0x6040_00) == 6
        await node.write((0x60C2, 1), 20)
        assert await node.read("ip_time_units") == 20
        assert await node.matches("statusword", "ready_to_switch_on")
        assert not await node.matches("statusword", "operation_enable")
        message = await node.read_message("statusword")
        assert isinstance(message, Message)
        assert (message.node_id, message.name, message.value) == (12, "statusword", 0x221)
        assert "ready_to_switch_on" in message.constants
        assert message.timestamp == master.now()


@pytest.mark.parametrize(("mode", "name"), [(1, "set_point_acknowledge"), (3, "speed_0"), (8, "drive_follows_command")])
@virtual_time
async def test_the_names_of_a_statusword_are_those_of_the_active_mode(mode: int, name: str) -> None:
    async with simulated(makers=standard_drives(12)), open_master(BUS) as master:
        node = master.node(12)
        await node.write("modes_of_operation", mode)
        for word in (6, 7, 15, 31):
            await node.write("controlword", word)
        message = await node.read_message("statusword")
        assert message.constants == ("operation_enable", "voltage_enabled", "remote", *message.constants[3:])
        of_bit_12 = {"set_point_acknowledge", "speed_0", "homing_attained", "ip_mode_active", "drive_follows_command"}
        assert of_bit_12 & set(message.constants) == {name}


@virtual_time
async def test_bytes_of_objects_that_no_dictionary_has() -> None:
    async with simulated(12), open_master(BUS) as master:
        node = master.node(12)
        assert await node.read_bytes(0x1000) == bytes.fromhex("92010200")
        await node.write_bytes(0x60C2, 1, b"\x05")
        assert await node.read_bytes(0x60C2, 1) == b"\x05"
        with pytest.raises(SdoRefusedError, match="refused writing 00 to 5FFF:01"):
            await node.write_bytes(0x5FFF, 1, b"\x00")


@virtual_time
async def test_a_wrong_call_sends_nothing() -> None:
    async with simulated(12), open_master(BUS) as master, await open_transport(BUS) as spy:
        node = master.node(12)
        with pytest.raises(ObjectNotFoundError, match="did you mean statusword"):
            await node.read("statuswort")
        with pytest.raises(ValueRangeError, match="controlword"):
            await node.write("controlword", 70000)
        with pytest.raises(LocalProtocolError, match="cannot be written"):
            await node.write("statusword", 1)
        with pytest.raises(LookupError, match="no constant"):
            await node.matches("statusword", "no_such_constant")
        with pytest.raises(LocalProtocolError, match="127"):
            master.node(200)
        with loop.move_on_after(1):
            pytest.fail(f"{await spy.receive()} was sent")


@virtual_time
async def test_a_refusal_says_what_was_asked_and_why_not() -> None:
    async with simulated(12), open_master(BUS) as master:
        node = master.node(12)
        with pytest.raises(SdoRefusedError) as caught:
            await node.read("touch_probe_function")  # the Powerball has none
        error = caught.value
        assert isinstance(error, SdoError)
        assert (error.node_id, error.bus, error.index, error.subindex) == (12, BUS, 0x60B8, 0)
        assert error.abort_code == 0x06020000
        assert error.code == "CO202"
        assert "node 12 refused reading 60B8:00 (touch_probe_function)" in str(error)
        assert "0x06020000" in error.seen
        assert error.tries


@virtual_time
async def test_a_node_that_was_never_heard() -> None:
    async with simulated(12), open_master(BUS, sdo_timeout=0.3) as master:
        started = loop.current_time()
        with pytest.raises(SdoTimeoutError) as caught:
            await master.node(13).read("statusword")
        assert loop.current_time() - started == pytest.approx(0.3)
        assert isinstance(caught.value, TimeoutError)
        assert caught.value.code == "CO201"
        assert "did not answer reading 6041:00 (statusword) in 0.3 s" in str(caught.value)
        assert "nothing at all was heard on this bus" in caught.value.seen
        with pytest.raises(SdoTimeoutError, match="may have been executed"):
            await master.node(13).write("controlword", 6)


@virtual_time
async def test_a_stopped_node_does_not_answer_and_the_error_says_so() -> None:
    async with simulated(12), open_master(BUS) as master:
        node = master.node(12)
        await node.write("producer_heartbeat_time", 100)
        await master.nmt_stop()
        await node.wait_for_heartbeat(1)
        with pytest.raises(SdoTimeoutError) as caught:
            await node.read("statusword")
        assert "node 12 was last heard" in caught.value.seen
        assert "NMT state STOPPED" in caught.value.seen
        assert caught.value.tries == ("canopen nmt preop 12",)


@virtual_time
async def test_a_node_that_is_alive_and_does_not_answer_this() -> None:
    async with simulated(12) as host, open_master(BUS) as master:
        node = master.node(12)
        await node.read("statusword")
        host.nodes[0].sdo.disable()
        with pytest.raises(SdoTimeoutError) as caught:
            await node.read("statusword")
        assert "node 12 was last heard 500 ms ago (SDO answer)" in caught.value.seen
        assert caught.value.tries == ("a longer sdo_timeout",)


@virtual_time
async def test_a_reset_ends_the_requests_to_that_node() -> None:
    async with simulated(12) as host, open_master(BUS) as master, loop.open_nursery() as nursery:
        node = master.node(12)
        host.nodes[0].sdo.disable()

        async def reading() -> None:
            with pytest.raises(SdoGivenUpError, match="given up") as caught:
                await node.read("statusword")
            assert caught.value.code == "CO203"
            assert "reset" in caught.value.cause

        nursery.start_soon(reading)
        await settled()
        await node.reset()
    assert node.nmt_state is NmtState.PRE_OPERATIONAL


@virtual_time
async def test_an_answer_of_another_length_is_not_taken_for_a_value() -> None:
    async with simulated(12), open_master(BUS) as master:
        dictionary = master.dictionary
        narrow = dictionary.variable("torque_actual_value")
        wrong = dataclasses.replace(narrow, data_type=DataType.INTEGER32)
        node = master.node(12, dictionary.with_objects([Object.of("torque_actual_value", [wrong])]))
        with pytest.raises(UnexpectedAnswerError, match="2 bytes") as caught:
            await node.read("torque_actual_value")
        assert isinstance(caught.value, ValueError)
        assert caught.value.tries[0] == "await node.read_bytes(0x6077, 0)"


@virtual_time
async def test_many_requests_at_once_each_get_their_own_answer() -> None:
    async with simulated(3, 4), open_master(BUS) as master:
        found: dict[tuple[int, str], object] = {}

        async def ask(node_id: int, key: str) -> None:
            found[node_id, key] = await master.node(node_id).read(key)

        async with loop.open_nursery() as nursery:
            for node_id in (3, 4):
                for key in ("statusword", "device_type", "supported_drive_modes", "position_actual_value"):
                    nursery.start_soon(ask, node_id, key)
        assert found[3, "supported_drive_modes"] == found[4, "supported_drive_modes"] == 0x43
        assert found[3, "device_type"] == 0x00020192
        assert len(found) == 8


@virtual_time
async def test_a_cancelled_request_is_aborted_on_the_wire_and_the_next_works() -> None:
    async with simulated(12), open_master(BUS) as master, await open_transport(BUS) as spy:
        silent = master.node(99)
        with loop.move_on_after(0.1) as scope:
            await silent.read("statusword")
        assert scope.cancelled_caught
        frames = [str((await spy.receive())[0]) for _ in range(2)]
        assert frames == ["663#4041600000000000", "663#8041600000000008"]
        with loop.move_on_after(0.1) as scope:
            await silent.write("controlword", 6)
        assert scope.cancelled_caught
        assert await master.node(12).read("statusword") == 0x240


@virtual_time
async def test_a_request_that_waits_behind_another_is_never_sent_once_cancelled() -> None:
    async with simulated(12), open_master(BUS) as master, await open_transport(BUS) as spy:
        silent = master.node(99)

        async def first() -> None:
            with pytest.raises(SdoTimeoutError):
                await silent.read("statusword")

        async with loop.open_nursery() as nursery:
            nursery.start_soon(first)
            await settled()
            with loop.move_on_after(0.1):
                await silent.write("controlword", 6)
        with loop.move_on_after(1):
            while True:
                assert "4060" not in str((await spy.receive())[0])


@virtual_time
async def test_the_same_node_is_the_same_object() -> None:
    async with open_master(BUS) as master:
        node = master.node(12)
        assert master.node(12) is node
        assert master.node(12, master.dictionary, bus=BUS) is node
        assert repr(node) == f"<Node 12 on {BUS}>"
        with pytest.raises(LocalProtocolError, match="another dictionary"):
            master.node(12, master.dictionary.with_objects([]))
        with pytest.raises(UnknownChainError, match="no bus 'can7'"):
            master.node(12, bus="can7")


@virtual_time
async def test_after_the_block_nothing_is_sent() -> None:
    async with simulated(12):
        async with open_master(BUS) as master:
            node = master.node(12)
        with pytest.raises(MasterClosedError):
            await node.read("statusword")
        with pytest.raises(MasterClosedError):
            master.node(13)
        with pytest.raises(MasterClosedError):
            await master.nmt_start()
        with pytest.raises(MasterClosedError):
            master.events(Event)
        with pytest.raises(MasterClosedError):
            await master.run(read(node.remote, "statusword"))


# ---- procedures ----


@virtual_time
async def test_a_procedure_runs_to_its_result_or_error() -> None:
    async with simulated(12), open_master(BUS) as master:
        node = master.node(12)
        assert await master.run(read(node.remote, "statusword")) == 0x240
        with pytest.raises(ProcedureError, match="refused reading"):
            await master.run(read(node.remote, "touch_probe_function"))


@virtual_time
async def test_a_cancelled_procedure_cleans_up_before_the_task_goes_on() -> None:
    async with simulated(12) as host, open_master(BUS) as master:
        node = master.node(12)

        def procedure():  # type: ignore[no-untyped-def]
            try:
                yield from sleep(10**12)
            except Cancelled:
                yield from write(node.remote, "ip_time_units", 77)
                raise

        with loop.move_on_after(1) as scope:
            await master.run(procedure())
        assert scope.cancelled_caught
        assert value(host.nodes[0], 0x60C2_01) == 77


@virtual_time
async def test_a_bus_error_has_the_fields_of_its_cause() -> None:
    with pytest.raises(BusError) as caught:
        async with open_master("nonsense:can0"):
            pytest.fail("opened")
    assert caught.value.code == "CO100"
    assert caught.value.bus == "nonsense:can0"
    assert caught.value.tries
