"""The task of `canopen move`: the target, the way there, and the check of it against the limits of each joint."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import trio

from canopen_cli.motion.chain_session import ChainGroup
from canopen_cli.shared.problem import usage
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_data.path_file import PathFile, Rounding
from canopen_master.errors import PathRefusedError, PlanRefusedError
from canopen_master.master import Master
from canopen_master.motion.device import Device
from canopen_master.motion.joint_procedures import ensure_answers
from canopen_master.motion.path_check import check_path, find_margin
from canopen_proto.dictionary.model import did_you_mean
from canopen_proto.drives.axis.identity import identify
from canopen_proto.drives.axis.limits import read_limits
from canopen_proto.drives.trajectory import JointLimits, Path, PathPoint, Segment
from canopen_proto.drives.trajectory.limit_check import demands_of, reach_of
from canopen_proto.procedures.steps import Procedure

Legs: TypeAlias = list[tuple[str, Path]]
"""Parts of a motion, at rest between them: what each is, for people, and its path."""
COLUMNS = "joint", "from", "to", "lowest", "highest", "speed", "of", "acceleration", "of ", "jerk", "of  "
_CLOSE = 1e-9


def targets_of(text: str, joints: Sequence[str]) -> dict[str, float]:
    """Return the targets that --to names, by joint. Raises a CommandError. text: "10,-5", a position for each joint, or
    "joint1=10,joint2=-5"."""
    parts = [part.strip() for part in text.split(",")]
    if not any("=" in part for part in parts):
        if len(parts) != len(joints):
            seen, tries = f"the joints are {', '.join(joints)}", ("--to JOINT=POSITION", "--to A,B,... with each joint")
            failed = f"--to {text!r} is {counted(len(parts), 'value')}, and there are {counted(len(joints), 'joint')}"
            raise usage("CO001", failed, seen=seen, tries=tries)
        parts = [f"{joint}={part}" for joint, part in zip(joints, parts, strict=True)]
    found: dict[str, float] = {}
    for part in parts:
        name, equals, number = (each.strip() for each in part.partition("="))
        if name in found:
            raise usage("CO001", f"--to: {name} has two positions", tries=("each joint once",))
        if name not in joints or not equals:
            seen = f"the joints are {', '.join(joints)}"
            raise usage("CO001", f"--to: {part!r} is not JOINT=POSITION{did_you_mean(name, joints)}", seen=seen)
        try:
            found[name] = float(number)
        except ValueError:
            found[name] = math.nan
        if not math.isfinite(found[name]):
            advice = f"{name}=NUMBER, in the joint's unit of the machine file: a unit is not written here"
            raise usage("CO001", f"--to: {number!r} is not a finite number", seen=f"the position of {name}", tries=(advice,))
    return found


async def check_before_power(master: Master, arm: ChainGroup, targets: dict[str, float] | None, path: PathFile | None) -> None:
    """Check a path, or the targets, by the limits that the drives tell, before any joint has power. The drives are only read.

    Raises PathRefusedError, PlanRefusedError, PackageMissingError; what keeps the drives from being read.
    """
    for device in arm.devices:
        await master.run(_learn_limits(device))
    limits = arm.moving.path_limits
    if path is not None:
        await _check(arm, path, limits)
    else:
        assert targets is not None
        for device, own in zip(arm.devices, limits, strict=True):
            target = targets.get(device.name)
            if target is not None:
                there = Path([[Segment(arm.cycle_time, (target,))]])
                await check_path([device], there, there.start, [own], arm.cycle_time)


def _learn_limits(device: Device) -> Procedure[None]:
    yield from ensure_answers(device.node)
    yield from identify(device.axis)
    device.limits = yield from read_limits(device.axis)


async def _check(arm: ChainGroup, path: PathFile, limits: Sequence[JointLimits]) -> None:
    """Check a path, and that the joints can stop along it; an error tells what the rounding of the file has to do with it."""
    try:
        await check_path(arm.devices, path.path, path.path.start, limits, arm.cycle_time)
        await find_margin(arm.devices, path.path, limits, arm.cycle_time)
    except PathRefusedError as refused:
        if refused.kind in ("jerk", "acceleration"):
            number = [device.name for device in arm.devices].index(refused.joint)
            refused.add_note(_rounding_text(path.roundings[number], limits[number].jerk or math.inf))
        raise


def smoothed_text(path: PathFile) -> str:
    """Return in a line what of a path was smoothed; "" if it goes through all positions as they were written."""
    moved = [
        f"{name}: {each.moved} rows by up to {each.unit / 2:g}"
        for name, each in zip(path.joints, path.roundings, strict=True)
        if each.moved
    ]
    return f"smoothed within the rounding of the file: {'; '.join(moved)}" if moved else ""


def _rounding_text(rounding: Rounding, limit: float) -> str:
    given = f"its file gives positions in steps of {rounding.unit:g} and {rounding.step:g} s"
    if rounding.is_smoothed:
        return f"{given}: this is the smoothest path within half a step of all of them, so it needs more time, not more decimals"
    if rounding.jerk < 0.1 * limit:
        return f"{given}: that is exact enough, so the path needs more time, or smoother positions"
    return (
        f"{given}: such rounding alone can be a jerk of {rounding.jerk:.3g}; for a limit of {limit:.4g} write "
        f"{rounding.decimals_for(limit)} decimals, or fewer rows"
    )


async def legs_of(arm: ChainGroup, targets: dict[str, float] | None, path: PathFile | None) -> Legs:
    """Return the way of a chain that stands and follows set-points: to the targets, or to the start of a path and along it.

    Raises PathRefusedError for a path beyond a limit, PlanRefusedError, PackageMissingError.
    """
    here = arm.desired_positions
    if path is None:
        assert targets is not None
        there = [targets.get(device.name, position) for device, position in zip(arm.devices, here, strict=True)]
        return [("to the target", planned(arm, here, there))]
    await _check(arm, path, arm.moving.path_limits)
    begin = path.path.start.positions
    along = ("along the path", path.path)
    if all(abs(a - b) <= device.axis.scale.amount_from_counts(1) for device, a, b in zip(arm.devices, here, begin, strict=True)):
        return [along]
    return [("to the start of the path", planned(arm, here, begin)), along]


def planned(arm: ChainGroup, here: Sequence[float], there: Sequence[float]) -> Path:
    """Return the fastest way from rest to rest. here, there: a position for each joint, in its unit."""
    from canopen_master.trajectories.point_to_point import point_to_point

    rest = [0.0] * len(here)
    try:
        return point_to_point(PathPoint(list(here), rest, rest), there, arm.moving.path_limits)
    except PlanRefusedError as error:
        error.name_joint([device.name for device in arm.devices])
        raise


async def show_legs(screen: Screen, arm: ChainGroup, legs: Legs) -> None:
    """Show each part of the motion, with what it asks of each joint, and the limits."""
    if screen.json_output:
        return
    for name, path in legs:
        screen.data(f"[bold]{name}[/]: {path.duration:.3g} s, within all limits")
        rows = []
        for number, (device, limits) in enumerate(zip(arm.devices, arm.moving.path_limits, strict=True)):
            demands = list(demands_of(path, number, arm.cycle_time))
            lowest, highest = reach_of(path, number)
            asked = [max(getattr(each, kind).magnitude for each in demands) for kind in ("speed", "acceleration", "jerk")]
            most = [limits.speed, limits.acceleration, limits.jerk]
            pairs = [cell for pair in zip(map(_shown, asked), map(_shown, most), strict=True) for cell in pair]
            ends = path.start.positions[number], path.end.positions[number]
            rows.append((escape(device.name), *map(_shown, (*ends, lowest, highest)), *pairs))
            await trio.lowlevel.checkpoint()  # a SYNC may be due
        screen.table(COLUMNS, rows, right=COLUMNS[1:])


def _shown(value: float | None) -> str:
    return "any" if value is None or math.isinf(value) else f"{0.0 if abs(value) < _CLOSE else value:.4g}"
