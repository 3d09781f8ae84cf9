"""Writes whose fate nobody knows: an error of their own, and one frame only on the wire."""

import pytest

from canopen_master import SdoGivenUpError, SdoNotConfirmedError, SdoRefusedError, SdoTimeoutError, open_master
from canopen_master.errors import SdoContestedError, sdo_error
from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.network import Network
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.client import SdoAborted
from canopen_transports import Transport, open_transport
from tests.master.loops import loop, settled
from tests.master.world import BUS, simulated, virtual_time


async def requests_on(spy: Transport) -> list[str]:
    """What clients have said until now."""
    frames = []
    with loop.move_on_after(1):
        while True:
            frames.append(str((await spy.receive())[0]))
    return [frame for frame in frames if frame.startswith("6")]


@virtual_time
async def test_a_write_without_answer_is_not_confirmed_and_sent_once() -> None:
    async with simulated(12), open_master(BUS) as master, await open_transport(BUS) as spy:
        with pytest.raises(SdoNotConfirmedError, match="may have been executed") as caught:
            await master.node(13).write("controlword", 6)
        assert isinstance(caught.value, SdoTimeoutError)
        assert isinstance(caught.value, TimeoutError)
        assert caught.value.code == "CO201"
        assert await requests_on(spy) == ["60D#2B40600006000000", "60D#8040600000000405"]


@virtual_time
async def test_nor_is_one_whose_node_was_reset_meanwhile() -> None:
    async with simulated(12) as host, open_master(BUS) as master, loop.open_nursery() as nursery:
        node = master.node(12)
        host.nodes[0].sdo.disable()

        async def writing() -> None:
            with pytest.raises(SdoNotConfirmedError, match=r"given up .not confirmed: it may have been executed") as caught:
                await node.write("controlword", 6)
            assert isinstance(caught.value, SdoGivenUpError)
            assert caught.value.code == "CO203"
            assert "reset" in caught.value.cause

        nursery.start_soon(writing)
        await settled()
        await node.reset()


@virtual_time
async def test_an_abort_that_finds_no_transfer_is_no_refusal() -> None:
    async with open_master(BUS) as master, await open_transport(BUS) as device, loop.open_nursery() as nursery:

        async def answer() -> None:
            while True:
                frame, _ = await device.receive()
                if str(frame).startswith("60C#21"):
                    await device.send(frame.parse("58C#6000200000000000"))
                elif str(frame).startswith("60C#05"):  # executed, but the answer is lost, and the segment came twice
                    await device.send(frame.parse("58C#8000000001000405"))

        nursery.start_soon(answer)
        with pytest.raises(SdoNotConfirmedError, match=r"given up .not confirmed: it may have been executed") as caught:
            await master.node(12).write_bytes(0x2000, 0, b"01234")
        assert (caught.value.code, caught.value.cause) == ("CO203", "its answer to the last frame was lost")
        nursery.cancel_scope.cancel()


@virtual_time
async def test_what_is_certain_is_no_such_error() -> None:
    async with simulated(12), open_master(BUS) as master:
        node = master.node(12)
        with pytest.raises(SdoRefusedError) as refused:
            await node.write_bytes(0x5FFF, 0, b"\x00")
        assert not isinstance(refused.value, SdoNotConfirmedError)
        for attempt in (lambda: master.node(13).read_bytes(0x1000), lambda: master.node(13).write_bytes(0x2000, 0, bytes(100))):
            with pytest.raises(SdoTimeoutError) as silent:
                await attempt()
            assert not isinstance(silent.value, SdoNotConfirmedError)
            assert "not confirmed" not in str(silent.value)


@virtual_time
async def test_a_slow_nodes_late_answer_is_not_taken_for_the_next_one() -> None:
    async with open_master(BUS, sdo_timeout=0.1) as master, await open_transport(BUS) as device, loop.open_nursery() as nursery:
        answered = 0

        async def answer() -> None:
            nonlocal answered
            while True:
                frame, _ = await device.receive()
                if str(frame).startswith("60C#4041"):
                    await loop.sleep(0.15 if not answered else 0.01)
                    answered += 1
                    await device.send(frame.parse(f"58C#4B4160000{answered}000000"))

        nursery.start_soon(answer)
        node = master.node(12)
        with pytest.raises(SdoTimeoutError):
            await node.read("statusword")
        assert await node.read("statusword") == 2
        nursery.cancel_scope.cancel()


@pytest.mark.parametrize(("not_confirmed", "kind"), [(True, SdoNotConfirmedError), (False, SdoContestedError)])
def test_an_error_names_what_another_client_did_and_never_a_refusal(not_confirmed: bool, kind: type[SdoGivenUpError]) -> None:
    network = Network()
    node = RemoteNode(network.out, 5, ObjectDictionary([]))
    request = bytes.fromhex("2B40600006000000")
    aborted = SdoAborted(5, 1, 0x6040, 0, AbortCode.GENERAL_ERROR, AbortOrigin.CONTESTED, not_confirmed, 0, request)
    error = sdo_error(network, node, "can0", aborted, "writing 15 to", 0)
    assert type(error) is kind
    assert error.code == "CO206"
    assert error.seen == "another SDO client wrote 0x6040:00"
    assert "refused" not in str(error)
    assert ("not confirmed" in str(error)) is not_confirmed
