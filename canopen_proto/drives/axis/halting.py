"""Halt a drive: it stops and stays enabled. Also the clean-up of everything that moves a drive.

The drive's speed and ramp decide how long that takes. So a halt waits step by step, as long as the drive is slower at the end of
a step than at its beginning. A step takes `reaction_time` plus `halt_time`. A drive that does not get slower is reported after
one step. A drive that loses its power during a halt may coast: it stands once its position stays.

Another master may take the halt back, by a controlword without bit 8. Then the halt is sent again, OVERRULED times at most. So is
a halt that went by RPDO, if a heartbeat shows then that the node is not Operational, and hears no PDOs.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Final

from canopen_proto.abort import AbortOrigin
from canopen_proto.drives.axis.axis import Axis, HomingStyle
from canopen_proto.drives.axis.controlword import STAYS, command, command_held, insist, insist_and_look
from canopen_proto.drives.axis.exclusive_motion import stops
from canopen_proto.drives.axis.failures import DriveTimeoutError, TakenOverError, as_drive_errors, is_loss, name_of
from canopen_proto.drives.axis.units import read_number
from canopen_proto.drives.axis.view import last_foreign, view_of
from canopen_proto.drives.axis.watching import DriveWait, wait_for_statusword
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import (
    COMMAND_BITS,
    POWERED,
    Command,
    ControlBit,
    State,
    StatusBit,
    enables_operation,
    state_of,
)
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Outcome, RequestId, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.procedures.objects import read_if_present, urgent_request, value_of
from canopen_proto.procedures.steps import (
    Cancelled,
    Procedure,
    ProcedureError,
    SdoTransferError,
    StepTimeoutError,
    Wait,
    act,
    ask_for_time,
    current_time,
    sleep,
)
from canopen_proto.remote_node import FRESH
from canopen_proto.sdo.client import SdoAborted, SdoUploaded

STANDSTILL_LOOK: Final = 30 * MILLISECOND
"""Between two looks at the position of a drive whose statusword does not show whether it stands."""

MANY_LOOKS: Final = 10
"""Looks that are needed to tell a position that goes to and fro from one that moves on."""

_SHOWS_STANDSTILL: Final = (
    Mode.PROFILE_POSITION,
    Mode.PROFILE_VELOCITY,
    Mode.TORQUE,
    Mode.HOMING,
    Mode.INTERPOLATED_POSITION,
)
"""Modes in which bit 10 of the statusword means "velocity 0" while bit 8 of the controlword is set. Other modes reserve it."""

_WITHOUT_SPEED: Final = (Mode.TORQUE, Mode.CYCLIC_SYNCHRONOUS_TORQUE)
"""Modes in which a drive may answer bit 8 by taking its torque away: an axis without friction moves on then."""

_CAN_BE_ENABLED: Final = (State.READY_TO_SWITCH_ON, State.SWITCHED_ON)
"""States from which one controlword leads to Operation enabled (from the first: in drives that take two steps at once)."""

OVERRULED: Final = 3
"""How often a halt that another master takes back is sent again. Whoever goes on wins, and the error names it."""

_WITH_POWER: Final = "standstill after a halt"
_WITHOUT_POWER: Final = "standstill without power (it coasts)"
_SLOWER: Final = 0.02
"""A drive counts as slower if it has lost more than this share of its speed in a step."""
_OF_ITS_RAMP: Final = 0.25
"""If its ramp is known, more than this share of the ramp's loss in `halt_time` is enough too: a ramp may begin smoothly."""


@stops(None)
@as_drive_errors
def halt(axis: Axis) -> Procedure[None]:
    """Stop the drive by bit 8 (it stays enabled) and wait for standstill, in its statusword and in its position (0x6064).

    A drive that is not enabled is not commanded, since bit 8 comes with the command to enable; if it brakes, its standstill is
    awaited. So a drive that does not show its state by PDO is asked for it first. If it was enabled when it was last heard, or
    was commanded to enable, and does not answer within 100 ms, it gets bit 8 all the same. Any other drive that does not answer
    gets a quick stop, which gives power to no drive. A drive that was commanded to enable, and is not enabled yet, is watched for
    `reaction_time`: it may obey late. If it is not enabled by then, it gets the command that leaves it in its state: a drive that
    obeys even later disables itself again. A drive in Quick stop active, which such a command would enable again, gets a quick
    stop at once. An RPDO that the drive holds for a SYNC is replaced: by the halt, or by a word that keeps a disabled drive in
    its state. Any later command without bit 8 ends the halt. The wait lasts as long as the drive slows down (0x606C, else
    0x6064). In torque modes, where bit 8 may only take the torque away, a drive that moves on gets a quick stop, and most drives
    have no power then. Raises StepTimeoutError if the drive still moves and did not become slower within a step, or if it shows
    no state for `reaction_time`; SdoTransferError, DriveLostError. A halt that is cancelled is not taken back: it begins again,
    as the clean-up.
    """
    try:
        yield from _stop(axis)
    except Cancelled:
        yield from _stop(axis)
        raise


def _stop(axis: Axis) -> Procedure[None]:
    may_move = axis.state in POWERED or may_be_enabled(axis)  # without power by now, it may still coast
    word = STAYS[axis.state] if axis.state in STAYS else (yield from _halt_word(axis))
    yield from command_held(axis, word)  # a SYNC may come before the drive's state is known
    is_told = yield from halt_first(axis)
    try:
        statusword = yield from _statusword_now(axis)
    except SdoTransferError as failed:
        if not is_told and failed.origin is not AbortOrigin.LOCAL:  # a drive that has booted has no power
            yield from insist(axis, int(Command.QUICK_STOP))
        raise
    state = state_of(statusword)
    axis.was_enabled = axis.was_enabled or state is State.OPERATION_ENABLED
    if state is State.UNKNOWN:
        state = yield from _next_state(axis)
    if state in _CAN_BE_ENABLED and may_be_enabled(axis):
        state = yield from _late_state(axis)
    if state is State.OPERATION_ENABLED:
        if not is_told:
            yield from _send_halt(axis)
    elif state is State.QUICK_STOP_ACTIVE and may_be_enabled(axis):
        yield from insist(axis, int(Command.QUICK_STOP))
    else:
        yield from command_held(axis, STAYS[state] if state in STAYS else (yield from _halt_word(axis)))
        if state not in POWERED and not may_move:
            return
    try:
        yield from _wait_for_standstill(axis)
    except StepTimeoutError:
        if axis.state is not State.OPERATION_ENABLED or axis.mode not in _WITHOUT_SPEED:
            raise
        yield from command(axis, int(Command.QUICK_STOP))
        yield from _wait_for_standstill(axis)


def halt_first(axis: Axis) -> Procedure[bool]:
    """Send bit 8 to a drive that is enabled, or may be and does not say so within 100 ms. Return whether it was sent.

    The first step of a halt: nothing before it can fail. Raises SdoTransferError if the drive does not confirm it.
    """
    statusword = axis.fresh_statusword((yield from current_time()))
    may_be = axis.state is State.OPERATION_ENABLED or may_be_enabled(axis)
    if statusword is None and may_be:
        statusword = yield from _statusword_soon(axis)
    is_enabled = may_be if statusword is None else state_of(statusword) is State.OPERATION_ENABLED
    if is_enabled:
        yield from _send_halt(axis)
    return is_enabled


def _send_halt(axis: Axis) -> Procedure[None]:
    """Send the word that halts the drive."""
    yield from insist_and_look(axis, (yield from _halt_word(axis)))


def _statusword_now(axis: Axis) -> Procedure[int]:
    """Return the statusword, as `read_statusword`; a read waits for no other transfer."""
    node = axis.node
    statusword = axis.fresh_statusword((yield from current_time()))
    if statusword is not None:
        return statusword
    outcome = yield from urgent_request(node, lambda now: node.read(objects.STATUSWORD, now, urgent=True))
    if not isinstance(outcome, SdoUploaded):
        assert isinstance(outcome, SdoAborted)
        raise SdoTransferError(outcome, "reading")
    value_of(node, node.dictionary.variable(objects.STATUSWORD), outcome)
    return axis.statusword


def _statusword_soon(axis: Axis) -> Procedure[int | None]:
    """Read the statusword; None if the answer does not come within FRESH, or is none."""
    node = axis.node
    request_id: RequestId = yield from act(lambda now: node.read(objects.STATUSWORD, now, urgent=True))
    try:
        report = yield Wait(FRESH, node, lambda each: isinstance(each, Outcome) and each.request_id == request_id)
    except Cancelled:
        yield from act(lambda now: node.cancel(request_id, now))
        raise
    if isinstance(report, SdoUploaded):
        value_of(node, node.dictionary.variable(objects.STATUSWORD), report)
    elif report is None:
        yield from act(lambda now: node.cancel(request_id, now))
    return axis.fresh_statusword((yield from current_time()))


def may_be_enabled(axis: Axis) -> bool:
    """Return whether the last controlword enables operation, or may do so: an unconfirmed one may have arrived."""
    return any(map(enables_operation, axis.node.may_hold(objects.CONTROLWORD)))


def _late_state(axis: Axis) -> Procedure[State]:
    """Wait for a drive that may be on its way to Operation enabled, at most `reaction_time`; return its state.

    A drive that is still in its state then is told to stay there. It obeys in order: the command to enable is not its last one.
    """
    goal = "operation enabled, as commanded"
    yield from ask_for_time(axis.reaction_time + SECOND)
    try:
        word = yield from wait_for_statusword(
            axis, lambda word: state_of(word) in POWERED, axis.reaction_time, goal, accept_fault=True, looks=False
        )
    except StepTimeoutError:
        yield from insist(axis, int(STAYS.get(axis.state, Command.DISABLE_VOLTAGE)))
        return (yield from _next_state(axis))  # it may have been enabled just before
    return state_of(word)


def _next_state(axis: Axis) -> Procedure[State]:
    """Return the state that the drive shows next; raise StepTimeoutError if it shows none for `reaction_time`."""
    yield from ask_for_time(axis.settings.reaction_time + SECOND)
    word = yield from wait_for_statusword(
        axis,
        lambda word: state_of(word) is not State.UNKNOWN,
        axis.settings.reaction_time,
        "a statusword that shows a state",
        accept_fault=True,
        looks=False,
    )
    return state_of(word)


def _halt_word(axis: Axis) -> Procedure[int]:
    """Return the word that halts a drive which shows Operation enabled.

    Bit 8 comes with the command to enable. A drive that another stop, or another master, has just told to leave Operation
    enabled, and that has not shown it yet, would be led back by it: it gets that word once more.
    """
    told_at, word = axis.commanded_at, axis.commanded
    foreign = last_foreign(axis, objects.CONTROLWORD)
    if foreign is not None and foreign.time >= (told_at or 0) and not enables_operation(foreign.value):
        assert isinstance(foreign.value, int)
        if (yield from current_time()) - foreign.time < axis.reaction_time:
            return foreign.value & COMMAND_BITS & ~ControlBit.FAULT_RESET
    # A write past the axis that was not confirmed may have come behind it
    is_last = not any(map(enables_operation, axis.node.may_hold(objects.CONTROLWORD) - {axis.controlword}))
    if told_at is not None and is_last and word & COMMAND_BITS in STAYS.values():
        now = yield from current_time()
        if now - told_at < axis.reaction_time:
            return word
    is_enabling = axis.controlword & 0x0F == Command.ENABLE_OPERATION
    return (axis.controlword if is_enabling else int(Command.ENABLE_OPERATION)) | ControlBit.HALT


def halt_after(axis: Axis, cause: BaseException, forget: Callable[[], Procedure[None]] | None = None) -> Procedure[None]:
    """Halt as the clean-up after `cause`. A halt that fails is noted in `cause`, or raised if `cause` is Cancelled.

    forget: makes the drive's target 0, see `halt_and_forget`. After TakenOverError the other command halts, and only this is
    done.
    """
    if axis.occupancy.is_inside and axis.occupancy.occupant is not None:
        axis.occupancy.occupant.is_ending = True
    try:
        if isinstance(cause, TakenOverError):
            if forget is not None:
                yield from forget()
        elif forget is not None:
            yield from halt_and_forget(axis, forget)
        else:
            yield from halt(axis)
    except ProcedureError as error:
        if isinstance(cause, Cancelled):
            raise
        cause.add_note((yield from _account(axis, error)))


def _account(axis: Axis, error: ProcedureError) -> Procedure[str]:
    """Return what is to be said of a halt that failed: whether the drive has its halt bit all the same, and power."""
    failed = f"and the halt of {name_of(axis)} failed: {error}"
    try:
        # the controlword would be read behind the late answer to the halt only, also of a drive that is silent
        statusword = yield from read_number(axis.node, objects.STATUSWORD)
        word = yield from read_number(axis.node, objects.CONTROLWORD)
    except ProcedureError:
        return failed  # it is silent: nothing is known
    if statusword is None:
        return failed
    state = state_of(statusword)
    power = f"{'it still has power' if state in POWERED else 'it has no power'} ({state})"
    if isinstance(error, SdoTransferError) and word is not None and word & ControlBit.HALT:
        return f"and {name_of(axis)} has its halt bit (controlword 0x{word:04X}), which it did not confirm; {power}"
    return f"{failed}; {power}"


def halt_and_forget(axis: Axis, forget: Callable[[], Procedure[None]]) -> Procedure[None]:
    """Halt; then `forget` makes the drive's target 0. A drive that does not obey bit 8 gets it all the same, and is halted by it.

    Raises as `halt` if it moves even then.
    """
    try:
        yield from halt(axis)
    except TakenOverError:
        yield from forget()
        raise
    except ProcedureError as failed:
        yield from forget()
        yield from halt(axis)
        if is_loss(failed):
            raise  # it stands now, but not because it was halted
    else:
        yield from forget()


def coast_down(axis: Axis) -> Procedure[None]:
    """Wait until the position (0x6064) of a drive without power stays: its axis may coast. Nothing is sent.

    Without a position, no power counts as standstill. Raises StepTimeoutError as `halt`, if the axis does not get slower.
    """
    yield from _wait_for_standstill(axis)


def _wait_for_standstill(axis: Axis) -> Procedure[None]:
    timeout = axis.settings.reaction_time + axis.settings.halt_time
    began = yield from current_time()
    before: float | None = None
    left = OVERRULED
    while True:
        yield from ask_for_time(timeout + SECOND)  # as long as the drive answers and slows down
        judge = _Standstill(axis, began, minds_others=left > 0)
        try:
            if (yield from judge.watch.until(judge.judge, timeout)):
                return
        except StepTimeoutError as failed:
            if judge.may_obey_late:
                continue
            word = yield from _other_word(axis)
            if word is None or not left:
                if before is None:
                    before = judge.top_speed  # not the speed at the beginning: the drive may just have accelerated
                now = yield from _speed(axis)
                if before is not None and now is not None and (yield from _has_slowed(axis, before, now)):
                    before = now
                    continue
                if word is None or not isinstance(failed, DriveTimeoutError):
                    raise
                view = replace(view_of(axis), controlword=word)
                text = f"did not reach {judge.watch.goal} within {timeout / SECOND:g} s"
                raise DriveTimeoutError(axis, text, view=view) from failed
        left -= 1
        yield from _send_halt(axis)


def _other_word(axis: Axis) -> Procedure[int | None]:
    """Return the controlword of a drive that lets it run; None if it halts it, or takes its power, or if it cannot be told."""
    if axis.state is not State.OPERATION_ENABLED or axis.node.rpdo_of(objects.CONTROLWORD) is not None:
        return None  # some drives do not show in 0x6040 what came by PDO
    word = yield from read_number(axis.node, objects.CONTROLWORD)
    return word if word is not None and _runs(word) else None


def _runs(controlword: int) -> bool:
    """Return whether a controlword lets an enabled drive run. Against one that takes the power no halt is sent: it comes with
    the command to enable."""
    return enables_operation(controlword) and not controlword & ControlBit.HALT


class _Standstill:
    """Judges, during a halt, whether the drive stands.

    Two things have to show it: the status bits (bit 10 if the mode has it, Schunk's bit 8), and a position that does not change.
    A drive that stands may still obey an older command and then move. So a drive that was just started is believed once its bits
    have shown that it moves, or `reaction_time` after its start. A drive without a position is believed once its bits have shown
    that it moves, or `reaction_time` after the halt: bit 10 may be left from before (as "target velocity reached").
    """

    def __init__(self, axis: Axis, began: Time, *, minds_others: bool) -> None:
        """began: when the drive was told to halt. minds_others: see `judge`."""
        reads = {
            objects.MODES_OF_OPERATION_DISPLAY: FRESH,
            objects.POSITION_ACTUAL_VALUE: STANDSTILL_LOOK,
            objects.VELOCITY_ACTUAL_VALUE: FRESH,
        }
        if axis.mode == Mode.VELOCITY:  # frequency converters need not have a position
            reads[objects.VL_VELOCITY_ACTUAL_VALUE] = FRESH
        present = {mux: pause for mux, pause in reads.items() if mux in axis.node.dictionary}
        self.watch: DriveWait[bool] = DriveWait(axis, _WITH_POWER, accept_fault=True, reads=present, looks=False)
        self.top_speed: float | None = None  # the highest speed seen, in the drive's unit
        self.may_obey_late = False  # its bits show that it stands, and it is too soon to believe them
        self._axis = axis
        self._began = began
        self._minds_others = minds_others
        self._by_rpdo = axis.node.rpdo_of(objects.CONTROLWORD) is not None
        self._is_schunk = axis.settings.homing is HomingStyle.SCHUNK
        self._was_moving = False  # as its bits showed
        self._looked_at: Time = -NEVER
        self._positions: deque[int] = deque(maxlen=MANY_LOOKS)

    def judge(self, statusword: int, heard_at: Time) -> bool | None:
        """Return True if the drive stands, False if the halt has to be sent again, None if it is not certain."""
        self._look()
        self.may_obey_late = False
        state = state_of(statusword)
        if state is State.UNKNOWN:
            return None  # the next statusword will show a state
        has_position = (
            objects.POSITION_ACTUAL_VALUE in self._axis.node.dictionary
            and self.watch.refusal(objects.POSITION_ACTUAL_VALUE) is None
        )
        self.watch.goal = _WITH_POWER if state in POWERED else _WITHOUT_POWER
        if state not in POWERED:
            return not has_position or self._is_at_one_place() or None
        if self._minds_others and state is State.OPERATION_ENABLED and (self._is_overruled() or self._is_unheard()):
            return False
        if self._is_schunk:
            stands = not statusword & StatusBit.MANUFACTURER_8
        elif not self._knows(objects.MODES_OF_OPERATION_DISPLAY):
            return None  # the meaning of bit 10 is not known yet
        elif has_position and (state is not State.OPERATION_ENABLED or self._axis.mode not in _SHOWS_STANDSTILL):
            return self._is_at_one_place() or None
        elif self._axis.mode == Mode.VELOCITY and self.watch.heard(objects.VL_VELOCITY_ACTUAL_VALUE) is not None:
            stands = self._axis.node.values.store.get(objects.VL_VELOCITY_ACTUAL_VALUE) == 0  # vl has no bit for it
        else:
            stands = bool(statusword & StatusBit.TARGET_REACHED)
        if not stands:
            self._was_moving = True
            return None
        since = self._axis.started_at if has_position else self._began
        has_obeyed = self._was_moving or heard_at - since >= self._axis.reaction_time
        self.may_obey_late = not has_obeyed and not has_position
        return (has_obeyed and (not has_position or self._is_at_one_place())) or None

    def _is_overruled(self) -> bool:
        """Return whether a controlword of another master that lets the drive run was heard since ours."""
        heard, ours = last_foreign(self._axis, objects.CONTROLWORD), self._axis.commanded_at
        if heard is None or ours is None or heard.time < ours:
            return False
        return isinstance(heard.value, int) and _runs(heard.value)

    def _is_unheard(self) -> bool:
        """Return whether the halt went by an RPDO to a node that has turned out to hear none: it was not Operational."""
        return self._by_rpdo and self._axis.node.rpdo_of(objects.CONTROLWORD) is None

    def _knows(self, mux: Mux) -> bool:
        """Return whether the object was heard, or will never be."""
        return self.watch.heard(mux) is not None or self.watch.refusal(mux) is not None

    def _look(self) -> None:
        """Take note of the drive's position and speed."""
        if self.watch.heard(objects.VELOCITY_ACTUAL_VALUE) is not None:
            self.top_speed = max(self.top_speed or 0.0, abs(self._axis.velocity_counts or 0))
        heard_at = self.watch.heard(objects.POSITION_ACTUAL_VALUE)
        position = self._axis.position_counts
        if heard_at is None or position is None or heard_at - self._looked_at < STANDSTILL_LOOK:
            return
        if self._positions and (objects.VELOCITY_ACTUAL_VALUE not in self._axis.node.heard_at):
            speed = abs(position - self._positions[-1]) * SECOND / (heard_at - self._looked_at)
            self.top_speed = max(self.top_speed or 0.0, speed)
        self._looked_at = heard_at
        self._positions.append(position)

    def _is_at_one_place(self) -> bool:
        """Return whether the position stays: it changed by at most one count since the last look, or it goes to and fro, as a
        fine encoder's does while the drive holds its place, so that the steps of MANY_LOOKS looks cancel out."""
        steps = [after - before for before, after in pairwise(self._positions)]
        if steps and abs(steps[-1]) <= 1:
            return True
        return len(self._positions) == MANY_LOOKS and 3 * abs(sum(steps)) < sum(map(abs, steps))


def _speed(axis: Axis) -> Procedure[float | None]:
    """Return the drive's present speed, in its own unit; None if it does not tell."""
    node = axis.node
    now = yield from current_time()
    velocity = node.fresh(objects.VELOCITY_ACTUAL_VALUE, now, STANDSTILL_LOOK)
    if velocity is None:
        velocity = yield from read_if_present(node, objects.VELOCITY_ACTUAL_VALUE)
    if isinstance(velocity, int):
        return float(abs(velocity))
    before = yield from read_if_present(node, objects.POSITION_ACTUAL_VALUE)
    began = yield from current_time()
    if not isinstance(before, int):
        return None
    yield from sleep(STANDSTILL_LOOK)
    after = yield from read_if_present(node, objects.POSITION_ACTUAL_VALUE)
    now = yield from current_time()
    return abs(after - before) * SECOND / (now - began) if isinstance(after, int) else None


def _has_slowed(axis: Axis, before: float, now: float) -> Procedure[bool]:
    """Return whether the drive is clearly slower than a step ago."""
    loss = _SLOWER * before
    ramp = yield from halt_ramp(axis)
    if ramp is not None:
        loss = min(loss, _OF_ITS_RAMP * ramp * axis.settings.halt_time / SECOND)
    return before - now > loss


def halt_ramp(axis: Axis) -> Procedure[int | None]:
    """Return the deceleration with which the drive halts (0x605D), in its own unit per second; None if it does not tell."""
    node = axis.node
    option = yield from read_if_present(node, objects.HALT_OPTION_CODE)
    keys = {1: (objects.PROFILE_DECELERATION, objects.PROFILE_ACCELERATION), 2: (objects.QUICK_STOP_DECELERATION,)}
    for key in keys.get(option if isinstance(option, int) else 1, ()):
        rate = yield from read_if_present(node, key)
        if isinstance(rate, int) and rate > 0:
            return rate
    return None
