"""The timekeeper's alarm, the fine one on a real clock (a few milliseconds of it) and the coarse one in virtual time."""

from __future__ import annotations

import sys
from contextlib import closing

import pytest

from canopen_master.participant.alarm import Alarm, CoarseAlarm, FineAlarm, best_alarm
from tests.master.loops import loop, settled
from tests.transports.support import run


async def keeps_time(alarm: Alarm) -> None:
    """Whatever was set first, it wakes at the earliest, and never before it."""
    with closing(alarm):
        for late, early in ((0.02, 0.004), (0.003, 0.03)):
            start = loop.current_time()
            alarm.set(start + late)
            alarm.set(start + early)
            await alarm.wait()
            assert loop.current_time() >= start + min(late, early)
        start = loop.current_time()
        async with loop.open_nursery() as nursery:
            nursery.start_soon(alarm.wait)
            await settled()
            alarm.set(start + 3600)
            alarm.set(start + 0.002)
        assert loop.current_time() >= start + 0.002
        alarm.set(start - 1)
        await alarm.wait()
        with loop.move_on_after(0.002) as scope:
            await alarm.wait()
        assert scope.cancelled_caught


def test_virtual_time_has_the_coarse_one() -> None:
    async def body() -> None:
        alarm = best_alarm()
        assert isinstance(alarm, CoarseAlarm)
        await keeps_time(alarm)

    run(body)


@pytest.mark.skipif(sys.platform != "linux", reason="timerfd is Linux's alone")
def test_a_real_clock_on_linux_has_the_fine_one() -> None:
    async def body() -> None:
        alarm = best_alarm()
        assert isinstance(alarm, FineAlarm)
        await keeps_time(alarm)

    run(body, real_time=True)
