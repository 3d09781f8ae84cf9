"""`canopen log export`: the values in a recording as a table: CSV, or Parquet for what has pyarrow."""

from __future__ import annotations

import csv
import datetime
import io
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, Any, Final

import click

from canopen_cli.live.frame_lines import WantedFrames, choosing
from canopen_cli.live.log_values import LoggedValue, values_in
from canopen_cli.live.source import FILE_OR_INPUT
from canopen_cli.live.window import Window, windowed
from canopen_cli.shared.new_files import check_new_file, new_file
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.problem import usage
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_master.motion.record_files import pyarrow_modules
from canopen_proto.machine import SECOND

CSV: Final = ".csv"
PARQUET: Final = ".parquet"
COLUMNS: Final = (
    "time", "seconds", "channel", "service", "node", "index", "sub", "name", "value", "physical", "unit", "text",
)  # fmt: skip
ROWS: Final = 65_536
"""Rows that are written at once as Parquet."""


@command("export")
@click.argument("source", metavar="FILE", type=FILE_OR_INPUT)
@click.option("-o", "--output", required=True, metavar="OUT", help="The table: .csv or .parquet.")
@click.option("--wide", is_flag=True, help="A column for each object, with its last value; else a row for each value.")
@choosing
@windowed
def export(
    settings: Settings, screen: Screen, source: Path, output: str, wide: bool, wanted: WantedFrames, window: Window
) -> None:
    """Write the values in a recording into a table: those of PDOs and SDO transfers. Times are those of the recording, in UTC.

    PDOs are taken apart by the mapping that the recording shows, else by the devices' own files, else by PDOs.csv. In Parquet,
    a value that is a number is in the column `number`, too.

    \b
    canopen log export trace.log -o values.csv
    canopen log export trace.log -o run.parquet --node 5 --object statusword --object 6064
    canopen log export trace.log -o run.csv --wide --service tpdo --since 10s --until 20s
    """
    kind = Path(output).suffix.lower()
    if kind not in (CSV, PARQUET):
        raise usage(
            "CO123",
            f"a table is written as {CSV} or {PARQUET}, not as {kind or 'a file without an ending'}",
            tries=("-o values.csv",),
        )
    if wide and kind == PARQUET:
        raise usage("CO123", f"--wide makes a {CSV} file", tries=("-o values.csv",))
    if kind == PARQUET:
        pyarrow_modules(output)
    check_new_file(settings, screen, output, str(source))
    values = values_in(settings, screen, source, wanted, window)
    with new_file(output) as file:
        count = _write_parquet(file, values, output) if kind == PARQUET else _write_csv(file, values, wide=wide)
    if settings.json:
        screen.json({"file": str(source), "output": output, "rows": count})
    screen.say(f"{counted(count, 'row')}: [bold]{escape(output)}[/]")


def _row(value: LoggedValue) -> tuple[Any, ...]:
    shown, record = value.shown, value.record
    return (
        clock_text(record.time),
        f"{value.seconds:.6f}",
        record.channel,
        value.service,
        shown.node_id,
        f"{shown.index:04X}",
        f"{shown.subindex:02X}",
        shown.name,
        value.plain,
        value.physical,
        value.unit,
        shown.text,
    )


def clock_text(time: int) -> str:
    """Return a recorded time, ns since 1970, in UTC; a time without a date is seconds since the file began."""
    seconds, rest = divmod(time, SECOND)
    if time < 0 or seconds >= 1 << 38:
        return f"{time / SECOND:.6f}"
    moment = datetime.datetime.fromtimestamp(seconds, datetime.UTC).replace(tzinfo=None)
    return f"{moment.isoformat()}.{rest // 1000:06d}Z"


def _write_csv(file: IO[bytes], values: Iterable[LoggedValue], *, wide: bool) -> int:
    text = io.TextIOWrapper(file, encoding="utf-8", newline="", write_through=True)
    rows = _wide_rows(list(values)) if wide else _long_rows(values)
    count = -1  # the head
    try:
        writer = csv.writer(text)
        for count, row in enumerate(rows):  # noqa: B007 - counts
            writer.writerow(["" if cell is None else cell for cell in row])
    finally:
        text.detach()  # the file is closed by who has opened it
    return count


def _long_rows(values: Iterable[LoggedValue]) -> Iterator[Iterable[Any]]:
    yield COLUMNS
    for value in values:
        yield _row(value)


def _wide_rows(values: list[LoggedValue]) -> Iterator[Iterable[Any]]:
    """Yield a row for each frame, with the last value of each object."""
    has_several = len({value.record.channel for value in values}) > 1  # node 5 of one bus is not node 5 of another
    labels = [f"{value.record.channel} {value.label}" if has_several else value.label for value in values]
    held: dict[str, Any] = dict.fromkeys(labels)
    yield ("time", "seconds", *held)
    for number, (value, label) in enumerate(zip(values, labels, strict=True)):
        held[label] = value.plain if value.physical is None else value.physical
        is_last = number + 1 == len(values) or values[number + 1].record is not value.record
        if is_last:
            yield (clock_text(value.record.time), f"{value.seconds:.6f}", *held.values())


def _write_parquet(file: IO[bytes], values: Iterable[LoggedValue], output: str) -> int:
    pyarrow, parquet = pyarrow_modules(output)
    words = ("channel", "service", "name", "value", "unit", "text")
    kinds = {each: pyarrow.string() for each in words} | {
        "time": pyarrow.timestamp("ns", tz="UTC"), "seconds": pyarrow.float64(),
        "node": pyarrow.uint8(), "index": pyarrow.uint16(), "sub": pyarrow.uint8(),
        "number": pyarrow.float64(), "physical": pyarrow.float64(),
    }  # fmt: skip
    schema = pyarrow.schema([(name, kinds[name]) for name in (*COLUMNS[:9], "number", *COLUMNS[9:])])
    count, waiting = 0, list[dict[str, Any]]()
    with parquet.ParquetWriter(file, schema) as writer:
        for value in values:
            waiting.append(_parquet_row(value))
            count += 1
            if len(waiting) == ROWS:
                writer.write_table(pyarrow.Table.from_pylist(waiting, schema=schema))
                waiting.clear()
        writer.write_table(pyarrow.Table.from_pylist(waiting, schema=schema))
    return count


def _parquet_row(value: LoggedValue) -> dict[str, Any]:
    shown, plain = value.shown, value.plain
    number = shown.value if isinstance(shown.value, int | float) else None
    return {
        "time": value.record.time,
        "seconds": value.seconds,
        "channel": value.record.channel,
        "service": value.service,
        "node": shown.node_id,
        "index": shown.index,
        "sub": shown.subindex,
        "name": shown.name,
        "value": str(plain),
        "number": None if number is None else float(number),
        "physical": value.physical,
        "unit": value.unit,
        "text": shown.text,
    }
