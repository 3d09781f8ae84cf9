"""How a transport reads from a backend of python-can, by descriptor and by thread, and what it makes of what goes wrong there."""

from __future__ import annotations

import math
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager

import can
import pytest
import trio
import trio.testing

from canopen_proto.frame import Frame
from canopen_transports import (
    BusState,
    BusStateChanged,
    PythonCanTransport,
    ReceiveOverrun,
    TransportError,
    parse_locator,
    python_can,
    readers,
)
from tests.transports.fake_bus import ScriptedBus
from tests.transports.support import LIMIT, trio_test

HERE = parse_locator("kvaser:0@500k")
SYNC = Frame.parse("080#")


def sync(timestamp: object = 0.0) -> can.Message:
    return can.Message(arbitration_id=0x80, is_extended_id=False, timestamp=timestamp)  # type: ignore[arg-type]


@contextmanager
def readable() -> Iterator[int]:
    """A descriptor that has something to read, for ever."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with ours, theirs:
        theirs.send(b"x")
        yield ours.fileno()


@contextmanager
def no_descriptor() -> Iterator[None]:
    yield None


@pytest.fixture(params=[readable, no_descriptor], ids=["descriptor", "thread"])
def fd(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[int | None]:
    """For a bus that is read in this way or in that."""
    monkeypatch.setattr(python_can, "REOPEN_PAUSE", 0.01)
    way: Callable[[], AbstractContextManager[int | None]] = request.param
    with way() as descriptor:
        yield descriptor


def opened(received: Iterable[can.Message | Exception], fd: int | None) -> PythonCanTransport:
    """A transport whose bus gives that; opened anew, it gives one SYNC."""

    async def reopen() -> can.BusABC:
        await trio.lowlevel.checkpoint()
        return ScriptedBus(received=[sync()], fd=fd)

    return PythonCanTransport(ScriptedBus(received=received, fd=fd), locator=HERE, reopen=reopen)


async def told(transport: PythonCanTransport) -> object:
    """What `receive` returns, in short."""
    match await transport.receive():
        case BusStateChanged(state=state):
            return state
        case ReceiveOverrun(lost=lost):
            return lost
        case received:
            return received[0]


@pytest.mark.parametrize(
    "failure",
    [
        OSError("the device hung up"),
        can.CanError("an error"),
        can.CanOperationError("Receiving failed"),
        NameError("name 'canReadWait' is not defined"),
        AttributeError("'NoneType' object has no attribute 'read'"),
        RuntimeError("USB error"),
        AssertionError(),
    ],
    ids=lambda failure: type(failure).__name__,
)
def test_whatever_a_backend_raises_the_bus_is_down_and_is_opened_anew(failure: Exception, fd: int | None) -> None:
    @trio_test(real_time=True)
    async def body() -> None:
        async with opened([sync(), failure], fd) as transport:
            assert [await told(transport) for _ in range(4)] == [SYNC, BusState.DOWN, BusState.UP, SYNC]

    body()


@pytest.mark.parametrize(
    "failure",
    [
        ValueError("no digit"),
        IndexError("too short"),
        TypeError("ord() expected a character"),
        struct.error("unpack requires a buffer of 4 bytes"),
    ],
    ids=lambda failure: type(failure).__name__,
)
def test_what_is_no_frame_is_a_frame_lost_and_reading_goes_on(failure: Exception, fd: int | None) -> None:
    @trio_test(real_time=True)
    async def body() -> None:
        async with opened([failure, sync(), failure, sync()], fd) as transport:
            assert [await told(transport) for _ in range(4)] == [1, SYNC, 1, SYNC]
            assert (transport.refused, transport.state) == (2, BusState.ACTIVE)

    body()


def test_nonsense_and_nothing_else_is_a_bus_that_is_down(fd: int | None) -> None:
    @trio_test(real_time=True)
    async def body() -> None:
        garbage = [ValueError("filedescriptor out of range in select()")] * (python_can.MAX_NONSENSE + 1)
        async with opened(garbage, fd) as transport:
            heard = [await told(transport) for _ in range(python_can.MAX_NONSENSE + 3)]
            assert heard[:-3] == [1] * python_can.MAX_NONSENSE
            assert heard[-3:] == [BusState.DOWN, BusState.UP, SYNC]

    body()


class MulticastBus(ScriptedBus):
    __module__ = "can.interfaces.udp_multicast.bus"


def test_a_socket_that_select_refuses_is_no_datagram_of_somebody_elses(fd: int | None) -> None:
    @trio_test(real_time=True)
    async def body() -> None:
        refusal = ValueError("filedescriptor out of range in select()")
        bus = MulticastBus(received=[refusal] * (python_can.MAX_NONSENSE + 1), fd=fd)
        async with PythonCanTransport(bus) as transport:
            assert [await told(transport) for _ in range(python_can.MAX_NONSENSE)] == [1] * python_can.MAX_NONSENSE
            with trio.fail_after(LIMIT), pytest.raises(TransportError, match="out of range in select"):
                await transport.receive()

    body()


class UnpluggedLine(ScriptedBus):
    """What came last was garbled, and there is nothing more to flush."""

    def flush(self) -> None:
        raise can.CanOperationError("Could not flush: Input/output error")


def test_unplugged_amid_a_line_the_bus_is_down(fd: int | None) -> None:
    @trio_test(real_time=True)
    async def body() -> None:
        async with PythonCanTransport(UnpluggedLine(received=[sync(), ValueError("no digit")], fd=fd)) as transport:
            with trio.fail_after(LIMIT):
                assert [await told(transport) for _ in range(2)] == [SYNC, 1]
                with pytest.raises(TransportError) as caught:
                    await transport.receive()
            assert (caught.value.code, caught.value.seen) == ("CO111", "Could not flush: Input/output error")

    body()


def test_a_bus_of_somebody_elses_ends_there(fd: int | None) -> None:
    @trio_test(real_time=True)
    async def body() -> None:
        bus = ScriptedBus(received=[sync(), can.CanOperationError("A device was unplugged"), sync()], fd=fd)
        async with PythonCanTransport(bus) as transport:
            assert await told(transport) == SYNC
            for _ in range(3):
                with pytest.raises(TransportError, match="cannot receive") as caught:
                    await transport.receive()
                assert (caught.value.code, caught.value.seen) == ("CO111", "A device was unplugged")

    body()


@pytest.mark.parametrize("stamp", [0.0, -1.5, math.nan, math.inf, -math.inf, 1e300, "yesterday", None])
def test_a_time_stamp_that_is_none(stamp: object, fd: int | None) -> None:
    @trio_test(real_time=True)
    async def body() -> None:
        async with opened([sync(stamp)], fd) as transport:
            assert await transport.receive() == (SYNC, None)

    body()


def test_64_bytes_of_can_fd_and_error_frames_among_frames(fd: int | None) -> None:
    @trio_test(real_time=True)
    async def body() -> None:
        long = can.Message(arbitration_id=0x181, is_extended_id=False, is_fd=True, data=bytes(64))
        async with opened([long, sync(), can.Message(is_error_frame=True), sync()], fd) as transport:
            assert [await told(transport) for _ in range(3)] == [SYNC, BusState.FAULT, SYNC]
            assert (transport.refused, transport.errors) == (1, 1)
            assert "CAN FD" in transport.last_refusal

    body()


class Restless(ScriptedBus):
    """A backend whose recv has nothing, and does not wait for it. looks: how often it was asked."""

    looks = 0

    def recv(self, timeout: float | None = None) -> can.Message | None:
        self.looks += 1
        return None


@trio_test(real_time=True)
async def test_a_backend_that_does_not_wait_does_not_keep_a_processor_busy() -> None:
    bus = Restless()
    began = time.monotonic()
    async with PythonCanTransport(bus) as transport:
        while not bus.looks:
            with trio.move_on_after(0.1):
                await transport.receive()
    assert bus.looks <= (time.monotonic() - began) / python_can.IDLE_PAUSE + 2


class Buffering(ScriptedBus):
    """As robotell: what it has read beyond one frame it keeps, and its descriptor says nothing of that."""

    __module__ = "can.interfaces.robotell"


@trio_test(real_time=True)
async def test_a_backend_with_a_buffer_of_its_own_is_not_waited_for_by_descriptor() -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs:  # nothing to read there
        async with PythonCanTransport(Buffering(received=[sync(), sync()], fd=ours.fileno())) as transport:
            assert [await told(transport) for _ in range(2)] == [SYNC, SYNC]


class Stuck(ScriptedBus):
    """A driver whose recv does not come back, whatever its time limit."""

    def __init__(self) -> None:
        super().__init__()
        self.release = threading.Event()

    def recv(self, timeout: float | None = None) -> can.Message | None:
        self.release.wait(20)
        return None


def test_a_reader_that_hangs_in_its_driver_does_not_hold_up_closing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(readers, "DRIVER_TIME", 0.02)

    @trio_test(real_time=True)
    async def body() -> None:
        bus = Stuck()
        (reader,) = await new_threads(bus)
        assert reader.is_alive()
        assert bus._is_shutdown
        bus.release.set()
        await trio.to_thread.run_sync(reader.join, 10)
        assert not reader.is_alive()

    async def new_threads(bus: Stuck) -> set[threading.Thread]:
        before = set(threading.enumerate())
        async with PythonCanTransport(bus) as transport:
            started = {thread for thread in threading.enumerate() if thread.name.startswith("receive ")} - before
            with trio.move_on_after(0.01) as scope:
                await transport.receive()
            assert scope.cancelled_caught
        return started

    body()
