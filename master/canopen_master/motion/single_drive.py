"""Procedures for one drive that stands alone: look at it, and let it move with power for that long only."""

from __future__ import annotations

from contextlib import suppress
from typing import TypeVar

from canopen_master.errors import NodeIsNoDriveError
from canopen_proto.drives.axis import halt, shut_down
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.axis_node import AxisNode
from canopen_proto.drives.axis.reasons import look_at
from canopen_proto.drives.axis.settings import OPEN_SETTINGS, AxisSettings
from canopen_proto.drives.axis.units import read_number
from canopen_proto.drives.axis.view import DriveView
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.axes import axis_of
from canopen_proto.multiplexer import index_of
from canopen_proto.procedures.objects import read_if_present, write
from canopen_proto.procedures.steps import Cancelled, Procedure, ProcedureError

T = TypeVar("T")


def look_at_drive(node: AxisNode, settings: AxisSettings = OPEN_SETTINGS) -> Procedure[DriveView]:
    """Return what a drive shows (see `look_at`). Raises NodeIsNoDriveError if it has no statusword."""
    view = yield from look_at(node, settings)
    if view is None:
        raise _no_drive(node)
    return view


def require_drive(node: AxisNode) -> Procedure[None]:
    """Raise NodeIsNoDriveError if a node has no statusword."""
    if (yield from read_number(node, objects.STATUSWORD)) is None:
        raise _no_drive(node)


def _no_drive(node: AxisNode) -> NodeIsNoDriveError:
    statusword = node.on_device(objects.STATUSWORD)
    return NodeIsNoDriveError(node.node_id, axis_of(statusword) or 0, index_of(statusword))


def ends_unpowered(axis: Axis, procedure: Procedure[T]) -> Procedure[T]:
    """Run a procedure that gives the drive power, and take the power away at its end, also if it fails or is cancelled.

    If a stop has taken it over, the power goes once the drive stands, or when it does not brake.
    """
    try:
        result = yield from procedure
    except (Cancelled, Exception) as cause:
        try:
            if axis.occupancy.stops:  # that of somebody else: it may brake yet
                with suppress(ProcedureError):
                    yield from halt(axis)
            yield from shut_down(axis)
        except ProcedureError as error:
            if isinstance(cause, Cancelled):
                raise
            cause.add_note(f"and it may still have power: {error}")
        raise
    yield from shut_down(axis)
    return result


def at_profile_velocity(axis: Axis, speed: float, procedure: Procedure[T]) -> Procedure[T]:
    """Run a procedure with a profile velocity (0x6081), and write the drive's own back. Where its unit is not known, that stays.

    speed: in the axis's unit per second.
    """
    node = axis.node
    own = yield from read_if_present(node, objects.PROFILE_VELOCITY)
    if axis.scale.velocity_unit is None or not isinstance(own, int):
        return (yield from procedure)
    yield from write(node, objects.PROFILE_VELOCITY, max(1, axis.scale.speed_to_wire(speed)))
    try:
        result = yield from procedure
    except (Cancelled, Exception) as cause:
        try:
            yield from write(node, objects.PROFILE_VELOCITY, own)
        except ProcedureError as error:
            if not isinstance(cause, Cancelled):
                cause.add_note(f"and its profile velocity (0x6081) was {own} before, and is slow now: {error}")
        raise
    yield from write(node, objects.PROFILE_VELOCITY, own)
    return result
