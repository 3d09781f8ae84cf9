"""python-can's pcan backend, for real, against a stand-in for the maker's library: what the transport makes of it."""

from __future__ import annotations

import ctypes
import threading

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
    Transport,
    TransportError,
    open_transport,
)
from canopen_transports.conformance.frames import END, number_of, numbered
from canopen_transports.peak import attached
from tests.pcan.stand_in import BUS_HEAVY, BUS_LIGHT, BUS_OFF, CHANNEL_1, OVERRUN, PASSIVE, QUEUE_OVERRUN
from tests.transports.support import LIMIT, reported, trio_test

ONE, TWO = "pcan:PCAN_USBBUS1@500k", "pcan:PCAN_USBBUS2@500k"


@trio_test(real_time=True)
async def test_the_manuals_device_file_is_the_first_usb_channel(peak: ctypes.CDLL) -> None:
    async with await open_transport("/dev/pcan32") as one, await open_transport(TWO) as other:
        await one.send(Frame.parse("60C#4041600000000000"))
        frame, stamp = await other.receive()
        assert frame == Frame.parse("60C#4041600000000000")
        assert stamp is not None
        await other.send(Frame.parse("58C#4B41600037020000"))
        assert (await one.receive())[0] == Frame.parse("58C#4B41600037020000")
        assert peak.stand_in_bitrate(CHANNEL_1) == 0x001C  # BTR0, BTR1 for 500 kbit/s


@trio_test(real_time=True)
async def test_a_full_transmit_queue_is_waited_for(peak: ctypes.CDLL) -> None:
    async with await open_transport(ONE) as one, await open_transport(TWO) as other:
        peak.stand_in_full(CHANNEL_1, 5)
        await one.send(END)
        assert (await other.receive())[0] == END


@trio_test(real_time=True)
async def test_the_states_of_the_controller_are_told_once_each(peak: ctypes.CDLL) -> None:
    async with await open_transport(ONE) as one, await open_transport(TWO) as other:
        for status, state, seen in (
            (BUS_LIGHT, BusState.WARNING, "light limit"),
            (BUS_HEAVY | PASSIVE, BusState.PASSIVE, "error passive"),
            (0, BusState.ACTIVE, "No error"),
        ):
            peak.stand_in_status(CHANNEL_1, status)
            change = await reported(one)
            assert (change.state, seen in change.seen) == (state, True)
        await other.send(END)
        assert (await one.receive())[0] == END


@trio_test(real_time=True)
async def test_bus_off_is_told_and_left_by_initialising_anew(peak: ctypes.CDLL) -> None:
    async with await open_transport(ONE) as one, await open_transport(TWO) as other:
        await other.send(numbered(1))
        with trio.fail_after(LIMIT):
            while not isinstance(one, PythonCanTransport) or one.received == 0:
                await trio.sleep(0.01)
        peak.stand_in_status(CHANNEL_1, BUS_OFF)
        with pytest.raises(FrameNotSentError, match="nothing acknowledges") as refused:
            await one.send(END)
        assert refused.value.code == "CO110"
        assert number_of((await one.receive())[0]) == 1  # it came before
        off = await reported(one)
        assert (off.state, off.seen) == (BusState.BUS_OFF, "The controller is bus-off")
        with pytest.raises(FrameNotSentError, match="nothing acknowledges"):
            await one.send(END)
        assert (await reported(one)).state is BusState.ACTIVE
        await one.send(END)
        assert (await other.receive())[0] == END


@trio_test(real_time=True)
async def test_bus_off_may_be_left_to_the_driver(peak: ctypes.CDLL) -> None:
    async with await open_transport(f"{ONE}?auto_reset=true") as one, await open_transport(TWO) as other:
        peak.stand_in_status(CHANNEL_1, BUS_OFF)
        assert (await reported(one)).state is BusState.BUS_OFF
        assert (await reported(one)).state is BusState.ACTIVE
        await one.send(END)
        assert (await other.receive())[0] == END


@trio_test(real_time=True)
async def test_a_bus_of_somebody_elses_is_not_initialised_anew(peak: ctypes.CDLL) -> None:
    bus = can.Bus("PCAN_USBBUS1", interface="pcan", ignore_config=True)
    async with PythonCanTransport(bus) as one:
        peak.stand_in_status(CHANNEL_1, BUS_OFF)
        assert (await reported(one)).state is BusState.BUS_OFF
        peak.stand_in_status(CHANNEL_1, 0)  # its owner has done something about it
        assert (await reported(one)).state is BusState.ACTIVE
        peak.stand_in_plug(CHANNEL_1, 0)
        with pytest.raises(TransportError, match="cannot receive") as caught:
            await one.receive()
        assert (caught.value.code, caught.value.seen) == ("CO111", "The hardware handle is invalid")
        with pytest.raises(TransportError, match="cannot send"):
            await one.send(END)


@trio_test(real_time=True)
async def test_unplugged_while_running_and_plugged_in_again(peak: ctypes.CDLL) -> None:
    async with await open_transport(ONE) as one, await open_transport(TWO) as other:
        peak.stand_in_plug(CHANNEL_1, 0)
        down = await reported(one)
        assert (down.state, down.seen) == (BusState.DOWN, "The hardware handle is invalid")
        assert "unplugged" in down.cause
        async with trio.open_nursery() as nursery:
            nursery.start_soon(plug_in_again, peak, one)
            assert (await reported(one)).state is BusState.UP
        await one.send(END)
        assert (await other.receive())[0] == END


async def plug_in_again(peak: ctypes.CDLL, transport: Transport) -> None:
    with pytest.raises(FrameNotSentError, match="cannot send") as refused:
        await transport.send(END)
    assert "unplugged" in refused.value.cause
    await trio.sleep(0.2)  # one try to open it is in vain
    peak.stand_in_plug(CHANNEL_1, 1)


@trio_test(real_time=True)
async def test_a_sender_may_be_the_first_to_notice(peak: ctypes.CDLL) -> None:
    async with await open_transport(ONE) as one:
        peak.stand_in_plug(CHANNEL_1, 0)
        with pytest.raises(FrameNotSentError):
            await one.send(END)
        assert (await reported(one)).state is BusState.DOWN


@trio_test(real_time=True)
async def test_unplugged_at_bus_off(peak: ctypes.CDLL) -> None:
    async with await open_transport(ONE) as one:
        peak.stand_in_status(CHANNEL_1, BUS_OFF)
        assert (await reported(one)).state is BusState.BUS_OFF
        peak.stand_in_plug(CHANNEL_1, 0)
        assert (await reported(one)).state is BusState.DOWN
        peak.stand_in_plug(CHANNEL_1, 1)
        assert (await reported(one)).state is BusState.UP


@trio_test(real_time=True)
async def test_closed_while_it_is_away(peak: ctypes.CDLL) -> None:
    one = await open_transport(ONE)
    peak.stand_in_plug(CHANNEL_1, 0)
    assert (await reported(one)).state is BusState.DOWN

    async def receive() -> None:
        with pytest.raises(trio.ClosedResourceError):
            await one.receive()

    async with trio.open_nursery() as nursery:
        nursery.start_soon(receive)
        await trio.testing.wait_all_tasks_blocked()
        await one.aclose()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("receive ")]


@trio_test(real_time=True)
async def test_an_overrun_is_told_and_more_is_received(peak: ctypes.CDLL) -> None:
    async with await open_transport(ONE) as one, await open_transport(TWO) as other:
        for status in (OVERRUN, QUEUE_OVERRUN):
            peak.stand_in_read(CHANNEL_1, status)
            caught = await reported(one, ReceiveOverrun, match="1 received frame lost")
            assert "too late" in caught.seen
        await other.send(END)
        assert (await one.receive())[0] == END


@trio_test(real_time=True)
async def test_a_queue_of_the_library_that_was_too_short(peak: ctypes.CDLL) -> None:
    async with await open_transport(ONE) as one, await open_transport(TWO) as other:
        peak.stand_in_queue(0)
        await other.send(END)
        await reported(one, ReceiveOverrun, match="1 received frame lost")


@trio_test(real_time=True)
async def test_an_overrun_that_only_the_status_tells(peak: ctypes.CDLL) -> None:
    async with await open_transport(ONE) as one:
        peak.stand_in_status(CHANNEL_1, OVERRUN)
        await reported(one, ReceiveOverrun, match="1 received frame lost")


@trio_test(real_time=True)
async def test_an_overrun_that_the_status_goes_on_telling_is_told_once(peak: ctypes.CDLL) -> None:
    async with await open_transport(ONE) as one, await open_transport(TWO) as other:
        peak.stand_in_status(CHANNEL_1, OVERRUN)
        await reported(one, ReceiveOverrun, match="1 received frame lost")
        for _ in range(3):
            one._follow(one._peak, OVERRUN)  # type: ignore[attr-defined] # a further look, between those of the reader
        await other.send(END)
        assert (await one.receive())[0] == END


@trio_test(real_time=True)
async def test_error_frames_say_what_they_saw(peak: ctypes.CDLL) -> None:
    async with await open_transport(ONE) as one, await open_transport("pcan:PCAN_USBBUS2@250k") as other:
        await one.send(END)
        await one.send(END)  # so soon, it is not told again
        fault = await reported(other)
        assert fault.state is BusState.FAULT
        assert fault.seen == "stuff error while receiving, tx error counter 0, rx error counter 8"


@trio_test(real_time=True)
async def test_listening_only_says_nothing(peak: ctypes.CDLL) -> None:
    async with await open_transport(f"{ONE}?listen_only=true") as one, await open_transport(TWO) as other:
        assert peak.stand_in_listens_only(CHANNEL_1) == 1
        await other.send(END)
        assert (await one.receive())[0] == END
        with pytest.raises(FrameNotSentError, match="cannot send") as caught:
            await one.send(END)
        assert caught.value.seen == "it was opened to listen only"
    async with await open_transport(f"{ONE}?listen_only=false"):
        assert peak.stand_in_listens_only(CHANNEL_1) == 0


def opening(locator: str) -> TransportError:
    with pytest.raises(TransportError) as caught:
        trio.run(open_transport, locator)
    return caught.value


def test_a_channel_that_is_not_there(peak: ctypes.CDLL) -> None:
    peak.stand_in_plug(CHANNEL_1, 0)
    error = opening("pcan:PCAN_USBBUS1@250k")
    assert error.code == "CO101"
    assert error.seen == "The hardware handle is invalid"
    assert error.cause.startswith("there is no PCAN_USBBUS1, but PCAN_USBBUS2, ")
    assert error.tries[0] == "pcan:PCAN_USBBUS2@250k"


def test_a_channel_that_is_in_use(peak: ctypes.CDLL) -> None:
    peak.stand_in_occupy(CHANNEL_1)
    assert attached()["PCAN_USBBUS1"] == "in use"
    error = opening(ONE)
    assert (error.seen, error.cause) == ("The hardware is in use already", "another program uses the adapter")


def test_the_driver_is_not_loaded(peak: ctypes.CDLL) -> None:
    peak.stand_in_driver(0)
    assert attached() == {}
    error = opening("/dev/pcan32")
    assert error.seen == "The driver is not loaded"
    assert error.cause == "no PEAK adapter is plugged in, or its driver is not loaded"
    assert error.tries[0] == "sudo modprobe pcan && cat /proc/pcan"


def test_the_library_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("can.interfaces.pcan.basic.find_library", lambda name: None)
    assert attached() == {}
    error = opening(ONE)
    assert error.seen == "pcanbasic library not found."
    assert error.cause == "the software for this adapter is not installed"
    assert error.tries[0] == "install PEAK's driver and its PCAN-Basic library (peak-system.com)"


def test_a_free_channel_that_the_driver_refuses(peak: ctypes.CDLL, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("canopen_transports.diagnosis.attached", lambda: {"PCAN_USBBUS9": "free"})
    assert opening("pcan:PCAN_USBBUS9").cause == "the driver refuses the adapter, which is there and free"
