"""`select_motionless_mode`: before a drive gets power, a mode in which power alone moves nothing."""

from __future__ import annotations

from typing import Final

from canopen_proto.abort import AbortOrigin
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.exclusive_motion import moves
from canopen_proto.drives.axis.failures import ModeUnsupportedError, as_drive_errors
from canopen_proto.drives.axis.state import set_mode
from canopen_proto.drives.axis.synchronous import align_position, clear_offsets
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode, mode_name
from canopen_proto.procedures.objects import read_int
from canopen_proto.procedures.steps import Procedure, SdoTransferError

_MOTIONLESS: Final = (Mode.INTERPOLATED_POSITION, Mode.HOMING, Mode.PROFILE_POSITION)
"""Modes in which a drive stands until bit 4 of the controlword rises."""


@moves
@as_drive_errors
def select_motionless_mode(axis: Axis) -> Procedure[None]:
    """Select a mode in which power alone moves nothing: ip, hm or pp, and the present mode if it is one of them.

    In these modes a motion begins when bit 4 of the controlword rises. A drive that has none of them, but csp, first gets its
    actual position as the set-point (0x607A; offsets 0), which it holds. Raises ModeUnsupportedError if it has no csp either.
    """
    shown = yield from read_int(axis.node, objects.MODES_OF_OPERATION_DISPLAY)
    for mode in sorted(_MOTIONLESS, key=lambda each: each != shown):
        if (yield from takes(axis, mode)):
            return
    csp = Mode.CYCLIC_SYNCHRONOUS_POSITION
    if objects.TARGET_POSITION in axis.node.dictionary:
        axis.set_points.select(csp)
        yield from align_position(axis)
        yield from clear_offsets(axis, csp)
        if (yield from takes(axis, csp)):
            yield from align_position(axis)
            return
    raise ModeUnsupportedError(
        axis,
        f"is in {mode_name(shown)}, in which power alone may move it, and accepts neither "
        f"{', '.join(mode_name(mode) for mode in _MOTIONLESS)} nor {mode_name(csp)}",
        remedy="look at its modes (0x6502), and enable it by hand once you know its targets",
    )


def takes(axis: Axis, mode: Mode) -> Procedure[bool]:
    """Select a mode; return whether the drive took it."""
    try:
        yield from set_mode(axis, mode)
    except ModeUnsupportedError:
        return False
    except SdoTransferError as failed:
        if failed.origin is not AbortOrigin.PEER:
            raise
        return False
    return True
