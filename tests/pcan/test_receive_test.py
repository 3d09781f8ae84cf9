"""The receive test and the search for a bit rate, with adapters that are none."""

from __future__ import annotations

import ctypes

import pytest
import trio

from canopen_proto.frame import Frame
from canopen_transports import BusState, Transport, TransportError, open_transport, parse_locator
from canopen_transports.receive_test import Heard, find_bitrate, listen, listen_on, silently
from tests.pcan.stand_in import CHANNEL_1, OVERRUN, PASSIVE
from tests.transports.support import run


def test_how_a_bus_is_opened_to_listen() -> None:
    for text, opened in (
        ("pcan:PCAN_USBBUS1@500k", "pcan:PCAN_USBBUS1@500k?listen_only=true"),
        ("pcan:PCAN_USBBUS1?auto_reset=true", "pcan:PCAN_USBBUS1?auto_reset=true&listen_only=true"),
        ("pcan:PCAN_USBBUS1?listen_only=false", "pcan:PCAN_USBBUS1?listen_only=false"),
        ("gs_usb:0", "gs_usb:0"),
        ("socketcan:can0", "socketcan:can0"),
    ):
        assert silently(parse_locator(text)) == opened


async def chatter(transport: Transport) -> None:
    while True:
        for text in ("703#05", "181#0102", "00000123#01"):
            await transport.send(Frame.parse(text))
        await trio.sleep(0.005)


def test_what_is_heard(peak: ctypes.CDLL) -> None:
    async def body() -> None:
        async with await open_transport("pcan:PCAN_USBBUS2@500k") as other, trio.open_nursery() as nursery:
            nursery.start_soon(chatter, other)
            heard = await listen("/dev/pcan32", 0.2)
            while len(heard.ids) < 2:  # a busy computer
                heard = await listen("/dev/pcan32", 1)
            assert heard.listen_only
            assert heard.frames >= 3
            assert heard.nodes == [3]
            assert set(heard.ids) == {0x703, 0x181}
            assert heard.first is not None
            assert not heard.is_bad
            nursery.cancel_scope.cancel()

    run(body, real_time=True)


def test_each_frame_counts_however_many_can_ids_there_are() -> None:
    async def body() -> None:
        async with await open_transport("virtual:all") as talker, await open_transport("virtual:all") as transport:
            for can_id in (*range(0x800), 0x7FF):
                await talker.send(Frame(can_id))
            heard = await listen_on(transport, "here", 1)
            assert (heard.frames, heard.ids.total(), heard.ids[0x7FF]) == (2049, 2049, 2)

    run(body)


def test_what_a_bus_reports(peak: ctypes.CDLL) -> None:
    async def body() -> None:
        async with await open_transport("pcan:PCAN_USBBUS1@500k") as transport:
            peak.stand_in_read(CHANNEL_1, OVERRUN)
            peak.stand_in_status(CHANNEL_1, PASSIVE)
            heard = await listen_on(transport, "here", 1)
            assert [state for state, _ in heard.states] == [BusState.PASSIVE]
            assert heard.lost == 1
            assert not heard.is_bad

    run(body, real_time=True)


@pytest.mark.parametrize("text", ["pcan:PCAN_USBBUS1@1M?auto_reset=true", "/dev/pcan32"])
def test_the_bit_rate_is_found(peak: ctypes.CDLL, text: str) -> None:
    async def body() -> None:
        told: list[Heard] = []
        async with await open_transport("pcan:PCAN_USBBUS2@250k") as other, trio.open_nursery() as nursery:
            nursery.start_soon(chatter, other)
            for seconds in (0.1, 1, 5):  # a busy computer needs longer
                told.clear()
                found = await find_bitrate(text, seconds, told.append)
                if found is not None:
                    break
            assert found is not None
            assert "PCAN_USBBUS1@250k" in found.locator
            nursery.cancel_scope.cancel()
        assert [bool(each.frames) for each in told] == [False, False, True]
        assert [each.is_bad for each in told] == [True, True, False]

    run(body, real_time=True)


def test_no_bit_rate_is_found(peak: ctypes.CDLL) -> None:
    async def body() -> None:
        assert await find_bitrate("pcan:PCAN_USBBUS1", 0.001) is None
        peak.stand_in_occupy(CHANNEL_1)
        with pytest.raises(TransportError, match="CO101"):
            await find_bitrate("pcan:PCAN_USBBUS1", 0.001)
        with pytest.raises(TransportError, match="CO100"):
            await find_bitrate("gs_usb:0", 0.001)

    run(body, real_time=True)
