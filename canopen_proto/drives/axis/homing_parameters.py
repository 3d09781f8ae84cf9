"""The numbers that a drive is given before it homes.

    homing_method         0x6098      checked first, see below
    homing_speed          0x6099:01   fast, to the switch
    homing_zero_speed     0x6099:02   slow, over the edge and to the index pulse
    homing_acceleration   0x609A
    home_position         0x607C      the position that the home point gets

Only what the settings name is written; the drive's own values hold for the rest. Speeds go in the drive's velocity unit, the
acceleration in its acceleration unit, both rounded down.

**The method is checked before it is sent.** A drive that has 0x60E3 lists its methods there. Of a drive without that list, any
method in the standard's table is accepted, and any manufacturer's (below 0). 36, homing by a touch probe, is in few drives: it
has to be in the list.

**Home position.** Nearly all drives show 0x607C as their position at the home point, so that the zero lies 0x607C before it. The
standard can be read with the other sign. `home_offset_reversed` is for drives that do so; `check_home_position` finds them.

Source: IEC 61800-7-201 (CiA 402-2), 11 (the clause as KEB's manual of the Combivert F6 cites it), homing mode; 60E3h from memory;
as the manuals of six makers have it.
"""

from __future__ import annotations

from typing import Final

from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.axis_node import AxisNode
from canopen_proto.drives.axis.failures import HomingError, ModeUnsupportedError
from canopen_proto.drives.axis.identity import learn_units
from canopen_proto.drives.axis.settings import HomingStyle
from canopen_proto.drives.axis.units import read_number
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.homing_methods import HOMING_METHODS, NO_HOMING, describe_homing, homing_method_name
from canopen_proto.machine import LocalProtocolError
from canopen_proto.multiplexer import Mux
from canopen_proto.procedures.objects import read_int, write
from canopen_proto.procedures.steps import Procedure

_LIST: Final = "canopen home --list NODE shows those that it has"


def read_homing_methods(node: AxisNode) -> Procedure[tuple[int, ...] | None]:
    """Read the homing methods that a drive lists (0x60E3), by SDO, by number; None if it has no list. A 0 is no method, and a
    list of zeros is no list."""
    count = yield from read_number(node, objects.SUPPORTED_HOMING_METHODS)
    if not count:
        return None
    found = []
    for number in range(1, count + 1):
        method = yield from read_number(node, Mux(objects.SUPPORTED_HOMING_METHODS + number), signed=True)
        if method:
            found.append(method)
    return tuple(found) or None


def check_homing_method(axis: Axis) -> Procedure[None]:
    """Raise ModeUnsupportedError if the drive cannot home by the method of its settings. Nothing was written then."""
    method = axis.settings.homing_method
    if method is None or axis.settings.homing is HomingStyle.SCHUNK:
        return
    listed = None if method == NO_HOMING else (yield from read_homing_methods(axis.node))
    if method == NO_HOMING:
        reason = "0 stands for a drive that needs no homing, or for which no method was selected"
    elif listed is not None and method not in listed:
        reason = f"its list (0x60E3) has {', '.join(map(str, sorted(listed)))}"
    elif listed is None and method >= 0 and method not in HOMING_METHODS:
        reason = "it has no list of its methods (0x60E3), and the standard's table has no picture of this one"
    else:
        return
    failed = f"does not home by {homing_method_name(method)}"
    raise ModeUnsupportedError(axis, failed, reason=f"{reason}; nothing was sent", remedy=f"another method: {_LIST}")


def write_homing_parameters(axis: Axis) -> Procedure[None]:
    """Write what the settings say of the homing. The method was checked.

    Raises LocalProtocolError for a speed or an acceleration whose number on the wire would be 0, SdoTransferError.
    """
    settings, node = axis.settings, axis.node
    rates = {
        objects.HOMING_SPEED_SEARCH_SWITCH: ("homing_speed", settings.homing_speed),
        objects.HOMING_SPEED_SEARCH_ZERO: ("homing_zero_speed", settings.homing_zero_speed),
        objects.HOMING_ACCELERATION: ("homing_acceleration", settings.homing_acceleration),
    }
    if any(rate is not None for _, rate in rates.values()):
        yield from learn_units(axis)
    for key, (name, rate) in rates.items():
        if rate is not None:
            convert = axis.scale.rate_to_wire if key == objects.HOMING_ACCELERATION else axis.scale.speed_to_wire
            number = convert(rate)
            if not number:
                raise LocalProtocolError(f"{name} = {rate:g} would be 0 in the units of drive {node.node_id}; make it higher")
            yield from write(node, key, number)
    if settings.home_position is not None:
        yield from write(node, objects.HOME_OFFSET, _home_offset(axis, settings.home_position))
    if settings.homing_method is not None:
        yield from write(node, objects.HOMING_METHOD, settings.homing_method)


def _home_offset(axis: Axis, home_position: float) -> int:
    return axis.scale.to_counts(home_position) * (-1 if axis.settings.home_offset_reversed else 1)


def check_home_position(axis: Axis) -> Procedure[None]:
    """Read the position of a drive that has just homed. Raises HomingError if it shows that the drive takes its home offset with
    the other sign than the settings say.

    Call it before the drive moves again: it has to stand near the home point, no further away than its way to stop.
    """
    if not axis.settings.home_position:
        return
    home = axis.scale.to_counts(axis.settings.home_position)
    position = yield from read_int(axis.node, objects.POSITION_ACTUAL_VALUE)
    if home and abs(position + home) < abs(position - home) and abs(position + home) < abs(home) / 2:
        is_reversed = axis.settings.home_offset_reversed
        raise HomingError(
            axis,
            f"homed, and shows {position} counts where its home position is {home}",
            reason="it takes its home offset (0x607C) with the other sign",
            remedy=f"AxisSettings(home_offset_reversed={not is_reversed})",
        )


def method_text(axis: Axis) -> str:
    """Return, for messages, the method that the drive was told to home by, or that it is known to have; "" if neither."""
    method = axis.settings.homing_method
    if method is None and objects.HOMING_METHOD in axis.node.heard_at:
        shown = axis.node.values.store.get(objects.HOMING_METHOD)
        method = shown if isinstance(shown, int) else None
    return "" if method is None else f"method {method}: {describe_homing(method)}"
