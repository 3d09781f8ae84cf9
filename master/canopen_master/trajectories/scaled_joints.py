"""`ScaledJoint`: a joint in a unit in which its speed limit is 1. Checks, errors and ruckig, for all planners.

ruckig compares with absolute tolerances of about 1e-8, so its origin is where the motion starts, too. In the user's units it
refuses one in twenty tasks with joints between micrometres and encoder counts.

Only motions from state to state are asked of ruckig. Its `intermediate_positions` would call a service on the internet.
"""

from __future__ import annotations

import importlib
import math
import re
from collections.abc import Callable, Sequence
from numbers import Real
from typing import Any, Final, NamedTuple

from canopen_master.errors import PackageMissingError, PlanRefusedError, wrong_values
from canopen_proto.drives.trajectory import JointLimits, Path, PathPoint
from canopen_proto.drives.trajectory.limit_check import positions_beyond

_DEGREE_OF_FREEDOM: Final = re.compile(r"\bdof:? (\d+)", re.IGNORECASE)
"""How the texts of ruckig name a joint."""

_TOO_LONG: Final = "-101"
"""Its result ErrorTrajectoryDuration, which its Python module lacks."""
MAX_DURATION: Final = 7600.0
"""The longest path of several joints that ruckig plans, in seconds."""

_TOLERANCE: Final = 1e-9
"""How far beyond a position limit is still a rounding error, in seconds at full speed."""


class ScaledJoint(NamedTuple):
    """One joint: positions from `origin` in units of `unit`, which is its speed limit (user's unit per second).

    acceleration, jerk: its limits in that unit. lowest, highest: its position limits in the user's unit; infinite where it has
    none.
    """

    origin: float
    unit: float
    acceleration: float
    jerk: float
    lowest: float
    highest: float


def load_ruckig(task: str) -> Any:
    """Import ruckig. task: what needs it, for the error. Raises PackageMissingError."""
    try:
        return importlib.import_module("ruckig")
    except ImportError as error:
        raise PackageMissingError("ruckig", "motion", task, error) from error


def scaled_joints(
    start: PathPoint, limits: Sequence[JointLimits], *, margin: float = 0.0, speed_factor: float = 1.0
) -> list[ScaledJoint]:
    """Check the state at the start and the limits, and return the joints in their own units.

    margin: this part of acceleration and jerk is not used (0 to below 1). speed_factor: this part of the speed is used (above 0,
    at most 1). A joint that starts beyond a position limit may stay there and come back, but not go further: its limit is then
    where it starts, as it is for set-points. Raises PlanRefusedError.
    """
    if not limits:
        raise PlanRefusedError("a motion needs at least one joint", seen="no limits were given")
    _check_part("margin", margin, lambda part: 0.0 <= part < 1.0, "from 0 to below 1")
    check_share("speed_factor", speed_factor)
    for values, kind in zip(start, ("position", "velocity", "acceleration"), strict=True):
        check_values(values, len(limits), f"{kind} at the start")
    joints = []
    for joint, (position, each) in enumerate(zip(start.positions, limits, strict=True)):
        speed = _bound(joint, "speed", each.speed)
        acceleration = _bound(joint, "acceleration", each.acceleration)
        jerk = _bound(joint, "jerk", each.jerk)
        unit = speed * speed_factor
        lowest, highest = each.range
        kept = (1.0 - margin) / unit
        limits_of_way = min(lowest, position), max(highest, position)
        joints.append(ScaledJoint(position, unit, acceleration * kept, jerk * kept, *limits_of_way))
    return joints


def check_values(values: Sequence[float], joints: int, kind: str) -> None:
    """Raise PlanRefusedError unless there is one finite value for each joint. kind: in the singular, such as "target"."""
    if wrong := wrong_values(values, joints):
        raise PlanRefusedError(f"there must be one {kind} for each joint", seen=wrong, tries=(f"{joints} values",))
    for joint, value in enumerate(values):
        if not math.isfinite(value):
            raise PlanRefusedError(f"the {kind} of joint {joint} is no finite number", joint=joint, value=value, seen=repr(value))


def position_excess(path: Path, number: int, joint: ScaledJoint) -> tuple[float, float] | None:
    """Return a position that joint `number` of a path reaches, and the limit that it exceeds there; None if it keeps both.

    The extremes that ruckig offers (`position_extrema`) miss some: those of 0.19.4 are wrong by up to a fifth of a second at full
    speed, with or without a phase that brakes.
    """
    tolerance = _TOLERANCE * joint.unit
    least, most = joint.lowest - tolerance, joint.highest + tolerance
    for _, position in positions_beyond(path.pieces[number], least, most):
        return position, joint.lowest if position < least else joint.highest
    return None


def limit_exceeded(position: float, joint: ScaledJoint) -> float | None:
    """Return the limit that a position exceeds, None if it is within both."""
    if position < joint.lowest:
        return joint.lowest
    return joint.highest if position > joint.highest else None


def beyond_limit(number: int, position: float, limit: float, failed: str, remedy: str) -> PlanRefusedError:
    """Return the error for a position beyond a limit."""
    name = "lowest" if position < limit else "highest"
    seen = f"position {position:g}, its {name} is {limit:g}"
    return PlanRefusedError(failed, joint=number, value=position, limit=limit, seen=seen, tries=(remedy,))


def ruckig_refused(error: Exception, task: str) -> PlanRefusedError:
    """Return the error for what ruckig raised."""
    text = str(error).strip().removeprefix("[ruckig]").partition("input:")[0].strip().rstrip(".")
    if _TOO_LONG in text:
        return PlanRefusedError(
            f"ruckig found no {task}",
            cause=f"it would take longer than {MAX_DURATION:g} s",
            tries=("more speed, or several plans",),
        )
    found = _DEGREE_OF_FREEDOM.search(text)
    joint = int(found[1]) if found else None
    return PlanRefusedError(
        f"ruckig found no {task}" + ("" if joint is None else f" for joint {joint}"),
        joint=joint,
        seen=text,
        cause="limits or a state of motion that are many orders of magnitude apart",
        tries=("limits that belong to each other: full acceleration within 10 s, full speed within minutes",),
    )


def check_share(name: str, share: object) -> None:
    """Raise PlanRefusedError unless this is a share of the speed limits: above 0, at most 1. name: of the caller's parameter."""
    _check_part(name, share, lambda part: 0.0 < part <= 1.0, "above 0 and at most 1")


def _check_part(name: str, value: object, is_within: Callable[[float], bool], needed: str) -> None:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise PlanRefusedError(f"{name} must be a number {needed}", seen=repr(value))
    number: Any = value  # a Real is compared as a float is, and may be too large for one
    if not is_within(number):
        raise PlanRefusedError(f"{name} must be {needed}", value=number, seen=repr(value))


def _bound(joint: int, name: str, limit: float | None) -> float:
    if limit is None or not math.isfinite(limit):
        raise PlanRefusedError(
            f"joint {joint} has no limit of its {name}", joint=joint, cause="a plan keeps limits, so it needs them all",
            tries=(f"JointLimits(..., {name}=...)",),
        )  # fmt: skip
    return limit
