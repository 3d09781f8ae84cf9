"""Motions of several joints as mathematics: pure functions and small machines, no I/O, no bus.

    path.py            `Path`: positions of all joints over time, in pieces of polynomials
    interpolation.py   paths from waypoints with times: `linear`, `cubic`, `quintic`, `from_function`
    fitting.py         the smoothest positions that samples with few decimals can have meant
    limit_check.py     `JointLimits`, and `first_violation`: the first place at which a path exceeds one
    path_clock.py      `PathClock`: runs a path, slows it down, stops on it, goes on
    margin.py         what a path leaves free of its limits, for braking
    speed_change.py    `SpeedChange`: a speed changes with limited acceleration and jerk
    steps.py           long checks in steps, for callers that must not stand still
    polynomial.py      value, derivatives and extremes of a polynomial; constant jerk

Units: positions in the user's unit of each joint, times in seconds.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_proto.drives.trajectory.interpolation import cubic as cubic
    from canopen_proto.drives.trajectory.interpolation import from_function as from_function
    from canopen_proto.drives.trajectory.interpolation import linear as linear
    from canopen_proto.drives.trajectory.interpolation import quintic as quintic
    from canopen_proto.drives.trajectory.limit_check import JointLimits as JointLimits
    from canopen_proto.drives.trajectory.limit_check import LimitViolation as LimitViolation
    from canopen_proto.drives.trajectory.limit_check import first_violation as first_violation
    from canopen_proto.drives.trajectory.path import Path as Path
    from canopen_proto.drives.trajectory.path import PathError as PathError
    from canopen_proto.drives.trajectory.path import PathPoint as PathPoint
    from canopen_proto.drives.trajectory.path import Segment as Segment
    from canopen_proto.drives.trajectory.path_clock import PathClock as PathClock
    from canopen_proto.drives.trajectory.speed_change import SpeedChange as SpeedChange
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
