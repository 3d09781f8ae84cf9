"""The commands of `canopen` with `-b demo`, in virtual time: what they print, and with which status they fail."""

from __future__ import annotations

import io
import json
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
import trio

from canopen_cli.shared import session
from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.screen import Screen
from canopen_master.simulation.host import simulate
from canopen_master.simulation.serving import SimulatedDevices
from canopen_proto.datatypes import Value
from canopen_proto.drives.cia402.objects import PROFILE_VELOCITY
from canopen_proto.local_node import LocalNode
from canopen_transports import open_transport
from canopen_transports.log_files import LogReader
from tests.cli.cli_support import SHORT, Alarm, Run, stands
from tests.core.devices import io_device

DEMO = ("-b", "demo")


class Typed(io.StringIO):
    """A keyboard."""

    def isatty(self) -> bool:
        return True


# ---- read ----


def test_read_shows_value_hexadecimal_and_constants(run: Run) -> None:
    outcome = run("read", "3", "statusword", *DEMO)
    assert outcome.status == 0
    row = outcome.out.splitlines()[-1].split()
    assert row[:4] == ["6041:00", "statusword", "576", "0x0240"]
    assert "switch_on_disabled," in row
    assert "node 3 (0x03)" in outcome.err


def test_read_several_objects_by_number_and_as_json(run: Run) -> None:
    documents = run("read", "0x3", "6041", "0x1000:00", "1008", *DEMO, "--json").json
    assert [document["name"] for document in documents] == ["statusword", "device_type", "manufacturer_device_name"]
    assert documents[0]["value"] == 0x240
    assert documents[0]["hex"] == "0x0240"
    assert documents[2]["value"] == "Simulated Schunk Powerball joint"
    assert run("read", "3", "6041", *DEMO, "--json").json["node"] == 3


def test_an_object_that_is_refused_does_not_hide_those_that_were_read(run: Run) -> None:
    keys = ("6041", "2FFF:02", "6064")
    outcome = run("read", "3", *keys, "--type", "u16", *DEMO)
    assert outcome.status == ExitCode.PARTIAL
    assert [line.split()[0] for line in outcome.out.splitlines()[-2:]] == ["6041:00", "6064:00"]
    told = " ".join(outcome.err.split())
    assert "not read: 2FFF:02" in told
    assert "0x06020000" in told
    outcome = run("read", "3", "6041", "2FFF:02", "--type", "u16", "--json", *DEMO)
    assert outcome.status == ExitCode.PARTIAL
    assert [document["name"] for document in outcome.json] == ["statusword"], "a list, because two were asked for"
    assert run("read", "3", "2FFF:02", "2FFF:03", "--type", "u16", *DEMO).status == ExitCode.SDO_ABORT


def test_a_type_that_the_dictionary_knows_better_is_not_ignored_silently(run: Run) -> None:
    told = " ".join(run("read", "3", "6064", "--type", "u16", *DEMO).err.split())
    assert "6064:00 is INTEGER32 in the dictionary: --type u16 does not count for it" in told
    assert "does not count" not in run("read", "3", "6064", "--type", "i32", *DEMO).err
    assert "-e FILE" in run("read", "3", "2FFF:02", *DEMO).err


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("write", "3", "controlword", "enable"), "did you mean sm_enable_operation"),
        (("read", "3", "position"), "did you mean position_actual_value"),
    ],
)
def test_a_word_of_a_name_leads_to_the_names_that_have_it(run: Run, words: tuple[str, ...], meant: str) -> None:
    assert meant in " ".join(run(*words, *DEMO).err.split())


@pytest.mark.parametrize("nodes", ["3-5", "3,4", "all"])
def test_several_nodes_are_read_one_at_a_time(run: Run, nodes: str) -> None:
    outcome = run("read", nodes, "6041", *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert "one node at a time" in outcome.err


def test_a_communication_object_that_the_dictionary_lacks_has_the_type_of_the_standard(run: Run) -> None:
    outcome = run("read", "3", "1F56:01", *DEMO)
    assert "refused reading 1F56:01" in outcome.err
    assert "program_data:program_1 (0x1F50:01) is write-only" in run("read", "3", "1F50:01", *DEMO).err
    assert "CO302" in run("read", "3", "1F4F:01", *DEMO).err


def test_options_may_stand_before_the_command(run: Run) -> None:
    assert run("-b", "demo", "--json", "read", "3", "6041").json["value"] == 0x240


def test_the_bus_may_come_from_the_environment(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CANOPEN_BUS", "demo")
    assert run("read", "3", "6041").status == 0


def test_a_node_that_does_not_answer(run: Run) -> None:
    outcome = run("read", "99", "statusword", *DEMO, "--timeout", "50ms")
    assert outcome.status == ExitCode.NO_ANSWER
    assert "node 99 did not answer reading 6041:00 (statusword) in 0.05 s" in outcome.err
    assert "canopen scan" in outcome.err
    error = run("read", "99", "statusword", *DEMO, "--json").error
    assert (error["code"], error["kind"], error["node"], error["index"], error["sub"]) == ("CO201", "no_answer", 99, 0x6041, 0)
    assert error["abort"] == 0x05040000


def test_an_object_that_only_a_type_describes(run: Run) -> None:
    outcome = run("read", "3", "5000:01", *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert "--type" in outcome.err
    outcome = run("read", "3", "5000:01", "--type", "u16", *DEMO, "--json")
    assert outcome.status == ExitCode.SDO_ABORT
    assert outcome.error["abort"] == 0x06020000
    assert run("read", "3", "1400:01", "--type", "u32", *DEMO, "--json").json["value"] == 0x203
    assert run("read", "3", "1A00.0", "--type", "u8", *DEMO, "--json").json["value"] == 3


@pytest.mark.parametrize("key", ["statuswrod", "60411:00", "0000", "6041:zz"])
def test_an_unknown_object(run: Run, key: str) -> None:
    outcome = run("read", "3", key, "--type", "u16", *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert "CO302" in outcome.err
    if key == "statuswrod":
        assert "did you mean statusword" in outcome.err


def test_what_is_write_only_is_not_asked(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "indices.csv").write_text("secret 0x2000 0x00 2 wo\n")
    (tmp_path / "constants.csv").write_text("")
    (tmp_path / "PDOs.csv").write_text("")
    monkeypatch.setenv("CANOPEN_DATA", str(tmp_path))
    outcome = run("read", "3", "secret", *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert "write-only" in outcome.err
    assert "used instead of the installed indices.csv" in outcome.err
    assert "used instead" not in run("read", "3", "secret", *DEMO, "-q").err


# ---- write ----


def test_write_shows_old_and_new(run: Run) -> None:
    outcome = run("write", "3", "controlword", "sm_shutdown", *DEMO)
    assert outcome.status == 0
    assert "node 3 (0x03) controlword (0x6040:00): 0 (0x0000)" in outcome.out
    assert "→ 6 (0x0006) [sm_shutdown]" in outcome.out
    document = run("write", "3", "6081", "1234", "--verify", *DEMO, "--json").json
    assert (document["previous"], document["value"], document["verified"]) == (20000, 1234, True)


def test_a_negative_number_is_no_option(run: Run) -> None:
    for words in (("-5",), ("--", "-5")):
        assert run("write", "3", "607A", *DEMO, *words).status == 0
    outcome = run("read", "3", "-5", *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert "negative numbers behind `--`: canopen read ... -- -5" in outcome.err


def test_what_only_the_command_line_describes_is_not_said_to_be_in_the_dictionary(run: Run) -> None:
    outcome = run("read", "3", "2FFF:01", "--type", "u8", *DEMO)
    assert outcome.status == ExitCode.SDO_ABORT
    assert "the device does not have this object" in outcome.err
    assert "dictionary lists" not in outcome.err


@pytest.mark.parametrize("width", ["60", "30"])
def test_a_table_that_is_too_wide_becomes_blocks(run: Run, monkeypatch: pytest.MonkeyPatch, width: str) -> None:
    monkeypatch.setenv("COLUMNS", width)
    outcome = run("scan", "--ids", "3-8", *DEMO)
    assert max(map(len, outcome.out.splitlines())) <= int(width)
    assert "…" not in outcome.out
    assert outcome.out.count("vendor-ID") == 6
    assert outcome.out.count("0x00000043") == 6


def test_a_width_that_is_none(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "wide")
    assert run("read", "3", "statusword", *DEMO).status == 0


def test_write_without_a_dictionary_entry(run: Run) -> None:
    outcome = run("write", "3", "1017", "100", "--type", "u16", *DEMO, "--json")
    assert outcome.json["previous"] == 500
    outcome = run("write", "3", "1A01:00", "0", "--type", "u8", "--verify", *DEMO, "--json")
    assert outcome.json["value"] == 0


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("6083", "99999999999", "99999999999"),
        ("controlword", "sm_shutdwn", "sm_shutdown"),
        ("controlword", "-1", "controlword"),
        ("controlword", "1.5", "controlword"),
        ("statusword", "5", "cannot be written"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_is_sent(run: Run, key: str, value: str, words: str) -> None:
    outcome = run("write", *DEMO, "3", key, "--", value)
    assert outcome.status == ExitCode.USAGE
    assert words in outcome.err


def test_a_refusal_of_the_drive(run: Run) -> None:
    outcome = run("write", "3", "modes_of_operation", "8", *DEMO, "--json")
    assert outcome.status == ExitCode.SDO_ABORT
    assert outcome.error["abort"] == 0x06090030


def test_a_value_that_reads_back_differently(run: Run, simulations: list[SimulatedDevices], alarm: Alarm) -> None:
    alarm.task = _stubborn_drive
    outcome = run("write", "3", "profile_velocity", "5", "--verify", *DEMO)
    assert outcome.status == ExitCode.VERIFY_MISMATCH
    assert "took 5 (0x00000005) for profile_velocity (0x6081:00), but shows 20000 (0x00004E20)" in outcome.err


class Stubborn(dict[int, Value]):
    """A memory that keeps one value."""

    def __setitem__(self, key: int, value: Value) -> None:
        if key != PROFILE_VELOCITY:
            super().__setitem__(key, value)


async def _stubborn_drive(simulation: SimulatedDevices) -> None:
    values = simulation.drives[3].values
    values.store = Stubborn(values.store)


# ---- scan, info ----


def test_scan_finds_six_drives(run: Run) -> None:
    outcome = run("scan", *DEMO)
    assert outcome.status == 0
    rows = outcome.out.splitlines()[2:]
    assert [row.split()[:2] for row in rows] == [[str(node), f"(0x0{node})"] for node in range(3, 9)]
    assert all("servo drive (CiA 402)" in row for row in rows)
    assert "serial number" not in outcome.out
    assert "6 nodes found" in outcome.err
    assert "serial number" in run("scan", *DEMO, "-v").out


def test_scan_as_json_and_of_some(run: Run) -> None:
    rows = run("scan", "--ids", "3-4", "--timeout", "20ms", *DEMO, "--json").json
    asked = [row["node"] for row in rows if row["device_type"] is not None]
    assert asked == [3, 4]
    assert {row["state"] for row in rows} == {"PRE_OPERATIONAL"}


def test_passive_scan(run: Run) -> None:
    outcome = run("scan", "--passive", *DEMO)
    assert "6 nodes heard" in outcome.err
    assert "pre-operational" in outcome.out
    outcome = run("scan", "--passive", "-b", "virtual:empty")
    assert "0 nodes heard" in outcome.err
    assert "without --passive" in outcome.err


def test_nobody_is_there(run: Run) -> None:
    outcome = run("scan", "-b", "virtual:empty")
    assert outcome.status == ExitCode.NO_ANSWER
    assert "0 nodes found" in outcome.err
    assert outcome.out == ""


@pytest.mark.parametrize(
    "command",
    ["scan", "scan --passive", "lss scan", "listen --seconds 1", "monitor --seconds 1", "top --once --seconds 1",
     "net init -o x.toml", "info 5", "drive 5 stop", "doctor --for 1s"],
)  # fmt: skip
def test_nobody_there_has_one_exit_status(run: Run, command: str) -> None:
    assert run(*command.split(), "-b", "virtual:empty").status == ExitCode.NO_ANSWER


def test_assign_has_nothing_to_do_where_nobody_lacks_a_node_id(run: Run) -> None:
    """Who has a node-ID does not answer its search: it cannot tell a silent bus from one where all is done."""
    assert run("lss", "assign", "--ids", "5-6", "--yes", "-b", "virtual:empty").status == ExitCode.OK


@pytest.mark.thorough(3)
@pytest.mark.parametrize(
    "command",
    [
        "scan",
        "scan -v",
        "info 99",
        "info 99 -vv",
        "drive 99 stop",
        "drive 3 stop --axis 9",
        "drive 3 enable --seconds 0.1",
        "nmt reset 3",
        "read 3 6041 --bogus",
        "scan --trace no-such-folder/t.log",
        "scan --trace t.blf -b virtual:empty",
        "lss assign --ids 5-6 --yes -b virtual:empty",
        "lss",
        "drive 3",
        "move --to joint1=1000",
        "no-such-command",
    ],
)
def test_with_json_stderr_is_one_document(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = run(*DEMO, *command.split(), "--json")
    document = json.loads(outcome.err)
    assert ("code" in document) is (
        outcome.status not in (ExitCode.OK, ExitCode.NO_ANSWER) or document.get("kind") == "no_answer"
    )
    assert all(isinstance(note, str) for note in document["notes"])


def test_an_error_has_the_notes_that_came_before_it(run: Run) -> None:
    error = run("demo", "--fault", "5@0.2", *SHORT, "--json").error
    assert error["code"] == "CO402"
    assert error["notes"]


def test_with_json_a_command_that_runs_until_ctrl_c_tells_at_once(run: Run) -> None:
    outcome = run("sim", "--id", "5", "-b", "virtual:x", "--seconds", "0.1", "--json")
    lines = [json.loads(line) for line in outcome.err.splitlines()]
    assert lines
    assert all(set(line) == {"note"} for line in lines)


def test_what_quiet_does_not_hide_is_json_too(capsys: pytest.CaptureFixture[str]) -> None:
    screen = Screen(json_output=True, verbosity=-1)
    screen.warn("[yellow]the state was not kept[/]")
    screen.say("ended")
    screen.finish()
    assert json.loads(capsys.readouterr().err) == {"notes": ["the state was not kept"]}


def test_a_scan_of_some_tells_of_these(run: Run) -> None:
    outcome = run("scan", "--ids", "3,99", *DEMO, "--json")
    assert [node["node"] for node in outcome.json] == [3]
    assert "1 node found; heard too, and not asked: 4, 5, 6, 7, 8" in outcome.err


@pytest.mark.parametrize(
    "command", ["lss assign --ids 5-9", "lss set-bitrate 250k --present 500k", "flash 3 pyproject.toml", "nmt reset 3"]
)
def test_a_question_that_nobody_can_answer_is_refused_before_anything_is_done(
    run: Run, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    def opened(*arguments: object, **options: object) -> None:
        raise AssertionError("the bus was opened")

    monkeypatch.setattr(session, "open_master", opened)
    outcome = run(*command.split(), "-b", "virtual:empty")
    assert outcome.status == ExitCode.USAGE, outcome.err
    assert "CO122" in outcome.err


def test_scan_on_a_terminal_draws_a_bar(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    outcome = run("scan", *DEMO)
    assert "scanning" in outcome.err
    assert "found 3, 4" in outcome.err


def test_info(run: Run) -> None:
    outcome = run("info", "3", *DEMO)
    assert outcome.status == 0
    facts = ("servo drive (CiA 402)", "switch on disabled", "interpolated position", "each 500 ms", "-14000 counts", "pre-op")
    for fact in facts:
        assert fact in outcome.out
    document = run("info", "3", *DEMO, "--json").json
    assert (document["node"], document["device_type"], document["supported_modes"]) == (3, 0x20192, 0x43)
    assert document["RPDO1"] == {"can_id": 0x203, "transmission_type": 1, "objects": ["6040:00", "6042:00", "60C1:01"]}
    assert "0x183, type 1: statusword, torque_actual_value, position_actual_value" in outcome.out


def test_info_asks_for_each_value_of_up_to_4_bytes_in_one_frame(run: Run, tmp_path: Path) -> None:
    """Such an answer names its object: another client on the channel cannot change it."""
    log = tmp_path / "info.log"
    assert run("info", "3", *DEMO, "--trace", str(log)).status == 0
    frames = [record.frame.data for record in LogReader(log) if record.frame.can_id == 0x583]
    assert not [data.hex() for data in frames if data[0] & 0xE0 == 0xC0]  # no block transfer, of whatever
    segmented = {data[1:3] for data in frames if data[0] == 0x41}
    assert segmented <= {b"\x08\x10", b"\x09\x10", b"\x0a\x10"}  # the texts
    assert len({data[1:4] for data in frames if data[0] in (0x43, 0x47, 0x4B, 0x4F)}) > 40


def test_info_of_a_drive_in_fault(run: Run, simulations: list[SimulatedDevices], alarm: Alarm) -> None:
    async def fault(simulation: SimulatedDevices) -> None:
        simulation.raise_fault(3, 0x2310)

    alarm.task = fault
    outcome = run("info", "3", *DEMO)
    for fact in ("current", "last errors", "drive error", "0x2310 continuous over-current"):
        assert fact in outcome.out


def test_info_of_something_that_is_no_drive(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    @asynccontextmanager
    async def io_module(*arguments: object) -> AsyncIterator[None]:
        async with trio.open_nursery() as nursery:
            transport = await open_transport("virtual:demo")
            await nursery.start(simulate, transport, [lambda out: LocalNode(out, 5, io_device(5))])
            await trio.sleep(0.1)
            yield
            nursery.cancel_scope.cancel()

    monkeypatch.setattr(session, "simulated_drives", io_module)
    outcome = run("info", "5", *DEMO)
    assert outcome.status == 0
    assert "I/O module (CiA 401)" in outcome.out
    assert "statusword" not in outcome.out
    assert "off" in outcome.out


def test_info_of_nobody(run: Run) -> None:
    assert run("info", "50", *DEMO).status == ExitCode.NO_ANSWER


# ---- nmt ----


def test_nmt_start_and_wait(run: Run) -> None:
    outcome = run("nmt", "start", "3", "--wait", *DEMO)
    assert outcome.status == 0
    assert "OPERATIONAL" in outcome.err
    assert "not confirmed" in run("nmt", "stop", "3", *DEMO).err
    assert run("nmt", "stop", "3", "--wait", *DEMO, "--json").json == {"command": "STOP", "node": 3, "state": "STOPPED"}


def test_nmt_reset_and_wait(run: Run) -> None:
    assert "PRE-OPERATIONAL" in run("nmt", "reset-comm", "3", "--wait", "--yes", *DEMO).err


def test_a_reset_and_all_nodes_have_to_be_confirmed(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    for words in (("reset", "3"), ("preop", "--all")):
        outcome = run("nmt", *words, *DEMO)
        assert outcome.status == ExitCode.USAGE
        assert "--yes" in outcome.err
        assert run("nmt", *words, "--yes", *DEMO).status == 0
    assert run("nmt", "start", "--all", "--yes", *DEMO, "--json").json["node"] == 0


def test_on_a_terminal_it_asks(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setattr(sys, "stdin", Typed("y\n"))
    assert run("nmt", "start", "--all", *DEMO).status == 0
    monkeypatch.setattr(sys, "stdin", Typed("n\n"))
    outcome = run("nmt", "start", "--all", *DEMO)
    assert outcome.status == ExitCode.INTERRUPTED
    assert "nothing was sent" in outcome.err


def test_nmt_wants_a_node_or_all(run: Run) -> None:
    assert run("nmt", "start", *DEMO).status == ExitCode.USAGE
    assert run("nmt", "start", "3", "--all", *DEMO).status == ExitCode.USAGE
    assert run("nmt", "start", "--all", "--wait", *DEMO).status == ExitCode.USAGE
    assert run("nmt", "explode", "3", *DEMO).status == ExitCode.USAGE


def test_waiting_for_a_node_that_is_not_there(run: Run) -> None:
    outcome = run("nmt", "start", "99", "--wait", *DEMO)
    assert outcome.status == ExitCode.NO_ANSWER
    assert "1017" in outcome.err


# ---- home ----


def test_home(run: Run, simulations: list[SimulatedDevices]) -> None:
    outcome = run("home", "3", "4", "3", *DEMO)
    assert outcome.status == 0
    assert [line.split()[:3] for line in outcome.out.splitlines()[2:]] == [["3", "(0x03)", "yes"], ["4", "(0x04)", "yes"]]
    (document,) = run("home", "5", "--reset-fault", *DEMO, "--json").json
    assert (document["node"], document["homed"], document["state"], document["position"]) == (5, True, "switch on disabled", 0)


def test_a_mode_that_the_drive_lacks(run: Run) -> None:
    outcome = run("home", "3", "--style", "standard", *DEMO)
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "CO405" in outcome.err
    assert "does not support homing" in outcome.err
    assert "interpolated position" in outcome.err


def test_homing_takes_too_long(run: Run, simulations: list[SimulatedDevices]) -> None:
    outcome = run("home", "3", "--limit", "100ms", *DEMO)
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "CO407" in outcome.err
    assert "the drives were halted" in outcome.err
    assert "a longer --limit (now 0.1 s)" in outcome.err
    assert all(stands(drive) for drive in simulations[0].drives.values())


def test_a_method_for_a_drive_that_knows_none(run: Run) -> None:
    outcome = run("home", "3", "--method", "17", *DEMO)
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "without a method" in outcome.err
    assert "the same without a method" in outcome.err
    assert run("home", "3", "--method", "17", "--style", "schunk", *DEMO).status == ExitCode.USAGE


@pytest.mark.parametrize("at", [0.02, 0.3, 0.8])
def test_ctrl_c_while_homing_halts_the_drives(run: Run, simulations: list[SimulatedDevices], alarm: Alarm, at: float) -> None:
    alarm.set((at, signal.SIGINT))
    outcome = run("home", "3", "5", *DEMO)
    assert outcome.status == ExitCode.INTERRUPTED
    assert "the drives were halted" in outcome.err
    assert all(stands(drive) for drive in simulations[0].drives.values())


# ---- sim ----


def test_sim_serves_for_a_while(run: Run) -> None:
    outcome = run("sim", "--ids", "12,13", "--shape", "standard", "--seconds", "1", "-b", "virtual:anywhere")
    assert outcome.status == 0
    assert "2 simulated drives on virtual:anywhere" in outcome.err
    assert "node 12 (0x0C)  NMT pre-operational" in outcome.err
    assert "node 13 (0x0D)  switch on disabled" in outcome.err


def test_sim_ends_well_by_ctrl_c(run: Run, simulations: list[SimulatedDevices], alarm: Alarm) -> None:
    async def fault(simulation: SimulatedDevices) -> None:
        await trio.sleep(0.1)
        simulation.raise_fault(3, 0x2310)

    alarm.task = fault
    alarm.set((1.0, signal.SIGINT))
    outcome = run("sim", *DEMO)
    assert outcome.status == 0
    assert "fault 0x2310" in outcome.err
    assert outcome.err.endswith("ended\n")


def test_sim_on_a_bus_that_is_not_there(run: Run) -> None:
    assert run("sim", "-b", "socketcan:can77").status == ExitCode.CANNOT_OPEN
    outcome = run("sim")
    assert outcome.status == ExitCode.USAGE
    assert "-b udp_multicast" in outcome.err


def test_sim_tells_who_can_hear_it(run: Run) -> None:
    told = run("sim", "--ids", "3", "--seconds", "1", *DEMO).err
    assert "1 simulated drive on demo, for 1 s" in told
    assert "-b udp_multicast another terminal can join" in told


# ---- data init ----


def test_data_init(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("CANOPEN_DATA")
    outcome = run("data", "init")
    assert outcome.status == 0
    folder = tmp_path / ".canopen"
    assert "created" in outcome.err
    (folder / "indices.csv").write_text("mine")
    outcome = run("data", "init")
    assert "kept" in outcome.err
    assert "--force" in outcome.err
    assert (folder / "indices.csv").read_text() == "mine"
    outcome = run("data", "init", "--force", "--json")
    assert {each["action"] for each in outcome.json} == {"replaced", "unchanged"}
    assert "CANOPEN_DATA=" in run("data", "init", "-o", str(tmp_path / "other")).err


def test_data_init_where_nothing_can_be_written(run: Run) -> None:
    assert run("data", "init", "-o", "/proc/nothing").status == ExitCode.BAD_FILE


def test_warnings_about_the_dictionary_are_told_when_asked(run: Run) -> None:
    assert "schunk_debug_rPDO" in run("read", "3", "6041", *DEMO, "-v").err
    assert "schunk_debug_rPDO" not in run("read", "3", "6041", *DEMO).err


# ---- the whole ----


def test_help_and_version(run: Run) -> None:
    outcome = run("--help")
    assert outcome.status == 0
    assert outcome.out.index("demo ") < outcome.out.index("scan ") < outcome.out.index("read ")
    assert run("--version").out.startswith("canopen")
    assert run().status == ExitCode.USAGE
    outcome = run("fly")
    assert outcome.status == ExitCode.USAGE
    assert "canopen --help" in outcome.err


def test_a_bus_has_to_be_named(run: Run) -> None:
    outcome = run("scan")
    assert outcome.status == ExitCode.USAGE
    assert "-b demo" in outcome.err


def test_an_impossible_node_id(run: Run) -> None:
    assert run("read", "200", "6041", *DEMO, "--json").error["code"] == "CO120"
