"""Read a recording back: CSV or Parquet, told apart by how the file begins.

    record = read_record("run.csv")
    record["joint1.position"]

Each column is an array of floats with NaN where a value is missing. A large recording is better read by pandas or polars.
"""

from __future__ import annotations

import csv
import math
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final

from canopen_master.motion.record_files import KEY, MARK, NEEDED, UNREADABLE, RecordError, RecordHead, head_of, pyarrow_modules

_PARQUET_MARK: Final = b"PAR1"


@dataclass(frozen=True, slots=True)
class MotionRecord:
    """A recording. columns: by name, all of one length, NaN for a value that is missing. source: the file.

    is_cut: the last row was not whole, and was left out: the program was killed while it wrote, or writes still.
    """

    head: RecordHead
    columns: Mapping[str, Sequence[float]]
    source: str
    is_cut: bool = False

    def __getitem__(self, column: str) -> Sequence[float]:
        return self.columns[column]

    def __len__(self) -> int:
        return len(self.columns["time"])

    def of(self, joint: str, quantity: str) -> Sequence[float]:
        """Return a column of a joint; all NaN if the file does not have it. quantity: the name behind the joint's, such as
        "actual"."""
        return self.columns.get(f"{joint}.{quantity}") or array("d", [math.nan]) * len(self)


def is_record(path: str | Path) -> bool:
    """Return whether a file begins as a recording does. Raises OSError. path: of the file."""
    with open(path, "rb") as file:
        return _kind(file) is not None


def read_record(path: str | Path) -> MotionRecord:
    """Read a recording. Raises RecordError, which says where the file is damaged, or what it is not."""
    try:
        with open(path, "rb") as file:
            kind = _kind(file)
            if kind is None:
                raise _unreadable(path, f"it begins neither with {MARK!r} nor as a Parquet file", "the file of --record")
            return _read_parquet(path) if kind == _PARQUET_MARK else _read_csv(path, file)
    except OSError as error:
        raise _unreadable(path, error.strerror or str(error), "its path") from error


def _kind(file: IO[bytes]) -> bytes | None:
    begin = file.read(len(MARK))
    file.seek(0)
    kinds = (_PARQUET_MARK, MARK.encode())
    return next((kind for kind in kinds if begin.startswith(kind)), None)


def _unreadable(path: str | Path, seen: str, *tries: str) -> RecordError:
    return RecordError(UNREADABLE, f"cannot read the recording {path}", seen=seen, tries=tries)


def _head(path: str | Path, text: str, columns: Sequence[str]) -> RecordHead:
    try:
        head = head_of(text)
    except ValueError as error:
        raise _unreadable(path, str(error)) from None
    missing = [name for name in NEEDED if name not in columns]
    if missing:
        raise _unreadable(path, f"it has no column {' and no column '.join(missing)}")
    return head


def _read_csv(path: str | Path, file: IO[bytes]) -> MotionRecord:
    lines = _TextLines(path, file)
    rows = csv.reader(lines)
    next(lines)
    head_text = next(lines, "")
    names = next(rows, [])
    head = _head(path, head_text.removeprefix("# "), names)
    columns = [array("d") for _ in names]
    for row in rows:
        if lines.was_cut:
            break
        if len(row) != len(names):
            raise _unreadable(path, f"line {lines.number} has {len(row)} cells, and there are {len(names)} columns")
        try:
            values = [float(cell) if cell else math.nan for cell in row]
        except ValueError:
            name, cell = next((name, cell) for name, cell in zip(names, row, strict=True) if not _is_number(cell))
            raise _unreadable(path, f"line {lines.number}, column {name}: {cell!r} is no number") from None
        for column, value in zip(columns, values, strict=True):
            column.append(value)
    return MotionRecord(head, dict(zip(names, columns, strict=True)), str(path), lines.was_cut)


def _is_number(cell: str) -> bool:
    try:
        float(cell or "0")
    except ValueError:
        return False
    return True


class _TextLines:
    """The lines of a file as text. number: of the last one, from 1. was_cut: it had no end."""

    def __init__(self, path: str | Path, file: IO[bytes]) -> None:
        self._path = path
        self._file = file
        self.number = 0
        self.was_cut = False

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        line = next(self._file)
        self.number += 1
        self.was_cut = not line.endswith(b"\n")
        try:
            return line.decode()
        except UnicodeDecodeError:
            raise _unreadable(self._path, f"line {self.number} is no UTF-8 text") from None


def _read_parquet(path: str | Path) -> MotionRecord:
    pyarrow, parquet = pyarrow_modules(str(path))
    try:
        table = parquet.read_table(path, memory_map=True)
        metadata = table.schema.metadata or {}
        if KEY not in metadata:
            raise _unreadable(path, f"it is a Parquet file of something else: its schema has no {KEY.decode()}")
        head = _head(path, metadata[KEY].decode(errors="replace"), table.column_names)
        columns = {
            name: array("d", (math.nan if value is None else value for value in column.to_pylist()))
            for name, column in zip(table.column_names, table.columns, strict=True)
        }
    except pyarrow.ArrowInvalid as error:
        cause = "the program that wrote it was killed before it closed the file; a CSV recording can be read even then"
        raise RecordError(
            UNREADABLE, f"cannot read the recording {path}", seen=str(error).partition("\n")[0], cause=cause
        ) from error
    return MotionRecord(head, columns, str(path))
