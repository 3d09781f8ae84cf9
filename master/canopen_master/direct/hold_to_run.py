"""Motion of one drive while its user holds something, for the direct half, which sends SYNC by hand. HandSync sends it, and looks
at the drive before a late one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress

from canopen_master.direct.drive import DirectDrive
from canopen_master.errors import MasterError
from canopen_master.motion.target_motion import DEAD_MAN
from canopen_master.trajectories.target_stream import TargetStream
from canopen_proto.drives.trajectory import PathPoint
from canopen_proto.machine import LocalProtocolError
from canopen_proto.procedures.steps import ProcedureError
from canopen_transports.loop import current_loop
from canopen_transports.loop.beside import beside


async def move_while_held(drive: DirectDrive, speed: float, held: Callable[[], bool]) -> None:
    """Move a drive at `speed`, in its unit per second, as long as `held` returns True; see Session.move_until_user_interrupt.

    held: waits in a thread of its own. If it hangs, the dead man's switch of the stream brakes. Once cancelled, the drive brakes
    first. In the end it is halted: nobody sends SYNC from then on. Raises as DirectDrive.follow and send_position do, and what
    `held` raises, once the drive stands.
    """
    if drive.master.sync_period:
        raise LocalProtocolError("the master's own SYNC runs: jog a chain instead")
    if not await _asked(held):
        return
    await drive.follow()
    try:
        await drive.until_halted(_Motion(drive, speed, held).to_its_end)
    except BaseException:
        with (
            current_loop().cancel_scope(shield=True),
            suppress(ProcedureError, MasterError),
        ):  # the first error is the one to tell
            await drive.halt()
        raise
    await drive.halt()


async def _asked(held: Callable[[], bool]) -> bool:
    return await current_loop().in_thread(held, abandon_on_cancel=True)


class _Motion:
    """One motion. failure: what ended it; None if `held` did."""

    def __init__(self, drive: DirectDrive, speed: float, held: Callable[[], bool]) -> None:
        self._drive, self._speed, self._held = drive, speed, held
        self._period = drive.interval / 1000
        start = PathPoint([drive.axis.set_points.position], [0.0], [0.0])
        cycles = math.ceil(DEAD_MAN / self._period)
        self._stream = TargetStream(start, [drive.limits], self._period, renew_cycles=cycles)
        self.failure: Exception | None = None

    async def to_its_end(self) -> None:
        """Move until it ends, and the drive has the set-point at which it stands. Raises what ended it."""
        async with beside(current_loop().open_nursery()) as nursery:
            nursery.start_soon(self.listen)
            try:
                await self.run()
            except current_loop().Cancelled:
                with current_loop().cancel_scope(shield=True):
                    self._stream.stop()
                    await self.run()
                raise
        if self.failure is not None:
            raise self.failure

    async def listen(self) -> None:
        """Ask `held` until it says no; then brake. The first answer may be from before the drive was ready: it moves nothing."""
        try:
            is_held = await _asked(self._held)
            self._stream.renew()
            while is_held and (is_held := await _asked(self._held)) and not self._stream.is_stopping:
                self._stream.move_at([self._speed])
        except Exception as error:  # noqa: BLE001 - the user's code: the drive brakes first
            self.failure = error
        self._stream.stop()

    async def run(self) -> None:
        """Send a set-point and SYNC in each interval until the stream has ended and is at rest."""
        due = current_loop().current_time()
        try:
            while not self._stream.is_finished:
                (position,) = self._stream.step().positions
                await self._drive.go_to(round(position) if self._drive.in_counts else position)
                if not self._drive.is_on_path:  # behind a late SYNC: there is no path to come back to, it goes on from there
                    self._stream.stand_at(0, [self._drive.stay()])
                due += self._period
                await current_loop().sleep_until(due)
                late = current_loop().current_time() - due
                if late > 0:  # the path waits; the dead man's switch does not
                    lost = int(late / self._period)
                    self._stream.after_gap(lost, from_rest=False)
                    due += lost * self._period
        except Exception as error:  # noqa: BLE001 - a nursery would wrap it in a group
            self.failure = error
