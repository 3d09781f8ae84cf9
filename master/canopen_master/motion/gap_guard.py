"""`GapGuard`: what a chain does before a late SYNC: it asks joints that may be out of reach (late_sync.py).

Each joint is asked by SDO, all at once, and its position becomes the set-point that waits in it: so it stays there at the SYNC,
and comes back to its path from there. Meanwhile SYNC waits, on all buses. If a joint does not tell its position, its chain is
halted.
"""

from __future__ import annotations

from collections.abc import Callable

from canopen_master.motion.cycles import SetPoints
from canopen_master.motion.joint_procedures import JointFailed, quietly
from canopen_proto.drive.synchronous import align_position
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.procedures.steps import Procedure, all_of


class GapGuard:
    """The `SyncGuard` of one chain; see this module's text."""

    def __init__(self, set_points: SetPoints, stop: Callable[[str], None]) -> None:
        """stop: halts the chain; it is told why."""
        self._set_points = set_points
        self._stop = stop
        self._looked: list[JointFailed | None] | None = None  # the failures, joint by joint; None: nobody was asked

    def look_before_sync(self, late: Time) -> Procedure[object] | None:
        """See `SyncGuard`."""
        return self._look() if self._set_points.must_look(late) else None

    def before_late_sync(self, late: Time) -> None:
        """See `SyncGuard`."""
        looked, self._looked = self._looked, None
        if not self._set_points.is_followed:
            return
        failed = next((each for each in looked or () if each is not None), None)
        if failed is not None:
            joint = failed.device.name
            self._stop(f"because SYNC was {late / MILLISECOND:.0f} ms late, and {joint} did not tell where it is: {failed}")
            return
        if looked is not None:
            self._set_points.stand_at_images()
        self._set_points.before_late_sync(late)

    def _look(self) -> Procedure[None]:
        self._set_points.rest()
        joints = self._set_points.limited
        self._looked = yield from all_of(*(quietly(device, align_position(device.axis)) for device in joints))
