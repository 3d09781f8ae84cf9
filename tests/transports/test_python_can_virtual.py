"""python-can's own `virtual` interface: a backend without a file descriptor, read by a thread."""

from __future__ import annotations

import threading

import can
import pytest
import trio
import trio.testing

from canopen_proto.frame import Frame
from canopen_transports import BusStateChanged, PythonCanTransport, ReceiveOverrun, python_can
from canopen_transports.conformance.frames import number_of, numbered
from tests.transports.support import reported, trio_test

CHANNEL = "conformance of canopen_transports"


def _bus() -> can.BusABC:
    return can.Bus(CHANNEL, interface="virtual", ignore_config=True)


@trio_test(real_time=True)
async def test_a_bus_that_is_ours_is_shut_down() -> None:
    bus = _bus()
    async with PythonCanTransport(bus):
        pass
    with pytest.raises(can.CanOperationError):
        bus.recv(0)


@trio_test(real_time=True)
async def test_a_bus_that_filters_says_that_frames_of_others_may_be_missing() -> None:
    with _bus() as lent:
        async with PythonCanTransport(lent, owned=False) as transport:
            assert transport.unheard is None
            lent.set_filters([{"can_id": 0x583, "can_mask": 0x7FF}])
            assert transport.unheard == "python-can was told to filter (can_filters)"


@trio_test(real_time=True)
async def test_a_bus_that_was_lent_stays_open_and_keeps_what_comes_later() -> None:
    with _bus() as lent, _bus() as other:
        async with PythonCanTransport(lent, owned=False) as transport:
            other.send(can.Message(arbitration_id=0x701, data=b"\x05", is_extended_id=False))
            assert (await transport.receive())[0] == Frame.parse("701#05")
        other.send(can.Message(arbitration_id=0x702, data=b"\x7f", is_extended_id=False))
        message = lent.recv(1)
        assert message is not None
        assert message.arbitration_id == 0x702


@trio_test(real_time=True)
async def test_closing_ends_the_reader_thread() -> None:
    def readers() -> list[threading.Thread]:
        return [thread for thread in threading.enumerate() if thread.name.startswith("receive ")]

    transport = PythonCanTransport(_bus())
    assert len(readers()) == 1
    await transport.aclose()
    assert not readers()


@trio_test(real_time=True)
async def test_the_queue_of_the_reader_thread_is_bounded() -> None:
    with _bus() as other:
        async with PythonCanTransport(_bus(), queue_size=4) as transport:
            for number in range(100):
                frame = numbered(number)
                other.send(can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False))
            heard = [number_of((await transport.receive())[0])]
            lost = 0
            while len(heard) + lost < 100:
                received = await transport.receive()
                if isinstance(received, ReceiveOverrun):
                    lost += received.lost
                else:
                    heard.append(number_of(received[0]))
            assert heard == sorted(heard)
            assert heard[0] == 0


@trio_test(real_time=True)
async def _stops_at_the_edge() -> None:
    with _bus() as other:
        async with PythonCanTransport(_bus()) as transport:
            for message, reason in (
                (can.Message(arbitration_id=1, data=bytes(12), is_fd=True), "CAN FD"),
                (can.Message(arbitration_id=0x800, is_extended_id=False), "CAN-ID 0x800 is out of range"),
                (can.Message(arbitration_id=-1), "out of range"),
                (can.Message(arbitration_id=1, data=b"\1", dlc=4), "announces 4 bytes and has 1"),
                (can.Message(arbitration_id=1, dlc=16), "length 16"),
                (can.Message(arbitration_id=1.5), "wrong types"),  # type: ignore[arg-type]
            ):
                refused = transport.refused
                other.send(message)
                other.send(can.Message(arbitration_id=0x80, is_extended_id=False))
                assert (await transport.receive())[0] == Frame.parse("080#")
                assert transport.refused == refused + 1
                assert reason in transport.last_refusal
            other.send(can.Message(is_error_frame=True))
            await reported(transport, BusStateChanged, match="bus fault")
            other.send(can.Message(is_error_frame=True))  # so soon, it is not told again
            other.send(can.Message(arbitration_id=0x80, is_extended_id=False))
            assert (await transport.receive())[0] == Frame.parse("080#")
            assert (transport.errors, transport.last_error) == (2, "error frame")


def test_what_is_no_classical_frame_stops_at_the_edge(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(python_can, "QUIET_TIME", 1000.0)  # however long this takes
    _stops_at_the_edge()


@trio_test(real_time=True)
async def test_what_is_legal_on_the_wire_is_brought_into_shape() -> None:
    with _bus() as other:
        async with PythonCanTransport(_bus()) as transport:
            for message, text in (
                (can.Message(arbitration_id=0x181, data=bytes(8), dlc=15, is_extended_id=False), "181#0000000000000000"),
                (can.Message(arbitration_id=0x181, data=b"\1\2\3", dlc=2, is_extended_id=False), "181#0102"),
                (can.Message(arbitration_id=0x701, is_remote_frame=True, dlc=12, is_extended_id=False), "701#R8"),
            ):
                other.send(message)
                assert (await transport.receive())[0] == Frame.parse(text)


def test_a_forgotten_transport_does_not_outlive_its_run() -> None:
    leaked: list[PythonCanTransport] = []

    async def forget() -> None:
        leaked.append(PythonCanTransport(_bus()))

    trio.run(forget)
    (reader,) = [thread for thread in threading.enumerate() if thread.name.startswith("receive ")]
    with _bus() as other:
        other.send(can.Message(arbitration_id=0x80, is_extended_id=False))
    reader.join(10)
    assert not reader.is_alive()
    leaked[0]._bus.shutdown()


@trio_test(real_time=True)
async def test_an_open_transport_names_the_bus_it_wraps() -> None:
    async with PythonCanTransport(_bus()) as transport:
        assert transport.locator == f"virtual (Virtual bus channel {CHANNEL})"


@trio_test(real_time=True)
async def test_a_bus_that_echoes_our_frames_does_not_make_us_a_stranger_to_ourselves() -> None:
    """As gs_usb does always: an SDO client would take its own request for another client's."""
    echoing = can.Bus(CHANNEL, interface="virtual", ignore_config=True, receive_own_messages=True)
    with _bus() as other:
        async with PythonCanTransport(echoing) as transport:
            await transport.send(Frame.parse("605#4000100000000000"))
            other.send(can.Message(arbitration_id=0x585, data=bytes(8), is_extended_id=False))
            assert (await transport.receive())[0] == Frame.parse("585#0000000000000000")
