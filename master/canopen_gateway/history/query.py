"""`History`: SQL over what `record_fleet` has written, by DuckDB.

    with open_history(Path("history")) as history:
        table = history.ask("SELECT place, avg(value) FROM samples WHERE name = 'statusword' GROUP BY place")
        for row in table.rows: ...

The views (VIEWS) need no knowledge of the folder. SQL reads them, and nothing else: DuckDB is told to reach no file, no
extension and no Python object, its settings are locked, and one SELECT is taken, nothing that changes something. The files are
read by pyarrow. So a query that somebody sent may be run.
"""

from __future__ import annotations

import decimal
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from canopen_gateway.errors import HistoryError, HistoryQueryError
from canopen_gateway.fleet.keys import FleetPlace
from canopen_gateway.history.layout import HOUR, RECORDER, HistoryFile, files_in
from canopen_gateway.history.rows import MARK, VERSION, schema
from canopen_master.errors import PackageMissingError
from canopen_master.motion.record_files import pyarrow_modules
from canopen_proto.explained import counted

if TYPE_CHECKING:
    import duckdb

VIEWS: Final = {
    "samples": """
        SELECT coalesce(site_time, recorder_time) AS time, site || '/' || bus || '/' || node AS place, name, object,
            coalesce(real, integer::DOUBLE) AS value, integer, real, text, type, unit, raw, pdo, problem,
            site, bus, node, site_time, recorder_time
        FROM recorded WHERE kind = 'sample'""",
    "states": """
        SELECT coalesce(site_time, recorder_time) AS time, site || '/' || bus || '/' || node AS place, text AS state,
            site, bus, node, site_time, recorder_time
        FROM recorded WHERE kind = 'state'""",
    "emergencies": """
        SELECT coalesce(site_time, recorder_time) AS time, site || '/' || bus || '/' || node AS place,
            integer::INTEGER AS code, text, raw, site, bus, node, site_time, recorder_time
        FROM recorded WHERE kind = 'emergency'""",
    "runs": """
        SELECT text AS run, min(recorder_time) AS began, max(recorder_time) AS written, bool_or(kind = 'ended') AS ended
        FROM recorded WHERE kind IN ('began', 'written', 'ended') GROUP BY text""",
    "gaps": """
        SELECT coalesce(begun, recorder_time) AS begun, coalesce(site_time, recorder_time) AS until, site || '/' || bus ||
            CASE WHEN node = 0 THEN '' ELSE '/' || node END AS place, pdo, lost, problem AS why, site, bus, node
        FROM recorded WHERE kind = 'gap'
        UNION ALL
        SELECT recorder_time, back, site || '/' || bus || CASE WHEN node = 0 THEN '' ELSE '/' || node END, NULL, NULL,
            'it was away', site, bus, node
        FROM (SELECT *, lead(recorder_time) OVER (PARTITION BY site, bus, node ORDER BY recorder_time) AS back
            FROM recorded WHERE kind IN ('gone', 'appeared'))
        WHERE kind = 'gone'
        UNION ALL
        SELECT written, lead(began) OVER (ORDER BY began), '@recorder/-', NULL, NULL,
            CASE WHEN ended THEN 'the recorder was ended' ELSE 'the recorder was killed, or runs' END, '@recorder', '-', 0
        FROM runs""",
    "nodes": """
        SELECT place, count(*) AS samples, count(DISTINCT name) AS objects, min(time) AS first, max(time) AS last,
            count(problem) AS problems
        FROM samples GROUP BY place""",
}
"""What SQL sees, by name, in the order in which they are made."""
VIEW_NAMES: Final = ", ".join(VIEWS)
_SETTINGS: Final = {
    "enable_external_access": "false",
    "autoinstall_known_extensions": "false",
    "autoload_known_extensions": "false",
    "python_enable_replacements": "false",
    "temp_directory": "",  # a query that is too large fails, and fills no disk
}
_BATCH: Final = 10_000
_EXPLAIN: Final = re.compile(r"\A\s*EXPLAIN\b(\s*ANALYZE\b)?(\s*\((ANALYZE|FORMAT)\b[^()]*\))?", re.IGNORECASE)


class HistoryTable(NamedTuple):
    """What a query has answered. columns, types: of each column, as SQL names them. rows: one after the other, as plain values:
    whole numbers exact, times as ISO 8601 with ns, in UTC; bytes in hexadecimal."""

    columns: Sequence[str]
    types: Sequence[str]
    rows: Iterator[tuple[Any, ...]]


class History:
    """See this module's text; made by `open_history`. files: those that a query reads. foreign: files in the folder that are none
    of a history, and were left alone."""

    def __init__(self, files: Sequence[HistoryFile], foreign: Sequence[Path], connection: duckdb.DuckDBPyConnection) -> None:
        self.files = files
        self.foreign = foreign
        self._connection = connection

    def ask(self, sql: str, values: Sequence[Any] = ()) -> HistoryTable:
        """Run one SELECT. values: for each ? in it. Raises HistoryQueryError if the SQL is wrong, is no SELECT, or reaches for
        something else than the views; so does the iterator over its rows."""
        import duckdb

        try:
            statements = self._connection.extract_statements(sql)
            # EXPLAIN ANALYZE carries out what it explains, so that has to be a SELECT, too
            asked = self._connection.extract_statements(_EXPLAIN.sub("", sql, count=1))
            if len(statements) != 1 or [each.type for each in asked] != [duckdb.StatementType.SELECT]:
                raise HistoryQueryError(
                    "this is not one SELECT", seen=sql[:200], cause="a history is only read", tries=(f"SELECT of {VIEW_NAMES}",)
                )
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # that Arrow is not the form of the DB-API
                reader: Any = self._connection.execute(statements[0], list(values)).to_arrow_reader(_BATCH)
            names = [str(each.name) for each in reader.schema]
            return HistoryTable(names, [str(each.type) for each in reader.schema], self._rows(reader))
        except duckdb.Error as error:
            raise _wrong(error) from error

    def _rows(self, reader: Any) -> Iterator[tuple[Any, ...]]:
        import duckdb

        try:
            for batch in reader:
                yield from zip(*(_plain_column(column) for column in batch.columns), strict=True)
        except (duckdb.Error, OSError) as error:
            raise _wrong(error) from error


@contextmanager
def open_history(
    folder: Path, *, places: Sequence[FleetPlace] = (), since: datetime | None = None, until: datetime | None = None
) -> Iterator[History]:
    """Open what was recorded in a folder, while the block runs.

    places: only these, and the recorder's own rows; each part may be "*", and node_id -1. since, until: only between these times
    of the recorder's clock. Each file is looked at before a query: one that is half, or was written by somebody else under such
    a name, is an error that names it. Raises HistoryError, PackageMissingError.
    """
    try:
        import duckdb
    except ImportError as missing:
        raise PackageMissingError("duckdb", "history", "a query of a history", missing) from missing
    pyarrow_modules("a history")
    import pyarrow.dataset as dataset

    if not folder.is_dir():
        raise HistoryError(f"{folder} is no folder of a history", tries=("canopen fleet record DIR",))
    chosen: list[HistoryFile] = []
    for tries_left in reversed(range(3)):
        try:
            files, foreign = files_in(folder)
            chosen = [each for each in files if _is_wanted(each, places, since, until)]
            for each in chosen:
                _check(each.path)
            break
        except OSError as error:
            if not (isinstance(error, FileNotFoundError) and tries_left):  # a recorder has put an hour together meanwhile
                raise HistoryError(f"{folder} cannot be read", seen=str(error)) from error
    if not files:
        seen = "there is no file of a recorder in it" + (f", and {counted(len(foreign), 'other')}" if foreign else "")
        raise HistoryError(f"{folder} has no history", seen=seen, tries=("canopen fleet record DIR",))
    data = dataset.dataset([str(each.path) for each in chosen], schema=schema(), format="parquet")
    when = dataset.field("recorder_time")
    arrow, _ = pyarrow_modules("a history")
    if since is not None:
        data = data.filter(when >= arrow.scalar(_nanoseconds(since), arrow.timestamp("ns")))
    if until is not None:
        data = data.filter(when <= arrow.scalar(_nanoseconds(until), arrow.timestamp("ns")))
    with duckdb.connect(":memory:", config=dict(_SETTINGS)) as connection:
        connection.register("recorded", data)
        for name, sql in VIEWS.items():
            connection.execute(f"CREATE VIEW {name} AS {sql}")
        connection.execute("SET lock_configuration = true")
        yield History(chosen, foreign, connection)


def _is_wanted(file: HistoryFile, places: Sequence[FleetPlace], since: datetime | None, until: datetime | None) -> bool:
    if since is not None and file.hour < since.astimezone(UTC).strftime(HOUR):
        return False
    if until is not None and file.hour > until.astimezone(UTC).strftime(HOUR):
        return False
    if not places or file.place == RECORDER:
        return True
    return any(file.place.matches(each) or file.place == each.bus_place for each in places)


def _check(path: Path) -> None:
    """Raise HistoryError unless a file is whole, and one of a history; FileNotFoundError if it is there no longer."""
    arrow, parquet = pyarrow_modules("a history")
    try:
        known = parquet.read_schema(path)
    except FileNotFoundError:
        raise
    except (OSError, arrow.ArrowException) as error:
        raise HistoryError(
            f"{path} cannot be read as Parquet",
            seen=str(error).splitlines()[0],
            cause="it is half a file, or was damaged: a recorder gives a file its name once it is whole",
            tries=("move it out of the folder",),
        ) from error
    version = (known.metadata or {}).get(MARK)
    if version != VERSION or known.names != schema().names:
        raise HistoryError(
            f"{path} has the name of a history's file, and is none",
            seen="another program wrote it" if version is None else f"it has version {version!r} of the columns",
            tries=("move it out of the folder",),
        )


def _plain_column(column: Any) -> list[Any]:
    """Return the values of a column as plain ones."""
    arrow, _ = pyarrow_modules("a history")
    if arrow.types.is_timestamp(column.type):
        per_second = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[column.type.unit]
        ticks = column.cast(arrow.int64()).to_pylist()
        return [None if each is None else _iso(each * (10**9 // per_second)) for each in ticks]
    return [_plain(each) for each in column.to_pylist()]


def _plain(value: Any) -> Any:
    if isinstance(value, decimal.Decimal):
        return int(value) if value == value.to_integral_value() else float(value)
    if isinstance(value, bytes | bytearray | memoryview):
        return bytes(value).hex(" ")
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, dict):
        return {str(key): _plain(each) for key, each in value.items()}
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)


def _iso(nanoseconds: int) -> str:
    seconds, rest = divmod(nanoseconds, 10**9)
    try:
        moment = datetime.fromtimestamp(seconds, UTC)
    except (OverflowError, ValueError, OSError):
        return f"{nanoseconds} ns"
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{rest:09d}Z"


def _nanoseconds(moment: datetime) -> int:
    return int(moment.timestamp() * 1e6) * 1000


def _wrong(error: Exception) -> HistoryQueryError:
    """Return the error for what DuckDB says."""
    lines = [line for line in str(error).splitlines() if line.strip()]
    first = lines[0] if lines else type(error).__name__
    if "file system operations are disabled" in first or "configuration has been locked" in first:
        return HistoryQueryError("this query reaches for a file, or a setting", seen=first, tries=(f"SELECT of {VIEW_NAMES}",))
    if isinstance(error, FileNotFoundError) or "No such file" in first:
        return HistoryQueryError("a recorder has put an hour together meanwhile", seen=first[:300], tries=("the same again",))
    seen = " ".join(lines[1:])[:300]
    return HistoryQueryError(f"the query failed: {first}"[:500], seen=seen, tries=(f"SELECT of {VIEW_NAMES}",))
