"""`canopen backup` and `canopen restore` over a bus: what they print, what they write, and how they end."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
import trio

from canopen_cli.node.backup import bit_rate_of, write_dcf
from canopen_cli.shared.options import Settings
from canopen_cli.shared.problem import ExitCode
from canopen_data.describing import describe
from canopen_data.descriptions import load_description
from canopen_data.eds.writer import write_eds
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Object, Variable
from canopen_proto.manager.parameters.backup import Backup
from canopen_proto.nmt import NmtState
from tests.cli.backup_world import EDS, NODE, Lasting, answering, change, lasting_device
from tests.cli.cli_support import Run, runner_in_folder
from tests.cli.command_examples import fit_their_schema
from tests.core.devices import LIMITED, TEXT
from tests.manager.restore_bench import GAIN, Strict, device


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    return runner_in_folder(capsys, monkeypatch, tmp_path)


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch, run: Run) -> Lasting:
    return lasting_device(monkeypatch)


# ---- backup ----


def test_a_backup_is_a_dcf_with_all_that_was_read(run: Run, world: Lasting) -> None:
    outcome = run("backup", *NODE, *EDS, "-o", "before.dcf")
    assert (outcome.status, outcome.out) == (0, "")
    assert outcome.err == (
        "before.dcf: backup of node 5 (0x05), 135 objects read; 1 write-only, 1 kept out by ObjFlags, "
        "1 DOMAIN (not read without --domains), 3 not in the device\n"
    )
    description = load_description("before.dcf")
    assert [str(each) for each in description.findings] == []
    assert description.commissioning is not None
    assert (description.commissioning.node_id, description.commissioning.bit_rate) == (5, None)
    assert description.file_info.file_name == "before.dcf"
    read = {each.mux: each.configured for each in description.dictionary if each.configured is not None}
    assert read == {key: world.values[key] for key in read}
    assert len(read) == 135
    assert world.writes == []
    assert world.state is NmtState.OPERATIONAL


def test_a_backup_as_json_and_with_the_bit_rate(run: Run, world: Lasting) -> None:
    outcome = run("backup", *NODE, *EDS, "-o", "before.dcf", "--json", "--domains")
    assert outcome.status == 0
    assert outcome.json["counts"] == {"read": 136, "write-only": 1, "kept out": 1, "absent": 3}
    assert [each["result"] for each in outcome.json["not_read"]] == ["absent"] * 3 + ["write-only", "kept out"]
    assert load_description("before.dcf").dictionary.variable("image").configured == b"firmware"
    rates = {"pcan:PCAN_USBBUS1@500k": 500, "pcan:PCAN_USBBUS1@83.333k": None, "can0": None, "nonsense": None}
    assert {bus: bit_rate_of(Settings(bus=bus)) for bus in rates} == rates


def test_a_backup_by_the_data_files_holds_what_the_device_has(run: Run, world: Lasting) -> None:
    assert run("backup", *NODE, "-o", "before.dcf").status == 0
    indices = set(load_description("before.dcf").dictionary.objects)
    assert {0x1000, 0x1017, 0x1018} <= indices
    assert indices <= set(world.dictionary.objects)


def test_a_backup_by_a_walk(run: Run, world: Lasting) -> None:
    outcome = run("backup", *NODE, "-o", "found.dcf", "--walk", "1000-1019,2000-0x2003")
    assert outcome.status == 0
    found = load_description("found.dcf").dictionary
    assert {0x1400, 0x1600, 0x1800, 0x1A00, 0x2000} <= set(found.objects)
    assert 0x2011 not in found.objects
    assert found.variable(0x2002).configured == 10
    assert found.variable(0x2003).configured == b"an I/O device with a long name"
    world.values[LIMITED << 8] = 12
    assert run("compare", *NODE[1:], "5", "found.dcf").status == 1
    assert run("restore", *NODE, "found.dcf", "--yes").status == 0
    assert world.values[LIMITED << 8] == 10
    assert run("backup", *NODE, *EDS, "-o", "x.dcf", "--walk", "2000").status == ExitCode.USAGE
    for nonsense in ("2001-2000", "xyz", "0"):
        assert run("backup", *NODE, "-o", "x.dcf", "--walk", nonsense).status == ExitCode.USAGE


def test_what_could_not_be_read_is_told_and_makes_a_backup_partial(run: Run, world: Lasting) -> None:
    refused = dict.fromkeys((0x1400, 0x1600, 0x1601, 0x2100), AbortCode.GENERAL_ERROR)
    world.prepare = lambda node: answering(node, {**refused, LIMITED: b"\x01\x02\x03"})
    outcome = run("backup", *NODE, *EDS, "-o", "before.dcf")
    assert outcome.status == ExitCode.PARTIAL
    assert "not read: 1400:00 rpdo1_communication_parameter:highest_sub" in outcome.err
    assert "refused: abort 0x08000000, general error" in outcome.err
    assert "not read: 7 more; -v shows them" in outcome.err
    assert Path("before.dcf").exists()
    told = run("backup", *NODE, *EDS, "-o", "before.dcf", "-v", "--force").err
    assert "not read: 2002:00 limited: 3 bytes (01 02 03) are no UNSIGNED8" in told
    assert "not read: 2010:00 secret: write-only" in told


def test_a_backup_by_the_file_of_another_device_says_so(run: Run, world: Lasting) -> None:
    Path("other.eds").write_text(Path(EDS[1]).read_text().replace("[1018sub2]", "[1018sub2]\nDefaultValue=0x77\n;"))
    told = run("backup", *NODE, "-e", "5=other.eds", "-o", "before.dcf")
    assert told.status == ExitCode.PARTIAL
    assert "other.eds is the file of ANOTHER DEVICE, by product code 0x" in told.err
    assert "(file: 0x00000077)" in told.err


def test_a_backup_that_cannot_be_written_is_told_before_the_work(run: Run, world: Lasting) -> None:
    outcome = run("backup", *NODE, *EDS, "-o", "nowhere/before.dcf")
    assert outcome.status == ExitCode.BAD_FILE
    assert "there is no folder nowhere" in outcome.err
    assert world.state is None  # nobody was asked
    assert run("backup", *NODE, *EDS, "-o", "device.eds").status == ExitCode.USAGE  # the file that describes it
    assert run("backup", *NODE).status == ExitCode.USAGE


@pytest.mark.parametrize(
    "command", [("backup", "-o", "x.dcf"), ("dump",), ("compare", "good.dcf"), ("restore", "good.dcf", "--yes")]
)
def test_a_dead_node(run: Run, world: Lasting, command: tuple[str, ...]) -> None:
    assert run("backup", *NODE, *EDS, "-o", "good.dcf").status == 0
    world.is_there = False
    name, *rest = command
    outcome = run(name, "5", *rest, "-b", "demo")
    assert outcome.status == ExitCode.NO_ANSWER
    assert "node 5 did not answer reading" in outcome.err
    assert "nothing at all was heard on this bus" in outcome.err
    assert not Path("x.dcf").exists()


def test_ctrl_c_leaves_no_half_file(run: Run, world: Lasting) -> None:
    world.prepare = lambda node: trio.lowlevel.spawn_system_task(ctrl_c, 0.001)
    Path("before.dcf").write_text("what was there")
    world_is_slow(world)
    outcome = run("backup", *NODE, *EDS, "-o", "before.dcf", "--force")
    assert outcome.status == ExitCode.INTERRUPTED
    assert Path("before.dcf").read_text() == "what was there"


async def ctrl_c(after: float) -> None:
    await trio.sleep(after)
    signal.raise_signal(signal.SIGINT)


def world_is_slow(world: Lasting) -> None:
    """Nobody answers: time passes on a virtual clock only while somebody waits."""
    begin = world.prepare

    def prepare(node: Strict) -> None:
        begin(node)
        node.takes = lambda frame: False

    world.prepare = prepare


# ---- restore ----


def test_a_changed_device_is_restored_and_each_write_is_shown(run: Run, world: Lasting) -> None:
    assert run("backup", *NODE, *EDS, "-o", "before.dcf").status == 0
    before = dict(world.values)
    Path("before.dcf").unlink()
    change(run, world)
    world.values = before.copy()
    assert run("restore", *NODE, "changed.dcf", "--yes").status == 0
    assert (world.values[0x1801_01], world.values[TEXT << 8], world.values[GAIN << 8]) == (0x295, "changed", 2.5)
    outcome = run("restore", *NODE, "before.dcf", "--verify", "--store", "--yes")
    assert outcome.status == 0
    assert outcome.out.splitlines() == [
        "1801:01 tpdo2_communication_parameter:cob_id: 661 (0x00000295) → 2147484309 (0x80000295)",
        "2003:00 text: 'changed' → 'an I/O device with a long name'",
        "2012:00 gain: 2.5 → 1.5",
        "1801:01 tpdo2_communication_parameter:cob_id: 2147484309 (0x80000295) → 645 (0x00000285)",
    ]
    assert "node 5 (0x05): 4 writes done, and stored. It is OPERATIONAL, as before" in outcome.err
    assert world.state is NmtState.OPERATIONAL
    assert world.writes == [(0x1801, 1), (TEXT, 0), (GAIN, 0), (0x1801, 1), (0x1010, 1)]
    settings = before.keys() - {0x1010_01, 0x1010_02, 0x1011_01, 0x1011_02}  # these show what a device can do
    assert {key: world.values[key] for key in settings} == {key: before[key] for key in settings}
    assert run("compare", "5", "before.dcf", "-b", "demo").status == 0


def test_a_dry_run_writes_nothing(run: Run, world: Lasting) -> None:
    change(run, world)
    outcome = run("restore", *NODE, "before.dcf", "--dry-run", "-v")
    assert outcome.status == 0
    assert sum("→" in line for line in outcome.out.splitlines()) == 4
    assert outcome.out.splitlines()[4].startswith("000#8005")  # the frames, from Pre-operational on
    assert "4 writes to do; nothing was written (--dry-run)" in outcome.err
    assert "left out: 1000:00, read-only" in outcome.err
    assert world.writes == []
    assert world.state is NmtState.OPERATIONAL
    assert world.values[GAIN << 8] == 2.5


def test_a_restore_as_json(run: Run, world: Lasting) -> None:
    change(run, world)
    outcome = run("restore", *NODE, "before.dcf", "--yes", "--json", "--skip", "gain", "--skip", "2003")
    fit_their_schema("restore", outcome.out)
    assert outcome.status == 0
    document = outcome.json
    assert [(each["index"], each["sub"], each["done"]) for each in document["writes"]] == [(0x1801, 1, True)] * 2
    assert document["writes"][0]["before"] == 0x295
    assert (document["state_before"], document["done"], document["stored"]) == ("OPERATIONAL", True, False)
    assert {"index": GAIN, "sub": 0, "reason": "skipped"} in document["left_out"]


def test_a_device_without_a_heartbeat_stays_pre_operational(run: Run, world: Lasting) -> None:
    world.dictionary = device(0)
    change(run, world)
    outcome = run("restore", *NODE, "before.dcf", "--yes")
    assert outcome.status == 0
    assert "It has no heartbeat that shows in which state it was: it stays Pre-operational; canopen nmt start 5" in outcome.err
    assert world.state is NmtState.PRE_OPERATIONAL
    assert "0 writes done\n" in run("restore", *NODE, "before.dcf", "--yes").err


def test_a_refusal_in_the_middle_is_told_with_what_stands(run: Run, world: Lasting) -> None:
    change(run, world)
    world.prepare = lambda node: setattr(node, "refuse", lambda count: AbortCode.DEVICE_STATE if count == 2 else None)
    outcome = run("restore", *NODE, "before.dcf", "--yes")
    assert outcome.status == ExitCode.SDO_ABORT
    assert len(outcome.out.splitlines()) == 1
    for line in (
        "error CO202: node 5 refused writing 0x2003:00",
        "1 of 4 writes were confirmed",
        "not written: 2003:00 (text), 2012:00 (gain), 1801:01 (tpdo2_communication_parameter:cob_id)",
        "PDOs left disabled: 1801:01 (tpdo2_communication_parameter:cob_id)",
        "node 5 (0x05) stays Pre-operational",
        "canopen restore 5 before.dcf --dry-run -b demo    (what is still to be written)",
        "--skip 2003:00, if the device need not have it",
    ):
        assert line in outcome.err
    assert world.state is NmtState.PRE_OPERATIONAL


def test_a_write_that_is_not_confirmed_is_told_and_not_repeated(run: Run, world: Lasting) -> None:
    change(run, world)
    world.prepare = lambda node: setattr(node, "is_silent", lambda count: count == 3)
    outcome = run("restore", *NODE, "before.dcf", "--yes", "--json")
    fit_their_schema("restore", outcome.out)
    assert outcome.status == ExitCode.NO_ANSWER
    assert "not confirmed, so it may have been executed: 2012:00 (gain); it is not sent again" in outcome.error["also"]
    assert len(world.writes) == 3
    assert [each["done"] for each in outcome.json["writes"]] == [True, True, False, False]


def test_what_reads_back_otherwise_is_told(run: Run, world: Lasting) -> None:
    change(run, world)

    def prepare(node: Strict) -> None:
        reads = node.read
        node.read = lambda index, sub, now: (  # type: ignore[method-assign]
            b"\0\0\0\0" if index == GAIN and node.writes else reads(index, sub, now)
        )

    world.prepare = prepare
    outcome = run("restore", *NODE, "before.dcf", "--yes", "--verify")
    assert outcome.status == ExitCode.VERIFY_MISMATCH
    assert "error CO205: node 5 took 1.5 for gain (0x2012:00), but shows something else" in outcome.err
    assert "bytes 00 00 00 00, written were 00 00 c0 3f" in outcome.err
    assert "--skip 2012:00" in outcome.err


def test_ctrl_c_in_the_middle_of_a_restore(run: Run, world: Lasting) -> None:
    change(run, world)

    def prepare(node: Strict) -> None:
        node.is_silent = lambda count: trio.lowlevel.spawn_system_task(ctrl_c, 0.1) is not None if count == 2 else False

    world.prepare = prepare
    outcome = run("restore", *NODE, "before.dcf", "--yes")
    assert outcome.status == ExitCode.INTERRUPTED
    assert "1 of 4 writes were confirmed" in outcome.err
    assert "not confirmed, so it may have been executed: 2003:00 (text)" in outcome.err
    assert "PDOs left disabled: 1801:01" in outcome.err
    assert world.state is NmtState.PRE_OPERATIONAL


def test_ctrl_c_before_anything_was_written(run: Run, world: Lasting) -> None:
    assert run("backup", *NODE, *EDS, "-o", "before.dcf").status == 0
    world.prepare = lambda node: trio.lowlevel.spawn_system_task(ctrl_c, 0.1)
    world_is_slow(world)
    outcome = run("restore", *NODE, "before.dcf", "--yes")
    assert outcome.status == ExitCode.INTERRUPTED
    assert "nothing was written" in outcome.err


def test_a_device_that_cannot_store(run: Run, world: Lasting) -> None:
    change(run, world)
    world.prepare = lambda node: answering(node, {0x1010: bytes(4)})
    outcome = run("restore", *NODE, "before.dcf", "--yes", "--store")
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "does not store its parameters on command" in outcome.err
    assert "nothing was written" in outcome.err
    assert world.writes == []


def test_a_restore_has_to_be_confirmed(run: Run, world: Lasting) -> None:
    change(run, world)
    outcome = run("restore", *NODE, "before.dcf")
    assert outcome.status == ExitCode.USAGE
    assert "becomes Pre-operational" in outcome.err
    assert "the same with --yes" in outcome.err


def test_to_overwrite_a_trace_allows_no_other_device(run: Run, world: Lasting) -> None:
    change(run, world)
    text = Path("before.dcf").read_text()
    Path("other.dcf").write_text(text.replace("ParameterValue=0x0000029C", "ParameterValue=0x000000AB"))
    for node, file, code in (("6", "before.dcf", "CO128"), ("5", "other.dcf", "CO207")):
        Path("run.log").write_text("of yesterday")
        world.writes = []
        outcome = run("restore", node, file, "--yes", "--trace", "run.log", "--force", "-b", "demo")
        assert (f"error {code}" in outcome.err, world.writes) == (True, [])
        assert "--any-device" in outcome.err
        assert "--force" not in outcome.err


def test_files_that_do_not_suit(run: Run, world: Lasting) -> None:
    change(run, world)
    assert "is of node 5 (0x05), not of node 6 (0x06)" in run("restore", "6", "before.dcf", "--yes", "-b", "demo").err
    assert run("restore", *NODE, "nothing.dcf", "--yes").status == ExitCode.BAD_FILE
    outcome = run("restore", *NODE, "device.eds", "--yes")
    assert (outcome.status, "device.eds sets nothing" in outcome.err) == (ExitCode.USAGE, True)
    assert run("restore", *NODE, "before.dcf", "--skip", "nonsense", "--yes").status == ExitCode.USAGE
    text = Path("before.dcf").read_text()
    Path("other.dcf").write_text(text.replace("ParameterValue=0x0000029C", "ParameterValue=0x000000AB"))
    world.writes = []
    outcome = run("restore", *NODE, "other.dcf", "--yes")
    assert outcome.status == ExitCode.DIFFERENT
    assert "vendor-ID 0x0000029C, in the file 0x000000AB" in outcome.err
    assert world.writes == []
    assert run("restore", *NODE, "other.dcf", "--yes", "--any-device").status == 0

    world.prepare = lambda node: answering(node, {0x1018: AbortCode.NO_SUCH_OBJECT})
    assert run("restore", *NODE, "other.dcf", "--yes").status == 0  # what a device does not tell is no difference


# ---- on a terminal ----


@pytest.mark.thorough(2)
@pytest.mark.parametrize("silent", [False, True])
def test_progress_is_drawn_on_a_terminal(run: Run, world: Lasting, monkeypatch: pytest.MonkeyPatch, silent: bool) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    if silent:
        world.is_there = False
    outcome = run("dump", *NODE, *EDS)
    assert "reading node 5 (0x05)" in outcome.err
    assert outcome.status == (ExitCode.NO_ANSWER if silent else 0)


# ---- odd cases ----


def test_reading_a_drive_that_another_master_runs_does_not_halt_it(run: Run, world: Lasting) -> None:
    world.dictionary = device(
        200, Object.of("controlword", [Variable(0x6040, 0, "controlword", DataType.UNSIGNED16, default=0x0F)])
    )
    outcome = run("dump", *NODE, "--json")
    assert 0x0F in [each["value"] for each in outcome.json["objects"] if each["index"] == 0x6040]
    assert world.writes == []


def test_a_backup_by_the_dcf_of_another_node_is_of_this_one(run: Run, world: Lasting) -> None:
    change(run, world)
    other = Path("before.dcf").read_text().replace("NodeID=5", "NodeID=7\nNodeName=axis 7")
    Path("other.dcf").write_text(other)
    assert run("backup", *NODE, "-e", "5=other.dcf", "-o", "mine.dcf").status == 0
    mine = load_description("mine.dcf").commissioning
    assert mine is not None
    assert (mine.node_id, mine.node_name) == (5, "")
    found = Backup(5, world.dictionary, [])
    write_dcf("fast.dcf", found, load_description("mine.dcf"), 500)
    fast = load_description("fast.dcf").commissioning
    assert fast is not None
    assert (fast.node_id, fast.bit_rate) == (5, 500)


def test_all_is_written_and_the_device_refuses_to_store(run: Run, world: Lasting) -> None:
    change(run, world)
    world.prepare = lambda node: setattr(node, "refuse", lambda count: AbortCode.HARDWARE_ERROR if count == 5 else None)
    outcome = run("restore", *NODE, "before.dcf", "--yes", "--store")
    assert outcome.status == ExitCode.SDO_ABORT
    assert "node 5 refused writing 0x1010:01" in outcome.err
    assert "4 of 4 writes were confirmed" in outcome.err
    assert "all of it is written\n" in outcome.err
    assert "not written:" not in outcome.err
    assert world.state is NmtState.PRE_OPERATIONAL


def test_a_file_without_an_identity_suits_any_device(run: Run, world: Lasting) -> None:
    whole = device()
    without = type(whole)(each for each in whole.objects.values() if each.index != 0x1018)
    Path("small.eds").write_text(write_eds(describe(without)))
    world.values[LIMITED << 8] = 12
    assert run("eds", "to-dcf", "small.eds", "--id", "5", "--set", "limited=15", "-o", "small.dcf").status == 0
    outcome = run("restore", *NODE, "small.dcf", "--yes")
    assert (outcome.status, world.values[LIMITED << 8]) == (0, 15)
    assert outcome.out == "2002:00 limited: 12 (0x0C) → 15 (0x0F)\n"


def test_what_cannot_be_read_is_written_without_knowing_what_it_was(run: Run, world: Lasting) -> None:
    assert run("eds", "to-dcf", "device.eds", "--id", "5", "--set", "secret=7", "-o", "secret.dcf").status == 0
    outcome = run("restore", *NODE, "secret.dcf", "--yes", "--verify")
    assert outcome.out == "2010:00 secret: ? → 7 (0x0007)\n"
    assert world.values[0x2010_00] == 7


def test_progress_goes_on_while_an_object_is_waited_for(run: Run, world: Lasting, monkeypatch: pytest.MonkeyPatch) -> None:
    def prepare(node: Strict) -> None:
        node.takes = lambda frame: frame.can_id != 0x605 or frame.data[1:3] != b"\x12\x20"

    monkeypatch.setenv("FORCE_COLOR", "1")
    world.prepare = prepare
    outcome = run("dump", *NODE, *EDS)
    assert outcome.status == ExitCode.PARTIAL
    assert "not read:" in outcome.err
    assert "/141" in outcome.err


def test_a_backup_that_another_client_disturbed_is_restored_only_by_force(run: Run, world: Lasting) -> None:
    change(run, world)
    found = Backup(5, load_description("before.dcf").dictionary, [], "wrote 0x2000:00")
    write_dcf("disturbed.dcf", found, load_description("before.dcf"), None)
    info = load_description("disturbed.dcf").file_info
    assert info.description == "DISTURBED: another SDO client wrote 0x2000:00 during this backup"
    write_dcf("again.dcf", Backup(5, found.dictionary, []), load_description("disturbed.dcf"), None)
    assert load_description("again.dcf").file_info.description == ""
    text = Path("before.dcf").read_text().replace("[FileInfo]\n", f"[FileInfo]\nDescription={info.description}\n", 1)
    Path("full.dcf").write_text(text)
    refused = run("restore", *NODE, "full.dcf", "--yes")
    assert refused.status == ExitCode.USAGE
    assert "error CO137" in refused.err
    assert "wrote 0x2000:00" in refused.err
    assert world.writes == []
    assert run("restore", *NODE, "full.dcf", "--yes", "--force").status == 0
    assert world.writes != []


def test_a_file_with_a_setting_that_cannot_be_read_is_restored_only_by_force(run: Run, world: Lasting) -> None:
    """The device would be left with another value, and nobody would know."""
    change(run, world)
    text = Path("before.dcf").read_text()
    Path("lost.dcf").write_text(text.replace("ParameterValue=1.5", "ParameterValue=1,5"))
    refused = run("restore", *NODE, "lost.dcf", "--yes")
    assert refused.status == ExitCode.BAD_FILE
    assert "in [2012]: ParameterValue '1,5' is no REAL32; left out" in refused.err
    assert "--force, to write the others" in refused.err
    assert world.writes == []
    assert run("restore", *NODE, "lost.dcf", "--yes", "--force").status == 0
    assert (GAIN, 0) not in world.writes
    assert world.writes != []
