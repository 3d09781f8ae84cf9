"""The check of a whole path before any joint moves: where it begins, its limits, and whether the chain can stop on it.

A path of thousands of points takes a second of calculation. It is done in steps of some 0.5 ms, and the other tasks of the
process run between them: a stall would be a gap of SYNC, for this chain and for others.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from typing import Final, TypeVar

from canopen_master.errors import PathRefusedError, with_names
from canopen_master.motion.device import Device
from canopen_master.motion.path_motion import LONGEST_STOP
from canopen_master.motion.set_point_check import setting_of
from canopen_proto.drives.trajectory import JointLimits, LimitViolation, Path, PathError, PathPoint, first_violation
from canopen_proto.drives.trajectory.limit_check import first_violation_in_steps
from canopen_proto.drives.trajectory.margin import Margin, margin_in_steps
from canopen_transports.loop import current_loop

START_COUNTS: Final = 2
"""Counts that a joint may be off the start of a path, at least: conversions of units round."""
START_TIME: Final = 0.001
"""Seconds at its speed limit that a joint may be off the start of a path, at most."""
T = TypeVar("T")
_UNITS: Final = {"position": "", "speed": " per second", "acceleration": " per second²", "jerk": " per second³"}


async def in_steps(steps: Generator[None, None, T]) -> T:
    """Do a calculation step by step, and let other tasks run in between. Return its result, or raise its error."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: T = end.value
            return result
        await current_loop().checkpoint()


async def check_path(
    devices: Sequence[Device], path: Path, start: PathPoint, limits: Sequence[JointLimits], cycle_time: float
) -> None:
    """Check a path before the joints follow it. Raises PathRefusedError.

    start: where the joints stand; see `check_start`. limits: of each joint. cycle_time: in s.
    """
    check_start(devices, path, start, limits, cycle_time)
    violation = await in_steps(first_violation_in_steps(path, limits, cycle_time))
    if violation is not None:
        raise beyond_limit(devices[violation.joint], violation)


async def find_margin(devices: Sequence[Device], path: Path, limits: Sequence[JointLimits], cycle_time: float) -> Margin:
    """Find what a path leaves free for a stop along it, while other tasks go on. Raises PathRefusedError if that is too little.

    limits: of each joint. cycle_time: in s.
    """
    try:
        return await in_steps(margin_in_steps(path, limits, cycle_time, LONGEST_STOP))
    except PathError as error:
        raise cannot_be_followed(devices, error) from error


def cannot_be_followed(devices: Sequence[Device], error: PathError) -> PathRefusedError:
    """Return the error for a path on which the chain could not stop."""
    text, _, tries = with_names(str(error), [device.name for device in devices]).partition(" Try: ")
    return PathRefusedError("the path cannot be followed", seen=text, tries=(tries,) if tries else ())


def check_now(devices: Sequence[Device], path: Path, start: PathPoint, limits: Sequence[JointLimits], cycle_time: float) -> None:
    """Check a path in one turn, as `check_path`: for joints that move, which will be elsewhere after it."""
    check_start(devices, path, start, limits, cycle_time)
    violation = first_violation(path, limits, cycle_time)
    if violation is not None:
        raise beyond_limit(devices[violation.joint], violation)


def check_start(
    devices: Sequence[Device], path: Path, start: PathPoint, limits: Sequence[JointLimits], cycle_time: float
) -> None:
    """Check that a path has a row for each joint, and begins where they stand, or as they move. Raises PathRefusedError.
    cycle_time: s.

    The step to the start of the path, in one cycle, must be within the acceleration of the joint, and no longer than its way in
    START_TIME; START_COUNTS are allowed in any case, and no more to a joint without these limits. The speed of joints that move
    may change by the acceleration of one cycle.
    """
    if path.joints != len(devices):
        names = ", ".join(device.name for device in devices)
        raise PathRefusedError(f"the path has {path.joints} joints, not {len(devices)}", seen=f"the joints are {names}")
    wanted = path.start.positions
    for device, each, here, there in zip(devices, limits, start.positions, wanted, strict=True):
        rounding = device.axis.scale.amount_from_counts(START_COUNTS)
        step = min((each.acceleration or 0.0) * cycle_time * cycle_time, (each.speed or 0.0) * START_TIME)
        tolerance = max(rounding, step) if math.isfinite(step) else rounding
        if abs(there - here) > tolerance:
            raise PathRefusedError(
                f"the path does not begin where {device.name} stands",
                device.name,
                value=there,
                seen=f"it begins at {there:.6g}, {device.name} stands at {here:.6g}: {abs(there - here):.3g} away, "
                f"{tolerance:.3g} are allowed",
                tries=("await chain.move(path.start.positions) first", "a path that begins at chain.desired_positions"),
            )
    if any(start.velocities):
        _check_velocities(devices, path.start, start, limits, cycle_time)


def _check_velocities(
    devices: Sequence[Device], first: PathPoint, start: PathPoint, limits: Sequence[JointLimits], cycle_time: float
) -> None:
    for device, each, here, there in zip(devices, limits, start.velocities, first.velocities, strict=True):
        allowed = math.inf if each.acceleration is None else each.acceleration * cycle_time
        if abs(there - here) > allowed:
            raise PathRefusedError(
                f"the path does not begin as {device.name} moves",
                device.name,
                time=0.0,
                kind="speed",
                value=there,
                seen=f"it begins at {there:.6g} per second, {device.name} moves at {here:.6g} per second",
                tries=("a path that begins with the velocities of the point that the function gets",),
            )


def beyond_limit(device: Device, violation: LimitViolation) -> PathRefusedError:
    """Return the error for a path beyond a limit of this joint."""
    kind, unit = violation.kind, _UNITS[violation.kind]
    source = source_of(device, kind, violation.limit)
    return PathRefusedError(
        f"the path takes {device.name} beyond its limit of {kind} at {violation.time:.6g} s",
        device.name,
        time=violation.time,
        kind=kind,
        value=violation.value,
        limit=violation.limit,
        seen=f"{kind} {violation.value:.6g}{unit}, its limit is {violation.limit:.6g}{unit}: {source}",
        tries=_tries(device, violation, source),
    )


def _tries(device: Device, violation: LimitViolation, source: str) -> tuple[str, ...]:
    """Return what to try. source: of the limit, in words."""
    kind = violation.kind
    is_of_drive = source.endswith("of the drive")
    if kind != "position":
        if source.endswith("can hold"):
            return ("a path that takes longer",)
        where = source if is_of_drive and source.startswith("0x6081") else setting_of(device, f"max_{kind}")
        return "a path that takes longer, or a smoother one", f"a larger limit, if the joint may do more: {where}"
    nearer = "a path within the position limits of the joint: `path_limits` tells them"
    if source.endswith("can hold"):
        return (nearer,)
    where = source if is_of_drive else setting_of(device, "max_position" if violation.value > violation.limit else "min_position")
    return nearer, f"a wider limit, if the joint may go there: {where}"


def source_of(device: Device, kind: str, value: float) -> str:
    """Return where a limit comes from, in words. value: the limit."""
    own = device.limits
    if kind == "position":
        return next((each.source for each in own.ends_of_paths if each is not None and each.value == value), "")
    return {"speed": own.speed_of_paths, "acceleration": own.max_acceleration, "jerk": own.max_jerk}[kind].source
