"""The clock of live displays goes on between frames, and never goes back."""

from __future__ import annotations

import trio
from trio.testing import MockClock

from canopen_cli.live.clocks import FrameClock
from canopen_cli.live.notes import note_source, note_state
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_transports.errors import BusState


def test_it_goes_on_between_frames() -> None:
    async def main() -> None:
        clock = FrameClock()
        assert clock.set(50 * SECOND) == 50 * SECOND
        await trio.sleep(3)
        assert clock.now() == 53 * SECOND
        assert clock.set(52 * SECOND) == 52 * SECOND  # it waited somewhere for a second
        assert clock.now() == 52 * SECOND

    trio.run(main, clock=MockClock(autojump_threshold=0))


def test_it_never_goes_back() -> None:
    async def main() -> None:
        clock = FrameClock()
        clock.set(50 * SECOND)
        assert clock.set(50 * SECOND - MILLISECOND) == 50 * SECOND  # of two buses, out of order
        assert clock.set(50 * SECOND + MILLISECOND) == 50 * SECOND + MILLISECOND
        assert clock.jumps == 0
        assert clock.set(10 * SECOND) == 50 * SECOND + MILLISECOND  # another recording begins
        assert clock.set(13 * SECOND) == 53 * SECOND + MILLISECOND
        assert clock.jumps == 1
        notes: dict[str, str] = {}
        note_source(notes, None, clock)
        assert notes == {"clock": "the clock of the frames went back 1 time; time goes on from there"}

    trio.run(main, clock=MockClock(autojump_threshold=0))


def test_a_bus_that_is_well_again_is_no_news() -> None:
    notes: dict[str, str] = {}
    note_state(notes, BusState.BUS_OFF, "too many errors")
    assert notes == {"bus": "the bus is bus-off: too many errors"}
    note_state(notes, BusState.ACTIVE, "")
    assert notes == {}
