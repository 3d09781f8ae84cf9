"""A history on a disk: values exact, files whole or not there, SQL that reaches nothing else. Pure: no fleet is needed."""

from __future__ import annotations

import datetime
import math
import os
import signal
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_gateway import HistoryError, HistoryQueryError
from canopen_gateway.fleet.keys import FleetPlace
from canopen_gateway.history.layout import RECORDER, files_in
from canopen_gateway.history.query import VIEWS, open_history
from canopen_gateway.history.rows import SAMPLE, HistoryRow, exact, plain
from canopen_gateway.history.writer import NS_OF_HOUR, HistoryWriter
from canopen_proto.datatypes import DataType, Value, decode, size_of
from tests.examples import examples, takes_all
from tests.gateway.history_world import BEGIN, SECOND, Clock, asked, needs_history

pytestmark = needs_history

FIVE = FleetPlace("hall", "arm", 5)
SIX = FIVE._replace(node_id=6)


def sample(now: int, value: Value, data: bytes = b"", name: str = "thing", data_type: str = "UNSIGNED16") -> HistoryRow:
    return HistoryRow(now, SAMPLE, now - 7, 1, "2000:00", name, data_type, "mm", raw=data, **exact(value))


def recorded(folder: Path, *rows: HistoryRow, place: FleetPlace = FIVE) -> HistoryWriter:
    """A folder with these rows in a file."""
    writer = HistoryWriter(folder, clock=Clock())
    for row in rows:
        writer.add(place, row)
    writer.write(writer.take())
    return writer


def tiny(data_type: DataType) -> st.SearchStrategy[bytes]:
    size = size_of(data_type)
    return st.binary(max_size=20) if size is None else st.binary(min_size=size, max_size=size)


@examples(60)
@given(data=st.data())
def test_each_value_of_each_type_is_what_it_was_with_its_bytes_beside_it(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    values: list[tuple[DataType, bytes, Value]] = []
    for data_type in DataType:
        raw = data.draw(tiny(data_type))
        try:
            values.append((data_type, raw, decode(raw, data_type)))
        except ValueError:  # no such time, half a character
            values.append((data_type, raw, raw))
    folder = tmp_path_factory.mktemp("history")
    rows = [sample(BEGIN + at, value, raw, each.name, each.name) for at, (each, raw, value) in enumerate(values)]
    recorded(folder, *rows)
    found = asked(folder, "SELECT name, type, integer, real, text, raw FROM samples ORDER BY time")
    for (data_type, raw, value), (name, kind, integer, real, text, told) in zip(values, found, strict=True):
        assert (name, kind, told) == (data_type.name, data_type.name, raw.hex(" "))
        if isinstance(value, int):
            assert integer == value
        elif isinstance(value, float):
            assert struct.pack("<d", real) == struct.pack("<d", value) or (math.isnan(real) and math.isnan(value))
        elif isinstance(value, str):
            assert text == plain(value)
        elif isinstance(value, datetime.datetime):
            assert datetime.datetime.fromisoformat(text) == value
        elif isinstance(value, datetime.timedelta):
            assert datetime.timedelta(seconds=float(text.removesuffix(" s"))) == value
        else:
            assert (integer, real, text) == (None, None, None)


def test_the_ends_of_64_bits_and_of_a_clock_are_exact(tmp_path: Path) -> None:
    whole = (2**64 - 1, -(2**63), 2**53 + 1, 0, True)
    recorded(tmp_path, *(sample(BEGIN + at, value) for at, value in enumerate(whole)))
    assert [each[0] for each in asked(tmp_path, "SELECT integer FROM samples ORDER BY time")] == [*whole[:4], 1]
    ((first, recorder),) = asked(tmp_path, "SELECT min(site_time), min(recorder_time) FROM samples")
    assert (first, recorder) == ("2027-01-15T08:00:00.123456782Z", "2027-01-15T08:00:00.123456789Z")


def test_half_of_a_surrogate_pair_is_stored_as_an_escape(tmp_path: Path) -> None:
    recorded(tmp_path, sample(BEGIN, "a\ud800b"))
    assert asked(tmp_path, "SELECT text FROM samples") == [("a\\ud800b",)]


def test_an_hour_becomes_one_file_once_it_is_over(tmp_path: Path) -> None:
    clock = Clock()
    writer = HistoryWriter(tmp_path, clock=clock)
    for number in range(3):
        writer.add(FIVE, sample(clock.now, number))
        writer.add(SIX, sample(clock.now, number))
        writer.write(writer.take())
        writer.put_together()
        clock.now += SECOND
    assert [each.part for each in files_in(tmp_path)[0] if each.place == FIVE] == ["000001", "000003", "000005"]
    clock.now += NS_OF_HOUR
    writer.add(FIVE, sample(clock.now, 3))
    writer.write(writer.take())
    writer.put_together()
    assert [(each.hour[-2:], each.part) for each in files_in(tmp_path)[0] if each.place == FIVE] == [
        ("08", "all"),
        ("09", "000007"),
    ]
    assert len(list((tmp_path / "hall/arm/5").rglob("*.parquet"))) == 2
    assert asked(tmp_path, "SELECT value FROM samples WHERE node = 5 ORDER BY time") == [(0,), (1,), (2,), (3,)]
    writer.write(writer.take(), last=True)
    writer.put_together(last=True)
    assert asked(tmp_path, "SELECT run, ended FROM runs") == [(writer.run, True)]
    assert asked(tmp_path, "SELECT count(*) FROM samples") == [(7,)]


def test_an_hour_that_comes_again_takes_nothing_from_the_first(tmp_path: Path) -> None:
    """The clock of the recorder is set back, twice, to hours that have been put together."""
    clock, number = Clock(), 0
    writer = HistoryWriter(tmp_path, clock=clock)
    for _ in range(3):
        for _ in range(2):
            writer.add(FIVE, sample(clock.now, number))
            writer.write(writer.take())
            writer.put_together()
            number += 1
            assert asked(tmp_path, "SELECT integer FROM samples ORDER BY integer") == [(each,) for each in range(number)]
            clock.now += SECOND
        clock.now += NS_OF_HOUR
        writer.put_together()
        clock.now -= NS_OF_HOUR + 2 * SECOND
    writer.put_together(last=True)
    assert asked(tmp_path, "SELECT integer FROM samples ORDER BY integer") == [(each,) for each in range(number)]
    assert sorted(each.part for each in files_in(tmp_path)[0] if each.place == FIVE) == ["all"] * 3


def test_files_of_an_hour_that_cannot_be_removed_are_not_put_together_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Somebody reads one of them, on Windows. What had been removed before would be missing from the new `-all`."""
    clock = Clock()
    writer = HistoryWriter(tmp_path, clock=clock)
    for number in range(4):
        writer.add(FIVE, sample(clock.now + number, number))
        writer.write(writer.take())
    clock.now += NS_OF_HOUR
    removed: list[Path] = []

    def unlink(path: Path) -> None:
        if len(removed) == 2:
            raise PermissionError(13, "it is open", str(path))
        if path.is_relative_to(tmp_path / "hall"):
            removed.append(path)
        os.unlink(path)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "unlink", unlink)
        with pytest.raises(PermissionError):
            writer.put_together()
    writer.write(writer.take())
    writer.put_together()
    assert asked(tmp_path, "SELECT integer FROM samples ORDER BY integer") == [(0,), (1,), (2,), (3,)]


class Killed(BaseException):
    """The process is gone: nothing in it runs any more."""


def killed_after(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """Let the process be killed at the count-th call that changes the disk; those behind it change nothing either."""
    done = 0

    def counted(call: Callable[..., Any]) -> Callable[..., Any]:
        def called(*arguments: Any, **options: Any) -> Any:
            nonlocal done
            done += 1
            if done > count:
                raise Killed
            return call(*arguments, **options)

        return called

    for name in ("replace", "unlink", "mkdir"):
        monkeypatch.setattr(os, name, counted(getattr(os, name)))
    monkeypatch.setattr(os, "fsync", counted(lambda number: None))  # nobody pulls the plug here


def test_a_kill_at_any_moment_leaves_whole_files_and_each_row_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of what had been flushed nothing is lost, whatever was under way; nothing is there twice, and nothing is half."""
    for count in range(0, 200, 1 if takes_all() else 4):
        clock, folder, flushed = Clock(), tmp_path / str(count), 0
        writer = HistoryWriter(folder, clock=clock)
        with monkeypatch.context() as patched:
            killed_after(patched, count)
            try:
                for number in range(2):
                    for place in (FIVE, SIX):
                        writer.add(place, sample(clock.now, number))
                    writer.write(writer.take())
                    flushed = number + 1
                    clock.now += SECOND
                clock.now += NS_OF_HOUR
                writer.put_together()
                is_over = True
            except Killed:
                is_over = False
        if files_in(folder)[0]:
            found = asked(folder, "SELECT node, integer FROM samples ORDER BY node, time")
            for node in (5, 6):
                values = [each for number, each in found if number == node]
                assert values in ([*range(flushed)], [*range(flushed + 1)]), (count, node)
        else:
            assert flushed == 0
        if is_over:
            assert count > 20  # every call before was tried
            return
    raise AssertionError


@pytest.mark.thorough
def test_a_recorder_that_is_killed_leaves_what_it_said_was_written(tmp_path: Path) -> None:
    """A process of its own, and SIGKILL."""
    program = f"""
import sys; sys.path[:0] = {[each for each in sys.path if each]!r}
from pathlib import Path
from canopen_gateway.fleet.keys import FleetPlace
from canopen_gateway.history.rows import HistoryRow
from canopen_gateway.history.writer import HistoryWriter
writer = HistoryWriter(Path({str(tmp_path)!r}))
for number in range(1 << 40):
    writer.add(FleetPlace("hall", "arm", 5), HistoryRow(writer.clock(), "sample", integer=number))
    writer.write(writer.take())
    print(number, flush=True)
"""
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        last = 0
        while last < 5:
            last = int(process.stdout.readline())
        process.send_signal(signal.SIGKILL)
        last = max([last, *map(int, process.stdout.read().split("\n")[:-1])])
    values = [each[0] for each in asked(tmp_path, "SELECT integer FROM samples ORDER BY integer")]
    assert values in ([*range(last + 1)], [*range(last + 2)])
    ((_, ended),) = asked(tmp_path, "SELECT run, ended FROM runs")
    assert ended is False
    assert "killed" in asked(tmp_path, "SELECT why FROM gaps")[0][0]


def test_a_full_disk_loses_nothing_while_there_is_room_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    writer = HistoryWriter(tmp_path, clock=clock)
    monkeypatch.setattr("canopen_gateway.history.writer.MOST_WAITING", 12)

    def full(number: int) -> None:
        raise OSError(28, "No space left on device")

    lost = 0
    for number in range(40):
        writer.add(FIVE, sample(clock.now + number, number))
        if number % 10 == 9:
            with monkeypatch.context() as patched:
                patched.setattr(os, "fsync", full)
                taken = writer.take()
                with pytest.raises(OSError, match="No space"):
                    writer.write(taken)
                writer.give_back(taken)
        assert writer.waiting <= 12
        if number < 10:
            assert writer.lost == 0
    lost = writer.lost
    assert 20 < lost < 40
    writer.write(writer.take())
    kept = [each[0] for each in asked(tmp_path, "SELECT value FROM samples ORDER BY time")]
    assert kept == [*range(40 - len(kept), 40)]  # the oldest went
    ((told, why),) = asked(tmp_path, "SELECT lost, why FROM gaps WHERE lost IS NOT NULL")
    assert (told, "disk" in why) == (lost, True)
    assert lost + len(kept) in (40, 41)  # and perhaps the recorder's own first row
    assert not [each for each in tmp_path.rglob("*") if each.name.endswith(".part")]


# ---- questions ----


@pytest.fixture
def history(tmp_path: Path) -> Path:
    """A folder with three rows, beside a file that is nobody's business."""
    (tmp_path / "secret.csv").write_text("password\n12345\n")
    folder = tmp_path / "history"
    recorded(folder, *(sample(BEGIN + number * SECOND, number) for number in range(3)))
    return folder


@pytest.mark.thorough(3)
@pytest.mark.parametrize(
    "sql",
    [
        "SELECT * FROM read_text('{beside}')",
        "SELECT * FROM read_csv('{beside}')",
        "SELECT * FROM read_blob('{beside}')",
        "SELECT * FROM '{beside}'",
        "SELECT * FROM read_parquet('{own}')",
        "SELECT * FROM parquet_metadata('{own}')",
        "SELECT * FROM glob('{folder}/*')",
        "SELECT * FROM sniff_csv('{beside}')",
        "SELECT getenv('HOME')",
        "SELECT * FROM folder",  # a Python variable of the caller
        "COPY (SELECT 1) TO '{folder}/new.csv'",
        "COPY samples TO '{own}' (FORMAT parquet)",
        "EXPORT DATABASE '{folder}/new'",
        "ATTACH '{folder}/new.db'",
        "INSTALL httpfs",
        "LOAD httpfs",
        "SET enable_external_access = true",
        "SET lock_configuration = false",
        "PRAGMA enable_external_access = true",
        "CREATE TABLE new AS SELECT 1",
        "DROP VIEW samples",
        "CREATE OR REPLACE VIEW samples AS SELECT 1",
        "SELECT 1; SELECT 2",
        "EXPLAIN ANALYZE DROP VIEW samples",
        "/* a */ EXPLAIN (ANALYZE) CREATE TABLE new AS SELECT 1",
        "SELECT * FROM query('COPY (SELECT 1) TO ''{folder}/new.csv''')",
        "SELEC",
        "SELECT * FROM sample",
        "SELECT no_such FROM samples",
        "",
        ";",
        "SELECT 'a'::INTEGER FROM samples",
    ],
)
def test_sql_reads_the_views_and_nothing_else(history: Path, sql: str) -> None:
    before = {each: each.read_bytes() for each in history.parent.rglob("*") if each.is_file()}
    own = str(files_in(history)[0][0].path)
    said = sql.format(beside=history.parent / "secret.csv", own=own, folder=history)
    with pytest.raises(HistoryQueryError) as refused:
        asked(history, said)
    assert refused.value.code == "CO164"
    assert "12345" not in str(refused.value)
    assert {each: each.read_bytes() for each in history.parent.rglob("*") if each.is_file()} == before


def test_each_view_can_be_asked_and_a_window_is_of_the_recorders_clock(history: Path) -> None:
    for view in VIEWS:
        asked(history, f"SELECT * FROM {view}")
        asked(history, f"EXPLAIN ANALYZE SELECT * FROM {view}")
    assert asked(history, "SELECT place, samples, objects FROM nodes") == [("hall/arm/5", 3, 1)]
    middle = datetime.datetime.fromtimestamp(BEGIN / SECOND + 0.5, datetime.UTC)
    with open_history(history, since=middle) as found:
        assert [each[0] for each in found.ask("SELECT value FROM samples ORDER BY time").rows] == [1, 2]
    with open_history(history, until=middle) as found:
        assert [each[0] for each in found.ask("SELECT value FROM samples").rows] == [0]
    with open_history(history, places=[SIX]) as found:
        assert {each.place for each in found.files} == {RECORDER}


def test_an_hour_that_is_put_together_meanwhile_is_looked_up_anew(history: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the list of the files and a look at one of them, a recorder gives the folder its one file of the hour."""
    from canopen_gateway.history import query

    (file,) = [each for each in files_in(history)[0] if each.place == FIVE]
    looked = []

    def files(folder: Path) -> Any:
        found = files_in(folder)
        if not looked:
            file.path.rename(file.path.with_name(f"{file.run}-all.parquet"))
        looked.append(folder)
        return found

    monkeypatch.setattr(query, "files_in", files)
    assert asked(history, "SELECT count(*) FROM samples") == [(3,)]
    assert len(looked) == 2


def test_a_file_that_is_half_is_named(history: Path) -> None:
    (file,) = [each for each in files_in(history)[0] if each.place == FIVE]
    data = file.path.read_bytes()
    for length in (0, 4, len(data) // 2, len(data) - 1):
        file.path.write_bytes(data[:length])
        with pytest.raises(HistoryError, match="cannot be read as Parquet") as refused:
            asked(history, "SELECT 1")
        assert file.path.name in str(refused.value)


def test_a_file_that_is_damaged_inside_ends_the_query_with_its_reason(history: Path) -> None:
    (file,) = [each for each in files_in(history)[0] if each.place == FIVE]
    data = bytearray(file.path.read_bytes())
    data[8 : len(data) // 2] = os.urandom(len(data) // 2 - 8)
    file.path.write_bytes(data)
    with pytest.raises((HistoryError, HistoryQueryError)):
        asked(history, "SELECT sum(value), max(time), max(raw), max(name) FROM samples")


def test_files_of_others_are_left_alone_or_named(history: Path, tmp_path: Path) -> None:
    import pyarrow
    import pyarrow.parquet

    (history / "notes.txt").write_text("x")
    (history / "hall" / "arm" / "5" / "old.parquet").write_bytes(b"x")
    os.symlink("/", history / "everything")
    with open_history(history) as found:
        assert [each.name for each in found.foreign] == ["old.parquet", "notes.txt"]
        assert len(list(found.ask("SELECT * FROM samples").rows)) == 3
    (file,) = [each for each in files_in(history)[0] if each.place == FIVE]
    pyarrow.parquet.write_table(pyarrow.table({"a": [1]}), file.path)
    with pytest.raises(HistoryError, match="another program wrote it"):
        asked(history, "SELECT 1")
    for wrong in (tmp_path / "none", tmp_path / "secret.csv"):
        with pytest.raises(HistoryError, match="is no folder"):
            asked(wrong, "SELECT 1")
    (tmp_path / "empty").mkdir()
    with pytest.raises(HistoryError, match="has no history"):
        asked(tmp_path / "empty", "SELECT 1")


def test_two_recorders_share_a_folder(tmp_path: Path) -> None:
    recorded(tmp_path, sample(BEGIN, 1))
    recorded(tmp_path, sample(BEGIN, 2))
    assert asked(tmp_path, "SELECT value FROM samples ORDER BY value") == [(1,), (2,)]
    assert len(asked(tmp_path, "SELECT * FROM runs")) == 2
