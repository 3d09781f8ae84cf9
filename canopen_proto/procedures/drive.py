"""The manual's sequences for a CiA 402 drive, as procedures over an `Axis`.

    reset_fault   0x0000, then 0x0080: the reset is a rising edge             manual: faultReset
    enable        up to Operation enabled, step by step                       manual: initDevice
    set_mode      0x6502 checked, 0x6060 written, 0x6061 awaited              manual: driveMode
    home          homing, to its end                                          manual: homing
    start_interpolation, start_cyclic_position                                manual: enableIPmode
    halt          bit 8: the drive stops by 0x605D and stays enabled
    quick_stop    the drive stops by 0x605A
    engage_brake  down to Ready to switch on                                  manual: enableBreak
    shut_down     unpowered (Switch on disabled)                              manual: shutdownDevice, with NMT stop

Commands take the way that `Axis` describes (the live RPDO, else SDO). A wait for the statusword takes what a TPDO brought within
the last 100 ms, else polls by SDO every 10 ms, since a drive whose SYNC is not running sends no TPDO.

A procedure that moves the drive halts it when it is cancelled or fails. Bit 4 is cleared before each homing and each start of
interpolation: both begin on its rising edge.

Source: IEC 61800-7-201 (CiA 402-2).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from canopen_proto.cia402.axis import Axis, HomingStyle
from canopen_proto.cia402.modes import (
    HomingStatus,
    Mode,
    ModeControl,
    ModeStatus,
    homing_status,
    mode_name,
    supported,
    supported_modes,
)
from canopen_proto.cia402.states import Command, ControlBit, State, StatusBit, next_command, state_of
from canopen_proto.machine import MILLISECOND, SECOND, Event, Time
from canopen_proto.pdo.consumer import PdoReceived
from canopen_proto.procedures.objects import read, read_if_present, read_int, write
from canopen_proto.procedures.steps import Cancelled, Procedure, ProcedureError, StepTimeout, Wait, act, current_time, sleep
from canopen_proto.sync import SyncReceived, SyncSent

POLL_INTERVAL: Final = 10 * MILLISECOND
"""Between two SDO reads of an object that is waited for, as the manual's library polled."""

REACTION_TIME: Final = 50 * MILLISECOND
"""What a drive may take until its statusword answers a command: an older "homing complete" must not end the next homing."""

START_TIME: Final = 1 * SECOND
"""How long a homing may take to begin to move."""

STANDSTILL_TIME: Final = 800 * MILLISECOND
"""How long a halt waits for the drive to report standstill; within CLEAN_UP_TIME."""

STANDSTILL_LOOK: Final = 30 * MILLISECOND
"""Between two looks at the position of a drive whose statusword does not tell that it stands."""

_SHOWS_STANDSTILL: Final = (
    Mode.PROFILE_POSITION,
    Mode.PROFILE_VELOCITY,
    Mode.TORQUE,
    Mode.HOMING,
    Mode.INTERPOLATED_POSITION,
)
"""Modes in which bit 10 of the statusword means "velocity 0" while bit 8 of the controlword is set. Others reserve it."""

SYNC_ALIVE: Final = 500 * MILLISECOND
"""SYNC counts as running when one was sent or heard within this time; it is also what a command waits for the next one."""


class DriveFault(ProcedureError):
    """The drive is in Fault, or fell into it while something else was awaited."""


class HomingFailed(ProcedureError):
    """The drive reported a homing error, or ended its homing unreferenced."""


class ModeUnsupported(ProcedureError):
    """The drive does not have a mode of operation (0x6502), or did not take it."""


def _name(axis: Axis) -> str:
    return f"drive {axis.node.node_id}"


# ---- statusword and controlword ----


def read_statusword(axis: Axis) -> Procedure[int]:
    """The present statusword: what was heard no longer than 100 ms ago, else read by SDO."""
    now = yield from current_time()
    statusword = axis.fresh_statusword(now)
    if statusword is None:
        statusword = yield from read_int(axis.node, "0x6041")
    return statusword


def wait_for_statusword(
    axis: Axis, done: Callable[[int], bool], timeout: Time, goal: str, *, accept_fault: bool = False
) -> Procedure[int]:
    """Wait until done(statusword), at most `timeout` ns; the statusword. What was heard before the wait does not count.

    Raises DriveFault as soon as the drive shows one (unless accept_fault), StepTimeout that names `goal` and what was seen last.
    """
    node = axis.node

    def is_news(report: Event) -> bool:
        return isinstance(report, PdoReceived) and report.node_id == node.node_id

    not_before = yield from current_time()
    deadline = not_before + timeout
    while True:
        now = yield from current_time()
        statusword = axis.fresh_statusword(now, not_before)
        if statusword is None:
            statusword = yield from read_int(node, "0x6041")
            now = yield from current_time()
            not_before = now + 1  # only a TPDO's value may serve for more than one look
        if done(statusword):
            return statusword
        if not accept_fault and state_of(statusword) in (State.FAULT, State.FAULT_REACTION_ACTIVE):
            raise (yield from fault_of(axis, f"while waiting for {goal}"))
        if now >= deadline:
            raise StepTimeout(f"{_name(axis)} did not reach {goal} within {timeout / SECOND:g} s: {axis.describe()}")
        yield Wait(min(POLL_INTERVAL, deadline - now), node, is_news)


def fault_of(axis: Axis, when: str) -> Procedure[DriveFault]:
    """What to raise for a drive in fault: with its error code (0x603F), which is read first, and its last EMCY."""
    try:
        yield from read_if_present(axis.node, "0x603F")
    except ProcedureError as error:
        when = f"{when} (its error code could not be read: {error})"
    return DriveFault(f"{_name(axis)} is in fault {when}: {axis.describe()}. Try: find the cause, then reset the fault")


def command(axis: Axis, controlword: int) -> Procedure[None]:
    """Bring a controlword to the drive: by the live RPDO that carries it, else by SDO, confirmed.

    By a synchronous RPDO it waits for the SYNC that takes it along, so that two commands in a row are two PDOs and an edge is an
    edge. Where SYNC is not running such an RPDO would never leave, and SDO is used. Raises SdoFailed.
    """
    producer = axis.node.rpdo_of(0x6040)
    if producer is not None and not producer.is_synchronous:
        yield from act(lambda now: axis.set_controlword(controlword, now))
        return
    last_sync = axis.node.last_sync
    if producer is not None and last_sync is not None and (yield from current_time()) - last_sync <= SYNC_ALIVE:
        yield from act(lambda now: axis.set_controlword(controlword, now))
        for _ in range(max(1, producer.transmission_type)):  # one of type n goes at every n-th SYNC
            if (yield Wait(SYNC_ALIVE, axis.node, lambda report: isinstance(report, SyncSent | SyncReceived))) is None:
                break
        else:
            return
    yield from write(axis.node, "0x6040", controlword)


def _leaves(state: State) -> Callable[[int], bool]:
    return lambda statusword: state_of(statusword) is not state


def change_state(axis: Axis, target: State) -> Procedure[int]:
    """Lead the drive to a state, one command after the other; the statusword. Raises DriveFault, StepTimeout.

    A drive in fault is not reset: that is `reset_fault`, a decision of the user's.
    """
    statusword = yield from read_statusword(axis)
    while (state := state_of(statusword)) is not target:
        if state in (State.FAULT, State.FAULT_REACTION_ACTIVE):
            raise (yield from fault_of(axis, f"and cannot go to {target}"))
        step = next_command(state, target)
        if step is not None:
            yield from command(axis, int(step))
        statusword = yield from wait_for_statusword(axis, _leaves(state), axis.settings.state_timeout, str(target))
    return statusword


# ---- state and mode ----


def reset_fault(axis: Axis) -> Procedure[None]:
    """Clear a fault by a rising edge of bit 7; a drive without one is left as it is, at most without power.

    Returns when the drive is out of Fault. Raises DriveFault where it stays: the cause is still there.
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
    except StepTimeout as stuck:
        raise (yield from fault_of(axis, "that a fault reset did not clear")) from stuck
    yield from command(axis, 0)


def enable(axis: Axis) -> Procedure[None]:
    """Lead the drive to Operation enabled. Raises DriveFault, StepTimeout, SdoFailed."""
    yield from change_state(axis, State.OPERATION_ENABLED)


def set_mode(axis: Axis, mode: int, *, waive_check: bool = False) -> Procedure[None]:
    """Select a mode of operation and wait until the drive shows it.

    Raises ModeUnsupported, with nothing written, where 0x6502 lacks the mode (a drive without 0x6502 is asked by doing), and
    where the drive does not take it up. waive_check: for drives that can do what 0x6502 denies (Schunk's homing).
    """
    if not waive_check:
        modes = yield from read_if_present(axis.node, "0x6502")
        if isinstance(modes, int) and not supported(modes, mode):
            has = ", ".join(mode_name(each) for each in supported_modes(modes)) or "none"
            raise ModeUnsupported(f"{_name(axis)} does not support {mode_name(mode)}: 0x6502 = 0x{modes:08X}, which is {has}")
    # Bit 4 means something else in each mode: what interpolates must not begin to home because it still stands.
    bears_bit_4 = axis.controlword & 0x1F == Command.ENABLE_OPERATION | ModeControl.START_HOMING
    if bears_bit_4 and state_of((yield from read_statusword(axis))) is State.OPERATION_ENABLED:
        yield from command(axis, int(Command.ENABLE_OPERATION))
    yield from write(axis.node, "0x6060", mode)
    deadline = (yield from current_time()) + axis.settings.state_timeout
    while True:
        shown = yield from read_int(axis.node, "0x6061")
        if shown == mode:
            return
        if (yield from current_time()) >= deadline:
            raise ModeUnsupported(
                f"{_name(axis)} did not take up {mode_name(mode)}; it shows {mode_name(shown)} in 0x6061: {axis.describe()}"
            )
        yield from sleep(POLL_INTERVAL)


# ---- motion ----


def halt(axis: Axis) -> Procedure[None]:
    """Stop the drive by bit 8 (it stays enabled) and wait for standstill. A drive that is not enabled is left alone.

    Any later command without bit 8 ends the halt. Raises StepTimeout where the drive does not report standstill, SdoFailed.
    """
    statusword = yield from read_statusword(axis)
    if state_of(statusword) is not State.OPERATION_ENABLED:
        return
    controlword = axis.controlword if axis.controlword & 0x0F == Command.ENABLE_OPERATION else int(Command.ENABLE_OPERATION)
    yield from command(axis, controlword | ControlBit.HALT)

    is_schunk = axis.settings.homing is HomingStyle.SCHUNK
    if not is_schunk and axis.mode not in _SHOWS_STANDSTILL and "0x6064" in axis.node.dictionary:
        yield from _wait_for_same_position(axis)
        return

    def stands(word: int) -> bool:
        if state_of(word) is not State.OPERATION_ENABLED:
            return True
        return not word & StatusBit.MANUFACTURER_8 if is_schunk else bool(word & StatusBit.TARGET_REACHED)

    yield from wait_for_statusword(axis, stands, STANDSTILL_TIME, "standstill after a halt", accept_fault=True)


def _wait_for_same_position(axis: Axis) -> Procedure[None]:
    """Standstill as the actual position shows it: the same after STANDSTILL_LOOK, but for the last digit."""
    deadline = (yield from current_time()) + STANDSTILL_TIME
    position = yield from read_int(axis.node, "0x6064")
    while True:
        yield from sleep(STANDSTILL_LOOK)
        before, position = position, (yield from read_int(axis.node, "0x6064"))
        if abs(position - before) <= 1:
            return
        if (yield from current_time()) >= deadline:
            limit = f"{STANDSTILL_TIME / SECOND:g} s"
            raise StepTimeout(f"{_name(axis)} did not reach standstill after a halt within {limit}: {axis.describe()}")


def halt_after(axis: Axis, cause: BaseException) -> Procedure[None]:
    """Halt as the clean-up of something that ended with `cause`; what goes wrong is noted there, or raised for a Cancelled."""
    try:
        yield from halt(axis)
    except ProcedureError as error:
        if isinstance(cause, Cancelled):
            raise
        cause.add_note(f"and the halt of {_name(axis)} failed: {error}")


def quick_stop(axis: Axis) -> Procedure[None]:
    """Command a quick stop and wait until the drive is in Quick stop active or Switch on disabled (CiA 402: 0x605A decides)."""
    yield from command(axis, int(Command.QUICK_STOP))
    stopped = (State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED)
    yield from wait_for_statusword(axis, lambda word: state_of(word) in stopped, axis.settings.state_timeout, "a quick stop")


def engage_brake(axis: Axis) -> Procedure[None]:
    """From any state without fault to Ready to switch on: no torque, brake engaged."""
    yield from change_state(axis, State.READY_TO_SWITCH_ON)


def shut_down(axis: Axis) -> Procedure[None]:
    """To Switch on disabled: no power. A drive in fault has none, and stays there. RPDOs are sent no more."""
    statusword = yield from read_statusword(axis)
    if state_of(statusword) not in (State.FAULT, State.FAULT_REACTION_ACTIVE):
        yield from change_state(axis, State.SWITCH_ON_DISABLED)
    now = yield from current_time()
    for number in axis.node.rpdos:
        axis.node.enable_rpdo(number, now, False)


def home(axis: Axis) -> Procedure[None]:
    """Home the drive, from any state without fault, and wait for the end.

    Raises HomingFailed, DriveFault, ModeUnsupported, StepTimeout (`homing_timeout`). The drive is halted when that happens, and
    when it is cancelled.
    """
    settings = axis.settings
    axis.is_homed = False
    is_schunk = settings.homing is HomingStyle.SCHUNK
    yield from set_mode(axis, Mode.HOMING, waive_check=is_schunk)
    if settings.homing_method is not None and not is_schunk:
        yield from write(axis.node, "0x6098", settings.homing_method)
    yield from enable(axis)
    try:
        yield from command(axis, int(Command.ENABLE_OPERATION))
        yield from command(axis, Command.ENABLE_OPERATION | ModeControl.START_HOMING)
        yield from (_schunk_homing(axis) if is_schunk else _standard_homing(axis))
    except (Cancelled, ProcedureError) as cause:
        yield from halt_after(axis, cause)
        raise
    yield from command(axis, int(Command.ENABLE_OPERATION))
    axis.is_homed = True


def _standard_homing(axis: Axis) -> Procedure[None]:
    yield from sleep(REACTION_TIME)
    ends = (HomingStatus.COMPLETE, HomingStatus.ERROR_STOPPED, HomingStatus.ERROR_MOVING)
    statusword = yield from wait_for_statusword(
        axis,
        lambda word: homing_status(word) in ends,
        axis.settings.homing_timeout,
        "the end of homing",
    )
    if homing_status(statusword) is not HomingStatus.COMPLETE:
        raise HomingFailed(f"{_name(axis)} reports a homing error: {axis.describe()}")


def _schunk_homing(axis: Axis) -> Procedure[None]:
    moving, referenced = StatusBit.MANUFACTURER_8, StatusBit.MANUFACTURER_15
    try:
        yield from wait_for_statusword(axis, lambda word: bool(word & moving), START_TIME, "the start of homing (bit 8)")
    except StepTimeout:
        # A joint that stands at its reference already need not move; or the movement was over between two reads.
        if not axis.statusword & referenced:
            raise
    timeout = axis.settings.homing_timeout
    statusword = yield from wait_for_statusword(axis, lambda word: not word & moving, timeout, "the end of homing (bit 8)")
    if not statusword & referenced:
        raise HomingFailed(f"{_name(axis)} stopped, but is not referenced (bit 15): {axis.describe()}")


def start_interpolation(axis: Axis, cycle_time: Time) -> Procedure[float]:
    """Make the drive follow a set-point per SYNC in interpolated position mode; the position from which it does so.

    cycle_time: ns between two SYNCs, 1 to 255 ms or 0.1 ms steps below. The actual position is read and is the first set-point,
    so that nothing jumps when bit 4 is set. Raises ModeUnsupported, DriveFault, StepTimeout. Halted if cancelled half-way.
    """
    yield from set_mode(axis, Mode.INTERPOLATED_POSITION)
    yield from _set_interpolation_period(axis, cycle_time)
    return (yield from _follow(axis, 0x60C1, 1, ModeControl.ENABLE_INTERPOLATION, ModeStatus.IP_MODE_ACTIVE))


def start_cyclic_position(axis: Axis, cycle_time: Time) -> Procedure[float]:
    """As start_interpolation, in cyclic synchronous position mode (0x607A is the set-point, and there is no bit 4)."""
    yield from set_mode(axis, Mode.CYCLIC_SYNCHRONOUS_POSITION)
    yield from _set_interpolation_period(axis, cycle_time)
    return (yield from _follow(axis, 0x607A, 0, 0, ModeStatus.FOLLOWS_COMMAND))


def _set_interpolation_period(axis: Axis, cycle_time: Time) -> Procedure[None]:
    """Write 0x60C2: period = :1 * 10 ** :2 seconds, :1 being UNSIGNED8."""
    if (0x60C2, 1) not in axis.node.dictionary:
        return
    exponent = -4 if cycle_time % MILLISECOND else -3
    units, rest = divmod(cycle_time, 10 ** (9 + exponent))
    if rest or not 1 <= units <= 255:
        cycle = f"{cycle_time / MILLISECOND:g} ms"
        raise ProcedureError(f"a cycle of {cycle} cannot be written to 0x60C2: it holds 1 to 255 units of 1 ms or 0.1 ms")
    yield from write(axis.node, (0x60C2, 2), exponent)
    yield from write(axis.node, (0x60C2, 1), units)


def _follow(axis: Axis, index: int, subindex: int, start: int, active: int) -> Procedure[float]:
    node = axis.node
    yield from enable(axis)
    try:
        position = yield from read_int(node, "0x6064")
        axis.set_position_counts(position)
        if (index, subindex) in node.dictionary:
            yield from write(node, (index, subindex), position)
        now = yield from current_time()
        for number, producer in node.rpdos.items():
            if producer.mapping.find_component((index, subindex)) is not None:
                node.enable_rpdo(number, now)
        yield from command(axis, int(Command.ENABLE_OPERATION))
        yield from command(axis, Command.ENABLE_OPERATION | start)
        goal = "interpolation active (bit 12)" if start else "follows command (bit 12)"
        yield from wait_for_statusword(axis, lambda word: bool(word & active), axis.settings.state_timeout, goal)
    except (Cancelled, ProcedureError) as cause:
        yield from halt_after(axis, cause)
        raise
    return axis.from_counts(position)


def move_to(axis: Axis, position: float, *, timeout: Time, relative: bool = False) -> Procedure[None]:
    """Profile position: move to a position in the user's unit, with the drive's profile (0x6081, 0x6083), and wait for the end.

    The set-point handshake of CiA 402: bit 4 clear, target, bit 4 set, bit 12 acknowledges, bit 4 clear, bit 10 at the target.
    Halted when cancelled or failed.
    """
    settings = axis.settings
    counts = axis.to_counts(position) - (settings.offset if relative else 0)
    yield from set_mode(axis, Mode.PROFILE_POSITION)
    yield from enable(axis)
    try:
        yield from command(axis, int(Command.ENABLE_OPERATION))
        yield from _wait_for_acknowledge(axis, False)
        yield from write(axis.node, "0x607A", counts)
        options = ModeControl.NEW_SET_POINT | (ModeControl.RELATIVE if relative else 0)
        yield from command(axis, Command.ENABLE_OPERATION | options)
        yield from _wait_for_acknowledge(axis, True)
        yield from command(axis, Command.ENABLE_OPERATION | options & ~ModeControl.NEW_SET_POINT)
        yield from wait_for_statusword(axis, lambda word: bool(word & StatusBit.TARGET_REACHED), timeout, "its target position")
    except (Cancelled, ProcedureError) as cause:
        yield from halt_after(axis, cause)
        raise


def _wait_for_acknowledge(axis: Axis, wanted: bool) -> Procedure[None]:
    yield from wait_for_statusword(
        axis,
        lambda word: bool(word & ModeStatus.SET_POINT_ACKNOWLEDGE) is wanted,
        axis.settings.state_timeout,
        f"set-point acknowledge (bit 12) = {int(wanted)}",
    )


def read_position(axis: Axis) -> Procedure[float]:
    """The actual position (0x6064), in the user's unit, read by SDO."""
    yield from read(axis.node, "0x6064")
    return axis.position
