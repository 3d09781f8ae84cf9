"""`WorldLoop` in a time that does nothing but jump."""

from __future__ import annotations

import asyncio

import pytest

from canopen_proto.machine import SECOND
from canopen_testing.world_loop import WorldLoop
from tests.loops import VirtualTime

DAY = 24 * 3600 * SECOND


@pytest.mark.parametrize("begin", [0, 2_700_000_000, 1234 * SECOND + 1, 40 * DAY + 7, 400 * DAY + 7])
@pytest.mark.parametrize("nanoseconds", [1, 2, 3, 999, 1_000_001])
def test_a_timer_is_never_so_early_that_it_is_set_once_more(begin: int, nanoseconds: int) -> None:
    """asyncio takes a timer that is 1 ns too early for due: then no time passes here."""
    time = VirtualTime()
    time.now = begin

    async def main() -> int:
        loop = asyncio.get_running_loop()
        deadline = (begin + nanoseconds) / SECOND
        for turn in range(10):
            if loop.time() >= deadline:
                return turn
            loop.call_soon(int)  # something else is ready: so the loop looks for timers before time passes
            await asyncio.sleep(deadline - loop.time())
        raise AssertionError(f"it is still {loop.time():.9f} s, and {deadline:.9f} s was waited for")

    with asyncio.Runner(loop_factory=lambda: WorldLoop(time)) as runner:
        assert runner.run(main()) <= 2
