"""`ChainSettings`: the cycle of a chain, its mode, the PDOs that are exchanged with its joints, and when it is stopped."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from canopen_master.seconds import check_seconds
from canopen_proto.drives.axis.following import SILENT_SYNCS
from canopen_proto.drives.axis.motion_plan import MODES
from canopen_proto.drives.cia402.modes import Mode, short_name
from canopen_proto.machine import LocalProtocolError

MAX_MISSED_CYCLES: Final = 10
"""In a row; at the usual 10 ms a program that is 0.1 s late has lost control of the arm."""


@dataclass(frozen=True, slots=True)
class ChainSettings:
    """cycle_time: seconds between two SYNCs.

    rpdo, tpdo: which PDOs of PDOs.csv are exchanged with each joint. define_pdos: have them declared to the devices
    (`definePDO`), for devices that do not come with them. own_pdos: exchange instead what the joint's own dictionary (an EDS,
    a DCF) has PDOs for, by a plan (canopen_proto.drives.axis.motion_plan), and set the device up like that where it is not; a
    joint whose dictionary has no PDO exchanges rpdo and tpdo, unless mode is None. Further axes of a node do so in any case.
    `Device.plan` is that plan.

    max_step: the largest step of a set-point from one cycle to the next, in the user's unit, besides what the joint's own limits
    allow; None for no such limit. max_missed_cycles: in a row, until the chain is halted. max_silent_cycles: in a row, of a joint
    that does not send its PDO, until the chain is stopped; and 20 ms at least, since adapters hold frames back.

    mode: in which the joints follow set-points: ip, csp, or pp, which is slow (slow_position.py of the core). None: the
    best one for each joint, by its own dictionary; own_pdos is implied. Raises LocalProtocolError for any other mode, and for a
    cycle_time that is not above 0.

    feed_forward: with own_pdos: give joints one more RPDO for what is fed forward. In csp the velocity of a path (0x60B1) and
    torques (0x60B2): for drives that do not feed the velocity forward by themselves, or they would do it twice. In ip the
    velocity of the record (0x60C1:02), for joints with `record_velocity_unit` in their AxisSettings.
    """

    cycle_time: float = 0.01
    rpdo: str = "schunk_default_rPDO"
    tpdo: str = "schunk_default_tPDO"
    define_pdos: bool = False
    own_pdos: bool = False
    max_step: float | None = None
    max_missed_cycles: int = MAX_MISSED_CYCLES
    max_silent_cycles: int = SILENT_SYNCS
    mode: Mode | None = Mode.INTERPOLATED_POSITION
    feed_forward: bool = False

    def __post_init__(self) -> None:
        check_seconds("cycle_time", self.cycle_time, above_zero=True)
        if self.mode is None:
            return
        if self.mode not in MODES:
            followed = ", ".join(short_name(mode) for mode in MODES)
            raise LocalProtocolError(f"a chain follows set-points in {followed}, or None for the best; not in {self.mode!r}")
        object.__setattr__(self, "mode", Mode(self.mode))  # a plain number is as good
