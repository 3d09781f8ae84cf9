"""Interpolated position mode (ip): its start, its sub-modes, and the drive's buffer of data records (0x60C4).

These objects are written, as far as the dictionary has them; the rest is as in synchronous.py:

    60C0       the sub-mode, if the drive has another one
    60C3       SYNC (:01 = 0), at each one (:02 = 1), if the drive has something else
    60C4:06    0: the buffer is cleared, and takes nothing    only with an `InterpolationBuffer`
    60C4:03    0 FIFO, 1 ring                                 so
    60C4:05    the size of a record                           so, and only if it is given
    60C4:06    1: the buffer takes records                    so
    60C2       the period
    60C1       the actual position, as a record
    6040       bit 4 rises; then the buffer is cleared and filled, see `InterpolationBuffer`

Without an InterpolationBuffer the buffer is left as it is, which suits most drives: they take the record of each SYNC.

Source: IEC 61800-7-201 (CiA 402-2), interpolated position mode; the order of writes as other masters have it.
"""

from __future__ import annotations

from dataclasses import dataclass

from canopen_proto.abort import AbortOrigin
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.exclusive_motion import moves
from canopen_proto.drives.axis.failures import DriveError, ModeUnsupportedError, as_drive_errors, require_reference
from canopen_proto.drives.axis.halting import halt_after
from canopen_proto.drives.axis.sub_modes import LINEAR, SubMode
from canopen_proto.drives.axis.synchronous import align_position, follow, prepare, require_carried, write_record
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.machine import LocalProtocolError, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.procedures.objects import read_if_present, write
from canopen_proto.procedures.steps import Cancelled, Procedure, SdoTransferError


@dataclass(frozen=True, slots=True)
class InterpolationBuffer:
    """How the drive's buffer of data records (0x60C4) is used.

    lead: records that wait in the drive: so many cycles may a set-point come late before the axis stops. The axis is as many
    cycles further behind (`Following.begin`: lag=LAG + lead). is_ring: a ring, in which a record that finds no place drives out
    the oldest one; else a FIFO, in which it is lost. record_size: written to 0x60C4:05; None: not written, since makers count
    differently: a linear record is 1 with Kollmorgen, and 4 (bytes) with Nanotec and Novanta.
    """

    lead: int = 1
    is_ring: bool = False
    record_size: int | None = None

    def __post_init__(self) -> None:
        if self.lead < 0:
            raise LocalProtocolError(f"lead must be 0 or more; it is {self.lead}")


@moves
@as_drive_errors
def start_interpolation(
    axis: Axis,
    cycle_time: Time,
    *,
    sends_itself: bool = False,
    sub_mode: SubMode = LINEAR,
    buffer: InterpolationBuffer | None = None,
) -> Procedure[float]:
    """Make the drive follow one set-point per SYNC in interpolated position mode; return the position where it starts.

    cycle_time: ns between two SYNCs. sends_itself: the caller sends the set-points by a PDO of its own; else RPDOs that the node
    exchanges must carry all objects of a record. sub_mode: how a record is made (sub_modes.py). buffer: how the drive's buffer is
    used; None: it is left as it is. The actual position is read and becomes the first set-point, so that nothing jumps. Raises
    ReferenceLostError, ModeUnsupportedError (also if the drive refuses the sub-mode), DriveInFaultError, StateLostError,
    ModeLostError, DriveLostError, StepTimeoutError; DriveError if no RPDO carries set-points, or none is sent, or the buffer is
    too small. The drive is halted if this is cancelled.
    """
    require_reference(axis)
    require_carried(axis, sub_mode.objects, sends_itself)
    axis.set_points.select_record(sub_mode, cycle_time)
    if buffer is not None:
        yield from _check_size(axis, buffer)

    def align(axis: Axis) -> Procedure[float]:
        yield from _set_up(axis, sub_mode, buffer)
        return (yield from align_position(axis))

    yield from prepare(axis, Mode.INTERPOLATED_POSITION, cycle_time, align)
    start = yield from follow(axis, Mode.INTERPOLATED_POSITION, sub_mode.objects, align_position)
    if buffer is not None:
        try:
            yield from _fill(axis, buffer)
        except (Cancelled, Exception) as cause:
            yield from halt_after(axis, cause)
            raise
    return start


def _check_size(axis: Axis, buffer: InterpolationBuffer) -> Procedure[None]:
    """Raise DriveError if the drive has no buffer, or too small a one."""
    told = yield from read_if_present(axis.node, objects.MAXIMUM_BUFFER_SIZE)
    size = told if isinstance(told, int) else 0
    if size <= buffer.lead:
        seen = f"its buffer holds {size} (0x60C4:01)" if size else "it has no buffer (0x60C4)"
        raise DriveError(axis, f"cannot keep {buffer.lead} records waiting", reason=seen, remedy="a smaller lead, or no buffer")


def _set_up(axis: Axis, sub_mode: SubMode, buffer: InterpolationBuffer | None) -> Procedure[None]:
    """Give the drive its sub-mode and its buffer. It stands, and is halted."""
    if buffer is not None:
        yield from write(axis.node, objects.BUFFER_CLEAR, 0)
    try:
        yield from _ensure(axis, objects.INTERPOLATION_SUB_MODE_SELECT, sub_mode.number)
    except SdoTransferError as failed:
        if failed.origin is not AbortOrigin.PEER:
            raise
        raise ModeUnsupportedError(
            axis,
            f"refused interpolation sub-mode {sub_mode.number} (0x60C0): {failed}",
            remedy="the sub-mode that its manual names, as `sub_mode`",
        ) from failed
    yield from _ensure(axis, objects.SYNCHRONIZE_ON_GROUP, 0)
    yield from _ensure(axis, objects.SYNC_EVERY_N_EVENTS, 1)
    if buffer is not None:
        yield from write(axis.node, objects.BUFFER_ORGANISATION, int(buffer.is_ring))
        if buffer.record_size is not None:
            yield from write(axis.node, objects.SIZE_OF_DATA_RECORD, buffer.record_size)
        yield from write(axis.node, objects.BUFFER_CLEAR, 1)


def _ensure(axis: Axis, mux: Mux, value: int) -> Procedure[None]:
    """Write a value, unless the drive lacks the object, or has the value already: many drives have one value only."""
    present = yield from read_if_present(axis.node, mux)
    if present is not None and present != value:
        yield from write(axis.node, mux, value)


def _fill(axis: Axis, buffer: InterpolationBuffer) -> Procedure[None]:
    """Empty the buffer, in which the records of the start wait, and put `lead` records into it. The drive stands meanwhile."""
    yield from write(axis.node, objects.BUFFER_CLEAR, 0)
    yield from write(axis.node, objects.BUFFER_CLEAR, 1)
    for _ in range(buffer.lead):
        yield from write_record(axis)
