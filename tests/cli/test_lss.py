"""`canopen lss`: what it finds, what it asks, what it writes, and what it says when it cannot."""

from __future__ import annotations

from pathlib import Path

import pytest

from canopen_cli.lss import set as lss_set
from canopen_cli.lss.set import read_table
from canopen_cli.shared import questions
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_master.simulation import serving
from canopen_proto.lss.messages import LssService
from canopen_proto.lss.slave import STORAGE_FAILED, LssSlave
from tests.builds import replaces_what_is_compiled
from tests.cli.cli_support import Run
from tests.cli.command_examples import json_that_fits

NOT_SUPPORTED = 1

QUICK = ("--window", "10ms", "-b", "demo")
DRIVE = ("--vendor", "0x332", "--product", "0x43", "--revision", "0x10000")


@pytest.fixture
def without_ids(monkeypatch: pytest.MonkeyPatch) -> None:
    """The demo's drives are two, and have no node-ID."""
    monkeypatch.setattr(serving, "DEMO_NODES", (255, 255))


@pytest.mark.usefixtures("without_ids")
def test_scan_shows_the_devices_without_a_node_id(run: Run) -> None:
    outcome = run("lss", "scan", *DRIVE, *QUICK, "--json")
    assert [each["serial_number"] for each in outcome.json] == [1, 2]
    outcome = run("lss", "scan", *DRIVE, *QUICK)
    assert "0x332:0x43:0x10000:0x2" in outcome.out
    assert "2 devices without a node-ID" in outcome.err
    assert "0.2 to 0.4 s for each device" in outcome.err


@pytest.mark.usefixtures("without_ids")
def test_assign_gives_them_ids_in_order(run: Run) -> None:
    outcome = run("lss", "assign", "--ids", "10-20", "--yes", *DRIVE, *QUICK, "--json")
    assert [(each["node"], each["stored"], each["booted"]) for each in outcome.json] == [(10, True, True), (11, True, True)]
    assert outcome.status == ExitCode.OK


def test_identify_does_not_say_that_nobody_is_there(run: Run) -> None:
    outcome = run("lss", "identify", "--vendor", "0x999", "--product", "1", *QUICK)
    assert (outcome.status, "0 devices" in outcome.err) == (ExitCode.NO_ANSWER, False)
    assert "nobody answered; some devices know only fastscan" in outcome.err
    assert "canopen lss scan" in outcome.err


@pytest.mark.usefixtures("without_ids")
def test_a_refused_store_is_not_answered_by_the_same_command_again(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(slave: LssSlave, error: int, now: int, spec: int = 0) -> None:
        complete(slave, NOT_SUPPORTED, now, spec)

    complete = LssSlave.complete_store
    monkeypatch.setattr(LssSlave, "complete_store", refuse)
    outcome = run("lss", "assign", "--ids", "10-20", "--yes", *DRIVE, *QUICK)
    assert outcome.status == ExitCode.PARTIAL
    assert "storing not supported" in outcome.err
    assert "--no-store, and this command after each power-up" in outcome.err
    assert "the same command again" not in outcome.err


@pytest.mark.usefixtures("without_ids")
def test_each_device_is_finished_before_the_next_is_searched(run: Run) -> None:
    lines = run("lss", "assign", "--ids", "10-20", "--yes", *DRIVE, *QUICK).err.splitlines()
    story = [each for each in lines if each.startswith(("found", "1 device so far", "2 devices so far")) or ", ready" in each]
    one, two = "0x332:0x43:0x10000:0x1:", "0x332:0x43:0x10000:0x2:"
    assert [each.split()[0] for each in story] == ["found", one, "1", "found", two, "2"]


@pytest.mark.usefixtures("without_ids")
def test_a_dry_run_of_assign_says_which_device_would_get_which(run: Run) -> None:
    outcome = run("lss", "assign", "--ids", "10-20", *DRIVE, *QUICK, "--dry-run")
    assert outcome.status == ExitCode.OK
    assert "would give 2 node-IDs: 10 to 0x332:0x43:0x10000:0x1, 11 to 0x332:0x43:0x10000:0x2" in outcome.err
    assert "two devices with one address would show only once the first has its node-ID" in outcome.err


@pytest.mark.usefixtures("without_ids")
def test_a_dry_run_of_assign_tells_whom_the_table_leaves_alone(run: Run, tmp_path: Path) -> None:
    table = tmp_path / "nodes.csv"
    table.write_text("node_id, vendor, serial\n12, 0x332, 2\n13, 0x332, 9\n")
    outcome = run("lss", "assign", "--table", str(table), *DRIVE, *QUICK, "--dry-run")
    assert outcome.status == ExitCode.PARTIAL
    assert "would give 1 node-ID: 12 to 0x332:0x43:0x10000:0x2" in outcome.err
    assert "0x332:0x43:0x10000:0x1 is left alone" in outcome.err
    assert "no device has node-ID 13" in outcome.err


@pytest.mark.usefixtures("without_ids")
def test_assign_by_a_table_leaves_strangers_alone(run: Run, tmp_path: Path) -> None:
    table = tmp_path / "nodes.csv"
    table.write_text("node_id, vendor, serial\n12, 0x332, 2\n")
    outcome = run("lss", "assign", "--table", str(table), "--yes", *DRIVE, *QUICK)
    assert "  12  0x332:0x43:0x10000:0x2  yes" in outcome.out
    assert "0x332:0x43:0x10000:0x1 is left alone" in outcome.err
    assert "1 device ready" in outcome.err
    assert (outcome.status, "1 device left without a node-ID" in outcome.err) == (ExitCode.PARTIAL, True)


def test_assign_says_which_rows_of_a_table_nobody_has(run: Run, tmp_path: Path) -> None:
    """Node 3 is one of the demo's; it was given its node-ID before."""
    table = tmp_path / "nodes.csv"
    table.write_text("node_id, vendor, serial\n3, 0x332, 1\n12, 0x332, 77\n13, 0x332, 78\n")
    outcome = run("lss", "assign", "--table", str(table), "--yes", *DRIVE, *QUICK)
    assert outcome.status == ExitCode.PARTIAL
    assert "no device has node-ID 12, 13 of" in outcome.err


@pytest.mark.usefixtures("without_ids")
def test_assign_writes_nothing_without_a_yes(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    async def answer() -> bytes:
        return b"n\n"

    monkeypatch.setattr(questions, "read_input", answer)
    monkeypatch.setattr(questions, "is_asked", lambda screen: True)
    outcome = run("lss", "assign", "--ids", "10-20", *DRIVE, *QUICK)
    assert outcome.err.count("Write 1 node-ID?") == 2
    assert outcome.err.count("is left alone: nobody agreed") == 2
    assert (outcome.status, "interrupted by you: 0 node-IDs written" in outcome.err) == (ExitCode.INTERRUPTED, True), outcome.err


def test_inquire_identify_store_and_set_id_of_a_node(run: Run) -> None:
    assert run("lss", "inquire", "5", *QUICK).out == "0x332:0x43:0x10000:0x3  node-ID 5\n"
    found = json_that_fits("lss identify", run("lss", "identify", *DRIVE[:4], "--serial", "2-3", *QUICK, "--json"))
    assert [each["serial_number"] for each in found] == [2, 3]
    assert "stored, node-ID 4" in run("lss", "store", "0x332:0x43:0x10000:2", "--yes", *QUICK).err
    outcome = run("lss", "set-id", "5", "20", "--yes", *QUICK)
    assert "  20  0x332:0x43:0x10000:0x3  yes      yes     yes" in outcome.out


def test_a_node_id_that_somebody_has_is_not_given(run: Run) -> None:
    outcome = run("lss", "set-id", "5", "6", "--yes", *QUICK)
    assert "CO123" in outcome.err
    assert "another node has the node-ID 6" in outcome.err


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (("inquire", "only"), "CO211", "several devices answer"),
        (("inquire", "0x332:0x43:0x10000:0x99"), "CO211", "no device with the address"),
        (("inquire", "1:2"), "CO120", "not an LSS address"),
        (("inquire", "1:2:3:x"), "CO120", "'x' is not a number"),
        (("assign",), "CO123", "one of the two"),
        (("set-bitrate", "250k"), "CO123", "which bit rate does the bus have now"),
    ],
)
def test_mistakes(run: Run, arguments: tuple[str, ...], code: str, text: str) -> None:
    outcome = run("lss", *arguments, *QUICK)
    assert code in outcome.err
    assert text in outcome.err


def test_a_bit_rate_that_is_none(run: Run) -> None:
    assert "300k is not in CiA's table" in run("lss", "set-bitrate", "300k", *QUICK).err
    outcome = run("lss", "set-bitrate", "250k", "--present", "500k", "-b", "socketcan:can7")
    assert "ip link set can7 type can bitrate {bitrate}" in outcome.err


def test_store_asks_first(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def opened(*arguments: object, **options: object) -> None:
        raise AssertionError("the bus was opened")

    monkeypatch.setattr(lss_set, "open_lss", opened)
    outcome = run("lss", "store", "5", *QUICK)
    assert (outcome.status, "This must be confirmed" in outcome.err) == (ExitCode.USAGE, True)
    assert "the same with --yes" in outcome.err


def test_store_and_set_bitrate_answer_json(run: Run) -> None:
    stored = run("lss", "store", "5", "--yes", "--json", *QUICK)
    assert stored.status == ExitCode.OK
    assert (stored.json["node"], stored.json["stored"]) == (5, True)
    assert run("lss", "store", "5", "--json", "--dry-run", *QUICK).json[-1]["service"] == "LSS"
    words = ("lss", "set-bitrate", "250k", "--present", "500k", "--json", *QUICK)
    dry = run(*words, "--dry-run").json
    assert (dry["before"], dry["bitrate"], dry["dry_run"]) == (500_000, 250_000, True)
    assert [each["stored"] for each in dry["devices"]] == [None] * 6
    done = run(*words, "--yes", "--delay", "100ms").json
    assert [each["stored"] for each in done["devices"]] == [True] * 6
    assert not done["dry_run"]
    passing = run(*words, "--yes", "--delay", "100ms", "--no-store").json
    assert [each["stored"] for each in passing["devices"]] == [None] * 6


@replaces_what_is_compiled
@pytest.mark.parametrize(("refuses", "stored"), [(True, False), (False, None)])
def test_a_device_whose_answer_alone_is_missing_is_not_told_as_one_that_has_not_stored(
    run: Run, monkeypatch: pytest.MonkeyPatch, refuses: bool, stored: bool | None
) -> None:
    def answered(self: LssSlave, service: LssService, error: int, specific: int = 0) -> None:
        if service is not LssService.STORE:
            answer(self, service, error, specific)
        elif refuses:
            answer(self, service, STORAGE_FAILED, specific)

    answer = LssSlave._answer_error
    monkeypatch.setattr(LssSlave, "_answer_error", answered)
    told = run("lss", "set-bitrate", "250k", "--present", "500k", "--json", "--yes", "--delay", "100ms", *QUICK)
    assert (told.status, "did not confirm that they stored" in told.err) == (ExitCode.PARTIAL, True), told.err
    assert [each["stored"] for each in told.json["devices"]] == [stored] * 6


def test_set_bitrate_shows_the_order_and_switches(run: Run) -> None:
    dry = run("lss", "set-bitrate", "250k", "--present", "500k", "--dry-run", *QUICK)
    assert dry.err.count("250 kbit/s in place of 500") == 6
    assert "nothing was written" in dry.err
    outcome = run("lss", "set-bitrate", "250k", "--present", "500k", "--yes", "--delay", "100ms", *QUICK)
    assert "6 devices at 250 kbit/s" in outcome.err


@pytest.mark.parametrize(
    "text", ["", "vendor,serial\n1,2\n", "node_id,colour\n1,2\n", "node_id,serial\n200,1\n", "node_id,serial\n1,x\n"]
)
def test_tables_that_are_none(tmp_path: Path, text: str) -> None:
    table = tmp_path / "nodes.csv"
    table.write_text(text)
    with pytest.raises(CommandError):
        read_table(table)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "the file is empty"),
        ("vendor;serial\n1;2\n", "line 1: vendor;serial"),
        ("node_id,serial\n4,1\n200,1\n", "nodes.csv:3: node-ID 200 is outside 1..127"),
        ("node_id,serial\n4,x\n", "nodes.csv:2: 'x' is not a number of an LSS address"),
        ("serial,node_id\n4\n", "nodes.csv:2: '' is not a node-ID"),
        ("node_id,serial\n4,1\n5,2\n4,3\n", "nodes.csv:4: node-ID 4 is in line 2, too"),
    ],
)
def test_a_wrong_table_is_told_with_its_line(run: Run, tmp_path: Path, text: str, told: str) -> None:
    table = tmp_path / "nodes.csv"
    table.write_text(text)
    outcome = run("lss", "assign", "--table", str(table), *QUICK)
    assert (outcome.status, told in outcome.err, "CO301" in outcome.err) == (ExitCode.BAD_FILE, True, True), outcome.err


def test_what_is_no_device_is_told_what_would_be_one(run: Run) -> None:
    outcome = run("lss", "inquire", "banana", *QUICK)
    assert (outcome.status, "'banana' is no device" in outcome.err, "0x360:0x2:0x10000:7" in outcome.err) == (2, True, True)


@pytest.mark.usefixtures("without_ids")
def test_the_next_step_names_the_bus(run: Run) -> None:
    outcome = run("lss", "inquire", "0x332:0x43:0x10000:0x9", *QUICK)
    assert (outcome.status, "canopen lss scan -b demo" in outcome.err) == (ExitCode.NO_ANSWER, True), outcome.err
