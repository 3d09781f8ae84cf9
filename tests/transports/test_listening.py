"""`listening`: each frame of a bus is told once, beside a recording or without one."""

from __future__ import annotations

import pytest
import trio

from canopen_proto.frame import Frame
from canopen_transports import open_transport
from canopen_transports.record import Record
from canopen_transports.tracing import current_trace, listening, recording


class Kept:
    """A LogWriter that keeps what is written."""

    left_out = 0

    def __init__(self) -> None:
        self.records: list[Record] = []
        self.write = self.records.append

    def close(self) -> None:
        """Nothing is open."""


async def say(frame: Frame) -> None:
    async with await open_transport("virtual:listening") as one, await open_transport("virtual:listening") as other:
        await one.send(frame)
        await other.receive()


@pytest.mark.parametrize("is_recorded", [False, True])
def test_each_frame_is_told_once_and_the_recording_goes_on(is_recorded: bool) -> None:
    heard: list[Record] = []
    kept = Kept()

    async def work() -> None:
        with listening(heard.append) as trace:
            await say(Frame(0x705, b"\x05"))
            assert abs(trace.now() - heard[0].time) < 10**10
        await say(Frame(0x706, b"\x05"))

    async def recorded() -> None:
        with recording(kept):
            await work()

    trio.run(recorded if is_recorded else work)
    assert [str(each.frame) for each in heard] == ["705#05"]
    assert [str(each.frame) for each in kept.records] == (["705#05", "706#05"] if is_recorded else [])
    assert current_trace() is None
