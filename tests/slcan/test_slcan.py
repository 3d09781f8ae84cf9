"""python-can's slcan backend over pseudo-terminals, with simulated adapters at their other ends."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import trio
import trio.testing

from canopen_proto.frame import Frame
from canopen_transports import (
    BusState,
    FrameNotSentError,
    PythonCanTransport,
    ReceiveOverrun,
    TransportError,
    open_transport,
)
from canopen_transports.conformance.frames import END
from tests.transports.support import LIMIT, reported, trio_test

if sys.platform == "win32":
    pytest.skip("pseudo-terminals are POSIX's alone", allow_module_level=True)

from tests.slcan.adapter import Adapter, SimulatedBus

AT_ONCE = "?sleep_after_open=0"


async def opened(adapter: Adapter, options: str = "") -> PythonCanTransport:
    """The transport on an adapter that has done what python-can tells it first: bit rate, and open, twice."""
    before = len(adapter.said)
    transport = await open_transport(f"slcan:{adapter.link}@250k{AT_ONCE}{options}")
    assert isinstance(transport, PythonCanTransport)
    with trio.fail_after(LIMIT):
        while sum(each in "OL" for each in adapter.said[before:]) < 2:
            await trio.sleep(0.001)
    return transport


@pytest.fixture
def bus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SimulatedBus]:
    monkeypatch.setattr("canopen_transports.python_can.REOPEN_PAUSE", 0.05)
    simulated = SimulatedBus(tmp_path)
    yield simulated
    simulated.close()


@trio_test(real_time=True)
async def test_bit_rate_and_listening_only_reach_the_adapter(bus: SimulatedBus) -> None:
    adapter = bus.plug("tty")
    async with await opened(adapter, "&listen_only=true") as transport:
        other = bus.plug("other")
        async with await opened(other) as sender:
            await sender.send(END)
        assert (await transport.receive())[0] == END
        with pytest.raises(FrameNotSentError, match="cannot send"):
            await transport.send(END)
    assert "S5" in adapter.said
    assert "L" in adapter.said
    assert "O" not in adapter.said


@trio_test(real_time=True)
async def test_lines_that_are_no_frames(bus: SimulatedBus) -> None:
    adapter = bus.plug("tty")
    async with await opened(adapter) as transport:
        for harmless in (b"\r", b"\a", b"z\r", b"V1013\r", b"hello\r"):
            adapter.write(harmless + b"t0800\r")
            assert (await transport.receive())[0] == Frame.parse("080#")
        for refused in (b"t080201\r", b"tFFF0\r", b"d0800\r"):  # too short, out of range, CAN FD
            adapter.write(refused + b"t0800\r")
            assert (await transport.receive())[0] == Frame.parse("080#")
        assert transport.refused == 2 + 1
        for nonsense in (b"t08\r", b"tXYZ0\r", b"t0809\xff\xfe\r", b"T\r"):
            adapter.write(nonsense)
            lost = await reported(transport, ReceiveOverrun, match="1 received frame lost")
            assert "not a valid frame" in lost.seen
            assert "tty_baudrate" in lost.cause
            adapter.write(b"t0800\r")
            assert (await transport.receive())[0] == Frame.parse("080#")


@trio_test(real_time=True)
async def test_no_frame_behind_nonsense_is_lost(bus: SimulatedBus) -> None:
    adapter = bus.plug("tty")
    async with await opened(adapter) as transport:
        for nonsense in (b"t08\r", b"t0809\xff\xfe\r"):
            adapter.write(nonsense + b"".join(b"t0811%02X\r" % number for number in range(20)))
            await reported(transport, ReceiveOverrun, match="1 received frame lost")
            assert [(await transport.receive())[0].data[0] for _ in range(20)] == [*range(20)]


@trio_test(real_time=True)
async def test_half_a_frame_is_waited_for(bus: SimulatedBus) -> None:
    adapter = bus.plug("tty")
    async with await opened(adapter) as transport:
        adapter.write(b"t7E5")
        with trio.move_on_after(0.05) as scope:
            await transport.receive()
        assert scope.cancelled_caught
        adapter.write(b"10E\r")
        assert (await transport.receive())[0] == END


@trio_test(real_time=True)
async def test_an_adapter_that_goes_away_and_comes_back(bus: SimulatedBus) -> None:
    adapter = bus.plug("tty")
    async with await opened(adapter) as transport:
        bus.unplug(adapter)
        down = await reported(transport)
        assert down.state is BusState.DOWN
        assert down.cause == "the adapter was unplugged, or its driver failed"
        with pytest.raises(FrameNotSentError, match="cannot send"):
            await transport.send(END)
        with trio.move_on_after(0.2) as scope:
            await transport.receive()
        assert scope.cancelled_caught
        adapter = bus.plug("tty")
        assert (await reported(transport)).state is BusState.UP
        adapter.write(b"t7E510E\r")
        assert (await transport.receive())[0] == END
        await transport.send(END)


@trio_test(real_time=True)
async def test_a_sender_may_be_the_first_to_notice(bus: SimulatedBus) -> None:
    adapter = bus.plug("tty")
    async with await opened(adapter) as transport, trio.open_nursery() as nursery:
        bus.unplug(adapter)
        with pytest.raises(FrameNotSentError, match="cannot send"):
            await transport.send(END)
        assert (await reported(transport)).state is BusState.DOWN
        nursery.cancel_scope.cancel()


@trio_test(real_time=True)
async def test_cancelled_while_it_comes_back_it_can_still_be_closed(bus: SimulatedBus) -> None:
    adapter = bus.plug("tty")
    transport = await open_transport(f"slcan:{adapter.link}@250k?sleep_after_open=0.1")
    bus.unplug(adapter)
    assert (await reported(transport)).state is BusState.DOWN
    bus.plug("tty")
    with trio.move_on_after(0.1):  # it has begun to open the line
        await transport.receive()
    await transport.aclose()
    with pytest.raises(trio.ClosedResourceError):
        await transport.receive()


def test_no_such_line_and_no_such_bit_rate(bus: SimulatedBus) -> None:
    with pytest.raises(TransportError) as caught:  # python-can's half-made bus would complain when it is collected
        trio.run(open_transport, f"slcan:{bus.plug('tty').link}@33k{AT_ONCE}")
    assert "Invalid bitrate, choose one of" in caught.value.seen
