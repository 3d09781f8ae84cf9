"""`Path`: the positions of all joints of a chain over time, each as a row of polynomials.

Each joint has its own knots. Between two knots its position is a polynomial of the time since the first of them, of degree 5 or
less: so a plan of constant jerk, a spline and a straight line are the same thing here. At a knot the derivatives are those of the
segment that begins there.

A path is geometry with a time of its own. `PathClock` decides how fast that time runs.

Units: the user's unit of each joint, seconds.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple, TypeAlias, final

from canopen_proto.compiling import mypyc_attr
from canopen_proto.machine import LocalProtocolError

MAX_DEGREE: Final = 5
"""Enough for position, velocity and acceleration at both ends of a segment."""
_NONE: Final = (0.0,) * (MAX_DEGREE + 1)
TIME_TOLERANCE: Final = 1e-9
"""By how much the durations of two joints may differ: in s, and as a part of durations above 1 s. Sums of floats need less."""
POSITION_TOLERANCE: Final = 1e-8
"""How far apart two segments may be at their knot: in the user's unit, and as a part of positions above 1."""
LARGEST: Final = 1e100
"""No position, and no coefficient, is larger. So nothing that is calculated of a path becomes infinite, or no number: that would
be above no limit."""


@mypyc_attr(native_class=False)
class PathError(LocalProtocolError, ValueError):
    """These values do not make a path, or this path cannot be followed. The text says where, and what to try."""


class Segment(NamedTuple):
    """A piece of one joint's path: the sum of `coefficients[k]` times the k-th power of the time since its own start.

    duration: in seconds, above 0. coefficients: one to six finite numbers; the first one is the position at the start. The sum
    of the amounts of their terms is LARGEST at most.
    """

    duration: float
    coefficients: tuple[float, ...]


class PathPoint(NamedTuple):
    """Where the joints are at one time: one value for each joint, in the user's unit, per second and per second²."""

    positions: list[float]
    velocities: list[float]
    accelerations: list[float]


Piece: TypeAlias = tuple[float, float, float, float, float, float, float, float]
"""The begin of a segment in the path's time, its duration, and its six coefficients."""


@final
class Path:
    """A path of one or more joints. It never changes.

    joints: for each joint its segments, in order. All joints need the same duration (TIME_TOLERANCE), and no position may jump
    (POSITION_TOLERANCE). Velocities may jump; `first_violation` finds such jumps.

    Raises PathError that names joint and segment, both counted from 0.
    """

    __slots__ = ("_begins", "duration", "joints", "pieces", "segments")

    def __init__(self, joints: Sequence[Sequence[Segment]]) -> None:
        if not joints:
            raise PathError("A path needs at least one joint. Try: give one row of segments for each joint.")
        self.segments: Final = tuple([tuple(row) for row in joints])
        """The segments of each joint."""
        self.joints: Final = len(self.segments)
        """How many joints it has."""
        self._begins: list[list[float]] = []
        self.pieces: Final[list[list[Piece]]] = []
        """The same, as they are evaluated."""
        ends = []
        for joint, row in enumerate(self.segments):
            pieces = _pieces(joint, row)
            self._begins.append([piece[0] for piece in pieces])
            self.pieces.append(pieces)
            ends.append(pieces[-1][0] + pieces[-1][1])
        self.duration: Final = max(ends)
        """In seconds."""
        for joint, end in enumerate(ends):
            if self.duration - end > TIME_TOLERANCE * max(1.0, self.duration):
                raise PathError(
                    f"All joints of a path take one time: joint {joint} ends at {end:g} s, joint {ends.index(self.duration)} "
                    f"at {self.duration:g} s. Try: let a joint that is done earlier rest, by a segment of one coefficient."
                )

    def at(self, time: float) -> PathPoint:
        """Return the point at `time` seconds; before 0 that at 0, beyond `duration` that at the end."""
        clamped = min(max(time, 0.0), self.duration)
        positions, velocities, accelerations = [], [], []
        for begins, pieces in zip(self._begins, self.pieces, strict=True):
            begin, duration, c0, c1, c2, c3, c4, c5 = pieces[bisect_right(begins, clamped) - 1]
            t = min(clamped - begin, duration)
            positions.append(c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))))
            velocities.append(c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * (5.0 * c5)))))
            accelerations.append(2.0 * c2 + t * (6.0 * c3 + t * (12.0 * c4 + t * (20.0 * c5))))
        return PathPoint(positions, velocities, accelerations)

    @property
    def start(self) -> PathPoint:
        """The point at time 0."""
        return self.at(0.0)

    @property
    def end(self) -> PathPoint:
        """The point at `duration`."""
        return self.at(self.duration)

    def stretched(self, factor: float) -> Path:
        """Return the same positions over `factor` times the duration: the speeds are divided by the factor, the accelerations by
        its square. factor: above 0; below 1 the path becomes faster."""
        if not 0.0 < factor < math.inf:
            raise PathError(f"A path cannot take {factor!r} times as long. Try: a finite number above 0.")
        return Path(
            [[Segment(d * factor, tuple([c / factor**k for k, c in enumerate(row)])) for d, row in own] for own in self.segments]
        )

    def __repr__(self) -> str:
        return f"<Path of {self.joints} joint{'s' * (self.joints != 1)}, {self.duration:g} s>"


def _pieces(joint: int, row: Sequence[Segment]) -> list[Piece]:
    """Check the segments of one joint, and return them as they are evaluated."""
    if not row:
        raise PathError(f"Joint {joint} of the path has no segment. Try: one segment of one coefficient for a joint that rests.")
    pieces: list[Piece] = []
    begin = 0.0
    end = math.nan
    for number, (duration, coefficients) in enumerate(row):
        if not (0.0 < duration < math.inf and 1 <= len(coefficients) <= MAX_DEGREE + 1 and all(map(is_number, coefficients))):
            raise _no_segment(joint, number, begin, duration, coefficients)
        c0, c1, c2, c3, c4, c5 = (*map(float, coefficients), *_NONE[len(coefficients) :])
        t = max(duration, 1.0)
        if abs(c0) + t * (abs(c1) + t * (abs(c2) + t * (abs(c3) + t * (abs(c4) + t * abs(c5))))) > LARGEST:
            raise PathError(f"{_name_of(joint, number, begin)} goes beyond {LARGEST:g}. Try: the unit of the joint, and seconds.")
        if number and abs(c0 - end) > POSITION_TOLERANCE * max(1.0, abs(end)):
            raise PathError(
                f"{_name_of(joint, number, begin)} starts at {c0!r}, but the segment before ends at {end!r}. "
                "Try: the same position for both."
            )
        pieces.append((begin, float(duration), c0, c1, c2, c3, c4, c5))
        end = c0 + duration * (c1 + duration * (c2 + duration * (c3 + duration * (c4 + duration * c5))))
        begin += duration
    return pieces


def _no_segment(joint: int, number: int, begin: float, duration: float, coefficients: Sequence[float]) -> PathError:
    """Return the error for a segment that is none by itself."""
    where = _name_of(joint, number, begin)
    if not 0.0 < duration < math.inf:
        return PathError(f"{where} has the duration {duration!r}. Try: a finite number of seconds above 0.")
    if not 1 <= len(coefficients) <= MAX_DEGREE + 1:
        return PathError(
            f"{where} has {len(coefficients)} coefficients. Try: 1 to {MAX_DEGREE + 1}, the position at its start first."
        )
    return PathError(f"{where} has a coefficient that is no finite number up to {LARGEST:g}: ({shown(coefficients)}).")


def is_number(value: float) -> bool:
    """Return whether a value is a finite number up to LARGEST. value: an int of any size, too."""
    return -LARGEST <= value <= LARGEST


def shown(values: Iterable[float]) -> str:
    """Return numbers as text. Python writes no int of more than 4300 digits: a very large one is only described."""
    return ", ".join([
        f"a whole number of {value.bit_length()} bits" if isinstance(value, int) and not is_number(value) else repr(value)
        for value in values
    ])  # fmt: skip


def _name_of(joint: int, number: int, begin: float) -> str:
    return f"Segment {number} of joint {joint}, which begins at {begin:g} s,"
