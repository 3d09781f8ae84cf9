"""Follow set-points in profile position mode (pp), for drives without ip and csp: each one is a target of the drive's profile.

`start_slow_position` leads the drive to where it takes targets; `feed_targets` gives it the newest set-point, again and again.
One target takes this handshake (CiA 402-2, profile position mode), in which target and controlword go by PDO or SDO:

    bit 4 of the controlword is 0, and bit 12 of the statusword shows 0
    the target position (0x607A)
    bit 4 = 1, with bit 5: this target replaces the one under way
    bit 12 = 1: the drive has it
    bit 4 = 0

The target is always in the drive before bit 4 rises, whatever the order of the objects in an RPDO. Set-points that come meanwhile
are skipped: the newest one is next. So the drive gets a target each 50 ms (TARGET_INTERVAL), or at every seventh SYNC if that is
longer and synchronous RPDOs carry them. The SYNC cycle waits for none of this.

**Lag.** The drive accelerates, and brakes before each target; it is behind the set-points by `profile_lag` at most. Whoever
watches it has to allow for that (`Following.begin(slack=...)`), and sees later that it has stopped.

Source: IEC 61800-7-201 (CiA 402-2), profile position mode.
"""

from __future__ import annotations

from typing import Final

from canopen_proto.drives.axis.axis import OBEYED, Axis
from canopen_proto.drives.axis.axis_node import rpdos_with
from canopen_proto.drives.axis.controlword import command, syncs_passed
from canopen_proto.drives.axis.exclusive_motion import moves
from canopen_proto.drives.axis.failures import TakenOverError, as_drive_errors, require_reference
from canopen_proto.drives.axis.following import Following
from canopen_proto.drives.axis.halting import halt, halt_after
from canopen_proto.drives.axis.profile_position import AT_ONCE, make_room, set_options
from canopen_proto.drives.axis.state import enable, set_mode
from canopen_proto.drives.axis.watching import POLL_INTERVAL, wait_for_statusword
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode, ModeControl, ModeStatus
from canopen_proto.drives.cia402.states import ControlBit, State
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Time
from canopen_proto.multiplexer import Mux, split_mux
from canopen_proto.procedures.objects import read_if_present, read_int
from canopen_proto.procedures.steps import Cancelled, Procedure, ProcedureError, act, current_time, download, sleep

HANDSHAKE_TIME: Final = 200 * MILLISECOND
"""A target that just missed one handshake waits for its end, and then takes one itself: twice 100 ms, with SDO and polls ..."""
HANDSHAKE_SYNCS: Final = 16
"""... or twice 7 SYNCs if RPDOs at SYNCs carry it, and one for the answer each."""
TARGET_INTERVAL: Final = 50 * MILLISECOND
"""The least time between two targets. More often would load the bus and this computer, and the profile brakes before each one."""
RAMP_TIME: Final = 500 * MILLISECOND
"""Of a drive that does not tell how fast it may go and accelerate."""
LONGEST_RAMP: Final = 2 * SECOND
"""A drive whose ramps are longer is not watched more loosely: it has a slow profile, and needs slow paths."""


@moves
@as_drive_errors
def start_slow_position(axis: Axis) -> Procedure[float]:
    """Make the drive take targets in profile position mode; return the position where it starts, which is its first target.

    RPDOs that are exchanged with the node and carry controlword or target are used; without, both go by SDO. Raises
    ReferenceLostError, ModeUnsupportedError, DriveInFaultError, StateLostError, ModeLostError, DriveLostError, StepTimeoutError,
    SdoTransferError. The drive is halted if this is cancelled.
    """
    require_reference(axis)
    axis.set_points.select(Mode.PROFILE_POSITION)
    yield from halt(axis)
    yield from set_mode(axis, Mode.PROFILE_POSITION)
    yield from enable(axis)
    try:
        yield from set_options(axis)
        position = yield from read_int(axis.node, objects.POSITION_ACTUAL_VALUE)
        axis.set_points.set_position_counts(position)
        now = yield from current_time()
        for number in rpdos_with(axis.node, (objects.CONTROLWORD, objects.TARGET_POSITION)):
            axis.node.enable_rpdo(number, now)
        yield from _give(axis, position, mode=Mode.PROFILE_POSITION)
    except (Cancelled, Exception) as cause:
        yield from halt_after(axis, cause)
        raise
    return axis.scale.from_counts(position)


def feed_targets(following: Following) -> Procedure[None]:
    """Give the drive its newest set-point (`Axis.set_points`) as a target, whenever it has changed, until cancelled. following:
    the watch of the axis.

    The watch must be on. It ends with FollowingLost if the drive does not take a target. This ends without it, and commands
    nothing more, when a stop takes the axis over (exclusive_motion.py).
    """
    axis = following.axis
    given = axis.set_points.counts
    try:
        while not axis.occupancy.is_being_stopped:
            counts = axis.set_points.counts
            if counts == given:
                yield from sleep(POLL_INTERVAL)
            else:
                began = yield from current_time()
                yield from _give(axis, counts)
                given = counts
                yield from sleep(max(0, began + TARGET_INTERVAL - (yield from current_time())))
    except (ProcedureError, LocalProtocolError) as error:
        if not axis.occupancy.is_being_stopped:
            following.lose(f"takes no more targets: {error}")


def profile_lag(axis: Axis, cycle_time: Time) -> Procedure[Time]:
    """Return how far the drive may be behind its set-points, in ns: handshakes, and its ramps from 0 to its profile velocity.

    cycle_time: ns between two SYNCs. Speed and ramps (0x6081, 0x6083, 0x6084) are the drive's; their quotient is a time if their
    units belong together, as in all drives known. Raises SdoTransferError if the drive does not answer.
    """
    speed = yield from _amount(axis, objects.PROFILE_VELOCITY)
    up = yield from _amount(axis, objects.PROFILE_ACCELERATION)
    down = (yield from _amount(axis, objects.PROFILE_DECELERATION)) or up
    ramps = sum(RAMP_TIME if not speed or not rate else round(speed * SECOND / rate) for rate in (up, down))
    return max(HANDSHAKE_TIME, HANDSHAKE_SYNCS * cycle_time) + min(ramps, LONGEST_RAMP)


def _amount(axis: Axis, key: Mux) -> Procedure[int]:
    value = yield from read_if_present(axis.node, key)
    return value if isinstance(value, int) else 0


def _give(axis: Axis, counts: int, mode: Mode | None = None) -> Procedure[None]:
    """Give a target. A halt that is in force ends with the same controlword that gives it; see `profile_position`."""
    if mode is None:
        yield from _command(axis, AT_ONCE | axis.controlword & ControlBit.HALT)
        yield from _acknowledged(axis, False, mode)
    else:
        yield from make_room(axis, int(AT_ONCE))
    yield from _bring(axis, counts)
    yield from _command(axis, AT_ONCE | ModeControl.NEW_SET_POINT)
    yield from _acknowledged(axis, True, mode)
    axis.started_at = OBEYED
    yield from _command(axis, int(AT_ONCE))


def _command(axis: Axis, controlword: int) -> Procedure[None]:
    """Command the drive, unless a stop has taken it over: this word would undo that one."""
    if axis.occupancy.is_being_stopped:
        raise TakenOverError(axis, "its targets", "a stop")
    yield from command(axis, controlword)


def _acknowledged(axis: Axis, wanted: bool, mode: Mode | None) -> Procedure[None]:
    """Wait for bit 12. mode: None leaves the watch on the mode to `Following`, which saves a read for each target."""
    yield from wait_for_statusword(
        axis,
        lambda word: bool(word & ModeStatus.SET_POINT_ACKNOWLEDGE) is wanted,
        axis.settings.state_timeout,
        f"set-point acknowledge (bit 12) = {int(wanted)}",
        mode=mode,
        stays=State.OPERATION_ENABLED,
    )


def _bring(axis: Axis, counts: int) -> Procedure[None]:
    """Bring a target to the drive: by the live RPDO that carries it, else by SDO. The image stays: it may be newer already."""
    node = axis.node
    producer = node.rpdo_of(objects.TARGET_POSITION)
    if producer is not None and not producer.is_synchronous:
        yield from act(producer.trigger)
    elif producer is None or not (yield from syncs_passed(axis, max(1, producer.transmission_type))):
        data = node.dictionary.variable(objects.TARGET_POSITION).encode(counts)
        yield from download(node.sdo, *split_mux(node.on_device(objects.TARGET_POSITION)), data)
