"""The simulated drive's modes of velocity and torque control: profile torque (tq), cyclic synchronous velocity and torque.

tq: the torque goes to 6071h by the slope 6087h as soon as either is written. Bit 10: the torque actual value is the target. Halt
stops the axis by 605Dh, and holds it; bit 10 then says that it stands. When halt ends, the torque goes on from the one that held.

csv: each SYNC takes 60FFh + 60B1h; 60B2h is added to the torque. cst: each SYNC takes 6071h + 60B2h. The value stays in force
until the next one, so a late SYNC makes no jerk. SYNC or an RPDO is lost as in ip and csp (synchronous_modes.py); then the axis
brakes by the quick stop ramp, bit 12 falls, and the warning bit rises. Once the axis rests, the mode follows again at the first
SYNC that finds a target of 0, so that it never jumps.

In all of them 60FFh and 6071h act within the limits of the drive: 607Fh, 6080h (speed), 607Dh (position), 6072h, 6073h, 60E0h,
60E1h (torque). Bit 11 shows that one of them acts.

Left out: torque profile type (6088h; the slope is linear), torque window.

Source: IEC 61800-7-201 (CiA 402-2): profile torque, cyclic synchronous velocity, cyclic synchronous torque. Bit 10 of tq, and
6072h and 6073h as limits that both count, as manuals of several drives have them.
"""

from __future__ import annotations

from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.states import ControlBit, StatusBit
from canopen_proto.machine import SECOND
from canopen_proto.multiplexer import Mux
from canopen_proto.simulation.drive.plant import Control
from canopen_proto.simulation.drive.profile_modes import OperationMode
from canopen_proto.simulation.drive.synchronous_modes import CyclicMode

_WINDOW = 1
"""Per mille of the rated torque between torque and target that count as reached."""


def _halt_or_coast(mode: OperationMode) -> None:
    """Stop the axis by 605Dh; in a drive that coasts, take the torque away."""
    servo = mode.servo
    if servo.settings.coasts:
        servo.push(0)
    else:
        servo.brake(servo.ramp(servo.parameter(objects.HALT_OPTION_CODE)))


class ProfileTorque(OperationMode):
    """Profile torque mode (tq)."""

    listens_to = frozenset({
        objects.TARGET_TORQUE,
        objects.TORQUE_SLOPE,
        objects.MAX_PROFILE_VELOCITY,
        objects.MAX_MOTOR_SPEED,
        objects.MIN_SOFTWARE_POSITION_LIMIT,
        objects.MAX_SOFTWARE_POSITION_LIMIT,
    })  # fmt: skip

    def control(self, controlword: int, previous: int) -> None:
        self.controlword = controlword
        if controlword & ~previous & ControlBit.HALT:
            self._halt()
        elif not self.is_halted:
            self._push()

    def written(self, key: Mux) -> None:
        if not self.is_halted:
            self._push()

    def _halt(self) -> None:
        _halt_or_coast(self)

    def _push(self) -> None:
        servo = self.servo
        servo.internal_limit = False
        servo.push(servo.parameter(objects.TARGET_TORQUE), servo.rate(objects.TORQUE_SLOPE))

    @property
    def status(self) -> int:
        servo = self.servo
        if self.is_halted:
            return self._reached()
        return (abs(servo.torques[1] - servo.parameter(objects.TARGET_TORQUE)) <= _WINDOW) * StatusBit.TARGET_REACHED


class _SpeedOrTorque(CyclicMode):
    """The common part of csv and cst: a set-point of 0 moves nothing."""

    def stopped_by_switch(self) -> None:
        """Go on following: each SYNC is looked at again, and one that leads away from the switch is obeyed."""

    def _would_stay(self) -> bool:
        return not self._target()

    def _target(self) -> int:
        raise NotImplementedError


class CyclicVelocity(_SpeedOrTorque):
    """Cyclic synchronous velocity mode (csv)."""

    def _target(self) -> int:
        return self.servo.parameter(objects.TARGET_VELOCITY)

    def _command(self) -> None:
        servo = self.servo
        wanted = float(self._target() + servo.parameter(objects.VELOCITY_OFFSET))
        rates = servo.rate(objects.MAX_ACCELERATION), servo.rate(objects.MAX_DECELERATION)
        servo.run(wanted, *rates, control=Control.VELOCITY)
        servo.feed_forward()
        next_velocity = servo.demand.at(servo.time + round(servo.interpolation_period() * SECOND))[1]
        servo.internal_limit = abs(next_velocity - wanted) >= 1.0


class CyclicTorque(_SpeedOrTorque):
    """Cyclic synchronous torque mode (cst)."""

    def _halt(self) -> None:
        _halt_or_coast(self)

    def _target(self) -> int:
        return self.servo.parameter(objects.TARGET_TORQUE)

    def _command(self) -> None:
        servo = self.servo
        servo.internal_limit = False
        servo.push(self._target())
        servo.feed_forward()
