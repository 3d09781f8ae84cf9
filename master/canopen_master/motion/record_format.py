"""The format of a recording: which columns it has, what they mean, and the words about the whole that stand before them.

There is one row for each SYNC. Its first columns are the chain's (`OF_CHAIN`), then come those of each joint (`OF_JOINT`), named
`JOINT.QUANTITY`. A value that is not known is left out: an empty cell in CSV, null in Parquet.

    cycle            the number of the period, from 0. Periods without a SYNC count; so a number that is missing although
                     `skipped` does not tell it is a row that was lost
    time             seconds since the first row, by the clock of this computer, when the SYNC was sent
    skipped          periods without a SYNC right before this one
    missed           1: no new set-points went along with this SYNC, though a loop had to give some
    rate             how fast the path's own time runs, 0 to 1; left out while no path with a clock runs
    set_point        sent behind this SYNC, in the joint's unit, as the program gave it (before it is rounded to counts); left out
                     while the joint follows none
    position         actual position, as the drive told it in answer to this SYNC
    velocity         actual velocity, per second
    following_error  set-point minus position, both of one instant: the set-point is that of two rows before (a drive takes a
                     set-point at the SYNC after it, and reaches it at the next one)
    torque           actual torque, as a share of the rated torque
    controlword      sent behind this SYNC
    statusword       in answer to this SYNC
    mode             the active mode of operation (0x6061), as last heard
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Final, TypeAlias

from canopen_proto.explained import Explained

VERSION: Final = 1
OF_CHAIN: Final = ("cycle", "time", "skipped", "missed", "rate")
OF_JOINT: Final = ("set_point", "position", "velocity", "following_error", "torque", "controlword", "statusword", "mode")
WHOLE: Final = frozenset({"cycle", "skipped", "missed", "controlword", "statusword", "mode"})
"""The columns of whole numbers."""
NEEDED: Final = ("cycle", "time")
"""The columns without which a file is no recording; any other may be missing."""
INCOMPLETE: Final = "CO343"
UNREADABLE: Final = "CO344"
PARQUET: Final = ".parquet"
"""The ending of a file that is written as Parquet; every other one is CSV."""

Value: TypeAlias = "float | int | None"
Row: TypeAlias = tuple[Value, ...]


class RecordError(Explained, Exception):
    """A recording is not complete, or cannot be read; see Explained for the fields."""


@dataclass(frozen=True, slots=True)
class RecordedJoint:
    """One joint of a recording. unit: of its positions: "degree", "radian" ..., "count", or "" for a unit without a name.

    node: its place, for people: "node 3 on can0".
    """

    name: str
    unit: str
    node: str


@dataclass(frozen=True, slots=True)
class RecordHead:
    """The head of a recording. cycle_time: seconds between two SYNCs. begun: date and time of day, UTC, ISO 8601."""

    chain: str
    cycle_time: float
    joints: tuple[RecordedJoint, ...]
    begun: str

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of all columns, in their order."""
        return (*OF_CHAIN, *(f"{joint.name}.{quantity}" for joint in self.joints for quantity in OF_JOINT))

    def as_text(self) -> str:
        """Return it as one line of JSON."""
        joints = [{"name": each.name, "unit": each.unit, "node": each.node} for each in self.joints]
        told = {"chain": self.chain, "cycle_time": self.cycle_time, "begun": self.begun, "joints": joints}
        return json.dumps({"version": VERSION, **told})


def head_of(text: str) -> RecordHead:
    """Return the head that `as_text` wrote. Raises ValueError, in words, if it is none, or one of another version."""
    try:
        told = json.loads(text)
        version = told["version"]
        if version != VERSION:
            raise ValueError(f"it has version {version!r} of the format, and this program knows version {VERSION}")
        joints = tuple(RecordedJoint(str(each["name"]), str(each["unit"]), str(each["node"])) for each in told["joints"])
        return RecordHead(str(told["chain"]), float(told["cycle_time"]), joints, str(told["begun"]))
    except (json.JSONDecodeError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"its head is damaged ({type(error).__name__})") from None


def is_whole(column: str) -> bool:
    """Return whether a column has whole numbers."""
    return column.rpartition(".")[2] in WHOLE
