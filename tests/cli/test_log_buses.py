"""A recording with several buses, as `candump any` makes one: nothing of two buses is mixed."""

from __future__ import annotations

import csv
from collections import Counter
from pathlib import Path
from typing import cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_cli.live.frame_lines import Buses
from canopen_cli.shared.node_files import NodeFiles
from canopen_cli.shared.problem import ExitCode
from canopen_proto.machine import MILLISECOND
from canopen_transports.log_files import LogReader
from canopen_transports.record import Record
from tests.cli.cli_support import Run, runner_in_folder
from tests.examples import examples
from tests.observer.observer_sessions import CLEAN, OF_THE_RECORDER, clean, damaged

READ = "({0}.1) {1} 605#4041600000000000 T\n({0}.101) {1} 585#4B416000{2}020000 R\n"
BOTH = "".join(
    f"({each}.0) can0 705#05\n({each}.0) can1 705#7F\n" + READ.format(each, "can0", "37") + READ.format(each, "can1", "50")
    for each in range(100, 103)
)
"""Node 5 of can0 is a drive that runs, node 5 of can1 one that does not."""


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    made = runner_in_folder(capsys, monkeypatch, tmp_path)
    Path("both.log").write_text(BOTH)
    Path("one.log").write_text("".join(line for line in BOTH.splitlines(True) if "can0" in line))
    return made


def test_each_bus_has_rates_and_a_load_of_its_own(run: Run) -> None:
    one = run("log", "stats", "one.log", "--json").json
    both = run("log", "stats", "both.log", "--json").json
    assert {each["channel"] for each in one["ids"]} == {"can0"}
    of_can0 = [each for each in both["ids"] if each["channel"] == "can0"]
    assert len(both["ids"]) == 2 * len(of_can0)
    assert [(each["can_id"], each["frames"]) for each in of_can0] == [(each["can_id"], each["frames"]) for each in one["ids"]]
    assert both["load_percent"] == pytest.approx(one["load_percent"], rel=0.1), "two buses do not carry the sum of both"
    shown = run("log", "stats", "both.log").out
    assert ("can0: 9 frames in 2.101 s" in shown, "can1: 9 frames in 2.101 s" in shown) == (True, True)


def test_two_nodes_with_one_id_have_a_column_each(run: Run) -> None:
    assert run("log", "export", "both.log", "-o", "wide.csv", "--wide", "--object", "statusword").status == ExitCode.OK
    with Path("wide.csv").open(newline="", encoding="utf-8") as file:
        last = list(csv.DictReader(file))[-1]
    assert (last["can0 5 statusword"], last["can1 5 statusword"]) == (str(0x237), str(0x250))


def test_two_nodes_with_one_id_have_a_curve_each(run: Run) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    outcome = run("log", "plot", "both.log", "statusword", "-o", "run.svg", "--json")
    assert {each["object"]: each["values"] for each in outcome.json["curves"]} == {"can0 5 statusword": 3, "can1 5 statusword": 3}


def test_what_differs_has_its_bus(run: Run) -> None:
    Path("other.log").write_text("".join(line for line in BOTH.splitlines(True) if "can1 705" not in line))
    found = run("log", "diff", "both.log", "other.log", "--json").json["differences"]
    assert [(each["kind"], each["what"], each["other"]) for each in found] == [
        ("CAN-ID", "can1 705 (heartbeat of node 5)", None),
    ]
    Path("later.log").write_text(BOTH.replace("4B41600050", "4B41600008"))
    found = run("log", "diff", "both.log", "later.log", "--json").json["differences"]
    assert [(each["what"], each["one"], each["other"]) for each in found] == [("can1 5 statusword", 0x250, 0x208)]


def test_frames_of_two_buses_are_never_sent_to_one(run: Run) -> None:
    """What a master said to node 5 of one bus would be a command for node 5 of the other."""
    for words in ((), ("--dry-run",)):
        refused = run("log", "replay", "both.log", "-b", "virtual:x", "--trace", "sent.log", *words)
        assert refused.status == ExitCode.USAGE
        assert "--channel can1" in refused.err
    assert not Path("sent.log").exists() or not Path("sent.log").read_text()
    outcome = run("log", "replay", "both.log", "-b", "virtual:x", "--trace", "sent.log", "--channel", "can1", "--force")
    assert outcome.status == ExitCode.OK, outcome.err
    assert [str(each.frame) for each in LogReader(Path("sent.log"))][:3] == [
        "705#7F",
        "605#4041600000000000",
        "585#4B41600050020000",
    ]
    assert run("log", "replay", "both.log", "-b", "virtual:x", "--channel", "can7").status == ExitCode.USAGE
    assert run("log", "replay", "one.log", "-b", "virtual:x").status == ExitCode.OK


class NoFiles:
    """Nothing is known of the nodes."""

    def dictionary_of(self, node_id: int) -> None:
        return None


def told(records: list[Record]) -> dict[str, list[tuple[str, int, bool]]]:
    """What is found, by bus."""
    buses, found = Buses(cast("NodeFiles", NoFiles())), dict[str, list[tuple[str, int, bool]]]()
    for record in records:
        for each in buses.observe(record)[1].findings:
            found.setdefault(record.channel, []).append((each.rule, each.node_id, each.is_certain))
    return found


def recorded(number: int, seed: int, channel: str) -> list[Record]:
    return [Record(at, channel, frame) for at, frame in damaged(clean(number), seed)]


sessions = st.tuples(st.integers(0, CLEAN - 1), st.integers(0, 10**9))


@given(sessions, sessions)
@examples(100)
def test_each_of_two_buses_is_understood_as_if_it_were_alone(one: tuple[int, int], other: tuple[int, int]) -> None:
    first, second = recorded(*one, "can0"), recorded(*other, "can1")
    alone = told(first) | told(second)
    assert told(sorted(first + second, key=lambda record: record.time)) == alone, "one beside the other"
    assert told(first + second) == alone, "one behind the other"


@given(sessions, st.integers(1, 10**6), st.integers(1001, 10**7))
@examples(100)
def test_a_clock_that_is_set_back_accuses_nobody(session: tuple[int, int], place: int, back: int) -> None:
    """back: ms."""
    records = recorded(*session, "can0")
    place %= len(records)
    moved = [record._replace(time=record.time - back * MILLISECOND) for record in records[place:]]
    before, found = (Counter(told(each).get("can0", [])) for each in (records, records[:place] + moved))
    assert [each for each in found - before if each[0] not in OF_THE_RECORDER] == []
