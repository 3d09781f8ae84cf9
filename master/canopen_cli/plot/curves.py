"""The curves of each joint over time, of a recording or a path, and the velocities and accelerations that its positions make."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from canopen_data.path_file import PathFile
from canopen_master.motion.record_reader import MotionRecord

POINTS = 2000
"""Of a path that is drawn: more than a picture has."""
NAN = math.nan


@dataclass(frozen=True)
class JointCurves:
    """One joint. unit: of its positions, "" for one without a name. All lists are as long as `MotionCurves.times`.

    A value that is not known is NaN.

    wanted: the set-points; actual, actual_velocities, errors: empty where only a path is known.
    """

    name: str
    unit: str
    wanted: Sequence[float]
    velocities: Sequence[float]
    accelerations: Sequence[float]
    actual: Sequence[float] = ()
    actual_velocities: Sequence[float] = ()
    errors: Sequence[float] = ()


@dataclass(frozen=True)
class MotionCurves:
    """All joints. times: seconds. late: the times of cycles that brought nothing new, or that were late themselves."""

    title: str
    subtitle: str
    times: Sequence[float]
    joints: Sequence[JointCurves]
    late: Sequence[float] = field(default=())


def curves_of_record(record: MotionRecord) -> MotionCurves:
    """Return the curves in a recording.

    Velocities and accelerations are those of the set-points, over the nominal cycle: the clock of the computer that sent them
    trembles by more than a motion changes within a cycle.
    """
    head, times = record.head, record["time"]
    ideal = [cycle * head.cycle_time for cycle in record["cycle"]]
    joints = []
    for joint in head.joints:
        wanted = record.of(joint.name, "set_point")
        joints.append(
            JointCurves(
                joint.name,
                joint.unit,
                wanted,
                velocities(ideal, wanted),
                accelerations(ideal, wanted),
                record.of(joint.name, "position"),
                record.of(joint.name, "velocity"),
                record.of(joint.name, "following_error"),
            )
        )
    counts = [record.columns.get(name, [0.0] * len(record)) for name in ("missed", "skipped")]
    late = [time for time, missed, skipped in zip(times, *counts, strict=True) if missed > 0 or skipped > 0]
    missed, skipped = (int(sum(count)) for count in counts)
    subtitle = f"{len(record)} cycles of {1000 * head.cycle_time:g} ms, {missed} missed, {skipped} skipped"
    begun = head.begun.replace("T", " ").partition(".")[0]
    return MotionCurves(f"{head.chain}: what it did", f"{subtitle}; begun {begun} UTC", times, joints, late)


def curves_of_path(file: PathFile, source: str, units: Mapping[str, str | None]) -> MotionCurves:
    """Return the curves of a path, which are those of its polynomials. units: of the joints, by name."""
    path = file.path
    times = [path.duration * place / POINTS for place in range(POINTS + 1)]
    points = [path.at(time) for time in times]
    joints = [
        JointCurves(name, units.get(name) or "", *([point[kind][number] for point in points] for kind in range(3)))
        for number, name in enumerate(file.joints)
    ]
    count = f"{len(joints)} joint{'s' * (len(joints) != 1)}"
    return MotionCurves(f"{source}: a path", f"{path.duration:.4g} s, {count}; not followed yet", times, joints)


def velocities(times: Sequence[float], positions: Sequence[float]) -> list[float]:
    """Return the slope at each position, from the one before to the one after; NaN at both ends and beside what is not known.
    times: s, one for each position."""
    inner = [
        (positions[place + 1] - positions[place - 1]) / (times[place + 1] - times[place - 1])
        for place in range(1, len(positions) - 1)
    ]
    return [NAN, *inner, NAN][: len(positions)]


def accelerations(times: Sequence[float], positions: Sequence[float]) -> list[float]:
    """Return the change of the slope at each position: of the step behind it, against the one before it; NaN as `velocities`.
    times: s, one for each position."""
    inner = []
    for place in range(1, len(positions) - 1):
        before, after = times[place] - times[place - 1], times[place + 1] - times[place]
        change = (positions[place + 1] - positions[place]) / after - (positions[place] - positions[place - 1]) / before
        inner.append(2 * change / (before + after))
    return [NAN, *inner, NAN][: len(positions)]


def largest(values: Sequence[float]) -> float | None:
    """Return the largest amount of the values that are known; None if none is."""
    return max((abs(value) for value in values if not math.isnan(value)), default=None)
