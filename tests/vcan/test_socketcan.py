"""The native SocketCAN transport on a real kernel: frames, their time stamps, too many of them, and no room for them."""

from __future__ import annotations

import os
import socket
import struct
import time

import pytest
import trio
import trio.testing

from canopen_transports import FrameNotSentError, ReceiveOverrun, Transport, TransportError
from canopen_transports.conformance.frames import END, number_of, numbered
from tests.transports.support import LIMIT, trio_test
from tests.vcan.support import interface, ip, joined, needs_vcan, raw_socket, slow

pytestmark = needs_vcan


# ---- frames ----


@trio_test(real_time=True)
async def test_can_fd_frames_stay_outside() -> None:
    with interface() as name, raw_socket(name) as sender:
        async with joined(name) as one:
            sender.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
            sender.send(struct.pack("=IBB2x64s", 0x123, 12, 1, bytes(64)))
            sender.send(struct.pack("=IB3x8s", 0x7E5, 1, b"\x0e"))
            assert (await one.receive())[0] == END


@trio_test(real_time=True)
async def test_time_stamps_are_the_kernels() -> None:
    async with joined("vcan0") as one, joined("vcan0") as other:
        stamps = []
        before = time.time_ns()
        for number in range(100):
            await one.send(numbered(number))
        for _ in range(100):
            stamp = (await other.receive())[1]
            assert stamp is not None
            stamps.append(stamp)
    assert stamps == sorted(stamps)
    assert before - 10**9 < stamps[0] <= stamps[-1] < time.time_ns() + 10**9
    assert any(stamp % 1000 for stamp in stamps)


@trio_test(real_time=True)
async def test_what_other_programs_write_that_no_wire_carries() -> None:
    with interface() as name, raw_socket(name) as sender:
        async with joined(name) as one:
            sender.send(struct.pack("=IB3x8s", 0x12345, 1, b"\1"))  # 29 bits, but not marked as such
            sender.send(struct.pack("=IB3x8s", 0x4001_2345, 1, b"\1"))
            sender.send(struct.pack("=IB2xB8s", 0x123, 8, 15, bytes(range(8))))  # a DLC of 15 stands for 8 bytes
            sender.send(struct.pack("=IB3x8s", 0x123, 2, bytes(range(8))))  # remains behind the data
            sender.send(struct.pack("=IB3x8s", 0xC000_0123, 8, bytes(range(8))))  # a remote frame with data
            heard = [str((await one.receive())[0]) for _ in range(3)]
    assert heard == ["123#0001020304050607", "123#0001", "00000123#R8"]


@trio_test(real_time=True)
async def _as_nobody(name: str) -> None:
    async with joined(name) as other:  # with root's rights
        os.seteuid(65534)
        try:
            one = joined(name)
        finally:
            os.seteuid(0)
        async with one:
            for number in range(100):
                await other.send(numbered(number))
            assert [number_of((await one.receive())[0]) for _ in range(100)] == list(range(100))
            small, large = (each._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) for each in (one, other))
            assert small <= large == 2 * (4 << 20)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="this is no other user than the tests'")
def test_a_user_without_rights_gets_the_receive_buffer_that_the_system_allows() -> None:
    with interface() as name:
        _as_nobody(name)


@trio_test(real_time=True)
async def test_a_socket_that_fails_in_any_other_way_is_a_lost_bus() -> None:
    with interface() as name:
        async with joined(name) as one:
            receiver, sender = os.pipe()
            try:
                os.dup2(receiver, one._socket.fileno())  # somebody else's descriptor: no socket any more
                os.write(sender, b"x")
                with pytest.raises(TransportError, match="cannot receive on socketcan:vcan7") as caught:
                    await one.receive()
                assert caught.value.code == "CO111"
                with pytest.raises(TransportError, match="cannot send 7E5#0E on socketcan:vcan7") as caught:
                    await one.send(END)
                assert caught.value.code == "CO111"
            finally:
                os.close(receiver)
                os.close(sender)


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Senders wait for room however long this computer takes."""
    monkeypatch.setattr("canopen_transports.socketcan.transport.ROOM_TIME", LIMIT)


# ---- too much ----


@trio_test(real_time=True)
async def test_frames_that_the_kernel_drops_are_told_at_their_place() -> None:
    async with joined("vcan0") as one, joined("vcan0") as other:
        other._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 20_000)
        for number in range(1000):
            await one.send(numbered(number))
        heard: list[int] = []
        while isinstance(received := await other.receive(), tuple):
            heard.append(number_of(received[0]))
        assert heard == list(range(len(heard)))
        assert isinstance(received, ReceiveOverrun)
        assert len(heard) + received.lost == 1000
        assert received.lost > 0
        for number in range(200):  # in the middle: the first frame behind the gap brings the counter with it
            await one.send(numbered(number))
        middle = [number_of((await other.receive())[0]) for _ in range(10)]
        await one.send(END)
        lost = 0
        while True:
            received = await other.receive()
            if isinstance(received, ReceiveOverrun):
                lost += received.lost
            else:
                if received[0] == END:
                    break
                middle.append(number_of(received[0]))
        assert middle == list(range(len(middle)))
        assert len(middle) + lost == 200


@trio_test(real_time=True)
async def test_frames_that_come_while_the_process_stalls_between_two_looks_stand_before_those_dropped_meanwhile() -> None:
    with interface() as name:
        async with joined(name) as one, joined(name) as other:
            other._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 20_000)
            look = other._drop_counter
            bursts = [range(1000, 2000)]

            def stalled() -> int:
                for number in bursts.pop() if bursts else ():
                    while not one.send_nowait(numbered(number)):
                        pass
                return look()

            for number in range(1000):
                await one.send(numbered(number))
            other._drop_counter = stalled  # type: ignore[method-assign]
            lost: list[int] = []
            heard: list[int] = []
            while len(heard) + sum(lost) < 2000:
                received = await other.receive()
                if isinstance(received, ReceiveOverrun):
                    lost.append(received.lost)
                    heard += [-1] * (len(lost) == 1)  # its place
                else:
                    heard.append(number_of(received[0]))
            first, second = heard[: heard.index(-1)], heard[heard.index(-1) + 1 :]
            assert first == list(range(len(first)))
            assert second == list(range(1000, 1000 + len(second)))
            assert lost == [1000 - len(first), 1000 - len(second)]


@pytest.mark.usefixtures("patient")
@trio_test(real_time=True)
async def test_a_sender_waits_for_room_and_keeps_the_order() -> None:
    with interface() as name:
        async with joined(name) as one, joined(name) as two, joined(name) as other:
            slow(name, "128kbit")  # 16 bytes to a frame: 1000 frames in a second
            heard: list[int] = []

            async def send(transport: Transport, first: int) -> None:
                for number in range(first, first + 100):
                    await transport.send(numbered(number))

            async with trio.open_nursery() as nursery:
                nursery.start_soon(send, one, 0)
                nursery.start_soon(send, one, 1000)
                nursery.start_soon(send, two, 2000)  # together they fill the interface's queue, too: ENOBUFS
                while len(heard) < 300:
                    heard.append(number_of((await other.receive())[0]))
            for first in (0, 1000, 2000):
                assert [number for number in heard if first <= number < first + 1000] == list(range(first, first + 100))


@trio_test(real_time=True)
async def test_a_sender_that_gets_no_room_gives_up() -> None:
    with interface() as name:
        async with joined(name) as one:
            slow(name, "8bit")
            with pytest.raises(TransportError) as caught:
                for number in range(100):
                    await one.send(numbered(number))
            assert caught.value.code == "CO110"
            assert "no room in the transmit queue for 1 s; no frame ever received" in caught.value.seen
            assert "nobody else on the bus" in caught.value.cause


@pytest.mark.usefixtures("patient")
@trio_test(real_time=True)
async def test_a_sender_that_waits_for_room_wakes_when_the_bus_goes_and_when_it_is_closed() -> None:
    with interface() as name:
        one, two = joined(name), joined(name)
        slow(name, "8bit")

        async def send(transport: Transport, error: type[Exception]) -> None:
            with pytest.raises(error):
                for number in range(100):
                    await transport.send(numbered(number))

        async with trio.open_nursery() as nursery:
            nursery.start_soon(send, one, FrameNotSentError)
            nursery.start_soon(send, two, trio.ClosedResourceError)
            await trio.sleep(0.1)
            await two.aclose()
            ip("link", "set", name, "down")
        await one.aclose()


@pytest.mark.usefixtures("patient")
@trio_test(real_time=True)
async def test_several_senders_share_a_queue_with_room_for_one_frame() -> None:
    with interface() as name:
        ip("link", "set", name, "txqueuelen", "1")
        async with joined(name) as one, joined(name) as two, joined(name) as other:
            slow(name, "128kbit", room=1)

            async def send(transport: Transport, first: int) -> None:
                for number in range(first, first + 50):
                    await transport.send(numbered(number))

            async with trio.open_nursery() as nursery:
                nursery.start_soon(send, one, 0)
                nursery.start_soon(send, two, 1000)
                heard = [number_of((await other.receive())[0]) for _ in range(100)]
            for first in (0, 1000):
                assert [number for number in heard if first <= number < first + 1000] == list(range(first, first + 50))


@pytest.mark.usefixtures("patient")
@trio_test(real_time=True)
async def test_where_there_is_no_room_a_frame_at_once_is_refused_and_a_cancelled_one_is_not_sent() -> None:
    with interface() as name:
        async with joined(name) as one, joined(name) as other:
            slow(name, "8bit")
            sent = 0
            while one.send_nowait(numbered(sent)):
                sent += 1
            async with trio.open_nursery() as nursery:
                nursery.start_soon(one.send, numbered(1000))
                await trio.testing.wait_all_tasks_blocked()
                assert not one.send_nowait(numbered(2000))  # others wait
                nursery.cancel_scope.cancel()
            slow(name, "128kbit")
            await one.send(END)
            for number in range(sent):
                assert number_of((await other.receive())[0]) == number
            assert (await other.receive())[0] == END


@trio_test(real_time=True)
async def test_closed_amid_a_burst_nothing_more_is_handed_out() -> None:
    with interface() as name:
        async with joined(name) as one, joined(name) as other:
            for number in range(200):
                await one.send(numbered(number))
            assert number_of((await other.receive())[0]) == 0  # the others of its batch are there
            await other.aclose()
            for refused in (other.receive(), other.send(END)):
                with pytest.raises(trio.ClosedResourceError):
                    await refused
            with pytest.raises(trio.ClosedResourceError):
                other.send_nowait(END)
