"""The simulated drive's modes that take a set-point at each SYNC: their common parts, and cyclic synchronous position (csp).

Interpolated position (ip) is in interpolated_position.py.

csp: each SYNC takes the present value of 607Ah + 60B0h; 60B1h and 60B2h feed velocity and torque forward, if there is a mass.
While the axis moves, a value of 607Ah that was not written since the last SYNC is not taken. If the axis then comes to rest
farther than 6067h from it, the mode stops following.

**No axis stops dead.** An axis that passes a set-point brakes behind it by the quick stop ramp (6085h) until the next SYNC
(`Servo.interpolate`). So it brakes as soon as one SYNC, or one target of csp, is missing.

**SYNC or an RPDO is lost.** SYNC is lost if none has come for three of its periods (1006h; 60C2h if 1006h is 0), and at least for
`sync_tolerance` of the settings. The watch begins with the first SYNC that the mode acts on. An RPDO is lost if it does not come
within its event time (1400h:05), whatever it carries. Either way the mode stops following, and the axis brakes by the quick stop
ramp.

**The mode stops following**: bit 12 falls, and the warning bit rises; the drive stays in Operation enabled. ip follows again
after a new rising edge of bit 4. csp follows again at the first SYNC that finds 607Ah where the axis stands (within 6067h), so
that it never jumps.

Source: IEC 61800-7-201 (CiA 402-2): interpolated position, cyclic synchronous position. It leaves to the maker what a drive does
without SYNC.
"""

from __future__ import annotations

from typing import Final

from canopen_proto.communication_objects import CYCLE_PERIOD
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import ModeStatus
from canopen_proto.drives.cia402.positioning import RotaryDirection
from canopen_proto.drives.cia402.states import ControlBit, StatusBit
from canopen_proto.machine import MICROSECOND, NEVER, SECOND, Event, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.simulation.drive.profile_modes import OperationMode
from canopen_proto.simulation.drive.servo import UNLIMITED
from canopen_proto.simulation.drive.turns import place_of

_MISSED_SYNCS: Final = 3


class SyncOverdue(Event):
    """In ip or csp, no SYNC came for `timeout` ns. The axis brakes by the quick stop ramp, and the mode stops following."""

    __match_args__ = ("node_id", "timeout")

    def __init__(self, node_id: int, timeout: Time) -> None:
        self.node_id = node_id
        self.timeout = timeout


class SynchronousMode(OperationMode):
    """The common part of ip, csp, csv and cst: whether the mode follows, and when it stops following."""

    def enter(self) -> None:
        self.due = NEVER
        self._sync_timeout: Time = 0
        self._follows = False
        self._warning = False

    def _begin_following(self) -> None:
        self._follows = True
        self._warning = False

    def _await_sync(self) -> None:
        """Start to wait for the next SYNC: the mode acts on this one."""
        period = self.servo.parameter(CYCLE_PERIOD) * MICROSECOND or round(self.servo.interpolation_period() * SECOND)
        self._sync_timeout = max(_MISSED_SYNCS * period, self.servo.settings.sync_tolerance)
        self.due = self.servo.time + self._sync_timeout

    def _stop_following(self) -> None:
        self.due = NEVER
        self._warning = self._warning or self._follows
        self._follows = False

    def stopped_by_switch(self) -> None:
        self._stop_following()

    def sync_lost(self) -> None:
        self.out.events.append(SyncOverdue(self.node_id, self._sync_timeout))
        self.rpdo_lost()

    def rpdo_lost(self) -> None:
        self._stop_following()
        if not self.servo.is_settled:
            self.servo.brake(self.servo.ramp(2))


class CyclicMode(SynchronousMode):
    """The common part of csp, csv and cst: each follows from its begin on, and takes the present set-point at each SYNC."""

    def enter(self) -> None:
        super().enter()
        self._follows = True

    def control(self, controlword: int, previous: int) -> None:
        self.controlword = controlword
        if controlword & ~previous & ControlBit.HALT:
            self.due = NEVER
            self._halt()

    def on_sync(self) -> None:
        if self.is_halted:
            return
        if not self._follows:
            if not (self.servo.is_settled and self._would_stay()):
                return
            self._begin_following()
        self._await_sync()
        self._command()

    def _would_stay(self) -> bool:
        """Return whether the present set-point moves nothing: a mode that has stopped following goes on from there."""
        raise NotImplementedError

    def _command(self) -> None:
        """Act on the present set-point."""
        raise NotImplementedError

    @property
    def status(self) -> int:
        follows = self._follows and not self.is_halted
        return follows * ModeStatus.FOLLOWS_COMMAND | self._warning * StatusBit.WARNING


class CyclicPosition(CyclicMode):
    """Cyclic synchronous position mode (csp)."""

    listens_to = frozenset((objects.TARGET_POSITION,))

    def enter(self) -> None:
        super().enter()
        self._is_new = True  # 607Ah was written since the last SYNC

    def written(self, key: Mux) -> None:
        self._is_new = True

    def _target(self) -> float:
        servo = self.servo
        wanted = servo.parameter(objects.TARGET_POSITION) + servo.parameter(objects.POSITION_OFFSET)
        return place_of(servo, wanted, RotaryDirection.SHORTEST)

    def _would_stay(self) -> bool:
        return self._is_near(self._target())

    def _command(self) -> None:
        servo, target = self.servo, self._target()
        if self._is_new or (not servo.moving_at and self._is_near(target)):
            servo.interpolate(target)
            servo.feed_forward(velocity=True)
        elif not servo.moving_at:  # it has braked and stopped far beyond the last target
            self._stop_following()
        self._is_new = False

    def _is_near(self, target: float) -> bool:
        """Return whether the axis is at this target, or at the software limit before it."""
        low, high = self.servo.limits()
        window = self.servo.parameter(objects.POSITION_WINDOW)
        nearness = 0 if window == UNLIMITED else window
        return abs(max(low, min(high, target)) - self.servo.demand_position) < nearness + 0.5  # positions are shown rounded
