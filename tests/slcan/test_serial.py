"""python-can's `serial` backend over a pseudo-terminal: it waits for the rest of a frame, and nobody else has to."""

from __future__ import annotations

import os
import struct
import sys
from collections.abc import Iterator
from typing import NamedTuple

import pytest
import trio

from canopen_proto.frame import Frame
from canopen_transports import BusState, ReceiveOverrun, open_transport
from tests.transports.support import reported, trio_test

if sys.platform == "win32":
    pytest.skip("pseudo-terminals are POSIX's alone", allow_module_level=True)

import pty
import tty

# start, time in ms, length, identifier, data, end
FRAME = b"\xaa" + struct.pack("<IBI", 1500, 2, 0x181) + b"\x01\x02\xbb"


class Line(NamedTuple):
    """The adapter's end of a serial line, and how a program calls the other."""

    fd: int
    name: str


@pytest.fixture
def line() -> Iterator[Line]:
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    yield Line(ours, os.ttyname(theirs))
    os.close(theirs)
    os.close(ours)


@trio_test(real_time=True)
async def test_frames_both_ways(line: Line) -> None:
    async with await open_transport(f"serial:{line.name}") as transport:
        os.write(line.fd, FRAME)
        assert await transport.receive() == (Frame.parse("181#0102"), 1_500_000_000)
        await transport.send(Frame.parse("601#40"))
        assert (await trio.to_thread.run_sync(os.read, line.fd, 100)).hex() == "aa00000000010106000040bb"


@trio_test(real_time=True)
async def test_half_a_frame_is_a_frame_lost(line: Line) -> None:
    async with await open_transport(f"serial:{line.name}?timeout=0.01") as transport:
        os.write(line.fd, FRAME[:3])
        lost = await reported(transport, ReceiveOverrun, match="1 received frame lost")
        assert "tty_baudrate" in lost.cause
        os.write(line.fd, FRAME)
        assert (await transport.receive())[0] == Frame.parse("181#0102")


@trio_test(real_time=True)
async def test_a_line_that_hangs_up(line: Line) -> None:
    async with await open_transport(f"serial:{line.name}") as transport:
        spare = os.open(os.devnull, os.O_RDWR)
        os.dup2(spare, line.fd)  # the adapter's end is closed
        os.close(spare)
        assert (await reported(transport)).state is BusState.DOWN
