"""The master's side of one CiA 402 drive: the `Axis`, its limits, the watch on its path; the manual's sequences as procedures.

    reset_fault   0x0000, then 0x0080: the reset is a rising edge             manual: faultReset
    enable        up to Operation enabled, step by step                       manual: initDevice
    select_standing_mode    a mode in which power alone moves nothing
    set_mode      0x6502 checked, 0x6060 written, 0x6061 awaited              manual: driveMode
    home          homing, to its end                                          manual: homing
    start_interpolation, start_cyclic_position                                manual: enableIPmode
    halt          bit 8: the drive stops by 0x605D and stays enabled
    quick_stop    the drive stops by 0x605A
    engage_brake  down to Ready to switch on                                  manual: enableBreak
    shut_down     unpowered (Switch on disabled)                              manual: shutdownDevice, with NMT stop

A procedure that moves the drive halts it if the procedure is cancelled or fails. Bit 4 is cleared before each homing and each
start of interpolation: both begin on its rising edge.

watching.py waits, controlword.py commands, state.py changes states and modes, halting.py stops, homing.py and motion.py move,
failures.py has the errors.

A wait ends as soon as its goal is reached or out of reach: DriveFault, StateLost (a quick stop or disable that was not ours),
ModeLost (another master wrote 0x6060), NodeLost (boot-up, lost heartbeat), LimitReached, and only then StepTimeout.

Source: IEC 61800-7-201 (CiA 402-2).
"""

from canopen_proto.drive.controlword import command
from canopen_proto.drive.failures import (
    DriveFault,
    HomingFailed,
    LimitReached,
    ModeLost,
    ModeUnsupported,
    NodeLost,
    ReferenceLost,
    StateLost,
    fault_of,
)
from canopen_proto.drive.halting import halt, halt_after
from canopen_proto.drive.homing import home
from canopen_proto.drive.motion import move_to, read_position, start_cyclic_position, start_interpolation
from canopen_proto.drive.state import (
    change_state,
    enable,
    engage_brake,
    quick_stop,
    reset_fault,
    select_standing_mode,
    set_mode,
    shut_down,
)
from canopen_proto.drive.watching import read_statusword, wait_for_statusword

__all__ = [
    "DriveFault",
    "HomingFailed",
    "LimitReached",
    "ModeLost",
    "ModeUnsupported",
    "NodeLost",
    "ReferenceLost",
    "StateLost",
    "change_state",
    "command",
    "enable",
    "engage_brake",
    "fault_of",
    "halt",
    "halt_after",
    "home",
    "move_to",
    "quick_stop",
    "read_position",
    "read_statusword",
    "reset_fault",
    "select_standing_mode",
    "set_mode",
    "shut_down",
    "start_cyclic_position",
    "start_interpolation",
    "wait_for_statusword",
]
