"""`HistoryWriter`: brings rows to a disk, so that a file is whole or not there.

Rows wait in memory, by place and hour. `take` hands over what waits, and `write` makes a file of each part: under another name,
brought to the disk, renamed. When an hour is over, its files become one (`-all`), which then takes their place; see layout.py.
Where the clock is set back, an hour comes again: its files get a word of their own, so that no `-all` takes the place of theirs.

What a kill loses is what waited. What the disk did not take waits on, up to MOST_WAITING rows; then the oldest are dropped and
counted, and the gap is a row, too.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, TypeAlias

from canopen_gateway.fleet.keys import FleetPlace
from canopen_gateway.history.layout import ALL, HOUR, RECORDER, folder_of, name_of
from canopen_gateway.history.rows import BEGAN, ENDED, GAP, WRITTEN, HistoryRow, schema, table_of
from canopen_master.motion.record_files import pyarrow_modules
from canopen_master.whole_file import whole_file

MOST_WAITING: Final = 400_000
"""Rows that wait for the disk: about 150 MB."""
FLUSH_AT: Final = 100_000
"""Rows at which a flush does not wait for its time."""
ROW_GROUP: Final = 100_000
"""Rows of a group in a file that was put together."""
NS_OF_HOUR: Final = 3_600 * 10**9
Waiting: TypeAlias = dict[tuple[FleetPlace, str], list[HistoryRow]]


class HistoryWriter:
    """See this module's text. folder: where. run: the word of this run. rows: how many are on the disk; lost: how many never came
    there; files: how many were written, those that were put together included. waiting: rows that were not taken yet. is_busy:
    for who calls it.

    `add` and `take` are for the loop; `write` and `put_together` for a thread, one at a time.
    """

    def __init__(self, folder: Path, *, clock: Callable[[], int] = time.time_ns) -> None:
        """folder: is made if it is not there. clock: ns since 1970. Raises OSError, PackageMissingError."""
        schema()
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self.clock = clock
        self.run = _new_word(clock())
        self.rows = self.lost = self.files = self.waiting = 0
        self.is_busy = False
        self._taken = 0  # rows that the thread has
        self._parts = 0
        self._waiting: Waiting = {}
        self._hours: dict[
            tuple[FleetPlace, str], tuple[str, list[Path]]
        ] = {}  # the word and files of each that is not put together
        self._over = ""  # hours before this one have been put together
        self._hour = (0, "")
        self._lost_before = 0
        self.add(RECORDER, HistoryRow(clock(), BEGAN, text=self.run))

    def add(self, place: FleetPlace, row: HistoryRow) -> None:
        """Let a row wait. Drops the oldest rows of a place if the disk has not taken any for long."""
        key = (place, self._hour_of(row.recorder_time))
        rows = self._waiting.get(key)
        if rows is None:
            rows = self._waiting[key] = []
        rows.append(row)
        self.waiting += 1
        if self.waiting + self._taken > MOST_WAITING:
            self._drop()

    def take(self) -> Waiting:
        """Hand over what waits; `write` brings it to the disk."""
        taken, self._waiting = self._waiting, {}
        self._taken, self.waiting = self.waiting, 0
        return taken

    def write(self, taken: Waiting, *, last: bool = False) -> None:
        """Write what was taken, and at the end a row which says so. last: the run ends. What could not be written is still in
        `taken`; `give_back` lets it wait again. Raises OSError."""
        self._parts += 1
        taken_until = self.clock()
        for key in sorted(taken):
            self._write_part(key, taken[key])
            self.rows += len(taken[key])
            self._taken -= len(taken.pop(key))
        own = [HistoryRow(taken_until, WRITTEN, text=self.run)]
        if self.lost > self._lost_before:
            gap = HistoryRow(taken_until, GAP, lost=self.lost - self._lost_before, problem="the disk of the recorder took none")
            own.insert(0, gap)
        if last:
            own.append(HistoryRow(taken_until, ENDED, text=self.run))
        self._parts += 1
        self._write_part((RECORDER, self._hour_of(taken_until)), own)
        self._lost_before = self.lost
        self.rows += len(own)

    def give_back(self, left: Waiting) -> None:
        """Let rows wait again that could not be written."""
        for key, rows in left.items():
            self._waiting[key] = rows + self._waiting.get(key, [])
            self.waiting += len(rows)
        self._taken = 0
        while self.waiting > MOST_WAITING:
            self._drop()

    def put_together(self, *, last: bool = False) -> None:
        """Make one file of each place and hour that is over; of all, if the run ends. Raises OSError."""
        _, parquet = pyarrow_modules("a history")
        present = self._hour_of(self.clock())
        self._over = max(self._over, present)
        for key in sorted(self._hours):
            place, hour = key
            if (hour >= present and not last) or key in self._waiting:
                continue
            word, parts = self._hours[key]
            if len(parts) > 1:
                self._write_whole(folder_of(self.folder, place, hour) / name_of(word, ALL), _joined(parquet, parts))
            del self._hours[key]  # first: if a part cannot be removed, those that are left must not be put together again
            for part in parts if len(parts) > 1 else ():
                part.unlink()

    # ---- inside ----

    def _hour_of(self, now: int) -> str:
        number = now // NS_OF_HOUR
        known = self._hour  # once: the thread sets it, too
        if number != known[0]:
            known = self._hour = number, datetime.fromtimestamp(number * 3600, UTC).strftime(HOUR)
        return known[1]

    def _drop(self) -> None:
        """Drop the older half of the longest list."""
        rows = max(self._waiting.values(), key=len)
        count = (len(rows) + 1) // 2
        del rows[:count]
        self.lost += count
        self.waiting -= count

    def _write_part(self, key: tuple[FleetPlace, str], rows: list[HistoryRow]) -> None:
        _, parquet = pyarrow_modules("a history")
        place, hour = key
        table = table_of(place, rows)

        def write(writer: Any) -> None:
            writer.write_table(table)

        folder = folder_of(self.folder, place, hour)
        folder.mkdir(parents=True, exist_ok=True)
        word, parts = self._hours.get(key) or (self.run if hour >= self._over else _new_word(self.clock()), [])
        path = folder / name_of(word, self._parts)
        self._write_whole(path, _writing(parquet, write))
        self._hours[key] = word, [*parts, path]

    def _write_whole(self, path: Path, write: Callable[[Any], None]) -> None:
        """Write a file so that it is whole, and on the disk, once it has its name."""
        with whole_file(path) as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        _sync_folder(path.parent)
        self.files += 1


def _new_word(now: int) -> str:
    """Return a word for the names of files that nobody else has. now: ns since 1970."""
    return f"{datetime.fromtimestamp(now / 1e9, UTC):%Y%m%dT%H%M%SZ}-{secrets.token_hex(4)}"


def _writing(parquet: Any, write: Callable[[Any], None]) -> Callable[[Any], None]:
    def into(file: Any) -> None:
        with parquet.ParquetWriter(file, schema(), compression="zstd") as writer:
            write(writer)

    return into


def _joined(parquet: Any, parts: Any) -> Callable[[Any], None]:
    """Return what copies files into one, in groups that are neither tiny nor held in memory as a whole."""
    arrow, _ = pyarrow_modules("a history")

    def write(writer: Any) -> None:
        held, count = [], 0
        for part in parts:
            held.append(parquet.read_table(part, schema=schema(), partitioning=None))
            count += held[-1].num_rows
            if count >= ROW_GROUP:
                writer.write_table(arrow.concat_tables(held))
                held, count = [], 0
        if held:
            writer.write_table(arrow.concat_tables(held))

    return _writing(parquet, write)


def _sync_folder(folder: Path) -> None:
    """Bring a new name in a folder to the disk. Windows cannot, and does so by itself."""
    with contextlib.suppress(OSError):
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)
