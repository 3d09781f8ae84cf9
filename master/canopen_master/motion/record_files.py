"""The files of a recording: CSV, which needs nothing, and Parquet, which needs pyarrow (the extra `parquet`).

A CSV file begins with two lines that begin with `#`: the name of the format, and its head as JSON; then come the names of the
columns, and the rows. It can be read however the program ended. `pandas.read_csv(FILE, comment="#")` reads it, too.
A Parquet file is a third of the size, and has the same head in the metadata of its schema (`canopen.recording`). It can be read
only after it was closed.

**The columns.** There is one row for each SYNC. Its first columns are the chain's (`OF_CHAIN`), then come those of each joint
(`OF_JOINT`), named `JOINT.QUANTITY`. A value that is not known is left out: an empty cell in CSV, null in Parquet.

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

import csv
import io
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final, TypeAlias

from canopen_master.errors import PackageMissingError
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


MARK: Final = "# canopen recording"
"""How a CSV recording begins."""
KEY: Final = b"canopen.recording"
"""The key of the head in the metadata of a Parquet file."""
_CHUNK_OF_CSV: Final = 100
_CHUNK_OF_PARQUET: Final = 2000
_PAUSE: Final = 0.0001
"""Seconds that the writing thread sleeps between two columns: Python runs one thread at a time, and the cycle goes first."""


class CsvFile:
    """A recording as CSV. Numbers are written so that they are read back exactly. chunk: how many rows are written at a time.

    `encode` is called in the turn of the cycle; `begin`, `write` and `close`, which raise OSError, in a thread of the file's own.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self.chunk = _CHUNK_OF_CSV
        self._file = file

    def encode(self, row: Row) -> str:
        return repr(row)[1:-1].replace("None", "").replace(" ", "")  # far cheaper than a call for each value

    def begin(self, head: RecordHead) -> None:
        names = io.StringIO()
        csv.writer(names, lineterminator="\n").writerow(head.columns)
        self._file.write(f"{MARK}\n# {head.as_text()}\n{names.getvalue()}".encode())

    def write(self, rows: Sequence[Any]) -> None:
        self._file.write(("\n".join(rows) + "\n").encode())
        self._file.flush()

    def close(self) -> None:
        self._file.close()


class ParquetFile:
    """A recording as Parquet: 64-bit floating point, and 32-bit whole numbers."""

    def __init__(self, file: IO[bytes]) -> None:
        """Raises PackageMissingError without pyarrow."""
        self._pyarrow, self._parquet = pyarrow_modules(PARQUET)
        self.chunk = _CHUNK_OF_PARQUET
        self._file = file
        self._schema: Any = None
        self._writer: Any = None

    def encode(self, row: Row) -> Row:
        return row

    def begin(self, head: RecordHead) -> None:
        pyarrow = self._pyarrow
        fields = [(name, pyarrow.int32() if is_whole(name) else pyarrow.float64()) for name in head.columns]
        self._schema = pyarrow.schema(fields).with_metadata({KEY: head.as_text().encode()})
        self._writer = self._parquet.ParquetWriter(self._file, self._schema, compression="zstd")

    def write(self, rows: Sequence[Any]) -> None:
        columns = []
        for number, field in enumerate(self._schema):
            columns.append(self._pyarrow.array([row[number] for row in rows], field.type))
            time.sleep(_PAUSE)
        self._writer.write_table(self._pyarrow.Table.from_arrays(columns, schema=self._schema))

    def close(self) -> None:
        try:
            if self._writer is not None:
                self._writer.close()
        finally:
            self._file.close()


def open_record(path: str | Path) -> CsvFile | ParquetFile:
    """Open a file for a recording, as its ending says. An older file is overwritten. Raises OSError, PackageMissingError. path:
    ends with .parquet for Parquet; anything else is CSV."""
    is_parquet = Path(path).suffix.lower() == PARQUET
    if is_parquet:
        pyarrow_modules(str(path))  # before an older file is emptied
    file = open(path, "wb")  # noqa: SIM115 - until it is closed by the thread
    return ParquetFile(file) if is_parquet else CsvFile(file)


def pyarrow_modules(what: str) -> tuple[Any, Any]:
    """Return the modules `pyarrow` and `pyarrow.parquet`. what: the file, for the message. Raises PackageMissingError without
    them."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as missing:
        raise PackageMissingError("pyarrow", "parquet", f"a Parquet file ({what})", missing) from missing
    return pyarrow, pyarrow.parquet
