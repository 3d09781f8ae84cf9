"""Why a drive does not move: `look_at` reads what it shows, `reasons` says what stands in the way, the first obstacle first.

A drive moves if its node is not stopped, it is in Operation enabled, no halt is commanded, it shows a mode of operation, and its
target lies elsewhere. The obstacles are looked for in the order in which they have to be removed: a drive in fault cannot be
enabled, whatever else is wrong with it. PDOs are not judged: a command may come by SDO too.

Digital inputs 0x60FD: bit 0 is the negative limit switch, bit 1 the positive one. Bit 3, the interlock, is left out: makers do
not agree on which level means "safe torque off".

Source: IEC 61800-7-201 (CiA 402-2), device control, 60FDh; the order is ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

from canopen_proto.cia402 import objects
from canopen_proto.cia402.modes import Mode, ModeStatus, mode_name, supported
from canopen_proto.cia402.states import FAULT_STATES, ControlBit, State, StatusBit, state_of
from canopen_proto.drive.axis import Axis
from canopen_proto.drive.units import read_number
from canopen_proto.error_codes import error_text
from canopen_proto.multiplexer import Mux
from canopen_proto.nmt import NmtState
from canopen_proto.procedures.steps import Procedure
from canopen_proto.remote_node import RemoteNode

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
_SIGNED: Final = (objects.MODES_OF_OPERATION, objects.MODES_OF_OPERATION_DISPLAY, objects.POSITION_ACTUAL_VALUE)
_ASKED: Final = {
    State.SWITCH_ON_DISABLED: ControlBit.ENABLE_VOLTAGE | ControlBit.QUICK_STOP,
    State.READY_TO_SWITCH_ON: ControlBit.ENABLE_VOLTAGE | ControlBit.QUICK_STOP | ControlBit.SWITCH_ON,
}
"""The bits of the command that leads out of a state to one with voltage. Bit 2 is 0 for a quick stop."""
_SWITCHES: Final = ("negative limit switch", "positive limit switch")
_FOLLOWING: Final = (Mode.PROFILE_POSITION, Mode.CYCLIC_SYNCHRONOUS_POSITION)
_OBEYS: Final = (
    Mode.CYCLIC_SYNCHRONOUS_POSITION, Mode.CYCLIC_SYNCHRONOUS_VELOCITY, Mode.CYCLIC_SYNCHRONOUS_TORQUE,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class DriveView:
    """The values of a drive's objects of CiA 402; None: it lacks the object. nmt_state: None: it was never heard."""

    statusword: int
    controlword: int | None = None
    mode: int | None = None
    wanted_mode: int | None = None
    supported_modes: int | None = None
    error_code: int | None = None
    position: int | None = None
    inputs: int | None = None
    nmt_state: NmtState | None = None

    @property
    def state(self) -> State:
        """The state of the drive, by its statusword."""
        return state_of(self.statusword)


class Reason(NamedTuple):
    """An obstacle, and what to do about it; both in words. is_command: a command removes it; else something outside has to."""

    what: str
    remedy: str
    is_command: bool = False


def seen_of(axis: Axis) -> DriveView:
    """Return what was last heard from a drive, and commanded to it; nothing is read."""

    def heard(key: Mux) -> int | None:
        value = axis.node.values.store.get(key) if key in axis.node.heard_at else None
        return value if isinstance(value, int) else None

    return DriveView(
        axis.statusword,
        axis.controlword,
        axis.mode,
        supported_modes=heard(objects.SUPPORTED_DRIVE_MODES),
        error_code=axis.error_code,
        inputs=heard(objects.DIGITAL_INPUTS),
    )


def outer_reason(axis: Axis) -> str:
    """Return the end of a message: the first obstacle that no command removes, and what to do about it; "" if there is none."""
    if objects.STATUSWORD not in axis.node.heard_at:
        return ""
    found = next((each for each in reasons(seen_of(axis)) if not each.is_command), None)
    return "" if found is None else f"; {found.what}. Try: {found.remedy}"


def look_at(node: RemoteNode) -> Procedure[DriveView | None]:
    """Read what a drive shows, by SDO, by number, whatever the dictionary has. Returns None for a node without a statusword.

    Raises SdoFailed if the node does not answer.
    """
    statusword = yield from read_number(node, objects.STATUSWORD)
    if statusword is None:
        return None
    shown: dict[str, int | None] = {}
    for name, key in _SHOWN.items():
        shown[name] = yield from read_number(node, key, signed=key in _SIGNED)
    return DriveView(statusword, nmt_state=node.nmt_state, **shown)


def reasons(view: DriveView) -> tuple[Reason, ...]:
    """Return what keeps a drive from moving, the first obstacle first; none: it would obey its next command."""
    found = []
    if view.nmt_state is NmtState.STOPPED:
        found.append(Reason("its NMT state is stopped: it takes no PDO and no SDO", "start it (NMT)"))
    if view.state in FAULT_STATES:
        return (*found, _fault(view))
    if view.state is State.UNKNOWN:
        what = f"its statusword 0x{view.statusword:04X} fits no state"
        return (*found, Reason(what, "look whether it is a drive by CiA 402, and this is its statusword"))
    if not view.statusword & StatusBit.REMOTE:
        found.append(Reason("it is under local control (bit 9, remote, is 0)", "give the fieldbus control, at the drive"))
    if view.state is State.QUICK_STOP_ACTIVE:
        found.append(Reason("a quick stop is active", "enable it again; if it does not leave this state, disable it first", True))
    elif view.state is not State.OPERATION_ENABLED:
        found.extend(_not_enabled(view))
    if view.controlword is not None and view.controlword & ControlBit.HALT:
        found.append(Reason("its controlword commands a halt (bit 8)", "a command without bit 8", True))
    found.extend(_mode(view))
    found.extend(_limits(view))
    return tuple(found)


def _fault(view: DriveView) -> Reason:
    code = f": 0x{view.error_code:04X} {error_text(view.error_code)}" if view.error_code else ""
    if view.state is State.FAULT_REACTION_ACTIVE:
        return Reason(f"it brakes because of a fault{code}", "wait until it is in fault")
    return Reason(f"it is in fault{code}", "remove the cause, then reset the fault")


def _not_enabled(view: DriveView) -> list[Reason]:
    found = []
    # Most drives show no voltage before they are told to switch on
    asked = _ASKED.get(view.state, 0)
    if (view.controlword or 0) & asked == asked and not view.statusword & StatusBit.VOLTAGE_ENABLED:
        found.append(Reason("its power stage has no voltage (bit 4 is 0)", "look at the motor supply, and at safe torque off"))
    if view.state is State.NOT_READY_TO_SWITCH_ON:
        return [*found, Reason("it is not ready to switch on: it still starts up", "wait", True)]
    return [*found, Reason(f"it is not enabled: {view.state}", "enable it", True)]


def _mode(view: DriveView) -> list[Reason]:
    found = []
    wanted, shown, modes = view.wanted_mode, view.mode, view.supported_modes
    if wanted is not None and wanted > 0 and modes is not None and not supported(modes, wanted):
        found.append(Reason(f"it does not have the mode that was selected, {mode_name(wanted)} (0x6502)", "another mode"))
    elif wanted is not None and shown is not None and wanted != shown:
        what = f"{mode_name(wanted)} was selected, but it shows {mode_name(shown)} (0x6060, 0x6061)"
        found.append(Reason(what, "wait; some drives change their mode only while they stand, or are not enabled"))
    elif shown == Mode.NO_MODE:
        found.append(Reason("no mode of operation is selected (0x6061 is 0)", "select one (0x6060)", True))
    if view.state is State.OPERATION_ENABLED and shown in _OBEYS and not view.statusword & ModeStatus.FOLLOWS_COMMAND:
        found.append(Reason("it does not follow its set-points (bit 12 is 0)", "send set-points in each cycle, with SYNC", True))
    return found


def _limits(view: DriveView) -> list[Reason]:
    found = []
    if view.statusword & StatusBit.INTERNAL_LIMIT:
        what = "a limit of its own holds it (bit 11): position 0x607D, speed, torque or current"
        found.append(Reason(what, "a target that leads away from the limit"))
    if view.mode in _FOLLOWING and view.statusword & ModeStatus.FOLLOWING_ERROR:
        found.append(Reason("its following error is too large (bit 13)", "look for a blocked axis; move more slowly"))
    inputs = view.inputs or 0
    for bit, name in enumerate(_SWITCHES):
        if inputs >> bit & 1:
            found.append(Reason(f"it stands on its {name} (0x60FD)", "move it the other way"))
    return found
