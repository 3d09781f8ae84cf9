"""Paths as CSV files: a column `time` in seconds, and one for each joint.

    time, shoulder, elbow, shoulder.velocity, elbow.velocity
    0.0,  0.0,      10.0,  0.0,               0.0
    0.5,  1.5,      8.0,   2.0,               -1.0

`shoulder` or `shoulder.position` is a position in the unit of the joint; `.velocity` is per second, `.acceleration` per second².
The path passes the positions with the velocities (polynomials of degree 3), or with velocities and accelerations (degree 5).
Without velocities it is a spline, at rest at both ends, or straight lines. All joints have the same columns.

**Positions with few decimals.** A spline through them would tremble: 0.01 degrees of rounding at 10 ms are a jerk of 40,000
degrees/s³. So if the rows are samples of a motion (50 ms or less apart, with a decimal at least), no rougher than their rounding,
the spline goes through the smoothest positions within half a unit of the last decimal of the column
(canopen_proto.drives.trajectory.fitting); the first one, the last one, and holds stay. Everything else is taken as it is.

Commas, semicolons or tabs separate columns, whichever the header has; quotes around a cell are left out. Blank lines are skipped,
and lines that begin with `#`. Numbers have a decimal point. The times rise, and may begin anywhere.

One DictionaryError holds all errors of a file, each with line and column. This module takes and gives texts.
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
import math
import operator
from collections.abc import Iterator, Sequence
from enum import StrEnum
from typing import Final, NamedTuple

from canopen_data.findings import DictionaryError, Finding, Severity
from canopen_data.rows import Cell
from canopen_proto.dictionary.model import did_you_mean
from canopen_proto.drives.trajectory.fitting import smoothed
from canopen_proto.drives.trajectory.interpolation import cubic, linear, quintic
from canopen_proto.drives.trajectory.path import TIME_TOLERANCE, Path, PathError

__all__ = ["PathFile", "read_path", "write_path"]

TIME: Final = "time"
POSITION, VELOCITY, ACCELERATION = "position", "velocity", "acceleration"
QUANTITIES: Final = (POSITION, VELOCITY, ACCELERATION)
MAX_ROWS: Final = 1_000_000
"""More rows than 1 kHz gives in a quarter of an hour are a recording that was chosen by mistake, and would fill the memory."""
_FINEST: Final = 1e-10
"""Numbers with more decimals are those of a computer: nobody has rounded them."""
_COARSEST: Final = 0.1
"""Whole numbers are meant: a person has chosen them."""
_MOST_DECIMALS: Final = 400
"""No float has more."""
_SEPARATORS: Final = ",;\t"
_BYTE_ORDER_MARK: Final = "\ufeff"


class Between(StrEnum):
    """How a path goes between positions that have no velocities."""

    SPLINE = "spline"
    LINES = "lines"


class Rounding(NamedTuple):
    """How exactly a file gives the positions of a joint.

    unit: of the last decimal, in the unit of the joint. step: the shortest time from row to row, in s. moved: how many rows the
    path passes within half a unit, instead of exactly, to be smooth.
    """

    unit: float
    step: float
    moved: int

    @property
    def is_smoothed(self) -> bool:
        """Whether the path goes through the smoothest positions within half a unit."""
        return self.moved > 0

    @property
    def jerk(self) -> float:
        """The jerk that rounding alone can make: a third difference of eight halves of a unit, over three steps."""
        return 4.0 * self.unit / self.step**3

    def decimals_for(self, jerk: float) -> int:
        """Return how many decimals keep the jerk of rounding below a tenth of this one."""
        return max(0, math.ceil(-math.log10(0.1 * jerk * self.step**3 / 4.0) - 1e-9))


class PathFile(NamedTuple):
    """A path, and the names of its joints in its order. roundings: of each joint."""

    joints: tuple[str, ...]
    path: Path
    roundings: tuple[Rounding, ...]


def read_path(text: str, source: str = "", *, joints: Sequence[str] = (), between: Between = Between.SPLINE) -> PathFile:
    """Return the path of a CSV text. source: the file's name, for errors.

    joints: the joints that the path has to have; the path has their order. None named: those of the file, in its order.
    between: what a file without velocities means. Raises DictionaryError, which holds every error.
    """
    findings: list[Finding] = []
    lines = _rows(text.removeprefix(_BYTE_ORDER_MARK), source)
    header = next(lines, None)
    if header is None:
        raise DictionaryError([Finding(Severity.ERROR, "empty", f"there is no header. {_EXPECTED}", source)])
    columns = _Columns(header, joints, findings)
    times: list[float] = []
    values: list[list[float]] = []
    decimals = [0] * len(header)
    for cells in itertools.islice(lines, MAX_ROWS + 1):
        if len(cells) != len(header):
            message = f"this row has {len(cells)} columns, the header has {len(header)}"
            findings.append(cells[-1].error("columns", message))
            continue
        numbers = [_number(cell, findings) for cell in cells]
        if columns.time is not None:
            time = numbers[columns.time]
            if times and time <= times[-1]:
                findings.append(
                    cells[columns.time].error("time", f"the times must rise; before this {time!r} comes {times[-1]!r}")
                )
            times.append(time)
        values.append(numbers)
        decimals = [max(most, _decimals(cell.text)) for most, cell in zip(decimals, cells, strict=True)]
    if len(values) > MAX_ROWS:
        findings.append(Finding(Severity.ERROR, "rows", f"a path has {MAX_ROWS:,} rows at most", source))
    if len(values) < 2 and not findings:
        findings.append(Finding(Severity.ERROR, "rows", f"a path needs two rows at least; there are {len(values)}", source))
    if findings:
        raise DictionaryError(sorted(findings, key=lambda each: (each.line, each.column)))
    rows = [[[row[place] for place in own] for row in values] for own in columns.places]
    is_spline = len(rows) == 1 and between is Between.SPLINE
    try:
        roundings = _smooth(times, rows[0], [10.0 ** -decimals[place] for place in columns.places[0]], is_spline)
        return PathFile(columns.joints, _path(times, rows, between), roundings)
    except PathError as error:  # numbers at the end of what floats can be
        raise DictionaryError([Finding(Severity.ERROR, "path", str(error), source)]) from error


def write_path(path: Path, joints: Sequence[str], step: float) -> str:
    """Return the path as a CSV text, with velocities and accelerations.

    joints: their names. step: seconds from row to row; the end and all knots have rows too, so that a path whose accelerations
    do not jump is read back as it is. Raises PathError for names or a step that cannot be.
    """
    if len(set(joints)) != path.joints or not all(_is_name(name) for name in joints):
        raise PathError(f"A file of a path with {path.joints} joints cannot name them {', '.join(map(repr, joints))}. {_NAMES}")
    if not (0.0 < step < math.inf and path.duration / step <= MAX_ROWS):
        raise PathError(f"A path of {path.duration:g} s cannot be written in steps of {step!r} s: {MAX_ROWS:,} rows at most.")
    names = [TIME, *joints, *(f"{name}.{quantity}" for quantity in (VELOCITY, ACCELERATION) for name in joints)]
    lines = [",".join(names)]
    for time in _times(path, step):
        point = path.at(time)
        lines.append(",".join(map(repr, (time, *point.positions, *point.velocities, *point.accelerations))))
    return "\n".join(lines) + "\n"


_EXPECTED: Final = 'Try: a first line such as "time, shoulder, elbow"'
_NAMES: Final = (
    f'Try: one name for each joint, each once, not "{TIME}", without separators, quotes, "#", white space at an end, '
    "or the ending of another column."
)


class _Columns:
    """The header of a path file: where the time and the values of each joint stand.

    time: None if there is no such column. places: for positions, velocities, accelerations, as far as the file has them, the
    column of each joint.
    """

    def __init__(self, header: list[Cell], joints: Sequence[str], findings: list[Finding]) -> None:
        self.time: int | None = None
        found: dict[str, dict[str, int]] = {quantity: {} for quantity in QUANTITIES}
        for place, cell in enumerate(header):
            name, quantity = _split(cell.text)
            is_time = cell.text == TIME
            if not name:
                findings.append(cell.error("column", "this column has no name"))
            elif self.time is not None if is_time else name in found[quantity]:
                findings.append(cell.error("column", f"there is another column {cell.shown}"))
            elif is_time:
                self.time = place
            elif joints and name not in joints:
                findings.append(cell.error("joint", f"there is no joint {name!a}{did_you_mean(name, joints)}"))
            else:
                found[quantity][name] = place
        last = header[-1]
        if self.time is None:
            findings.append(header[0].error("column", f'there is no column "{TIME}". {_EXPECTED}'))
        self.joints: Final = tuple(joints or found[POSITION])
        if not self.joints and not findings:
            findings.append(last.error("column", f"there is no column of a joint. {_EXPECTED}"))
        used = [quantity for quantity in QUANTITIES if quantity == POSITION or found[quantity]]
        if used[-1] == ACCELERATION and VELOCITY not in used:
            used.insert(1, VELOCITY)
        for quantity in used:
            named = [name for each in QUANTITIES for name in found[each]]
            for name in dict.fromkeys([*self.joints, *(() if joints else named)]):
                if name not in found[quantity]:
                    missing = name if quantity == POSITION else f"{name}.{quantity}"
                    findings.append(last.error("column", f'there is no column "{missing}": all joints have the same columns'))
        self.places = [[found[quantity].get(name, 0) for name in self.joints] for quantity in used]


def _split(text: str) -> tuple[str, str]:
    """Return the joint and the quantity that a column names."""
    name, dot, quantity = text.rpartition(".")
    return (name, quantity) if dot and quantity in QUANTITIES else (text, POSITION)


def _is_name(name: str) -> bool:
    """Return whether a joint of this name is read back from a header."""
    separated = any(each in name for each in f'{_SEPARATORS}"\n\r')
    return (
        bool(name.strip() == name != "")
        and name != TIME
        and not separated
        and name[0] != "#"
        and _split(name) == (name, POSITION)
    )


def _rows(text: str, source: str) -> Iterator[list[Cell]]:
    """Yield the cells of each line that has any."""
    separator = ""
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        separator = separator or next((each for each in ";\t" if each in line), ",")
        cells, column = [], 1
        for part in line.split(separator):
            begin = column + len(part) - len(part.lstrip())
            cells.append(Cell(part.strip().strip('"').strip(), source, number, begin))
            column += len(part) + 1
        yield cells


def _number(cell: Cell, findings: list[Finding]) -> float:
    try:
        number = float(cell.text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        findings.append(cell.error("number", f"{cell.shown} is no finite number; a decimal point is a point"))
    return number


def _decimals(text: str) -> int:
    """Return the place of the last decimal of a number; 0 for what is none."""
    mantissa, _, exponent = text.lower().partition("e")
    try:
        return min(len(mantissa.partition(".")[2]) - int(exponent or 0), _MOST_DECIMALS)
    except ValueError:
        return 0


def _smooth(times: list[float], rows: list[list[float]], units: list[float], is_spline: bool) -> tuple[Rounding, ...]:
    """Put the smoothest positions into the rows of a spline, where rounding makes them rough."""
    steps = [end - begin for begin, end in itertools.pairwise(times)]
    found = []
    for joint, unit in enumerate(units):
        column = [row[joint] for row in rows]
        smooth = column
        if is_spline and _FINEST <= unit <= _COARSEST:
            with contextlib.suppress(ArithmeticError, ValueError):  # beyond what floats can be: the samples stay
                smooth = smoothed(steps, column, unit)
        moved = sum(map(operator.ne, smooth, column))
        for row, position in zip(rows, smooth, strict=True):
            row[joint] = position
        found.append(Rounding(unit, min(steps), moved))
    return tuple(found)


def _path(times: list[float], rows: list[list[list[float]]], between: Between) -> Path:
    if len(rows) == 1:
        return linear(times, rows[0]) if between is Between.LINES else cubic(times, rows[0])
    return cubic(times, rows[0], rows[1]) if len(rows) == 2 else quintic(times, rows[0], rows[1], rows[2])


def _times(path: Path, step: float) -> Iterator[float]:
    """Yield the times of the rows: each step, each knot, the end; none of them twice."""
    steps = (number * step for number in range(math.ceil(path.duration / step)))
    knots = (itertools.accumulate([segment.duration for segment in row]) for row in path.segments)
    last = -math.inf
    for time in heapq.merge(steps, *knots):
        if time - last > TIME_TOLERANCE * max(1.0, path.duration) and time < path.duration:
            last = time
            yield time
    yield path.duration
