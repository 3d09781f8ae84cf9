"""What a bus reports that is no frame, by a real kernel: interfaces that go away and come back, and error frames."""

from __future__ import annotations

import resource
import socket
import struct
from collections.abc import Iterator

import pytest
import trio
import trio.testing

from canopen_transports import BusState, FrameNotSentError, ReceiveOverrun, TransportError, open_transport
from canopen_transports.conformance.frames import END, number_of, numbered
from tests.transports.support import reported, trio_test
from tests.vcan.support import error_frame, interface, ip, joined, needs_vcan, raw_socket

pytestmark = needs_vcan

END_AS_WRITTEN = struct.pack("=IB3x8s", END.can_id, 1, END.data)


@pytest.fixture
def can() -> Iterator[str]:
    with interface() as name:
        yield name


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
            with pytest.raises(FrameNotSentError) as caught:
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
        with pytest.raises(FrameNotSentError):
            await other.send(END)
        await other.send(numbered(1))
        await other.send(END)
        assert (await one.receive())[0] == END  # the filter is there again
        assert [(await reported(other)).state for _ in range(2)] == [BusState.DOWN, BusState.UP]


def test_an_adapter_that_is_plugged_in_again(can: str) -> None:
    _replaced(can)


@trio_test(real_time=True)
async def test_an_interface_that_vanishes_while_it_is_being_opened() -> None:
    with pytest.raises(TransportError, match="cannot open socketcan:nocan0") as caught:
        joined("nocan0")  # as if it had been there when `open_transport` looked
    assert caught.value.code == "CO101"
    assert caught.value.cause.startswith("the adapter is not plugged in")


@trio_test(real_time=True)
async def _removed(name: str) -> None:
    async with joined(name) as one, joined(name) as other:
        for number in range(3):
            await one.send(numbered(number))
        ip("link", "del", name)
        with pytest.raises(FrameNotSentError) as caught:  # the sender finds it out, not the receiver
            await other.send(END)
        assert caught.value.seen == f"{name} is gone"
        assert caught.value.tries == ("plug it in again", "ip link")
        assert [number_of((await other.receive())[0]) for _ in range(3)] == [0, 1, 2]
        down = await reported(other)
        assert (down.state, down.seen) == (BusState.DOWN, f"{name} is gone")


def test_what_came_before_an_interface_was_removed_stands_before_the_report(can: str) -> None:
    _removed(can)


@trio_test(real_time=True)
async def test_a_new_interface_may_have_the_number_of_the_old_one() -> None:
    with interface(index=7777) as name:
        one = joined(name)
    async with one:
        with interface(index=7777):
            assert [(await reported(one)).state for _ in range(2)] == [BusState.DOWN, BusState.UP]
            async with joined(name) as other:
                await other.send(END)
                assert (await one.receive())[0] == END
                await one.send(END)
                assert (await other.receive())[0] == END


@trio_test(real_time=True)
async def test_a_new_interface_that_cannot_be_opened_yet_is_tried_again() -> None:
    with interface() as name:
        one = joined(name)
    async with one:
        assert (await reported(one)).state is BusState.DOWN
        with interface(), raw_socket(name) as sender:
            limits = resource.getrlimit(resource.RLIMIT_NOFILE)
            resource.setrlimit(resource.RLIMIT_NOFILE, (3, limits[1]))  # no descriptor is to be had
            try:
                with pytest.raises(FrameNotSentError):
                    one.send_nowait(END)
            finally:
                resource.setrlimit(resource.RLIMIT_NOFILE, limits)
            assert (await reported(one)).state is BusState.UP
            sender.send(END_AS_WRITTEN)
            assert (await one.receive())[0] == END


@trio_test(real_time=True)
async def _renamed(name: str) -> None:
    async with joined(name) as one:
        ip("link", "set", name, "down")
        ip("link", "set", name, "name", "vcan8")
        ip("link", "set", "vcan8", "up")
        try:
            assert (await reported(one)).seen == f"{name} is gone"
            with raw_socket("vcan8") as stranger:
                stranger.send(b"\x23\x01" + bytes(14))
            with pytest.raises(FrameNotSentError):
                await one.send(END)
            with interface(name), raw_socket(name) as sender:
                report = await reported(one)
                assert (report.state, report.seen) == (BusState.UP, f"there is a new {name}, and it is UP")
                sender.send(END_AS_WRITTEN)
                assert (await one.receive())[0] == END
        finally:
            ip("link", "del", "vcan8")


def test_an_interface_that_is_renamed_is_gone_until_there_is_one_of_that_name(can: str) -> None:
    _renamed(can)


@trio_test(real_time=True)
async def _flaps(name: str) -> None:
    async with joined(name) as one, joined(name) as other:
        ip("link", "set", name, "down")
        assert (await reported(one)).state is BusState.DOWN
        for way in ("up", "down", "up"):
            ip("link", "set", name, way)
        assert (await reported(one)).state is BusState.UP
        assert [(await reported(other)).state for _ in range(2)] == [BusState.DOWN, BusState.UP]
        await other.send(END)
        assert (await one.receive())[0] == END


def test_what_happened_while_it_was_away_is_not_told_later(can: str) -> None:
    _flaps(can)


@trio_test(real_time=True)
async def _overrun_and_down(name: str) -> None:
    async with joined(name) as one, joined(name) as other:
        other._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 20_000)
        for number in range(1000):
            await one.send(numbered(number))
        ip("link", "set", name, "down")
        heard = 0
        while isinstance(received := await other.receive(), tuple):
            assert number_of(received[0]) == heard
            heard += 1
        assert isinstance(received, ReceiveOverrun)
        assert heard + received.lost == 1000
        assert (await reported(other)).state is BusState.DOWN


def test_frames_that_the_kernel_drops_before_an_interface_goes_down_are_told(can: str) -> None:
    _overrun_and_down(can)


@trio_test(real_time=True)
async def _told_by_the_sender(name: str) -> None:
    async with joined(name) as one:

        async def listen() -> None:
            assert [(await reported(one)).state for _ in range(2)] == [BusState.DOWN, BusState.UP]
            with pytest.raises(trio.ClosedResourceError):
                await one.receive()

        async with trio.open_nursery() as nursery:
            nursery.start_soon(listen)
            await trio.testing.wait_all_tasks_blocked()
            ip("link", "set", name, "down")
            with pytest.raises(FrameNotSentError):
                one.send_nowait(END)
            await trio.testing.wait_all_tasks_blocked()
            ip("link", "set", name, "up")
            while not one.send_nowait(END):
                pass
            await trio.testing.wait_all_tasks_blocked(0.1)
            await one.aclose()


def test_a_sender_that_finds_the_bus_away_wakes_the_receiver_who_reports_it_once(can: str) -> None:
    _told_by_the_sender(can)


# ---- error frames ----


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
            await reported(one, ReceiveOverrun, match="1 received frame lost")
            report = await reported(one)
            assert report.state is BusState.BUS_OFF
            assert "ip -details -statistics link show vcan7" in report.tries
            assert one.errors == 9
            with pytest.raises(FrameNotSentError, match="nothing acknowledges our frames") as caught:
                await one.send(END)
            assert caught.value.code == "CO110"
            controller.send(error_frame(0x100))
            assert (await reported(one)).state is BusState.ACTIVE
            await one.send(END)
            while not isinstance(received := await other.receive(), tuple) or received[0] != END:
                pass


@trio_test(real_time=True)
async def test_a_filter_for_frames_lets_error_frames_through() -> None:
    with interface() as name, raw_socket(name) as controller:
        async with joined(name, "?filter=ids") as one:
            assert one.set_filters([])
            controller.send(b"\x23\x01" + bytes(14))
            controller.send(error_frame(0x40))
            assert (await reported(one)).state is BusState.BUS_OFF


@trio_test(real_time=True)
async def test_a_report_that_is_among_the_frames_lost() -> None:
    with interface() as name, raw_socket(name) as controller:
        async with joined(name) as one, joined(name) as other:
            other._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 20_000)
            controller.send(error_frame(0x40))
            for number in range(1000):
                controller.send(number.to_bytes(2, "little") + bytes(14))
            controller.send(error_frame(0x100))
            assert (await reported(other)).state is BusState.BUS_OFF
            with pytest.raises(FrameNotSentError):
                await other.send(END)
            while not isinstance(await other.receive(), ReceiveOverrun):
                pass
            await other.send(END)
            report = await reported(other)
            assert (report.state, report.seen) == (BusState.ACTIVE, f"{name} has a carrier again")
            while not isinstance(received := await one.receive(), tuple) or received[0] != END:
                pass


@trio_test(real_time=True)
async def test_a_controller_that_was_bus_off_before_we_came() -> None:
    """A vxcan whose other end is down has no carrier, as an adapter that is bus-off: the kernel takes frames, and drops them."""
    with interface("vxcan7", kind="vxcan", more=("peer", "name", "vxcan8")) as name:
        async with joined(name) as one:
            assert (await reported(one)).state is BusState.BUS_OFF
            with pytest.raises(FrameNotSentError, match="nothing acknowledges our frames"):
                await one.send(END)
            ip("link", "set", "vxcan8", "up")
            async with joined("vxcan8") as other:
                await one.send(END)
                assert (await reported(one)).state is BusState.ACTIVE
                assert (await other.receive())[0] == END
                ip("link", "set", "vxcan8", "down")
                ip("link", "set", name, "down")
                ip("link", "set", name, "up")
                assert [(await reported(one)).state for _ in range(3)] == [BusState.DOWN, BusState.UP, BusState.BUS_OFF]
