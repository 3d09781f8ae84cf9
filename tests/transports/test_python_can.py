"""PythonCanTransport against backends that fail in the ways that real ones do."""

from __future__ import annotations

import errno
import os
import socket
import threading
from collections.abc import Iterator

import can
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
    parse_locator,
)
from canopen_transports.python_can import MAX_NONSENSE, ROOM_TIME
from tests.transports.fake_bus import ScriptedBus
from tests.transports.support import reported, trio_test

CAN0 = parse_locator("socketcan:can0@500k")
SYNC = Frame.parse("080#")


def os_error(number: int, doing: str = "Failed to transmit") -> can.CanOperationError:
    """As python-can's SocketCAN raises it."""
    error = can.CanOperationError(f"{doing}: {os.strerror(number)}", number)
    error.__cause__ = OSError(number, os.strerror(number))
    return error


def full() -> can.CanOperationError:
    return os_error(errno.ENOBUFS)


def error_frame(classes: int, data: str) -> can.Message:
    return can.Message(arbitration_id=classes, is_extended_id=False, is_error_frame=True, data=bytes.fromhex(data))


def sync() -> can.Message:
    return can.Message(arbitration_id=0x80, is_extended_id=False)


@pytest.fixture
def readable() -> Iterator[int]:
    """The descriptor of a socket that has something to read, for ever."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with ours, theirs:
        theirs.send(b"x")
        yield ours.fileno()


@pytest.fixture
def silent() -> Iterator[int]:
    """The descriptor of a socket that has nothing to read."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with ours, theirs:
        yield ours.fileno()


@trio_test()
async def _waits_for_room(fd: int, complaint: can.CanError) -> None:
    bus = ScriptedBus(sends=[complaint] * 20, fd=fd)
    async with PythonCanTransport(bus, locator=CAN0) as transport:
        start = trio.current_time()
        await transport.send(SYNC)
        assert len(bus.sent) == 1
        assert 0.01 < trio.current_time() - start < ROOM_TIME
        assert set(bus.timeouts) == {0}
        assert set(bus.threads) == {threading.main_thread()}


@pytest.mark.parametrize("complaint", [full(), os_error(errno.EAGAIN), can.CanOperationError("Transmit buffer full")])
def test_a_full_queue_is_waited_for(silent: int, complaint: can.CanError) -> None:
    _waits_for_room(silent, complaint)


@trio_test()
async def _gives_up(fd: int) -> None:
    bus = ScriptedBus(sends=[full()] * 5000, fd=fd)
    async with PythonCanTransport(bus, locator=CAN0) as transport:
        with pytest.raises(TransportError) as caught:
            await transport.send(Frame.parse("60C#4041600000000000"))
    error = caught.value
    assert error.code == "CO110"
    assert error.failed == "cannot send 60C#4041600000000000 on socketcan:can0@500k: nothing acknowledges our frames"
    assert error.seen == "no room in the transmit queue for 1 s; no frame ever received"
    assert error.cause.startswith("nobody else on the bus, or its power is off; wrong bit rate (ours 500k); ")
    assert "sudo ip link set can0 up type can bitrate 500000 restart-ms 100" in error.tries[-1]
    assert "105" not in str(error)


def test_a_queue_that_stays_full_is_explained(silent: int) -> None:
    _gives_up(silent)


@trio_test()
async def _explains_with_what_it_heard(fd: int) -> None:
    passive = error_frame(0x024, "0020000000008000")
    bus = ScriptedBus(sends=[full()] * 5000, received=[sync(), passive, sync()], fd=fd)
    async with PythonCanTransport(bus, locator=CAN0) as transport:
        await transport.receive()
        assert (await reported(transport)).state is BusState.PASSIVE
        await transport.receive()
        with pytest.raises(TransportError) as caught:
            await transport.send(SYNC)
    assert "2 frames received so far; no acknowledge, controller is error-passive, tx error counter 128" in caught.value.seen
    assert "nobody else" not in caught.value.cause


def test_what_was_heard_changes_the_explanation(readable: int) -> None:
    _explains_with_what_it_heard(readable)


@trio_test()
async def _is_cancelled_while_waiting(fd: int) -> None:
    bus = ScriptedBus(sends=[full()] * 100, fd=fd)
    async with PythonCanTransport(bus, locator=CAN0) as transport:
        with trio.move_on_after(0.02) as scope:
            await transport.send(Frame.parse("080#01"))
        assert scope.cancelled_caught
        await transport.send(Frame.parse("080#02"))
    assert [bytes(message.data) for message in bus.sent] == [b"\x02"]


def test_a_send_that_was_cancelled_while_it_waited_has_sent_nothing(silent: int) -> None:
    _is_cancelled_while_waiting(silent)


@trio_test()
async def _senders_keep_their_order(fd: int) -> None:
    bus = ScriptedBus(sends=[full(), full(), None, full()], fd=fd)
    async with PythonCanTransport(bus, locator=CAN0) as transport, trio.open_nursery() as nursery:
        for number in range(5):
            nursery.start_soon(transport.send, Frame(0x80, bytes([number])))
            await trio.testing.wait_all_tasks_blocked()
    assert [message.data[0] for message in bus.sent] == [0, 1, 2, 3, 4]


def test_a_sender_that_waits_is_not_overtaken(silent: int) -> None:
    _senders_keep_their_order(silent)


@trio_test()
async def _close_wakes_a_waiting_sender(fd: int) -> None:
    transport = PythonCanTransport(ScriptedBus(sends=[full()] * 5000, fd=fd), locator=CAN0)

    async def send() -> None:
        with pytest.raises(trio.ClosedResourceError):
            await transport.send(SYNC)

    async with trio.open_nursery() as nursery:
        nursery.start_soon(send)
        await trio.sleep(0.1)
        nursery.start_soon(send)
        await transport.aclose()


def test_closing_wakes_a_sender_that_waits_for_room(silent: int) -> None:
    _close_wakes_a_waiting_sender(silent)


@trio_test()
async def _send_fails(fd: int, complaint: can.CanError, seen: str, step: str) -> None:
    async with PythonCanTransport(ScriptedBus(sends=[complaint], fd=fd), locator=CAN0) as transport:
        for doing in (transport.send, transport.send, lambda frame: transport.receive()):
            with pytest.raises(TransportError) as caught:
                await doing(SYNC)
            assert not isinstance(caught.value, FrameNotSentError)  # it will not come back: we cannot open it anew
            assert caught.value.code == "CO111"
            assert caught.value.seen.startswith(seen)
            assert "unplugged" in caught.value.cause
            assert caught.value.tries[0] == step


@pytest.mark.parametrize(
    ("number", "seen", "step"),
    [
        (errno.ENETDOWN, "can0 is DOWN", "sudo ip link set can0 up type can bitrate 500000"),
        (
            errno.ENXIO,
            "Failed to transmit: No such device or address [Error Code 6]",
            "plug it in again, then open the bus again",
        ),
    ],
)
def test_a_bus_that_is_lost_while_sending(silent: int, number: int, seen: str, step: str) -> None:
    _send_fails(silent, os_error(number), seen, step)


@trio_test()
async def _receive_fails(fd: int) -> None:
    bus = ScriptedBus(received=[os_error(errno.ENODEV, "Error receiving"), sync()], fd=fd)
    async with PythonCanTransport(bus, locator=CAN0) as transport:
        for _ in range(2):
            with pytest.raises(TransportError) as caught:
                await transport.receive()
            assert caught.value.code == "CO111"


def test_a_bus_that_is_lost_while_receiving(readable: int) -> None:
    _receive_fails(readable)


@trio_test()
async def _nonsense_now_and_then(fd: int) -> None:
    worst = [ValueError("no frame")] * MAX_NONSENSE
    bus = ScriptedBus(received=[*worst, sync(), *worst, sync(), *worst, ValueError("once more")], fd=fd)
    async with PythonCanTransport(bus, locator=CAN0) as transport:
        lost = [0]
        with pytest.raises(TransportError):
            while True:
                item = await transport.receive()
                if isinstance(item, ReceiveOverrun):
                    lost[-1] += item.lost
                else:
                    lost.append(0)
        assert lost == [MAX_NONSENSE] * 3


def test_a_driver_that_hands_over_nonsense_is_given_up_only_if_nothing_else_comes(readable: int) -> None:
    _nonsense_now_and_then(readable)


@trio_test()
async def _error_frames(fd: int) -> None:
    bus = ScriptedBus(
        received=[
            error_frame(0x001, ""),
            error_frame(0x001, ""),  # so soon, it is not told again
            sync(),
            error_frame(0x004, "0001000000000000"),
            error_frame(0x040, "0000000000000000"),
            error_frame(0x004, "0040000000000000"),
            error_frame(0x200, "0000000000000000"),
            sync(),
        ],
        fd=fd,
    )
    async with PythonCanTransport(bus, locator=CAN0) as transport:
        assert (await reported(transport)).seen == transport.last_error == "transmission timed out"
        assert (await transport.receive())[0] == SYNC
        assert transport.errors == 2
        overrun = await reported(transport, ReceiveOverrun, match="1 received frame lost")
        assert overrun.seen == "controller's receive buffer overran"
        off = await reported(transport)
        assert (off.state, off.seen) == (BusState.BUS_OFF, "controller is bus-off")
        assert off.tries[-1].endswith("restart-ms 100")
        with pytest.raises(FrameNotSentError, match="nothing acknowledges") as refused:
            await transport.send(SYNC)
        assert refused.value.code == "CO110"
        assert (await reported(transport)).state is BusState.ACTIVE
        await transport.send(SYNC)
        assert (await transport.receive())[0] == SYNC
        assert (transport.errors, transport.last_error) == (6, "unknown error")


def test_error_frames_are_reported_and_never_handed_out(readable: int) -> None:
    _error_frames(readable)


@trio_test(real_time=True)
async def _readable_without_a_frame(fd: int) -> None:
    bus = ScriptedBus(received=[can.Message(is_fd=True)], fd=fd)
    async with PythonCanTransport(bus, locator=CAN0) as transport:
        with trio.move_on_after(0.1) as scope:  # a serial line has half a frame: the descriptor is readable, recv gives nothing
            await transport.receive()
        assert scope.cancelled_caught
        assert transport.refused == 1


def test_a_readable_descriptor_need_not_hold_a_frame(readable: int) -> None:
    _readable_without_a_frame(readable)


@trio_test(real_time=True)
async def test_a_serial_line_is_written_to_in_a_thread_with_a_time_limit() -> None:
    reading, writing = os.pipe()
    try:
        bus = ScriptedBus(received=[sync()], fd=reading)
        async with PythonCanTransport(bus) as transport:
            os.write(writing, b"x")
            assert await transport.receive() == (SYNC, None)
            await transport.send(SYNC)
            assert bus.timeouts == [ROOM_TIME]
            assert bus.threads[0] is not threading.main_thread()
        assert transport.locator == "ScriptedBus (scripted)"
    finally:
        os.close(reading)
        os.close(writing)


@trio_test(real_time=True)
async def test_a_backend_without_a_descriptor_is_written_to_in_a_thread() -> None:
    bus = ScriptedBus(sends=[can.CanOperationError("The transmit queue is full")])
    async with PythonCanTransport(bus) as transport:
        await transport.send(SYNC)
        assert bus.timeouts == [None, None]
        assert threading.main_thread() not in bus.threads


@trio_test(real_time=True)
async def test_a_reader_thread_hands_over_what_came_before_the_bus_was_lost() -> None:
    failure = can.CanOperationError("A device was unplugged")
    async with PythonCanTransport(ScriptedBus(received=[sync(), failure])) as transport:
        assert (await transport.receive())[0] == SYNC
        for _ in range(2):
            with pytest.raises(TransportError) as caught:
                await transport.receive()
            assert caught.value.code == "CO111"
            assert caught.value.seen == "A device was unplugged"


@trio_test(real_time=True)
async def test_a_bus_that_fails_to_close_is_closed_all_the_same() -> None:
    class Unplugged(ScriptedBus):
        def shutdown(self) -> None:
            super().shutdown()
            raise can.CanOperationError("Could not close serial socket")

    transport = PythonCanTransport(Unplugged())
    await transport.aclose()
    with pytest.raises(trio.ClosedResourceError):
        await transport.receive()


@trio_test(real_time=True)
async def test_a_frame_that_fails_because_we_close_is_closed_not_lost() -> None:
    class SlowToFail(ScriptedBus):
        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            closing.wait(10)
            raise can.CanOperationError("Cannot operate on a closed bus")

    closing = threading.Event()
    transport = PythonCanTransport(SlowToFail())

    async def send() -> None:
        with pytest.raises(trio.ClosedResourceError):
            await transport.send(SYNC)

    async with trio.open_nursery() as nursery:
        nursery.start_soon(send)
        await trio.testing.wait_all_tasks_blocked()
        nursery.start_soon(transport.aclose)
        await trio.testing.wait_all_tasks_blocked()
        closing.set()


@trio_test(real_time=True)
async def test_time_stamps_are_nanoseconds() -> None:
    stamped = can.Message(arbitration_id=0x80, is_extended_id=False, timestamp=1_700_000_000.25)
    async with PythonCanTransport(ScriptedBus(received=[stamped])) as transport:
        assert await transport.receive() == (SYNC, 1_700_000_000_250_000_000)


def test_a_descriptor_that_a_backend_does_not_really_have_is_not_used() -> None:
    class Negative(ScriptedBus):  # as python-can's seeedstudio gives it where the system has none
        def fileno(self) -> int:
            return -1

    async def body() -> None:
        async with PythonCanTransport(Negative(received=[sync()])) as transport:
            assert (await transport.receive())[0] == SYNC

    trio.run(body)
