"""`HandSync`: SYNC that a script sends by hand, with the set-points of all its drives, in one hand-over to the master's thread.

A hand-over blocks the script until the master's thread has run, which a busy computer may delay by 10 ms or more. One for each
drive and one for SYNC would so make SYNC late. So `send_pos` checks its set-point in the script's own thread and leaves it with
the drive; `send_sync` sends all of them, then SYNC.

Set-points wait for `send_sync` only while the last SYNC on the bus was one of ours (`is_ours`). As soon as anybody else sends
SYNC, they are sent at once, and so are those that follow.

**A script that was stalled** sends its SYNC late. Then no drive may jump, nor go faster than it may:

- a drive that may be out of reach of its set-point is asked where it is, and stays there at this SYNC (late_sync.py); it comes
  back to the script's path from there. If that cannot be known, the drives are halted;
- the next SYNC comes an interval after the late one, whatever the phase was, or at most a part of ON_TIME earlier;
- while a drive comes back, SYNC is not early at all: its steps use its whole speed limit, in the interval that it was told.
"""

from __future__ import annotations

from typing import Final, Protocol

from canopen_master.master import Master
from canopen_master.motion.device import Device
from canopen_master.motion.late_sync import GapGuard
from canopen_master.participant.participant import ON_TIME
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.sync import SyncReceived, SyncSent
from canopen_transports.loop import current_loop

NEVER_SENT: Final = -1


class HandDriven(Protocol):
    """A drive that gets its set-points here: a DirectDrive; see there."""

    interval: int
    comes_back: bool

    @property
    def device(self) -> Device: ...

    @property
    def is_limited(self) -> bool: ...

    @property
    def way(self) -> float: ...

    def take_given(self) -> None: ...

    def send_given(self) -> None: ...

    def must_look(self, late: Time) -> bool: ...

    def stand_at_image(self) -> None: ...

    def lose(self, cause: str) -> None: ...


class HandSync:
    """See this module's text. It is what a GapGuard guards. is_ours: whether the last SYNC was sent here."""

    def __init__(self, master: Master) -> None:
        self.is_ours = False
        self._master = master
        self._drives: list[HandDriven] = []  # those that follow set-points
        self._guard = GapGuard(self, self._stop)
        self._sent_at: Time = NEVER_SENT
        self._interval: Time = 0  # from the last SYNC to the next one, as the script said
        self._is_sending = False
        master.watch((SyncSent, SyncReceived), self._on_sync)

    def begin(self, drive: HandDriven) -> None:
        """Send the set-points of a drive from now on."""
        self._drives.append(drive)

    def end(self, drive: HandDriven) -> None:
        """Send no more of them; does nothing if none are sent."""
        if drive in self._drives:
            self._drives.remove(drive)

    async def send(self, interval: Time) -> None:
        """Send the set-points that wait, then SYNC. interval: ns until the next one; 0: the script keeps the time.

        While drives follow, it waits first until most of the last interval is over, and until a drive that comes back to its
        path has had the whole interval that it was told. Raises BusError.
        """
        master = self._master
        if self._drives and self._sent_at != NEVER_SENT:
            whole = (drive.interval * MILLISECOND for drive in self._drives if drive.comes_back)
            earliest = self._sent_at + max(self._interval - self._interval // ON_TIME, *whole, 0)
            await current_loop().sleep(max(0, earliest - master.now()) / SECOND)
        for drive in self._drives:
            drive.take_given()
        late = self._late()
        look = self._guard.look_before_sync(late)
        if look is None:
            self._guard.before_late_sync(late)
        while look is not None:
            began = master.now()
            await master.run(look)
            look = self._guard.look_again(master.now() - began)
            if look is None:
                self._guard.before_late_sync(self._late())
        for drive in tuple(self._drives):
            drive.send_given()
        await master.pump.flush()  # a controller may send a SYNC before an RPDO that waits with it
        self._is_sending = True
        try:
            await master.send_sync()
        finally:
            self._is_sending = False
        self.is_ours, self._interval = True, interval

    def _late(self) -> Time:
        return 0 if self._sent_at == NEVER_SENT else max(0, self._master.now() - self._sent_at - self.period)

    def _stop(self, why: str) -> None:
        for drive in tuple(self._drives):
            drive.lose(f"was halted {why}")

    def _on_sync(self, report: SyncSent | SyncReceived) -> None:
        self._sent_at = self._master.now()
        if not self._is_sending and self.is_ours:
            self.is_ours = False
            for drive in tuple(self._drives):
                drive.take_given()
                drive.send_given()

    # ---- what the GapGuard needs: see `Guarded` ----

    @property
    def is_followed(self) -> bool:
        """Whether a drive follows."""
        return bool(self._drives)

    @property
    def period(self) -> Time:
        """ns from SYNC to SYNC: the shortest that a drive was told."""
        return min((drive.interval * MILLISECOND for drive in self._drives), default=0)

    def must_look(self, late: Time) -> bool:
        """Return whether a drive may be out of reach of the set-point that it would take at this SYNC. late: ns behind the time
        at which it was due."""
        return any(drive.must_look(late) for drive in self._drives)

    @property
    def limited(self) -> dict[Device, float]:
        """The drives whose speed their set-points limit, with the ways that they make in an interval at these limits."""
        return {drive.device: drive.way for drive in self._drives if drive.is_limited}

    def rest(self) -> None:
        """Do nothing: no velocities are fed forward."""

    def stand_at_images(self) -> None:
        """Go on from where the drives are, and have been told to be."""
        for drive in self._drives:
            if drive.is_limited:
                drive.stand_at_image()

    def before_late_sync(self, late: Time) -> None:
        """Do nothing: the next SYNC comes a whole interval later."""
