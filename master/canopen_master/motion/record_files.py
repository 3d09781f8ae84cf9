"""The files of a recording: CSV, which needs nothing, and Parquet, which needs pyarrow (the extra `parquet`).

A CSV file begins with two lines that begin with `#`: the name of the format, and its head as JSON; then come the names of the
columns, and the rows. It can be read however the program ended. `pandas.read_csv(FILE, comment="#")` reads it, too.
A Parquet file is a third of the size, and has the same head in the metadata of its schema (`canopen.recording`). It can be read
only after it was closed.
"""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, Final, Protocol

from canopen_master.errors import PackageMissingError
from canopen_master.motion.record_format import PARQUET, RecordHead, Row, is_whole

MARK: Final = "# canopen recording"
"""How a CSV recording begins."""
KEY: Final = b"canopen.recording"
"""The key of the head in the metadata of a Parquet file."""
_CHUNK_OF_CSV: Final = 100
_CHUNK_OF_PARQUET: Final = 2000
_PAUSE: Final = 0.0001
"""Seconds that the writing thread sleeps between two columns: Python runs one thread at a time, and the cycle goes first."""


class RecordFile(Protocol):
    """A file that rows are written to. chunk: how many rows are written at a time.

    `encode` is called in the turn of the cycle; `begin`, `write` and `close` in a thread of the file's own.
    """

    chunk: int

    def encode(self, row: Row) -> Any:
        """Return the row as `write` takes it."""

    def begin(self, head: RecordHead) -> None:
        """Write what stands before the rows."""

    def write(self, rows: Sequence[Any]) -> None:
        """Write rows. Raises OSError."""

    def close(self) -> None:
        """End the file. Raises OSError."""


class CsvFile:
    """A recording as CSV. Numbers are written so that they are read back exactly."""

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


def open_record(path: str | Path) -> RecordFile:
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
