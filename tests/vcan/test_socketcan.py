"""The native SocketCAN transport on a real kernel: what it promises, and what a kernel does to it."""

from __future__ import annotations

import itertools
import socket
import struct
import subprocess
import time
from collections.abc import Iterator

import pytest
import trio
import trio.testing

from canopen_proto.frame import KEY_EXTENDED, KEY_REMOTE, Frame
from canopen_transports import BusState, BusStateChanged, FrameNotSent, ReceiveOverrun, Transport, TransportError, open_transport
from canopen_transports.locator import parse_locator
from canopen_transports.socketcan import SocketCanTransport, open_socketcan
from tests.transports.conformance import END, TransportConformance, number_of, numbered
from tests.transports.support import trio_test
from tests.vcan.support import interface, ip, needs_vcan, raw_socket, tool

pytestmark = needs_vcan

ERROR = 0x2000_0000


class TestConformance(TransportConformance):
    unopenable = (
        "socketcan:nocan0",
        "socketcan:vcan99",
        "socketcan:lo",
        "vcan98",
        "socketcan:vcan0?filter=some",
        "socketcan:vcan0?local_loopback=true",
    )

    async def join(self) -> Transport:
        return await open_transport("socketcan:vcan0")


class TestConformanceOfPythonCan(TransportConformance):
    unopenable = ("pythoncan:socketcan:nocan0", "pythoncan:socketcan:lo")

    async def join(self) -> Transport:
        return await open_transport("pythoncan:socketcan:vcan0")


@pytest.fixture
def can() -> Iterator[str]:
    with interface() as name:
        yield name


def joined(name: str, options: str = "") -> SocketCanTransport:
    return open_socketcan(parse_locator(f"socketcan:{name}{options}"))


async def reported(transport: Transport) -> BusStateChanged:
    with pytest.raises(BusStateChanged) as caught:
        await transport.receive()
    return caught.value


# ---- going down and coming back ----


@trio_test(real_time=True)
async def _opening_fails(name: str) -> None:
    for locator in (f"socketcan:{name}", f"pythoncan:socketcan:{name}"):
        with pytest.raises(TransportError) as caught:
            await open_transport(locator)
        assert caught.value.seen == f"{name} is there, but it is DOWN"
        assert caught.value.tries == (f"sudo ip link set {name} up",)


def test_an_interface_that_is_down_is_not_opened(can: str) -> None:
    ip("link", "set", can, "down")
    _opening_fails(can)


@trio_test(real_time=True)
async def _goes_down_and_comes_back(name: str) -> None:
    async with joined(name) as one, joined(name) as other:
        for number in range(3):
            await one.send(numbered(number))
        await trio.to_thread.run_sync(ip, "link", "set", name, "down")
        for number in range(3):  # what came before stands before
            assert number_of((await other.receive())[0]) == number
        down = await reported(other)
        assert down.state is BusState.DOWN
        assert down.seen == f"{name} is DOWN"
        assert down.tries == (f"sudo ip link set {name} up",)
        for _ in range(2):  # the first has word of it pending; the second knows it
            with pytest.raises(FrameNotSent) as caught:
                await one.send(numbered(4))
            assert caught.value.code == "CO111"
            assert caught.value.seen == f"{name} is DOWN"
        assert (await reported(one)).state is BusState.DOWN
        ip("link", "set", name, "up")
        await one.send(END)
        assert (await reported(one)).state is BusState.UP
        up = await reported(other)
        assert (up.state, up.seen) == (BusState.UP, f"{name} is UP again")
        with trio.move_on_after(0.2):  # where it was not yet listening again
            await other.receive()
        await one.send(END)
        assert (await other.receive())[0] == END


def test_an_interface_that_goes_down_is_reported_and_comes_back(can: str) -> None:
    _goes_down_and_comes_back(can)


@trio_test(real_time=True)
async def _replaced(name: str) -> None:
    async with joined(name, "?filter=ids") as one, joined(name) as other:
        one.set_filters([END.key])
        seen: list[BusState] = []

        async def listen() -> None:
            while BusState.UP not in seen:
                seen.append((await reported(one)).state)

        async with trio.open_nursery() as nursery:
            nursery.start_soon(listen)
            await trio.testing.wait_all_tasks_blocked()
            ip("link", "del", name)
            ip("link", "add", "dev", name, "type", "vcan")
            ip("link", "set", name, "up")
        assert seen == [BusState.DOWN, BusState.UP]
        with pytest.raises(FrameNotSent):
            await other.send(END)
        await other.send(numbered(1))
        await other.send(END)
        assert (await one.receive())[0] == END  # the filter is there again
        assert [(await reported(other)).state for _ in range(2)] == [BusState.DOWN, BusState.UP]


def test_an_adapter_that_is_plugged_in_again(can: str) -> None:
    _replaced(can)


# ---- what is no frame ----


def error_frame(kinds: int, data: str = "0000000000000000") -> bytes:
    return struct.pack("=IB3x8s", ERROR | kinds, 8, bytes.fromhex(data))


@trio_test(real_time=True)
async def test_error_frames_become_reports() -> None:
    with interface() as name, raw_socket(name) as controller:
        async with joined(name) as one, joined(name) as other:
            for _ in range(3):
                controller.send(error_frame(0x20))  # no acknowledge, which comes with each repetition
            controller.send(error_frame(0x2))  # lost arbitration: daily life
            controller.send(error_frame(0x204, "0008000000006000"))
            controller.send(error_frame(0x204, "0020000000008800"))
            controller.send(error_frame(0x204, "0020000000009000"))
            controller.send(error_frame(0x4, "0001" + "00" * 6))
            controller.send(error_frame(0x40))
            assert (await reported(one)).state is BusState.NO_ACKNOWLEDGE
            report = await reported(one)
            assert (report.state, report.seen) == (
                BusState.WARNING,
                "controller warns of errors, tx error counter 96, rx error counter 0",
            )
            assert (await reported(one)).state is BusState.PASSIVE
            with pytest.raises(ReceiveOverrun, match="1 received frame lost"):
                await one.receive()
            report = await reported(one)
            assert report.state is BusState.BUS_OFF
            assert "ip -details -statistics link show vcan7" in report.tries
            assert one.errors == 9
            with pytest.raises(FrameNotSent, match="nothing acknowledges our frames") as caught:
                await one.send(END)
            assert caught.value.code == "CO110"
            controller.send(error_frame(0x100))
            assert (await reported(one)).state is BusState.ACTIVE
            await one.send(END)
            received = None
            while received != END:
                try:
                    received = (await other.receive())[0]
                except TransportError:
                    continue


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


# ---- too much ----


@trio_test(real_time=True)
async def test_frames_that_the_kernel_drops_are_told_at_their_place() -> None:
    async with joined("vcan0") as one, joined("vcan0") as other:
        other._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 20_000)
        for number in range(1000):
            await one.send(numbered(number))
        heard: list[int] = []
        with pytest.raises(ReceiveOverrun) as caught:
            while True:
                heard.append(number_of((await other.receive())[0]))
        assert heard == list(range(len(heard)))
        assert len(heard) + caught.value.lost == 1000
        assert caught.value.lost > 0
        for number in range(200):  # in the middle: the first frame behind the gap brings the counter with it
            await one.send(numbered(number))
        middle = [number_of((await other.receive())[0]) for _ in range(10)]
        await one.send(END)
        lost = 0
        while True:
            try:
                frame = (await other.receive())[0]
            except ReceiveOverrun as overrun:
                lost += overrun.lost
            else:
                if frame == END:
                    break
                middle.append(number_of(frame))
        assert middle == list(range(len(middle)))
        assert len(middle) + lost == 200


def slow(name: str, rate: str) -> None:
    """Let the interface take frames at this rate only, with the short queue of a real one."""
    tc = [tool("tc"), "qdisc", "replace", "dev", name, "root", "tbf", "rate", rate, "burst", "100", "limit", "160"]
    done = subprocess.run(tc, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"tc: {done.stderr.strip()}")


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
            nursery.start_soon(send, one, FrameNotSent)
            nursery.start_soon(send, two, trio.ClosedResourceError)
            await trio.sleep(0.1)
            await two.aclose()
            ip("link", "set", name, "down")
        await one.aclose()


# ---- filters and cyclic frames ----


@trio_test(real_time=True)
async def test_the_kernel_filters_what_it_is_told_to() -> None:
    async with joined("vcan0") as one, joined("vcan0", "?filter=ids") as other:
        frames = [Frame.parse(text) for text in ("181#01", "181#R", "182#", "00000181#", "18FF0001#02", "18FF0001#R1", "705#R")]

        async def through() -> list[str]:
            for frame in [*frames, END]:
                await one.send(frame)
            heard = []
            while (frame := (await other.receive())[0]) != END:
                heard.append(str(frame))
            return heard

        assert other.filtered
        assert len(await through()) == 7  # nobody has set one yet
        assert other.set_filters([0x181, 0x18FF0001 | KEY_EXTENDED | KEY_REMOTE, 0x705 | KEY_REMOTE, END.key])
        assert await through() == ["181#01", "18FF0001#R1", "705#R"]
        assert other.set_filters([END.key, END.key, 0x182])
        assert await through() == ["182#"]
        assert not other.set_filters(range(513))
        assert len(await through()) == 7
        assert other.set_filters([END.key])
        assert not other.set_filters(None)
        assert len(await through()) == 7


@trio_test(real_time=True)
async def test_the_kernel_sends_cyclic_frames() -> None:
    with interface() as name:
        async with joined(name, "?sync=bcm") as one, joined(name) as other:
            assert one.sends_sync
            one.start_cyclic([Frame(0x80, bytes((count,))) for count in (1, 2, 3)], 5_000_000)
            for transport in (one, other):  # we hear the kernel's frames ourselves
                assert [str((await transport.receive())[0]) for _ in range(7)] == [f"080#0{n}" for n in (1, 2, 3, 1, 2, 3, 1)]
            one.start_cyclic([Frame(0x80)], 20_000_000)
            while (await other.receive())[0].data:
                pass
            stamps = [(await other.receive())[1] or 0 for _ in range(6)]
            assert all(later > earlier for earlier, later in itertools.pairwise(stamps))
            one.stop_cyclic()
            one.stop_cyclic()
            await one.send(END)
            while (await other.receive())[0] != END:
                pass
            with trio.move_on_after(0.1) as scope:
                await other.receive()
            assert scope.cancelled_caught
            for frames, period in (([], 10**6), ([Frame(0x80)] * 257, 10**6), ([Frame(0x80)], 999), ([Frame(0x800)], 10**6)):
                with pytest.raises(ValueError):
                    one.start_cyclic(frames, period)
        with pytest.raises(trio.ClosedResourceError):
            one.start_cyclic([END], 10**6)


@trio_test(real_time=True)
async def test_no_cyclic_frames_on_an_interface_that_is_gone() -> None:
    with interface() as name:
        async with joined(name) as one:
            ip("link", "del", name)
            with pytest.raises(TransportError, match="cyclically"):
                one.start_cyclic([END], 10**6)
