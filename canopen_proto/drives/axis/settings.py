"""`AxisSettings`: what the user says of one axis: its scale and its limits, how it homes, how long it may take."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, fields, replace
from typing import Final

from canopen_proto.drives.axis.units import Unit, units_of
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.drive_bit import DriveBit
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Time

MILLIDEGREES_PER_RADIAN: Final = 180_000 / math.pi
_MILLIDEGREES: Final = units_of({objects.VENDOR_ID: objects.SCHUNK_VENDOR_ID})


MODE_CHANGE_STATES: Final = (
    State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.OPERATION_ENABLED,
)  # fmt: skip
"""States in which some drive takes another mode of operation, the one with the least power first."""


class HomingStyle(enum.Enum):
    """How a drive homes."""

    STANDARD = "standard"
    """CiA 402: mode 6, method in 0x6098; bits 13, 12 and 10 of the statusword show the result."""
    SCHUNK = "schunk"
    """Schunk Powerball firmware of 2012: mode 6 although 0x6502 lacks it, no 0x6098. Homing is done when bit 8 (moving) was set,
    is 0 again, and bit 15 (referenced) is set."""


@dataclass(frozen=True, slots=True)
class AxisSettings:
    """The settings of one axis.

    counts_per_unit: counts on the wire per user's unit; None: no scale, so that the user's unit is the count. unit: the name of
    the user's unit. If it is given without counts_per_unit, the drive has to tell the scale (`drive.identity`).
    velocity_unit: counts per second in one velocity unit of the drive (0x60FF, 0x606C); None: as the drive tells (units.py).
    acceleration_unit: counts per second² in one unit of 0x6083, 0x6084, 0x609A, 0x60C5 and 0x60C6; None: as the drive
    tells (units.py).
    counts_per_motor_turn: for velocity mode (vl), which counts turns of the motor; None: as the drive tells.
    direction: 1, or -1 for a motor that is mounted the other way round. offset: counts at position 0.
    homing: how the drive homes; None: its vendor-ID decides. homing_method: written to 0x6098. homing_speed, homing_zero_speed:
    in the user's unit per second, fast to the switch and slow to the home point (0x6099). homing_acceleration: in the user's unit
    per second² (0x609A). home_position: the position of the home point, in the user's unit (0x607C); home_offset_reversed: for
    drives that take 0x607C with the other sign. None: the drive's own value stays; see homing_parameters.py.
    homing_timeout: ns for a whole homing. state_timeout: ns for one change of state or mode.
    following_error_limit: how far off its set-points the drive may be, in the user's unit, before it counts as lost; None: the
    limit that `following_procedures.following_limit` finds; math.inf: no limit.
    keeps_reference: whether the drive knows its position after a reset or a loss of power (an absolute encoder). Such a drive
    need not be homed again.
    shows_following: whether bit 12 of the statusword shows in ip, csp, csv and cst that the drive follows its set-points. False:
    it stays 0, as in ros2_canopen's simulated drive. It is not looked at then: only the following error shows a drive that stays.
    reaction_time: ns until what the drive shows answers the last command. Until then, an end of a homing, a move or a halt that
    was shown before the command is not believed. halt_time: ns that a halted drive may take in addition. The wait is extended
    while the drive's speed still falls.

    min_position, max_position: in the user's unit; set-points and targets beyond are refused. None: only the drive's own limits
    (0x607D) apply, which always apply. max_speed: in the user's unit per second; set-points that need more are refused. None: the
    drive's own limit (0x607F, 0x6080), else a cautious default; math.inf: no limit. See limits.py.

    max_acceleration, max_jerk: in the user's unit per second² and per second³; paths are planned, checked, stopped within them.
    None: the drive's own limit (0x60C5, 0x60C6; none of the jerk), else a default that the speed limit gives; math.inf: no limit.

    sto_input, brake_bit: the bit that shows "safe torque off", and the one of a brake that holds; None: the drive has none, and
    errors name neither. Each maker has them elsewhere: see `DriveBit`.

    mode_change_state: the highest state in which the drive takes another mode of operation; it is led down to this state first,
    and loses its power on the way if need be. Most drives take one while they are enabled. changes_mode_halted: whether it does
    so while bit 8 of the controlword is set; Engel's drives do not. Such a drive is led down to Switched on.

    record_velocity_unit: for ip, counts per second in one unit of 0x60C1:02, of drives whose records have a position and a
    velocity (sub-mode -1, see sub_modes.py: Infranor, Parker); None: linear interpolation, a position alone.

    queues_set_points: whether the drive keeps a set-point of profile position until the one before is reached (bit 5 = 0).
    Synapticon's drives do not. Such a drive gets each one when it has reached the one before.

    obeys_within: ns from a halt to the beginning of the drive's ramp, at most. A drive that runs at a velocity is halted so early
    before min_position and max_position.
    """

    counts_per_unit: float | None = None
    direction: int = 1
    offset: int = 0
    homing: HomingStyle | None = None
    homing_method: int | None = None
    homing_speed: float | None = None
    homing_zero_speed: float | None = None
    homing_acceleration: float | None = None
    home_position: float | None = None
    home_offset_reversed: bool = False
    homing_timeout: Time = 60 * SECOND
    state_timeout: Time = 3 * SECOND
    following_error_limit: float | None = None
    keeps_reference: bool = False
    shows_following: bool = True
    min_position: float | None = None
    max_position: float | None = None
    max_speed: float | None = None
    max_acceleration: float | None = None
    max_jerk: float | None = None
    reaction_time: Time = 1 * SECOND
    halt_time: Time = 1 * SECOND
    sto_input: DriveBit | None = None
    brake_bit: DriveBit | None = None
    mode_change_state: State = State.OPERATION_ENABLED
    changes_mode_halted: bool = True
    unit: Unit | None = None
    velocity_unit: float | None = None
    acceleration_unit: float | None = None
    counts_per_motor_turn: float | None = None
    record_velocity_unit: float | None = None
    queues_set_points: bool = True
    obeys_within: Time = 250 * MILLISECOND

    def __post_init__(self) -> None:
        scale = self.counts_per_unit
        if scale is not None and not (math.isfinite(scale) and scale > 0):
            raise LocalProtocolError(f"counts_per_unit must be a finite number above 0, or None for no scale; it is {scale!r}")
        for name in ("velocity_unit", "acceleration_unit", "counts_per_motor_turn", "record_velocity_unit"):
            unit = getattr(self, name)
            if unit is not None and not (math.isfinite(unit) and unit > 0):
                raise LocalProtocolError(f"{name} must be a finite number above 0, or None; it is {unit!r}")
        if self.direction not in (1, -1):
            raise LocalProtocolError(f"direction must be 1 or -1; it is {self.direction!r}")
        lowest = -math.inf if self.min_position is None else self.min_position
        highest = math.inf if self.max_position is None else self.max_position
        if not lowest < highest:
            raise LocalProtocolError(f"min_position must be below max_position; they are {lowest!r} and {highest!r}")
        if self.following_error_limit is not None and not self.following_error_limit > 0:
            raise LocalProtocolError(f"following_error_limit must be above 0, inf for none; it is {self.following_error_limit!r}")
        for name in ("max_speed", "max_acceleration", "max_jerk"):
            limit = getattr(self, name)
            if limit is not None and not limit > 0:
                raise LocalProtocolError(f"{name} must be above 0, inf for no limit; it is {limit!r}")
        for name in ("homing_speed", "homing_zero_speed", "homing_acceleration"):
            rate = getattr(self, name)
            if rate is not None and not (math.isfinite(rate) and rate > 0):
                raise LocalProtocolError(f"{name} must be a finite number above 0, or None for the drive's own; it is {rate!r}")
        if self.homing_method is not None and not -128 <= self.homing_method <= 127:
            raise LocalProtocolError(f"homing_method must be from -128 to 127; it is {self.homing_method!r}")
        for name in ("reaction_time", "halt_time", "obeys_within"):
            time: Time = getattr(self, name)
            if time <= 0:
                raise LocalProtocolError(f"{name} must be above 0; it is {time} ns")
        if self.mode_change_state not in MODE_CHANGE_STATES:
            raise LocalProtocolError(f"mode_change_state must be one of {', '.join(MODE_CHANGE_STATES)}")
        for name, bit in (("sto_input", self.sto_input), ("brake_bit", self.brake_bit)):
            if bit is not None:
                bit.check(name)

    def of_vendor(self, vendor_id: int | None) -> AxisSettings:
        """Return these settings, with open ones (None) filled in for drives of that vendor (None: no vendor-ID).

        A joint of Schunk's counts millidegrees; its user's unit is the radian, unless `unit` names another.
        """
        homing = self.homing
        if homing is None:
            homing = HomingStyle.SCHUNK if vendor_id == objects.SCHUNK_VENDOR_ID else HomingStyle.STANDARD
        is_schunk = homing is HomingStyle.SCHUNK and vendor_id == objects.SCHUNK_VENDOR_ID
        scale = self.counts_per_unit
        if is_schunk and scale is None:
            scale = MILLIDEGREES_PER_RADIAN if self.unit is None else _MILLIDEGREES.counts_per(self.unit)
        return replace(self, homing=homing, counts_per_unit=scale)

    def difference(self, other: AxisSettings) -> str:
        """Return how these settings differ from others, as text: "direction 1, not -1"; empty if they are equal."""
        names = [each.name for each in fields(self) if getattr(self, each.name) != getattr(other, each.name)]
        return ", ".join(f"{name} {_shown(getattr(self, name))}, not {_shown(getattr(other, name))}" for name in names)


def _shown(value: object) -> str:
    return value.value if isinstance(value, enum.Enum) else str(value)


OPEN_SETTINGS: Final = AxisSettings()
"""Nothing is said: what the drive tells counts."""
SCHUNK_POWERBALL: Final = AxisSettings(counts_per_unit=MILLIDEGREES_PER_RADIAN, homing=HomingStyle.SCHUNK)
"""The manual's arm: millidegrees on the wire; the user's unit is the radian."""
