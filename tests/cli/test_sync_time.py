"""`canopen sync` and `canopen time`: what is on the bus, and how often."""

from __future__ import annotations

import datetime
from pathlib import Path

import pytest

from canopen_cli.shared.problem import ExitCode
from canopen_proto.datatypes import DataType, decode
from canopen_proto.frame import SYNC, TIME
from canopen_transports.log_files import LogReader
from canopen_transports.record import Record
from tests.cli.cli_support import Run, runner_in_folder

TRACED = ("-b", "demo", "--trace", "bus.log", "--force")


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    return runner_in_folder(capsys, monkeypatch, tmp_path)


def sent(can_id: int) -> list[Record]:
    return [record for record in LogReader(Path("bus.log")) if record.frame.can_id == can_id]


def test_one_sync(run: Run) -> None:
    outcome = run("sync", *TRACED, "--yes")
    assert (outcome.status, "1 SYNC sent" in outcome.err) == (ExitCode.OK, True)
    assert [record.frame.data for record in sent(SYNC)] == [b""]


def test_so_many_each_after_the_period(run: Run) -> None:
    outcome = run("sync", *TRACED, "--yes", "--period", "20ms", "--count", "5", "--json")
    assert outcome.json == {"sent": 5, "period": 0.02}
    times = [record.time for record in sent(SYNC)]
    assert [round((time - times[0]) / 1e6) for time in times] == [0, 20, 40, 60, 80]


def test_for_a_time(run: Run) -> None:
    assert run("sync", *TRACED, "--yes", "--period", "20ms", "--for", "100ms", "--json").json == {"sent": 5, "period": 0.02}
    assert run("sync", *TRACED, "--yes", "--period", "20ms", "--for", "1s", "--count", "2", "--json").json["sent"] == 2
    assert "--for needs a --period" in run("sync", "-b", "demo", "--for", "1s", "--yes").err


def test_a_sync_has_to_be_confirmed_since_drives_act_on_it(run: Run) -> None:
    outcome = run("sync", "-b", "demo")
    assert outcome.status == ExitCode.USAGE
    assert "drives act on the set-points" in outcome.err


def test_a_count_needs_a_period(run: Run) -> None:
    assert run("sync", "-b", "demo", "--count", "3", "--yes").status == ExitCode.USAGE


def test_time(run: Run) -> None:
    outcome = run("time", *TRACED, "--json")
    assert outcome.status == ExitCode.OK
    told = datetime.datetime.fromisoformat(outcome.json["time"])
    (record,) = sent(TIME)
    on_the_bus = decode(record.frame.data, DataType.TIME_OF_DAY)
    assert isinstance(on_the_bus, datetime.datetime)
    assert abs((told - on_the_bus).total_seconds()) < 0.001
    assert "UTC" in run("time", "-b", "demo").err
