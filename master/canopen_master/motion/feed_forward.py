"""`FeedForward`: what one joint is told beside its position set-points, so that its controller need not wait for an error.

    csp    0x60B1, velocity offset, and 0x60B2, torque offset, if an RPDO that is exchanged with the joint maps them
    ip     the velocity of the data record, in sub-modes that have one (canopen_proto.drives.axis.sub_modes)

The velocity goes along by itself. A torque goes along only if the caller gives one: nobody else knows the masses. At rest,
the velocity is 0; a torque against gravity stays. A drive whose velocity unit is not known is told no velocity.

Source: IEC 61800-7-201 (CiA 402-2): cyclic synchronous position mode, interpolated position mode.
"""

from __future__ import annotations

from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.axis_node import rpdos_with
from canopen_proto.drives.cia402 import objects
from canopen_proto.multiplexer import Mux


class FeedForward:
    """The set-points of one joint with what goes along; see this module's text. takes_torque: whether an RPDO carries 0x60B2.

    torque: the one that was put last.
    """

    __slots__ = ("_axis", "_has_offsets", "_takes_velocity", "takes_torque", "torque")

    def __init__(self, axis: Axis) -> None:
        """axis: its PDOs are defined already."""
        self._axis = axis
        self.takes_torque = is_carried(axis, objects.TORQUE_OFFSET)
        self._takes_velocity = is_carried(axis, objects.VELOCITY_OFFSET) and axis.scale.velocity_unit is not None
        self.torque = 0.0
        self._has_offsets = self._takes_velocity or self.takes_torque

    def put(self, position: float, velocity: float, torque: float = 0.0) -> None:
        """Set what the next RPDO takes along. Raises LocalProtocolError, ValueRangeError for values that do not fit. position: in
        the user's unit. velocity: per second. torque: a share of the rated torque."""
        self.torque = torque
        self._axis.set_points.set_position(position, velocity)
        if self._has_offsets:
            self._axis.set_points.set_offsets(velocity=velocity if self._takes_velocity else 0.0, torque=torque)

    def clear(self) -> None:
        """Feed nothing forward from now on."""
        if self._has_offsets:
            self._axis.set_points.set_offsets()


def is_carried(axis: Axis, mux: Mux) -> bool:
    """Return whether an RPDO that is exchanged with the drive carries an object."""
    return bool(rpdos_with(axis.node, (mux,)))
