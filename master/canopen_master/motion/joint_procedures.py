"""The procedures that a chain runs for each of its joints; the sequences themselves are in canopen_proto.drives.axis."""

from __future__ import annotations

import math
from typing import Final, NamedTuple, TypeVar

from canopen_master.motion.chain_settings import ChainSettings
from canopen_master.motion.device import Device
from canopen_master.motion.feed_forward import is_carried
from canopen_master.node import Node
from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.dictionary import Direction, Key, PdoDescription
from canopen_proto.drives.axis import (
    enable,
    engage_brake,
    halt,
    learn_units,
    reset_fault,
    select_motionless_mode,
    shut_down,
    start_cyclic_position,
    start_interpolation,
)
from canopen_proto.drives.axis.following_error import UNCERTAIN
from canopen_proto.drives.axis.following_procedures import following_limit
from canopen_proto.drives.axis.identity import identify
from canopen_proto.drives.axis.limits import Limit, read_limits
from canopen_proto.drives.axis.motion_plan import exchange_planned, plan_motion, read_modes
from canopen_proto.drives.axis.reasons import look_closer
from canopen_proto.drives.axis.slow_position import profile_lag, start_slow_position
from canopen_proto.drives.axis.sub_modes import LINEAR, PositionAndVelocity
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.pdo.configure import define_pdo
from canopen_proto.pdo.mapping import Mapping
from canopen_proto.pdo.settings import place_of
from canopen_proto.procedures.objects import ABSENT, read, read_if_present, unless_refused, write
from canopen_proto.procedures.steps import Procedure, ProcedureError, SdoTransferError, act

T = TypeVar("T")

DEVICE_TYPE: Final = "0x1000"
"""The one object that every device has: reading it shows whether the device answers at all."""
HEARTBEAT: Final = "0x1017"
HEARTBEATS_PER_TIMEOUT: Final = 3
"""One lost or late frame does not make a lost node."""
MAX_HEARTBEAT_MS: Final = 0xFFFF
LONGEST_CATCH_UP: Final = 1.0
"""Seconds for which a drive that limits its acceleration may cut steps, after a late SYNC; else it has the time of its ramps,
2 x speed limit / 0x60C5."""


class JointError(ProcedureError):
    """A joint's procedure failed; the error is its __cause__."""

    def __init__(self, device: Device, error: ProcedureError) -> None:
        super().__init__(str(error))
        self.device = device
        self.error = error


def of_joint(device: Device, procedure: Procedure[T]) -> Procedure[T]:
    """Run a procedure; its failure says which joint it was."""
    try:
        return (yield from procedure)
    except ProcedureError as error:
        raise JointError(device, error) from error


def failure_of(device: Device, procedure: Procedure[object]) -> Procedure[JointError | None]:
    """Run a procedure; its failure is its result, so that the procedures beside it go on."""
    try:
        yield from procedure
    except ProcedureError as error:
        return JointError(device, error)
    return None


def ensure_answers(node: Node, key: Key = DEVICE_TYPE) -> Procedure[None]:
    """Read an object to see whether the node answers. A node in state Stopped cannot answer, and is made pre-operational first.
    key: of that object.

    The last program that used the drive has left it stopped: a chain, and the manual's shutdownDevice, end so.
    """
    if node.nmt_state is not NmtState.STOPPED:
        try:
            yield from read(node.remote, key)
        except SdoTransferError as failed:
            silent = failed.origin is AbortOrigin.TIMEOUT and node.nmt_state in (None, NmtState.STOPPED)
            booted = failed.origin is AbortOrigin.LOCAL  # it was being switched on, and is there now
            if not silent and not booted:
                raise
        else:
            return
    if node.nmt_state in (None, NmtState.STOPPED):
        yield from act(lambda now: node.send_nmt(NmtCommand.ENTER_PRE_OPERATIONAL, now))
    yield from read(node.remote, key)


def exchange_named(device: Device, pdos: tuple[PdoDescription, ...], define: bool) -> Procedure[None]:
    """Exchange these PDOs with the joint, at each SYNC. define: declare them to the device before."""
    node = device.node.remote
    tpdos = [Mapping.from_description(each) for each in pdos if each.direction is Direction.TPDO]
    device.cyclic = {mux: 1 for mapping in tpdos for mux in mapping.muxes}
    for description in pdos:
        if define:
            yield from define_pdo(node, description)
        else:
            yield from act(lambda now, description=description: node.add_pdo(description, now))  # type: ignore[misc]


def plan_joint(device: Device, settings: ChainSettings, *, lean: bool = False) -> None:
    """Plan by the joint's own dictionary how it follows set-points (`device.plan`). lean: see `plan_motion`. Raises
    NoMotionPlanError."""
    node, cycle_time = device.node.remote, round(settings.cycle_time * SECOND)
    device.plan = plan_motion(
        node.dictionary,
        node.node_id,
        cycle_time,
        modes=device.modes,
        wish=settings.mode,
        axis=device.axis.number,
        lean=lean,
        feed_forward=settings.feed_forward,
    )


def has_plan(device: Device, settings: ChainSettings) -> bool:
    """Return whether the joint exchanges the PDOs of a plan of its own, by these settings; else those that they name."""
    has_pdos = any(place_of(index) is not None for index in device.node.dictionary.objects)
    # PDOs.csv is about the first axis
    return settings.mode is None or (settings.own_pdos and has_pdos) or bool(device.axis.number)


def exchange(device: Device, settings: ChainSettings) -> Procedure[None]:
    """Exchange the PDOs of the joint's own plan, or the named ones."""
    if device.plan is not None:
        yield from exchange_planned(device.node.remote, device.plan)
        device.cyclic = device.plan.cyclic
    else:
        yield from exchange_named(device, named_pdos(device, settings), settings.define_pdos)


def named_pdos(device: Device, settings: ChainSettings) -> tuple[PdoDescription, PdoDescription]:
    """Return the RPDO and the TPDO that the settings name. Raises ObjectNotFoundError if the joint's dictionary lacks one."""
    return device.node.dictionary.pdo(settings.rpdo), device.node.dictionary.pdo(settings.tpdo)


def mode_of(device: Device, settings: ChainSettings) -> Mode:
    """Return the mode in which a joint follows set-points; of a chain that is not initialised, ip if its plan is to choose."""
    if device.plan is not None:
        return device.plan.mode
    return Mode.INTERPOLATED_POSITION if settings.mode is None else settings.mode


def contact(device: Device, settings: ChainSettings) -> Procedure[None]:
    """See that the joint answers, identify it, and plan its PDOs (`device.plan`; None: those that the settings name).

    Raises at once, before it sends anything, if its dictionary lacks a PDO that the settings name.
    """
    device.plan = None
    is_planned = has_plan(device, settings)
    if not is_planned:
        named_pdos(device, settings)
    return _contact(device, settings, is_planned)


def _contact(device: Device, settings: ChainSettings, is_planned: bool) -> Procedure[None]:
    device.last_look = None
    yield from ensure_answers(device.node)
    yield from locate(device)  # PDOs keep the position up to date from the first one on
    if is_planned:
        device.modes = yield from read_modes(device.axis.node)
        plan_joint(device, settings)


def locate(device: Device) -> Procedure[None]:
    """Identify the joint, and read where it is."""
    yield from identify(device.axis)
    yield from read_if_present(device.axis.node, objects.POSITION_ACTUAL_VALUE)


def prepare(device: Device, settings: ChainSettings, heartbeat_timeout: Time) -> Procedure[None]:
    """Exchange PDOs with the joint, have it send its heartbeat if that is supervised, and read its limits. heartbeat_timeout: ns;
    0: no heartbeat is supervised."""
    node = device.node.remote
    yield from exchange(device, settings)
    is_guarded = node.guarding.guard_time  # its answers count as heartbeats, and a device has one or the other
    if heartbeat_timeout and HEARTBEAT in node.dictionary and not is_guarded:
        period = max(1, min(heartbeat_timeout // HEARTBEATS_PER_TIMEOUT // MILLISECOND, MAX_HEARTBEAT_MS))
        yield from unless_refused(write(node, HEARTBEAT, period), (*ABSENT, AbortCode.READ_ONLY))
    device.limits = yield from read_limits(device.axis, mode_of(device, settings))


def reset_and_enable(device: Device) -> Procedure[None]:
    """Halt the joint, which another program may have left running, and bring it into Operation enabled."""
    yield from halt(device.axis)
    yield from reset_fault(device.axis)
    yield from select_motionless_mode(device.axis)
    yield from enable(device.axis)


class Followed(NamedTuple):
    """How a joint follows set-points, for its watch: see `Following.begin`.

    speed: the most that its set-points may ask for; inf: anything, since nothing limits it, or it limits itself.
    """

    limit: Limit
    mode: Mode
    catches_up: int
    speed: float
    slack: int = UNCERTAIN


def follow(
    device: Device, name: str, cycle_time: Time, mode: Mode = Mode.INTERPOLATED_POSITION, *, sends_itself: bool = False
) -> Procedure[Followed]:
    """Halt the joint, read its limits, and let it follow set-points from where it stands.

    name: gives the set-points, and occupies the joint from then on: `Device.release` ends it. cycle_time: ns. mode: csp, ip, or
    pp, in which a joint follows slowly. sends_itself: the caller sends the set-points, not the RPDOs at SYNC.
    """
    axis = device.axis
    yield from halt(axis)
    device.limits = yield from read_limits(axis, mode)
    limit = yield from following_limit(axis, device.limits)
    if is_carried(axis, objects.VELOCITY_OFFSET) and axis.scale.velocity_unit is None:
        yield from learn_units(axis)  # see feed_forward.py
    acceleration = device.limits.acceleration
    ramps = 0.0 if acceleration is None else min(2 * device.limits.speed.value / acceleration.value, LONGEST_CATCH_UP)
    catches_up = max(1, math.ceil(ramps * SECOND / cycle_time))
    if mode is Mode.PROFILE_POSITION:
        lag = yield from profile_lag(axis, cycle_time)
        yield from start_slow_position(axis)
        device.occupy(name)
        return Followed(limit, mode, catches_up, math.inf, UNCERTAIN - (-lag // cycle_time))
    if mode is Mode.CYCLIC_SYNCHRONOUS_POSITION:
        yield from start_cyclic_position(axis, cycle_time, sends_itself=sends_itself)
    else:
        unit = axis.settings.record_velocity_unit
        sub_mode = LINEAR if unit is None else PositionAndVelocity(unit)
        yield from start_interpolation(axis, cycle_time, sends_itself=sends_itself, sub_mode=sub_mode)
    device.occupy(name)
    return Followed(limit, mode, catches_up, device.limits.speed.value)


def stop(device: Device) -> Procedure[None]:
    """Halt the joint, and wait until it stands, also at the end of a fault reaction. Then read what tells why it was stopped: it
    may have no power, or stand on a limit switch."""
    if device.has_fault:
        yield from read_if_present(device.axis.node, objects.ERROR_CODE)
    yield from halt(device.axis)
    device.last_look = yield from look_closer(device.axis)


def power_down(device: Device) -> Procedure[None]:
    """Halt, engage the brake, take the power away. A joint in fault loses its power by itself, once it has braked."""
    yield from halt(device.axis)
    if not device.has_fault:
        yield from engage_brake(device.axis)
    yield from shut_down(device.axis)
