"""SocketCAN's error frames, as words and as states of the bus."""

from __future__ import annotations

import sys

import pytest

from canopen_transports import BusState

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="SocketCAN is Linux's alone")


@pytest.mark.parametrize(
    ("kinds", "data", "state", "text"),
    [
        (0x001, "", BusState.FAULT, "transmission timed out"),
        (0x002, "", None, "lost arbitration"),
        (0x004, "0001", None, "controller's receive buffer overran"),
        (0x004, "0002", BusState.FAULT, "controller's transmit buffer overran"),
        (0x204, "0004000000000060", BusState.WARNING, "controller warns of errors, tx error counter 0, rx error counter 96"),
        (0x004, "0020", BusState.PASSIVE, "controller is error-passive"),
        (0x004, "0040", BusState.ACTIVE, "controller is error-active again"),
        (0x004, "00", None, "controller trouble, unspecified"),
        (0x004, "0030", BusState.PASSIVE, "controller is error-passive"),
        (0x008, "00004003", BusState.FAULT, "protocol violation on the wire, active error flag"),
        (0x008, "00008402", BusState.FAULT, "protocol violation on the wire, bit stuffing, while sending"),
        (0x088, "00000019", BusState.NO_ACKNOWLEDGE, "protocol violation on the wire, bus error, no acknowledge"),
        (0x010, "0000000004", BusState.FAULT, "transceiver fault"),
        (0x020, "", BusState.NO_ACKNOWLEDGE, "no acknowledge"),
        (0x024, "0030", BusState.PASSIVE, "no acknowledge, controller is error-passive"),
        (0x044, "0030", BusState.BUS_OFF, "controller is bus-off, controller is error-passive"),
        (0x100, "", BusState.ACTIVE, "controller restarted"),
        (0x200, "", None, "unknown error"),
    ],
)
def test_what_an_error_frame_says(kinds: int, data: str, state: BusState | None, text: str) -> None:
    from canopen_transports.error_frames import ErrorReport

    report = ErrorReport(kinds, bytes.fromhex(data))
    assert (report.state, report.text) == (state, text)
    assert report.overrun == ("receive buffer" in text)
