"""Why a drive does not move: `look_at` reads what it shows, `reasons` says what stands in the way, the first obstacle first.

A drive moves if its node is not stopped, it is in Operation enabled, no halt is commanded, it shows a mode of operation, and its
target lies elsewhere. The obstacles are looked for in the order in which they have to be removed: a drive in fault cannot be
enabled, whatever else is wrong with it.

Objects of makers are looked at only if the settings name them: the bit for "safe torque off", and that of a brake that holds.
Digital inputs 0x60FD: bit 0 is the negative limit switch, bit 1 the positive one. A homing looks for them: they are no obstacle
in homing mode.

Source: IEC 61800-7-201 (CiA 402-2), device control, 60FDh; the order is ours.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final, NamedTuple

from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.axis_node import AxisNode
from canopen_proto.drives.axis.settings import OPEN_SETTINGS, AxisSettings
from canopen_proto.drives.axis.units import read_number
from canopen_proto.drives.axis.view import COMPARED, DriveView, command_text, view_of
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.drive_bit import DriveBit
from canopen_proto.drives.cia402.modes import Mode, ModeControl, ModeStatus, mode_name, supported
from canopen_proto.drives.cia402.states import FAULT_STATES, Command, ControlBit, State, StatusBit, enables_operation
from canopen_proto.error_codes import error_text
from canopen_proto.nmt import NmtState
from canopen_proto.procedures.steps import Procedure, ProcedureError, current_time

_SHOWN: Final = {
    "controlword": objects.CONTROLWORD,
    "mode": objects.MODES_OF_OPERATION_DISPLAY,
    "wanted_mode": objects.MODES_OF_OPERATION,
    "supported_modes": objects.SUPPORTED_DRIVE_MODES,
    "error_code": objects.ERROR_CODE,
    "position": objects.POSITION_ACTUAL_VALUE,
    "inputs": objects.DIGITAL_INPUTS,
}
"""The fields of `DriveView` that `look_at` reads besides the statusword."""
_TELLING: Final = ("controlword", "wanted_mode", "error_code", "inputs")
"""Those that `look_closer` reads: no procedure looks at them by itself."""
_SIGNED: Final = (objects.MODES_OF_OPERATION, objects.MODES_OF_OPERATION_DISPLAY, objects.POSITION_ACTUAL_VALUE)
_ASKED: Final = {State.SWITCH_ON_DISABLED: int(Command.SHUTDOWN), State.READY_TO_SWITCH_ON: int(Command.SWITCH_ON)}
"""Bits 2, 1, 0 of the commands that lead out of a state to one with voltage."""
_COMMAND: Final = ControlBit.QUICK_STOP | ControlBit.ENABLE_VOLTAGE | ControlBit.SWITCH_ON
LIMIT_SWITCHES: Final = ("negative limit switch", "positive limit switch")
"""Bits 0 and 1 of 0x60FD."""
_FOLLOWING: Final = (Mode.PROFILE_POSITION, Mode.CYCLIC_SYNCHRONOUS_POSITION)
_OBEYS: Final = (
    Mode.CYCLIC_SYNCHRONOUS_POSITION, Mode.CYCLIC_SYNCHRONOUS_VELOCITY, Mode.CYCLIC_SYNCHRONOUS_TORQUE,
)  # fmt: skip
_BY_PDO: Final = (Mode.INTERPOLATED_POSITION, *_OBEYS)
"""The modes whose set-points come by PDO."""
_BY_BIT_4: Final = (Mode.PROFILE_POSITION, Mode.INTERPOLATED_POSITION)


class Reason(NamedTuple):
    """An obstacle, and what to do about it; both in words. is_command: a command removes it; else something outside has to."""

    what: str
    remedy: str
    is_command: bool = False


def outer_reason(view: DriveView) -> Reason | None:
    """Return the first obstacle that no command of this master removes; None if there is none."""
    return next((each for each in reasons(view) if not each.is_command), None)


def look_at(node: AxisNode, settings: AxisSettings = OPEN_SETTINGS) -> Procedure[DriveView | None]:
    """Read what a drive shows, by SDO, by number, whatever the dictionary has. Returns None for a node without a statusword.

    settings: name the maker's bits (`sto_input`, `brake_bit`). Raises SdoTransferError if the node does not answer.
    """
    statusword = yield from read_number(node, objects.STATUSWORD)
    if statusword is None:
        return None
    shown: dict[str, Any] = {}
    for name, key in _SHOWN.items():
        shown[name] = yield from read_number(node, key, signed=key in _SIGNED)
    view = DriveView(statusword, nmt_state=node.nmt_state, emcy=node.emcy.last, **shown)
    return (yield from _with_bits(view, node, settings))


def look_closer(axis: Axis) -> Procedure[DriveView]:
    """Return what is known of a drive, and read what tells why it does not obey. A drive that does not answer adds nothing."""
    view = replace(view_of(axis), is_homed=axis.is_homed or axis.settings.keeps_reference)
    try:
        for name in _TELLING:
            key = _SHOWN[name]
            heard = axis.node.fresh(key, (yield from current_time()))
            value = heard if isinstance(heard, int) else (yield from read_number(axis.node, key, signed=key in _SIGNED))
            view = _with(view, name, value)
        return (yield from _with_bits(view, axis.node, axis.settings))
    except ProcedureError:
        return view  # the error that is being explained is raised all the same


def _with_bits(view: DriveView, node: AxisNode, settings: AxisSettings) -> Procedure[DriveView]:
    """Read the maker's bits that the settings name."""
    for name, bit in (("safe_torque_off", settings.sto_input), ("brake", settings.brake_bit)):
        if bit is not None:
            view = _with(view, name, (yield from _if_shown(node, bit)))
    return view


def _with(view: DriveView, name: str, value: int | DriveBit | None) -> DriveView:
    change: dict[str, Any] = {} if value is None else {name: value}
    return replace(view, **change)


def _if_shown(node: AxisNode, bit: DriveBit) -> Procedure[DriveBit | None]:
    """Return the bit if the drive shows it, else None."""
    value = yield from read_number(node, bit.mux)
    return bit if value is not None and bit.is_shown_by(value) else None


def reasons(view: DriveView) -> tuple[Reason, ...]:
    """Return what keeps a drive from moving, the first obstacle first; none: it would obey its next command."""
    found = []
    if view.nmt_state is NmtState.STOPPED:
        found.append(Reason("its NMT state is stopped: it takes no PDO and no SDO", "start it (NMT)"))
    if not view.is_heard:
        return tuple(found)
    if view.state in FAULT_STATES:
        return (*found, _fault(view))
    if view.state is State.UNKNOWN:
        what = f"its statusword 0x{view.statusword:04X} fits no state"
        return (*found, Reason(what, "look whether it is a drive by CiA 402, and this is its statusword"))
    if view.foreign is not None:
        found.append(Reason(str(view.foreign), "end the other master, or leave the drive to it"))
    if not view.statusword & StatusBit.REMOTE:
        found.append(Reason("it is under local control (bit 9, remote, is 0)", "give the fieldbus control, at the drive"))
    if view.safe_torque_off is not None:
        what = f"safe torque off is active ({view.safe_torque_off})"
        found.append(Reason(what, "release the emergency stop, and look at the wiring of the drive's STO inputs"))
    if view.state is State.QUICK_STOP_ACTIVE:
        found.append(Reason("a quick stop is active", "enable it again; if it does not leave this state, disable it first", True))
    elif view.state is not State.OPERATION_ENABLED:
        found.extend(_not_enabled(view))
    elif view.brake is not None:
        found.append(Reason(f"its brake holds it ({view.brake})", "look at the supply of the brake, and at who controls it"))
    found.extend(_command(view))
    found.extend(_mode(view))
    found.extend(_limits(view))
    if all(each.is_command for each in found) and _refuses_positions(view):
        found.extend(_unheard_start(view) or _reference(view))
    return tuple(found)


def _fault(view: DriveView) -> Reason:
    code = f": 0x{view.error_code:04X} {error_text(view.error_code)}" if view.error_code else ""
    if view.state is State.FAULT_REACTION_ACTIVE:
        return Reason(f"it brakes because of a fault{code}", "wait until it is in fault")
    return Reason(f"it is in fault{code}", "remove the cause, then reset the fault")


def _not_enabled(view: DriveView) -> list[Reason]:
    found = []
    # Most drives show no voltage before they are told to switch on
    is_asked = view.controlword is not None and view.controlword & _COMMAND == _ASKED.get(view.state)
    if is_asked and not view.statusword & StatusBit.VOLTAGE_ENABLED:
        found.append(Reason("its power stage has no voltage (bit 4 is 0)", "look at the motor supply, and at safe torque off"))
    if view.state is State.NOT_READY_TO_SWITCH_ON:
        return [*found, Reason("it is not ready to switch on: it still starts up", "wait", True)]
    return [*found, Reason(f"it is not enabled: {view.state}", "enable it", True)]


def _command(view: DriveView) -> list[Reason]:
    """Return what is wrong with the controlword: a halt, or another word in the drive than the one that it was sent."""
    word, sent = view.controlword, view.commanded
    if word is None:
        return []
    is_ours = sent is None or not (word ^ sent) & COMPARED
    if word & ControlBit.HALT and (is_ours or (sent is not None and sent & ControlBit.HALT)):
        return [Reason("its controlword commands a halt (bit 8)", "a command without bit 8", True)]
    if is_ours or sent is None or (view.state is State.OPERATION_ENABLED and not enables_operation(word)):
        return []  # some drives do not show in 0x6040 what came by PDO
    if view.rpdo is not None:
        return [_not_reached(view.rpdo, word, sent)]
    differs = _other_word(word, sent)
    if word & ControlBit.HALT:
        return [Reason(f"its controlword commands a halt (bit 8): {differs}", "find the other master that halts it")]
    return [Reason(differs, "find the other master that commands it")]


def _other_word(word: int, sent: int) -> str:
    return f"its controlword is {command_text(word)}, not the {command_text(sent)} that it was sent"


def _not_reached(rpdo: int, word: int, sent: int) -> Reason:
    return Reason(
        f"its RPDO {rpdo}, which carries the controlword, does not reach it: {_other_word(word, sent)}",
        "start it (NMT), as it may have left Operational when it missed its master's heartbeat; "
        "or compare the RPDO's CAN-ID and mapping with those of the drive (canopen info)",
    )


def _unheard_start(view: DriveView) -> list[Reason]:
    """Return whether bit 4, with which it was to begin, has not come to it by its RPDO."""
    word, sent, rpdo = view.controlword, view.commanded, view.rpdo
    if word is None or sent is None or rpdo is None or not sent & ~word & ModeControl.NEW_SET_POINT:
        return []
    return [_not_reached(rpdo, word, sent)]


def _mode(view: DriveView) -> list[Reason]:
    found = []
    wanted, shown, modes, selected = view.wanted_mode, view.mode, view.supported_modes, view.selected_mode
    if selected is not None and wanted is not None and wanted != selected:
        what = f"0x6060 holds {mode_name(wanted)}, not {mode_name(selected)} as it was sent"
        found.append(
            Reason(what, "find the other master that selects its modes; or look whether it takes this one when disabled")
        )
    elif wanted is not None and wanted > 0 and wanted != shown and modes is not None and not supported(modes, wanted):
        found.append(Reason(f"it does not have the mode that was selected, {mode_name(wanted)} (0x6502)", "another mode"))
    elif wanted is not None and shown is not None and wanted != shown:
        what = f"{mode_name(wanted)} was selected, but it shows {mode_name(shown)} (0x6060, 0x6061)"
        found.append(
            Reason(
                what,
                "wait; some drives change their mode only while they stand, or are not enabled (AxisSettings.mode_change_state)",
            )
        )
    elif shown == Mode.NO_MODE:
        found.append(Reason("no mode of operation is selected (0x6061 is 0)", "select one (0x6060)", True))
    if view.nmt_state not in (None, NmtState.OPERATIONAL, NmtState.STOPPED) and (wanted in _BY_PDO or shown in _BY_PDO):
        found.append(Reason(f"its NMT state is {_name(view.nmt_state)}: it takes no set-points by PDO", "start it (NMT)"))
    if view.state is State.OPERATION_ENABLED and shown in _OBEYS and not view.statusword & ModeStatus.FOLLOWS_COMMAND:
        found.append(Reason("it does not follow its set-points (bit 12 is 0)", "send set-points in each cycle, with SYNC", True))
    return found


def _name(state: NmtState | None) -> str:
    return "unknown" if state is None else state.name.lower().replace("_", "-")


def _limits(view: DriveView) -> list[Reason]:
    found = []
    inputs = 0 if view.mode == Mode.HOMING else view.inputs or 0
    for bit, name in enumerate(LIMIT_SWITCHES):
        if inputs >> bit & 1:
            found.append(Reason(f"it stands on its {name} (0x60FD)", "move it the other way"))
    if view.statusword & StatusBit.INTERNAL_LIMIT:
        what = "a limit of its own holds it (bit 11): position 0x607D, speed, torque or current"
        found.append(Reason(what, "a target that leads away from the limit"))
    if view.mode in _FOLLOWING and view.statusword & ModeStatus.FOLLOWING_ERROR:
        found.append(Reason("its following error is too large (bit 13)", "look for a blocked axis; move more slowly"))
    return found


def _refuses_positions(view: DriveView) -> bool:
    """Return whether the drive does not take up a position that it was given, by bit 4 or in csp: bit 12 is 0."""
    if view.state is not State.OPERATION_ENABLED or view.statusword & ModeStatus.SET_POINT_ACKNOWLEDGE:
        return False
    is_started = bool((view.commanded or 0) & ModeControl.NEW_SET_POINT)
    return view.mode == Mode.CYCLIC_SYNCHRONOUS_POSITION or (view.mode in _BY_BIT_4 and is_started)


def _reference(view: DriveView) -> list[Reason]:
    if view.has_lost_reference:
        what = "it has lost its reference: it was homed, and then reset or without power, or homed without success"
        return [Reason(what, "home it again; AxisSettings(keeps_reference=True) if it has an absolute encoder")]
    if view.is_homed is False:
        return [Reason("this master has not homed it, and some drives take no position before", "home it")]
    return []
