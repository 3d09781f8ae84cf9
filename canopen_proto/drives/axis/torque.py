"""Profile torque mode (tq): the drive pushes with a torque, and moves as that makes it.

Nothing in this mode says where the axis goes, or how fast. So a torque is applied for a bounded time, by an axis whose speed has
a limit, and the master watches position and speed meanwhile (bounds.py). Order:

    1. the drive is halted, and stands. 0x6071 = the torque that holds it (0 without power); 0x6087, if a slope is given
    2. mode tq, enable, the end of the halt: nothing changes yet
    3. 0x6071 = the torque, to which the drive goes by its slope
    4. after the time: halt (bit 8) until it stands, then 0x6071 = 0

A limit that is left, a fault, a lost node, another mode or a cancel end it earlier, in the same way. Bit 8 may only take the
torque away in this mode. A drive that moves on after it gets a quick stop, and most drives have no power then (halting.py).

Source: IEC 61800-7-201 (CiA 402-2), profile torque mode; objects and bit 8 as in Nanotec's manual (PD2-C), the rest from
memory.
"""

from __future__ import annotations

from canopen_proto.drives.axis.axis import OBEYED, Axis
from canopen_proto.drives.axis.bounds import bounds_of
from canopen_proto.drives.axis.controlword import bring, command
from canopen_proto.drives.axis.exclusive_motion import moves
from canopen_proto.drives.axis.failures import DriveError, LimitReachedError, as_drive_errors
from canopen_proto.drives.axis.halting import halt, halt_after, halt_and_forget
from canopen_proto.drives.axis.state import enable, require_mode, set_mode
from canopen_proto.drives.axis.synchronous import holding_torque
from canopen_proto.drives.axis.watching import POLL_INTERVAL, DriveWait
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import Command, State
from canopen_proto.machine import LocalProtocolError, Time
from canopen_proto.procedures.objects import read_if_present, write
from canopen_proto.procedures.steps import Cancelled, Procedure, current_time


@moves
@as_drive_errors
def apply_torque(
    axis: Axis, torque: float, duration: Time, *, slope: float | None = None, max_speed: float | None = None
) -> Procedure[float]:
    """Let the drive push with a torque for a time, in profile torque mode, and halt it then. Return the torque that it was given.

    torque: a share of the rated torque (0x6076), rounded to thousandths of it. duration: ns. slope: 0x6087, shares of the rated
    torque per second; None: the drive's own. max_speed: see `bounds_of`; without any limit of the speed nothing is done. **A load
    that the brake holds falls until the torque has grown**, if the drive had no power before.

    Raises LimitReachedError if a limit of position or speed is left, or the torque is more than 0x6072; DriveError if the torque
    is less than a thousandth, the slope cannot be written, or nothing limits the speed; ValueRangeError; ReferenceLostError,
    ModeUnsupportedError, DriveInFaultError, StateLostError, ModeLostError, DriveLostError, StepTimeoutError, SdoTransferError.
    The drive is halted if this fails or is cancelled, once anything was written: the checks before stop no motion that somebody
    else has begun.
    """
    if duration < 0:
        raise LocalProtocolError(f"duration must not be below 0; it is {duration!r}")
    target = axis.scale.torque_to_wire(torque)
    if torque and not target:
        raise DriveError(axis, f"gets no torque of {torque:g}", reason="0x6071 counts thousandths of the rated torque")
    steepness = None if slope is None else _slope_number(axis, slope)
    yield from require_mode(axis, Mode.TORQUE)
    bounds = yield from bounds_of(axis, max_speed)
    most = yield from read_if_present(axis.node, objects.MAX_TORQUE)
    if isinstance(most, int) and abs(target) > most:
        raise LimitReachedError(
            axis, f"was given no torque of {torque:g}", reason=f"0x6072 allows {most / 1000:g} of the rated torque", remedy="less"
        )
    axis.node.encode(objects.TARGET_TORQUE, target)  # now: nothing may fail once the drive has power
    yield from halt(axis)
    held = axis.scale.torque_to_wire((yield from holding_torque(axis)))
    yield from write(axis.node, objects.TARGET_TORQUE, held)
    if steepness is not None:
        yield from write(axis.node, objects.TORQUE_SLOPE, steepness)
    try:  # from here on a load may move: mode and power alone hold it with `held` only
        yield from set_mode(axis, Mode.TORQUE)
        yield from enable(axis)
        yield from command(axis, int(Command.ENABLE_OPERATION))
        axis.started_at = OBEYED  # no bit starts a motion here
        yield from bring(axis, objects.TARGET_TORQUE, target)
        end = (yield from current_time()) + duration
        reads = dict.fromkeys(bounds.watched, POLL_INTERVAL)
        watch: DriveWait[bool] = DriveWait(
            axis, "the end of its torque", mode=Mode.TORQUE, stays=State.OPERATION_ENABLED, reads=reads
        )

        def judge(statusword: int, heard_at: Time) -> bool | None:
            excess = bounds.judge()
            if excess:
                raise LimitReachedError(axis, excess, remedy="less torque, or another limit")
            return True if heard_at >= end else None

        yield from watch.until(judge, duration + axis.settings.state_timeout)
    except (Cancelled, Exception) as cause:
        yield from halt_after(axis, cause, lambda: _forget(axis))
        raise
    yield from halt_and_forget(axis, lambda: _forget(axis))
    return axis.settings.direction * target / 1000


def _slope_number(axis: Axis, slope: float) -> int:
    """Return 0x6087 for a slope. One of less than a thousandth per second is refused: some drives take 0 for none."""
    number = round(slope * 1000)
    if number <= 0:
        raise DriveError(axis, f"gets no slope of {slope:g}", reason="0x6087 counts thousandths of the rated torque per second")
    if objects.TORQUE_SLOPE not in axis.node.dictionary:
        raise DriveError(axis, f"gets no slope of {slope:g}", reason="it has no torque slope (0x6087)", remedy="no slope")
    axis.node.encode(objects.TORQUE_SLOPE, number)
    return number


def _forget(axis: Axis) -> Procedure[None]:
    """Set the target to 0, so that no later command finds the old one."""
    return bring(axis, objects.TARGET_TORQUE, 0)
