"""`canopen log record`, `export`, `plot` and `diff`: the values of a recording, taken apart."""

from __future__ import annotations

import csv
import datetime
import errno
import json
import signal
from pathlib import Path

import pytest
import trio
from trio.testing import MockClock

from canopen_cli.live.clocks import SystemClock
from canopen_cli.live.log_export import clock_text
from canopen_cli.live.log_record import _Files
from canopen_cli.live.source import _BusSource
from canopen_cli.shared.problem import ExitCode
from canopen_proto.frame import Frame
from canopen_proto.machine import SECOND
from canopen_transports import VirtualTransport
from canopen_transports.candump_text import CandumpWriter
from canopen_transports.log_files import LogReader
from canopen_transports.record import Record
from tests.cli.cli_support import Alarm, Run, runner_in_folder

BEGIN = 1_700_000_000
LOG = f"""\
({BEGIN}.000000) can0 705#05 R
({BEGIN}.100000) can0 605#4041600000000000 T
({BEGIN}.101000) can0 585#4B41600037020000 R
({BEGIN + 1}.000000) can0 605#2364600010270000 T
({BEGIN + 1}.001000) can0 585#6064600000000000 R
({BEGIN + 2}.000000) can0 605#4041600000000000 T
({BEGIN + 2}.001000) can0 585#4B41600033020000 R
"""
"""Node 5: its statusword is 0x237, and after two seconds 0x233."""
STATUSWORD = ("--object", "statusword")


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    made = runner_in_folder(capsys, monkeypatch, tmp_path)
    Path("bus.log").write_text(LOG)
    return made


def table(path: str) -> list[dict[str, str]]:
    with Path(path).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


# ---- export ----


def test_a_row_for_each_value_with_its_time_by_the_clock(run: Run) -> None:
    outcome = run("log", "export", "bus.log", "-o", "values.csv", *STATUSWORD, "--json")
    assert outcome.status == ExitCode.OK, outcome.err
    assert outcome.json == {"file": "bus.log", "output": "values.csv", "rows": 2}
    first, second = table("values.csv")
    assert (first["time"], first["seconds"]) == ("2023-11-14T22:13:20.101000Z", "0.101000")
    assert (first["node"], first["index"], first["sub"], first["name"]) == ("5", "6041", "00", "statusword")
    assert (first["value"], second["value"]) == (str(0x237), str(0x233))
    assert (first["service"], first["channel"]) == ("SDO", "can0")


@pytest.mark.parametrize(
    ("window", "values"),
    [
        (("--since", "1s"), [0x233]),
        (("--until", "1.5"), [0x237]),
        (("--since", "2023-11-14T22:13:21+00:00"), [0x233]),
    ],
)
def test_a_window_of_time(run: Run, window: tuple[str, ...], values: list[int]) -> None:
    assert run("log", "export", "bus.log", "-o", "values.csv", *STATUSWORD, *window).status == ExitCode.OK
    assert [int(each["value"]) for each in table("values.csv")] == values


@pytest.mark.parametrize(
    ("objects", "values"),
    [
        (("5:statusword",), [0x237, 0x233]),
        (("5:6041",), [0x237, 0x233]),
        (("0x5:6041:00",), [0x237, 0x233]),
        (("6:statusword",), []),
        (("6:6041",), []),
        (("6:statusword", "5:6064"), [10_000, 10_000]),
        (("6041:00",), [0x237, 0x233]),
    ],
)
def test_an_object_of_one_node(run: Run, objects: tuple[str, ...], values: list[int]) -> None:
    words = [word for each in objects for word in ("--object", each)]
    assert run("log", "export", "bus.log", "-o", "values.csv", *words).status == ExitCode.OK
    assert [int(each["value"]) for each in table("values.csv")] == values
    lines = run("log", "decode", "bus.log", *words).out
    assert ("read 6041:00" in lines) is (0x237 in values)


def test_an_object_of_a_node_that_has_none(run: Run) -> None:
    outcome = run("log", "decode", "bus.log", "--object", "5:statuswrod")
    assert outcome.status == ExitCode.BAD_FILE or outcome.status == ExitCode.USAGE
    assert "statusword" in outcome.err  # what was meant
    assert run("log", "decode", "bus.log", "--object", "200:statusword").status == ExitCode.USAGE


def test_a_column_for_each_object(run: Run) -> None:
    assert run("log", "export", "bus.log", "-o", "wide.csv", "--wide").status == ExitCode.OK
    rows = table("wide.csv")
    assert [each["5 statusword"] for each in rows] == [str(0x237), str(0x237), str(0x237), str(0x233)][-len(rows) :]
    assert rows[-1]["5 position_actual_value"] == "10000"


def test_a_parquet_file_has_the_same_values(run: Run) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    assert run("log", "export", "bus.log", "-o", "values.parquet", *STATUSWORD).status == ExitCode.OK
    rows = parquet.read_table("values.parquet").to_pylist()
    assert [each["number"] for each in rows] == [0x237, 0x233]
    assert [each["name"] for each in rows] == ["statusword", "statusword"]


def test_what_cannot_be_exported(run: Run) -> None:
    for words in (
        ("-o", "values.txt"),
        ("-o", "values.parquet", "--wide"),
        ("-o", "values.csv", "--since", "yesterday"),
        ("-o", "bus.log"),
    ):
        assert run("log", "export", "bus.log", *words).status == ExitCode.USAGE, words
    assert Path("bus.log").read_text() == LOG
    assert run("log", "export", "nothing.log", "-o", "values.csv").status == ExitCode.BAD_FILE
    assert not Path("values.csv").exists()


def test_a_time_without_a_date_is_seconds() -> None:
    assert clock_text(0) == "1970-01-01T00:00:00.000000Z"
    assert clock_text(-1_500_000_000) == "-1.500000"
    assert clock_text(BEGIN * 10**9 + 1500) == "2023-11-14T22:13:20.000001Z"


# ---- diff ----


def test_two_recordings_that_are_alike(run: Run) -> None:
    outcome = run("log", "diff", "bus.log", "bus.log")
    assert (outcome.status, outcome.out) == (ExitCode.OK, "")
    assert "0 differences" in outcome.err


def test_what_two_recordings_show_differently(run: Run) -> None:
    Path("other.log").write_text(
        LOG.replace("4B41600033020000", "4B41600008020000") + f"({BEGIN + 3}.0) can0 085#1023010000000000 R\n"
    )
    outcome = run("log", "diff", "bus.log", "other.log", "--rate", "60", "--json")
    assert outcome.status == ExitCode.DIFFERENT
    found = {each["what"]: (each["kind"], each["one"], each["other"]) for each in outcome.json["differences"]}
    assert found["5 statusword"] == ("value", 0x233, 0x208)
    assert found["085 (EMCY of node 5)"][:2] == ("CAN-ID", None)
    shown = run("log", "diff", "bus.log", "other.log")
    assert "value 5 statusword" in shown.out
    assert "not there" in shown.out


# ---- plot ----


def test_the_values_of_objects_are_drawn(run: Run) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    outcome = run("log", "plot", "bus.log", "statusword", "6064", "-o", "run.svg", "--json")
    assert outcome.status == ExitCode.OK, outcome.err
    assert {each["object"]: each["values"] for each in outcome.json["curves"]}["5 statusword"] == 2
    assert Path("run.svg").read_text(encoding="utf-8").lstrip().startswith("<?xml")
    assert run("log", "plot", "bus.log", "6077").status == ExitCode.BAD_FILE


# ---- record ----


def test_a_bus_is_recorded_as_it_passes(run: Run) -> None:
    outcome = run("log", "record", "new.log", "-b", "demo", "--for", "3s", "--json")
    assert outcome.status == ExitCode.OK, outcome.err
    records = list(LogReader(Path("new.log")))
    assert outcome.json["frames"] == len(records) > 10
    assert not any(record.sent for record in records)
    assert abs(records[0].time / 1e9 - datetime.datetime.now(datetime.UTC).timestamp()) < 3600


def test_only_what_is_chosen_is_recorded(run: Run) -> None:
    assert run("log", "record", "new.log", "-b", "demo", "--for", "3s", "--node", "4").status == ExitCode.OK
    assert {record.frame.can_id & 0x7F for record in LogReader(Path("new.log"))} == {4}


def test_one_file_after_the_other_and_the_oldest_goes(run: Run) -> None:
    outcome = run("log", "record", "new.log", "-b", "demo", "--for", "6s", "--rotate", "1s", "--keep", "2", "--json")
    files = sorted(Path().glob("new-*.log"))
    assert outcome.json["files"] == [str(each) for each in files]
    assert len(files) == 2
    assert all(list(LogReader(each)) for each in files)
    assert not Path("new.log").exists()


def test_only_frames_in_files_that_are_there_are_counted(run: Run) -> None:
    outcome = run("log", "record", "new.log", "-b", "demo", "--for", "6s", "--rotate", "1s", "--keep", "2", "--json")
    assert outcome.json["frames"] == sum(len(list(LogReader(Path(each)))) for each in outcome.json["files"])


def _recorded(files: _Files, *seconds: float) -> None:
    for second in seconds:
        files.write(Record(round((BEGIN + second) * SECOND), "can0", Frame(0x100)))


def test_a_file_that_was_taken_away_begins_anew(run: Run) -> None:
    """Somebody tidies up, or logrotate renames: what is written into a file without a name is in no file, for weeks."""
    told: list[str] = []
    files = _Files(Path("new.log"), None, None, told.append)
    _recorded(files, 0, 1)
    Path("new.log").unlink()
    _recorded(files, 2, 11, 12)
    Path("new.log").rename("old.log")
    Path("new.log").write_text("of somebody else")
    _recorded(files, 13, 25)
    files.close()
    assert [len(list(LogReader(Path(each)))) for each in ("old.log", "new-2.log")] == [3, 1]
    assert Path("new.log").read_text() == "of somebody else"
    assert (files.frames, files.written) == (1, [Path("new-2.log")])
    assert told == [f"new.log was taken away, with {count} frames; a new file begins" for count in (3, 3)]


def test_a_file_whose_clock_was_set_back_does_not_wait_for_its_end(run: Run) -> None:
    files = _Files(Path("new.log"), 2 * SECOND, None)
    _recorded(files, 7200, 7201, 0, 1, 2)
    files.close()
    assert [len(list(LogReader(each))) for each in files.written] == [2, 2, 1]


def test_a_file_that_cannot_be_deleted_is_named(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    files = _Files(Path("new.log"), SECOND, 1, told.append)

    def unlink(path: Path, missing_ok: bool = False) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "unlink", unlink)
    _recorded(files, 0, 1)
    files.close()
    assert [text.partition(", ")[2] for text in told] == ["and cannot be deleted: Permission denied"]


@pytest.mark.parametrize("room", [3, 40])
def test_a_full_disk_is_told_with_the_file_and_what_is_in_it(run: Run, monkeypatch: pytest.MonkeyPatch, room: int) -> None:
    written: list[Record] = []

    def write(writer: CandumpWriter, record: Record) -> None:
        if len(written) == room:
            raise OSError(errno.ENOSPC, "No space left on device")
        written.append(record)

    monkeypatch.setattr(CandumpWriter, "write", write)
    outcome = run("log", "record", "new.log", "-b", "demo", "--for", "60s", "--json")
    assert outcome.status == ExitCode.BAD_FILE
    error = json.loads(outcome.err.splitlines()[-1])
    assert error["message"] == "cannot write new.log"
    assert error["seen"] == f"No space left on device; {room} frames were written before: new.log"


@pytest.mark.parametrize("end", ["Ctrl-C", "--for"])
@pytest.mark.usefixtures("simulations")
def test_a_file_that_cannot_be_ended_is_told(run: Run, monkeypatch: pytest.MonkeyPatch, alarm: Alarm, end: str) -> None:
    """The disk is full as the last frames go to it: they are not in the file."""

    def close(writer: CandumpWriter) -> None:
        writer._file.close()
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(CandumpWriter, "close", close)
    if end == "Ctrl-C":
        alarm.set((1.0, signal.SIGINT))
    outcome = run("log", "record", "new.log", "-b", "demo", "--for", "60s" if end == "Ctrl-C" else "1s")
    assert outcome.status == ExitCode.BAD_FILE
    assert "cannot write new.log" in outcome.err
    assert "No space left on device" in outcome.err


def test_a_recording_of_weeks_has_the_time_of_day(run: Run) -> None:
    """The clock of a small computer is set once the network is there; a laptop sleeps for an hour."""
    system, own = 5 * SECOND, 5 * SECOND
    clock = SystemClock(lambda: system, lambda: own)

    async def main() -> list[int]:
        nonlocal system, own
        times = []
        async with VirtualTransport("dated") as wire, VirtualTransport("dated") as ours:
            source = _BusSource("dated", "virtual:dated", ours, clock)
            zero = round(trio.current_time() * SECOND)
            for set_to in (None, BEGIN * SECOND, BEGIN * SECOND + SECOND // 2, BEGIN * SECOND - 3600 * SECOND):
                system = system if set_to is None else set_to
                await wire.send(Frame(0x100))
                (heard,) = await source.take()
                assert isinstance(heard, Record)
                times.append(heard.time - zero + own)
        return times

    times = trio.run(main, clock=MockClock())
    assert times == [5 * SECOND, BEGIN * SECOND, BEGIN * SECOND, BEGIN * SECOND - 3600 * SECOND]


def test_what_cannot_be_recorded(run: Run) -> None:
    assert run("log", "record", "new.doc", "-b", "demo").status == ExitCode.USAGE
    assert run("log", "record", "new.log", "--keep", "2", "-b", "demo").status == ExitCode.USAGE
    assert run("log", "record", "bus.log", "-b", "demo").status == ExitCode.USAGE
    assert Path("bus.log").read_text() == LOG


def test_a_file_of_the_same_second_takes_nothing_from_the_one_before(run: Run) -> None:
    """As at the end of summer time, when an hour comes twice; and where a recording of another run is there already."""
    files = _Files(Path("new.log"), SECOND // 2, 2)
    for number in range(4):
        files.write(Record(BEGIN * SECOND + number * SECOND // 5, "can0", Frame(0x100 + number, b"")))
    files.close()
    assert [[record.frame.can_id for record in LogReader(each)] for each in files.written] == [[0x100, 0x101, 0x102], [0x103]]
    again = _Files(Path("new.log"), SECOND // 2, None)
    again.write(Record(BEGIN * SECOND, "can0", Frame(0x200, b"")))
    again.close()
    assert sorted(len(list(LogReader(each))) for each in Path().glob("new-*.log")) == [1, 1, 3]
