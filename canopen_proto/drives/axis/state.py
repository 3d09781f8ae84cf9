"""Lead a drive through its states and modes of operation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.controlword import STAYS, bring, command, command_held, insist, insist_and_look, put
from canopen_proto.drives.axis.digital_io import return_brake
from canopen_proto.drives.axis.exclusive_motion import moves, stops
from canopen_proto.drives.axis.failures import (
    DriveTimeoutError,
    ModeUnsupportedError,
    as_drive_errors,
    fault_of,
    state_lost,
    taken_down,
)
from canopen_proto.drives.axis.halting import halt, halt_after, may_be_enabled
from canopen_proto.drives.axis.settings import MODE_CHANGE_STATES
from canopen_proto.drives.axis.view import is_taken_down
from canopen_proto.drives.axis.watching import POLL_INTERVAL, DriveWait, read_statusword, wait_for_statusword
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.axes import axis_of
from canopen_proto.drives.cia402.modes import Mode, ModeControl, mode_name, supported, supported_modes
from canopen_proto.drives.cia402.states import FAULT_STATES, POWERED, Command, ControlBit, State, next_command, state_of
from canopen_proto.machine import SECOND, Time
from canopen_proto.procedures.objects import read_if_present, read_int
from canopen_proto.procedures.steps import Cancelled, Procedure, SdoTransferError, StepTimeoutError, act, current_time

_POWER: Final = {State.READY_TO_SWITCH_ON: 1, State.SWITCHED_ON: 2, State.OPERATION_ENABLED: 3}
"""How far a state is on the way to Operation enabled; 0 for all other states."""
_ANOTHER: Final = "a mode that it has"

_ANOTHER_STATE: Final = {
    State.OPERATION_ENABLED: State.SWITCHED_ON,
    State.SWITCHED_ON: State.READY_TO_SWITCH_ON,
    State.SWITCH_ON_DISABLED: State.READY_TO_SWITCH_ON,
}
"""State -> the one by which a drive shows that it has obeyed. From all others it goes to Switch on disabled."""

ACTS_LATE: Final = "keep away; if it is only slow, longer reaction_time and state_timeout in its settings; else reset its node"
"""The remedy for a drive that may still obey an old command."""


def _leaves(state: State) -> Callable[[int], bool]:
    return lambda statusword: state_of(statusword) not in (state, State.UNKNOWN)


@as_drive_errors
def change_state(axis: Axis, target: State) -> Procedure[int]:
    """Lead the drive to the state `target`, one command after the other; return the statusword.

    A drive in fault is not reset: `reset_fault` does that, by the user's decision. Raises StateLostError for a drive that goes
    down when it is led up, reaches a state twice, or was disabled since the motion began: something else commands it. Raises
    DriveInFaultError, DriveLostError, StepTimeoutError, SdoTransferError. On the way to Operation enabled, `axis.watchdog` first
    makes the drive watch its master. On the way to any other state, the drive first gets its brake back if this master has opened
    it. To Operation enabled it counts as a motion, else as a stop, see exclusive_motion.py.
    """
    lead = _change_state_up if target is State.OPERATION_ENABLED else _change_state_down
    return (yield from lead(axis, target))


def _lead(axis: Axis, target: State) -> Procedure[int]:
    if target is State.OPERATION_ENABLED and axis.watchdog is not None:
        yield from axis.watchdog.hold()
    if target is not State.OPERATION_ENABLED:
        yield from return_brake(axis)
    if target in STAYS:  # the drive may be there already, and hold an RPDO that would lead it away
        yield from command_held(axis, STAYS[target])
    if target is not State.OPERATION_ENABLED:
        yield from _take_power_first(axis, target)
    statusword = yield from read_statusword(axis)
    if state_of(statusword) is target and target in STAYS and may_be_enabled(axis):
        yield from insist(axis, int(STAYS[target]))  # it has not shown yet what it was told since
    seen: list[State] = []
    slowest: Time | None = None
    while (state := state_of(statusword)) is not target:
        if state in FAULT_STATES:
            raise (yield from fault_of(axis, f"and cannot go to {target}"))
        goes_up = _POWER.get(target, 0) > _POWER.get(state, 0)
        if target is State.OPERATION_ENABLED and is_taken_down(axis):
            raise taken_down(axis)
        if state in seen or (goes_up and seen and _POWER.get(state, 0) < _POWER.get(seen[-1], 0)):
            raise state_lost(axis, state, str(target))
        seen.append(state)
        step = next_command(state, target)
        began = yield from current_time()
        try:
            if step is not None:
                yield from (insist_and_look if state in POWERED and not goes_up else command)(axis, int(step))
            statusword = yield from wait_for_statusword(axis, _leaves(state), axis.settings.state_timeout, str(target))
        except (Cancelled, StepTimeoutError, SdoTransferError):
            axis.leave_unanswered(f"the way to {target}")
            raise
        if step is not None:
            slowest = max(slowest or 0, (yield from current_time()) - began)
    if slowest is not None and not axis.unanswered:
        axis.answer_time = slowest
    return statusword


def settle(axis: Axis) -> Procedure[None]:
    """Make sure that the drive has obeyed all that it was commanded: lead it to another state, and wait until it shows it.

    An enabled drive slows down by its ramp and has no power then. Others go one state down, or from the lowest one up: there they
    have no power either. Raises DriveTimeoutError if the drive does not show the state within `state_timeout`: it may still act.
    """
    state = state_of((yield from read_statusword(axis)))
    left = axis.unanswered or "what it was commanded before"
    axis.leave_unanswered(left)
    try:
        yield from change_state(axis, _ANOTHER_STATE.get(state, State.SWITCH_ON_DISABLED))
    except StepTimeoutError as late:
        failed = f"has not answered within {axis.settings.state_timeout / SECOND:g} s (state_timeout), and may still obey {left}"
        raise DriveTimeoutError(
            axis, failed, reason=late.reason if isinstance(late, DriveTimeoutError) else "", remedy=ACTS_LATE
        ) from late
    axis.unanswered = ""


def _take_power_first(axis: Axis, target: State) -> Procedure[None]:
    """Send the command that leads down to `target` before anything is read: a drive may move while answers are lost.

    Sends nothing to a drive that shows its state by PDO, or showed that it has no power. The word gives power to no drive.
    """
    if axis.fresh_statusword((yield from current_time())) is not None:
        return
    if target in STAYS and (axis.state in (State.UNKNOWN, *POWERED) or may_be_enabled(axis)):
        yield from insist_and_look(axis, int(STAYS[target]))


@moves
def _change_state_up(axis: Axis, target: State) -> Procedure[int]:
    """As `change_state`."""
    return (yield from _lead(axis, target))


@stops(halt_after)
def _change_state_down(axis: Axis, target: State) -> Procedure[int]:
    """As `change_state`."""
    return (yield from _lead(axis, target))


@as_drive_errors
def reset_fault(axis: Axis) -> Procedure[None]:
    """Clear a fault by a rising edge of bit 7. A drive without a fault stays as it is, or at worst loses its power.

    Returns when the drive has left Fault. Raises DriveInFaultError if it stays there: the cause persists.
    """
    statusword = yield from wait_for_statusword(
        axis,
        lambda word: state_of(word) is not State.FAULT_REACTION_ACTIVE,
        axis.settings.state_timeout,
        "the end of its fault reaction",
        accept_fault=True,
    )
    if state_of(statusword) is not State.FAULT:
        return
    yield from command(axis, 0)
    yield from command(axis, int(Command.FAULT_RESET))
    try:
        yield from wait_for_statusword(
            axis,
            lambda word: state_of(word) is not State.FAULT,
            axis.settings.state_timeout,
            "the end of its fault",
            accept_fault=True,
        )
    except StepTimeoutError as stuck:
        raise (yield from fault_of(axis, "that a fault reset did not clear")) from stuck
    yield from command(axis, 0)


@moves
@as_drive_errors
def enable(axis: Axis) -> Procedure[None]:
    """Lead the drive to Operation enabled. Raises DriveInFaultError, StepTimeoutError, SdoTransferError.

    In velocity, torque and cyclic modes the drive then obeys its last target at once, from whatever source: select a mode first,
    or call `select_motionless_mode`.
    """
    yield from change_state(axis, State.OPERATION_ENABLED)


def require_mode(axis: Axis, mode: int) -> Procedure[None]:
    """Raise ModeUnsupportedError if 0x6502 lacks a mode of the standard. Nothing is written; without 0x6502 any mode may do."""
    modes = yield from read_if_present(axis.node, objects.SUPPORTED_DRIVE_MODES)
    if isinstance(modes, int) and not supported(modes, mode):
        has = ", ".join(mode_name(each) for each in supported_modes(modes)) or "none"
        reason = f"0x6502 = 0x{modes:08X}, which is {has}"
        raise ModeUnsupportedError(axis, f"does not support {mode_name(mode)}", reason=reason, remedy=_ANOTHER)


@moves
@as_drive_errors
def set_mode(axis: Axis, mode: int, *, waive_check: bool = False) -> Procedure[None]:
    """Select a mode of operation and wait until the drive shows it. 0x6060 goes by the live RPDO that carries it, else by SDO.

    Raises ModeUnsupportedError, with nothing written, if 0x6502 lacks the mode (without 0x6502 the mode is simply tried); also if
    the drive does not take up the mode within `state_timeout`. waive_check: write the mode although 0x6502 lacks it (Schunk's
    homing). Modes of the maker, below 0, have no bit in 0x6502. Raises DriveInFaultError, StateLostError (the drive was enabled,
    and no longer is), DriveLostError.

    A drive that by its settings (mode_change_state, changes_mode_halted) takes no other mode in its present state is first halted
    and led down to a state in which it does; it stays there. One that shows the mode already is left as it is.
    """
    if not waive_check and mode >= 0:
        yield from require_mode(axis, mode)
    state = state_of((yield from read_statusword(axis)))
    lower = _state_below(axis, state)
    if lower is not None:
        if (yield from read_int(axis.node, objects.MODES_OF_OPERATION_DISPLAY)) == mode:
            axis.node.keep_commanded(objects.MODES_OF_OPERATION)  # an RPDO that is sent later asks for this mode too
            yield from act(lambda now: put(axis, objects.MODES_OF_OPERATION, mode, now))
            return
        yield from halt(axis)
        yield from change_state(axis, lower)
        state = lower
    # Bit 4 means something else in each mode: a drive that interpolates must not begin to home because the bit is still set.
    bears_bit_4 = axis.controlword & 0x1F == Command.ENABLE_OPERATION | ModeControl.START_HOMING
    if bears_bit_4 and state is State.OPERATION_ENABLED:
        yield from command(axis, Command.ENABLE_OPERATION | axis.controlword & ControlBit.HALT)  # a halt stays in force
    axis.selected_mode, axis.selected_at = mode, (yield from current_time())
    yield from bring(axis, objects.MODES_OF_OPERATION, mode)
    watch: DriveWait[bool] = DriveWait(
        axis,
        mode_name(mode),
        accept_fault=state in FAULT_STATES,
        stays=state if state is State.OPERATION_ENABLED else None,
        reads={objects.MODES_OF_OPERATION_DISPLAY: POLL_INTERVAL},
    )

    def is_shown(statusword: int, heard_at: Time) -> bool | None:
        refusal = watch.refusal(objects.MODES_OF_OPERATION_DISPLAY)
        if refusal is not None:
            raise refusal
        return True if watch.heard(objects.MODES_OF_OPERATION_DISPLAY) is not None and axis.mode == mode else None

    try:
        yield from watch.until(is_shown, axis.settings.state_timeout)
    except DriveTimeoutError as late:
        axis.leave_unanswered(mode_name(mode))
        shown = axis.mode or Mode.NO_MODE
        if axis.node.rpdo_of(objects.MODES_OF_OPERATION) is not None:
            # An RPDO cannot be refused: it would go on asking, and the drive might obey at any later time.
            yield from act(lambda now: put(axis, objects.MODES_OF_OPERATION, shown, now))
        failed = f"did not take up {mode_name(mode)}; it shows {mode_name(shown)} in 0x6061"
        raise ModeUnsupportedError(axis, failed, reason=late.reason, remedy=late.remedy, view=late.view) from late


def _state_below(axis: Axis, state: State) -> State | None:
    """Return the state to which a drive has to go down before it takes another mode; None if it takes one as it is."""
    highest = axis.settings.mode_change_state
    if state in POWERED and not axis.settings.changes_mode_halted and axis.controlword & ControlBit.HALT:
        highest = min(highest, State.SWITCHED_ON, key=MODE_CHANGE_STATES.index)  # the command that leads there has no bit 8
    if state in (State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE):
        state = State.OPERATION_ENABLED
    goes_down = state in MODE_CHANGE_STATES and MODE_CHANGE_STATES.index(state) > MODE_CHANGE_STATES.index(highest)
    return highest if goes_down else None


@stops(halt_after)
@as_drive_errors
def quick_stop(axis: Axis) -> Procedure[None]:
    """Command a quick stop; wait until the drive is in Quick stop active or Switch on disabled (CiA 402: 0x605A decides)."""
    yield from insist_and_look(axis, int(Command.QUICK_STOP))
    yield from return_brake(axis)
    stopped = (State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED)
    try:
        yield from wait_for_statusword(axis, lambda word: state_of(word) in stopped, axis.settings.state_timeout, "a quick stop")
    except StepTimeoutError:
        axis.leave_unanswered("a quick stop")
        raise


@stops(halt_after)
@as_drive_errors
def engage_brake(axis: Axis) -> Procedure[None]:
    """Lead the drive from any state without fault to Ready to switch on: no torque, brake engaged."""
    yield from change_state(axis, State.READY_TO_SWITCH_ON)


@stops(halt_after)
@as_drive_errors
def shut_down(axis: Axis) -> Procedure[None]:
    """Lead the drive to Switch on disabled: no power. Then stop sending RPDOs, and let `axis.watchdog` go.

    A drive in Fault has no power, and stays there. A drive in its fault reaction still has power and brakes: it is awaited. A
    drive that may have power, and does not show its state by PDO, is commanded before anything is read.
    """
    if not axis.has_opened_brake:  # else a load may fall: `change_state` first gives the brake back
        yield from _take_power_first(axis, State.SWITCH_ON_DISABLED)
    state = state_of((yield from read_statusword(axis)))
    if state is State.FAULT_REACTION_ACTIVE:
        yield from halt(axis)
    elif state is not State.FAULT:
        yield from change_state(axis, State.SWITCH_ON_DISABLED)
    now = yield from current_time()
    for number in _own_rpdos(axis):
        axis.node.enable_rpdo(number, now, False)
    if axis.watchdog is not None:
        yield from axis.watchdog.let_go()


def _own_rpdos(axis: Axis) -> list[int]:
    """Return the numbers of the RPDOs that are exchanged with the node and carry nothing for another axis of it."""
    carried = {
        number: {place for mux in rpdo.mapping.muxes if (place := axis_of(mux)) is not None}
        for number, rpdo in axis.node.rpdos.items()
    }
    return [number for number, axes in carried.items() if (axes or {0}) == {axis.number}]
