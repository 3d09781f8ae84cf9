"""A task waits for the end of a motion while the process is stalled."""

from __future__ import annotations

from canopen_master.motion.path_motion import NO_SYNC, WITHOUT_SYNC, Motion
from canopen_proto.drives.trajectory.path import PathPoint
from tests.loops import jump, loop
from tests.master.world import virtual_time


class Going:
    """A stream of targets that goes on for ever."""

    is_finished = is_at_rest = False

    def step(self) -> PathPoint:
        return PathPoint([], [], [])

    def stop(self) -> None:
        pass

    def after_gap(self, lost_cycles: int, *, from_rest: bool) -> None:
        pass


@virtual_time
async def test_a_wait_that_wakes_long_after_the_last_point_goes_on() -> None:
    motion = Motion(Going(), [], 0.01, PathPoint([], [], []))
    async with loop.open_nursery() as nursery:
        nursery.start_soon(motion.over)
        await loop.sleep(0.6 * WITHOUT_SYNC)
        motion.advance(0)  # the last point before the stall
        jump(3.0 * WITHOUT_SYNC)
        await loop.sleep(0.1 * WITHOUT_SYNC)
        assert not motion.is_over
        motion.end(NO_SYNC)
