"""`canopen log`, and --trace: in virtual time."""

from __future__ import annotations

import errno
import io
import json
import os
import re
import signal
import sys
from pathlib import Path

import pytest

from canopen_cli.shared.problem import ExitCode
from canopen_proto.frame import REMOTE
from canopen_transports.log_files import LogReader
from canopen_transports.tracing import Trace
from tests.cli.cli_support import Alarm, Run, runner, watched_simulations

LOG = """\
(1436509100.000000) can0 603#4041600000000000 T
(1436509100.100000) can0 583#4B41600040020000 R
(1436509101.000000) can0 703#R1 T
(1436509102.000000) can0 703#05 R
"""


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    own = tmp_path / "own"
    own.mkdir()
    monkeypatch.chdir(tmp_path)
    return runner(capsys, monkeypatch, own)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    (tmp_path / "a.log").write_text(LOG)
    return tmp_path / "a.log"


def frames(path: str) -> list[str]:
    return [f"{record.frame}{' T' if record.sent else ''}" for record in LogReader(Path(path))]


# ---- --trace ----


def test_a_command_is_recorded_with_its_simulated_drives(run: Run) -> None:
    outcome = run("read", "3", "statusword", "-b", "demo", "--trace", "t.log")
    assert outcome.status == 0
    assert "8 frames recorded: t.log" in outcome.err
    assert frames("t.log") == [*(f"70{node}#00" for node in range(3, 9)), "603#4041600000000000 T", "583#4B41600040020000"]
    assert {record.channel for record in LogReader(Path("t.log"))} == {"virtual0"}


def test_a_simulation_records_its_own_side(run: Run) -> None:
    assert run("sim", "--id", "3", "-b", "virtual:x", "--seconds", "0.7", "--trace", "t.log").status == 0
    assert frames("t.log") == ["703#00 T", "703#7F T"]


def test_errors_do_not_cut_the_trace(run: Run) -> None:
    outcome = run("read", "3", "0x5FFF", "--trace", "t.log", "-b", "demo")
    assert outcome.status != 0
    outcome = run("read", "99", "0x1000", "--trace", "t.log", "-b", "demo", "--force")
    assert outcome.status == 5
    assert any(frame.startswith("663#80001000") for frame in frames("t.log"))  # the abort of the time-out


def test_ctrl_c_does_not_cut_it_either(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    alarm = Alarm()
    watched_simulations(monkeypatch, alarm)
    alarm.set((3.0, signal.SIGINT))
    outcome = run("demo", "--trace", "t.log")
    assert outcome.status == 130
    said = frames("t.log")
    assert len(said) > 1000
    for node in range(3, 9):  # each drive was halted, and its answer recorded
        assert any(frame.startswith(f"{0x180 + node:X}#") for frame in said[-200:])


@pytest.mark.parametrize(("name", "seen"), [("t.txt", "it ends in '.txt'"), ("none/t.log", "there is no folder none")])
def test_a_trace_that_cannot_be_begun(run: Run, name: str, seen: str) -> None:
    outcome = run("read", "3", "statusword", "-b", "demo", "--trace", name)
    assert outcome.status == 6
    assert re.search("error CO34[12]", outcome.err)
    assert seen in outcome.err
    assert not outcome.out


def test_a_trace_that_lacks_something_says_so(run: Run, log: Path) -> None:
    outcome = run("log", "replay", str(log), "-b", "virtual:x", "--trace", "t.trc")
    assert outcome.status == 6
    assert "1 frame missing in it (.trc: remote frames are left out" in outcome.err
    assert "error CO343: the trace t.trc is not complete" in outcome.err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_full_disk_does_not_stop_the_command(run: Run, tmp_path: Path) -> None:
    (tmp_path / "full.log").symlink_to("/dev/full")
    outcome = run("read", "3", "statusword", "-b", "demo", "--trace", "full.log")
    assert outcome.status == 6
    assert "statusword" in outcome.out
    assert "error CO343: the trace full.log is not complete" in outcome.err
    assert f"{os.strerror(errno.ENOSPC)} after 0 frames" in outcome.err
    outcome = run("read", "3", "0x5FFF", "-b", "demo", "--trace", "full.log")
    assert outcome.status not in (0, 6)
    assert "also:  the trace full.log is not complete" in outcome.err


def test_a_trace_never_replaces_what_is_being_read(run: Run, log: Path, tmp_path: Path) -> None:
    os.link(log, "same.log")
    for command in (
        ("log", "replay", str(log), "-b", "virtual:x"),
        ("scan", "-b", f"file:{log}"),
        ("scan", "-b", f"file:{tmp_path}/../{tmp_path.name}/a.log?speed=max"),
    ):
        for trace in (str(log), "same.log"):
            outcome = run(*command, "--trace", trace)
            assert outcome.status == 2
            assert "which is being read" in outcome.err
            assert log.read_text() == LOG
    run("scan", "-b", f"file:{log}", "--trace", "t.log")
    heard = [frame for frame in frames("t.log") if not frame.endswith(" T")]
    assert heard == [frame.removesuffix(" T") for frame in frames(str(log))]


@pytest.mark.thorough(5)
@pytest.mark.parametrize("kind", [".asc", ".blf", ".trc", ".pcapng"])
def test_a_trace_of_another_kind_is_whole_after_ctrl_c(run: Run, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    alarm = Alarm()
    watched_simulations(monkeypatch, alarm)
    alarm.set((0.5, signal.SIGINT))
    assert run("demo", "--trace", f"t{kind}").status == 130
    assert len(frames(f"t{kind}")) > 20
    if Path("/dev/full").exists():
        Path(f"full{kind}").symlink_to("/dev/full")
        outcome = run("read", "3", "statusword", "-b", "demo", "--trace", f"full{kind}")
        assert outcome.status == 6
        assert f"error CO343: the trace full{kind} is not complete" in outcome.err


def test_a_trace_that_missed_frames_says_so(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    closing = Trace.close

    def lossy(trace: Trace) -> None:
        trace.lost += 3  # as a tap counts them
        closing(trace)

    monkeypatch.setattr(Trace, "close", lossy)
    outcome = run("read", "3", "statusword", "-b", "demo", "--trace", "t.log")
    assert outcome.status == 6
    assert " lost before being recorded" in outcome.err


# ---- convert ----


def test_convert(run: Run, log: Path) -> None:
    outcome = run("log", "convert", str(log), "b.blf")
    assert outcome.status == 0
    assert "4 frames: b.blf" in outcome.err
    assert "names of buses become numbers" in outcome.err
    assert run("log", "convert", "b.blf", "c.log").status == 0
    assert frames("c.log") == frames(str(log))
    assert Path("c.log").read_text() == LOG


def test_a_conversion_as_json(run: Run, log: Path) -> None:
    target = log.with_suffix(".asc")
    found = run("log", "convert", str(log), str(target), "--json").json
    frames = run("log", "stats", str(target), "--json").json["frames"]
    assert found == {"file": str(log), "output": str(target), "frames": frames, "left_out": 0, "skipped": 0}


def test_a_replay_as_json(run: Run, log: Path) -> None:
    frames = run("log", "stats", str(log), "--json").json["frames"]
    found = run("log", "replay", str(log), "-b", "virtual:replay", "--speed", "max", "--json").json
    assert found == {"file": str(log), "bus": "virtual:replay", "frames": frames, "skipped": 0}


def test_convert_says_what_it_leaves_out(run: Run, log: Path) -> None:
    outcome = run("log", "convert", str(log), "b.trc")
    assert outcome.status == 7
    assert "1 frame left out; .log holds them" in outcome.err
    assert not any(record.frame.flags & REMOTE for record in LogReader(Path("b.trc")))
    log.write_text(LOG + "(103.0) can0 123##1AA\n")
    assert "1 entry passed over, the last: a CAN FD frame" in run("log", "convert", str(log), "b.log").err


def test_convert_spoils_nothing(run: Run, log: Path) -> None:
    os.link(log, "same.log")
    for same in (str(log), "same.log"):
        assert run("log", "convert", str(log), same).status == 2
    outcome = run("log", "convert", "none.log", str(log), "--force")
    assert outcome.status == 6
    assert "cannot read none.log" in outcome.err
    assert log.read_text() == LOG


def test_convert_keeps_what_is_there_of_a_damaged_file(run: Run, log: Path) -> None:
    assert run("log", "convert", str(log), "whole.blf").status == 0
    whole = Path("whole.blf").read_bytes()
    Path("cut.blf").write_bytes(whole[:-1])
    outcome = run("log", "convert", "cut.blf", "b.log")
    assert outcome.status == 6
    assert "what could be read, 4 frames, is in b.log" in outcome.err
    assert f"seen:  the file ends in the middle, after {len(whole) - 1} of {len(whole)} bytes" in outcome.err
    assert frames("b.log") == frames(str(log))


def test_convert_to_a_full_disk(run: Run, log: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    for kind in (".log", ".asc", ".blf", ".trc"):
        Path(f"full{kind}").symlink_to("/dev/full")
        outcome = run("log", "convert", str(log), f"full{kind}")
        assert outcome.status == 6
        assert os.strerror(errno.ENOSPC) in outcome.err


# ---- replay ----


def test_replay(run: Run, log: Path) -> None:
    outcome = run("log", "replay", str(log), "-b", "virtual:x", "--trace", "t.log")
    assert outcome.status == 0
    assert "4 frames sent on virtual:x" in outcome.err
    sent = list(LogReader(Path("t.log")))
    assert [str(record.frame) for record in sent] == [frame.removesuffix(" T") for frame in frames(str(log))]
    assert (sent[-1].time - sent[0].time) / 1e9 == pytest.approx(2.0, abs=1e-3)
    Path("one.log").write_text("(1.0) can0 705#05\n")
    assert "1 frame sent on virtual:x" in run("log", "replay", "one.log", "-b", "virtual:x").err
    assert run("log", "replay", str(log), "-b", "virtual:x", "--trace", "u.log", "--speed", "max", "--only-sent").status == 0
    assert frames("u.log") == ["603#4041600000000000 T", "703#R1 T"]


def test_replay_wants_a_bus_and_a_speed(run: Run, log: Path) -> None:
    assert "canopen bus serve" in run("log", "replay", str(log)).err
    for bus in ("socketcan:can0", "can0", "pcan:PCAN_USBBUS1@500k"):  # drives may be there
        outcome = run("log", "replay", str(log), "-b", bus)
        assert (outcome.status, "DRIVES MAY MOVE. This must be confirmed" in outcome.err) == (2, True)
        assert run("log", "replay", str(log), "-b", bus, "--yes").status in (3, 9)  # there is no such bus here
    assert run("log", "replay", str(log), "-b", "socketcan:vcan77").status in (3, 9)
    for speed in ("fast", "0", "-1", "nan"):
        outcome = run("log", "replay", str(log), "-b", "virtual:x", "--speed", speed)
        assert outcome.status == 2
        assert "neither a positive number nor max" in outcome.err


# ---- stats, decode ----


def test_stats(run: Run, log: Path) -> None:
    outcome = run("log", "stats", str(log), "--bitrate", "125k")
    assert outcome.status == 0
    assert "4 frames in 2 s, 2 a second, load 0.1" in outcome.out
    found = run("log", "stats", str(log), "--json").json
    assert (found["frames"], found["seconds"], found["bitrate"], found["skipped"]) == (4, 2.0, 500_000, 0)
    assert [(each["can_id"], each["service"], each["node"], each["frames"]) for each in found["ids"]] == [
        ("583", "SDO", 3, 1),
        ("603", "SDO", 3, 1),
        ("703", "heartbeat", 3, 1),
        ("703", "guarding", 3, 1),
    ]
    assert found["load_percent"] == pytest.approx(sum(each["load_percent"] for each in found["ids"]))
    log.write_text("(1.0) can0 703#00\n")
    assert run("log", "stats", str(log), "--json").json["ids"][0]["service"] == "heartbeat"
    assert "\n1 frame in 0 s" in run("log", "stats", str(log)).out
    outcome = run("log", "stats", str(log), "--bitrate", "2M", "--json")
    assert (outcome.status, outcome.error["code"]) == (2, "CO001"), "as of `canopen plan`"


def test_decode(run: Run, log: Path) -> None:
    outcome = run("log", "decode", str(log))
    assert outcome.status == 0
    lines = outcome.out.splitlines()
    assert lines[0] == "    0.000000 603#4041600000000000      SDO         3  read 6041:00 statusword"
    assert lines[1].endswith("read 6041:00 statusword = 576 (0x240, switch_on_disabled, remote)")
    assert lines[3].endswith("heartbeat   3  operational")
    assert len(run("log", "decode", str(log), "--service", "sdo", "--node", "3").out.splitlines()) == 2
    nothing = run("log", "decode", str(log), "--node", "4")
    assert (nothing.status, nothing.out) == (0, "")
    assert "4 frames passed over: none is what was asked for" in nothing.err
    assert "passed over" not in run("log", "decode", str(log), "--node", "3").err
    first = json.loads(run("log", "decode", str(log), "--json").out.splitlines()[0])
    assert (first["frame"], first["service"], first["node"], first["sent"]) == ("603#4041600000000000", "SDO", 3, True)


def test_decode_by_a_devices_file(run: Run, tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text("(1.0) can0 605#4000100000000000\n(1.1) can0 185#01020304\n(1.2) can0 123##1AA\n")
    outcome = run("log", "decode", "a.log", "-e", "5=sample_io.xdd")
    assert outcome.status == 0
    assert "read 1000:00" in outcome.out
    assert "TPDO 1" in outcome.out
    assert "1 entry passed over" in outcome.err


def test_a_recording_without_any_frame_is_no_bus_without_faults(run: Run) -> None:
    Path("fd.log").write_text("(1.2) can0 123##1AA\n")
    for command in (("log", "check"), ("log", "decode"), ("monitor", "--log")):
        outcome = run(*command, "fd.log")
        assert (outcome.status, "CO342" in outcome.err, "a CAN FD frame" in outcome.err) == (6, True, True), command


BAD = (
    "(1.0) can0 603#4041600000000000\n(1.1) can0 583#4B41600037020000\n(1.2) can0 583#4B41600037060000\n"
    "(1.3) can1 603#4041600000000000\n(1.4) can1 583#4B41600037020000\n(1.5) can1 000#01\n"
)
"""Two answers on can0, as two nodes with one ID give them; nothing of the kind on can1, but a command that is too short."""


LACKING = "missing (likely): node 3: frames are missing here: an SDO answer whose request is not there"


def test_decode_says_what_is_wrong_with_a_frame(run: Run, tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text(BAD)
    outcome = run("log", "decode", "a.log")
    lines = outcome.out.splitlines()
    assert lines[3] == f"! {LACKING}"
    assert lines[7] == "! length: an NMT command of 1 byte; it has two"
    assert (outcome.status, len(lines)) == (0, 8)
    third = json.loads(run("log", "decode", "a.log", "--json").out.splitlines()[2])
    assert [(each["rule"], each["node_id"]) for each in third["findings"]] == [("missing", 3)]


def test_check(run: Run, tmp_path: Path, log: Path) -> None:
    outcome = run("log", "check", str(log))
    assert (outcome.status, outcome.out) == (0, "")
    assert "4 frames, no findings" in outcome.err
    (tmp_path / "a.log").write_text(BAD)
    outcome = run("log", "check", "a.log")
    assert outcome.status == 1
    assert outcome.out.splitlines() == [
        f"    0.200000 583#4B41600037060000      {LACKING}",
        "    0.500000 000#01                    length: an NMT command of 1 byte; it has two",
    ]
    assert "1 x missing (likely): frames are missing here" in outcome.err
    assert "6 frames, 2 findings (1 certain, 1 likely)" in outcome.err
    (tmp_path / "one.log").write_text("(1.0) can0 000#01\n")
    assert "1 frame, 1 finding\n" in run("log", "check", "one.log").err
    found = [json.loads(line) for line in run("log", "check", "a.log", "--json").out.splitlines()]
    assert [(each["rule"], each["channel"]) for each in found] == [("missing", "can0"), ("length", "can1")]


FAULT = (
    "(1.0) can0 605#40001A0000000000\n(1.1) can0 585#4F001A0001000000\n(1.2) can0 605#40001A0100000000\n"
    "(1.3) can0 585#43001A0110004160\n(1.4) can0 000#01\n(1.5) can0 085#1023030000000000\n(1.6) can0 185#0802\n"
)
"""Between two reads and a fault of the drive, a command that is too short."""


def test_check_tells_the_story_and_the_findings_in_the_order_of_time(run: Run) -> None:
    Path("a.log").write_text(FAULT)
    outcome = run("log", "check", "a.log")
    assert outcome.status == 1
    finding, emergency, fault = outcome.out.splitlines()
    assert "0.500000 085#1023030000000000      EMCY: node 5: 0x2310 continuous over-current" in emergency
    assert "0.600000 185#0802                  fault: node 5: the drive is in fault" in fault
    assert "0.400000 000#01                    length: " in finding
    assert "1 x EMCY: a node tells an error" in outcome.err
    assert "7 frames, 2 events, 1 finding\n" in outcome.err
    told = [json.loads(line) for line in run("log", "check", "a.log", "--json").out.splitlines()]
    assert [each.get("event") or each["rule"] for each in told] == ["length", "EMCY", "fault"]
    assert [each.get("is_certain") for each in told] == [True, None, None]


def test_check_believes_the_recorder_that_it_lost_frames(run: Run) -> None:
    """What is missing behind an overrun has its cause: it is told once, as certain, and with the cause."""
    overrun = "(1.15) can0 20000004#0001000000000000\n"
    Path("a.log").write_text(FAULT.replace("(1.2)", f"{overrun}(1.2)"))
    told = [json.loads(line) for line in run("log", "check", "a.log", "--json").out.splitlines()]
    assert [(each["rule"], each["is_certain"], each["text"]) for each in told if each.get("rule") == "missing"] == [
        ("missing", True, "frames are missing here: the controller of the recorder was overrun")
    ]
    Path("b.log").write_text(overrun + BAD)
    outcome = run("log", "check", "b.log")
    assert ("1 x missing (likely)" in outcome.err, outcome.status) == (True, 1)  # nothing was heard before it


def test_aborts_alone_are_no_fault(run: Run) -> None:
    Path("a.log").write_text("(1.0) can0 605#4000200000000000\n(1.1) can0 585#8000200000000206\n")
    outcome = run("log", "check", "a.log")
    assert (outcome.status, "2 frames, 1 event\n" in outcome.err) == (0, True)


def test_check_tells_what_could_be_read_of_a_recording_that_is_cut(run: Run) -> None:
    """A recorder that was killed leaves half a line, or nothing at all."""
    Path("cut.log").write_text(BAD + "(1.6) can0 5")
    outcome = run("log", "check", "cut.log")
    whole = run("log", "check", "cut.log", "--json").out
    assert outcome.status == ExitCode.BAD_FILE
    assert "cut.log:7 is not understood" in outcome.err
    assert "6 frames, " in outcome.err
    Path("bad.log").write_text(BAD)
    assert run("log", "check", "bad.log").out == outcome.out
    assert run("log", "check", "bad.log", "--json").out == whole
    Path("empty.log").write_text("")
    assert run("log", "check", "empty.log").status == ExitCode.BAD_FILE


def test_check_looks_at_the_load(run: Run, tmp_path: Path) -> None:
    text = "".join(f"({1 + number / 1000:.6f}) can0 185#0102030405060708\n" for number in range(2500))
    (tmp_path / "a.log").write_text(text)
    assert run("log", "check", "a.log", "--bitrate", "250k").status == 0
    outcome = run("log", "check", "a.log", "--bitrate", "250k", "--limit", "40")
    assert outcome.status == 1
    assert "of 250000 bit/s in the last 1 s; the limit is 40 %" in outcome.out
    assert run("log", "check", "a.log", "--bitrate", "2M").status == 2


def test_decode_names_the_line_that_is_wrong(run: Run, log: Path) -> None:
    log.write_text(LOG + "hello\n")
    outcome = run("log", "decode", str(log))
    assert outcome.status == 6
    assert f"{log}:5 is not understood" in outcome.err
    assert len(outcome.out.splitlines()) == 4


@pytest.mark.parametrize("command", ["log record x.log", "monitor", "emcy watch"])
def test_a_command_that_ends_by_itself_says_so(run: Run, command: str) -> None:
    outcome = run(*command.split(), "--for", "0.5", "-b", "demo")
    assert ("for 0.5 s; " in outcome.err, "until Ctrl-C" in outcome.err) == (True, False)


def test_a_damaged_line_in_the_middle_is_skipped_and_told(run: Run, log: Path) -> None:
    """Nothing is lost in silence: its number is told, and frames are missing there."""
    first, *others = LOG.splitlines(keepends=True)
    log.write_text("".join([first, "(1436509100.05) can0 58\n", *others]))
    outcome = run("log", "decode", str(log))
    assert (outcome.status, len([line for line in outcome.out.splitlines() if line[0] != "!"])) == (0, 4)
    assert "! missing: frames are missing here: line 2 is damaged" in outcome.out
    assert "1 entry passed over, the last: line 2 is damaged" in outcome.err
    outcome = run("log", "check", str(log))
    assert outcome.status == 1
    assert "missing: frames are missing here: line 2 is damaged" in outcome.out
    log.write_text("hello\n" + LOG)
    assert run("log", "decode", str(log)).status == ExitCode.BAD_FILE, "it may be no recording at all"


def test_a_bus_server_records_too(run: Run) -> None:
    outcome = run("bus", "serve", "--port", "0", "--seconds", "0", "--trace", "t.log")
    assert outcome.status == 0
    assert "0 frames recorded: t.log" in outcome.err


def test_decode_reads_what_candump_shows_from_standard_input(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    said = (
        "  can0  603   [8]  40 00 10 00 00 00 00 00\n\n  can0  583   [8]  43 00 10 00 92 01 02 00\n"
        "  can0  183   [8]  37 02 00 00 64 00 00 00\n"
    )
    monkeypatch.setattr("sys.stdin", typed(said.encode()))
    outcome = run("log", "decode", "-")
    assert outcome.status == 0
    read, answer, pdo = outcome.out.splitlines()
    assert read.endswith("read 1000:00 device_type")
    assert "schunk_default_tPDO" in pdo  # PDOs.csv, as no file is given, and the device is a drive
    assert "position_actual_value = 100" in pdo
    monkeypatch.setattr("sys.stdin", typed(b"what is this\n"))
    outcome = run("log", "stats", "-")
    assert outcome.status == 6
    assert "standard input:1 is not understood" in outcome.err
    monkeypatch.setattr("sys.stdin", typed(b"\xff\xfe" + said.encode("utf-16-le")))  # what PowerShell pipes
    assert run("log", "decode", "-").out.splitlines() == [read, answer, pdo]
    monkeypatch.setattr("sys.stdin", typed(b"M\xe4r\n"))
    outcome = run("log", "decode", "-")
    assert outcome.status == 6
    assert "standard input:1 is not understood" in outcome.err


def test_a_standard_input_that_is_closed_is_empty(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", None)
    outcome = run("log", "decode", "-")
    assert (outcome.status, outcome.out) == (ExitCode.BAD_FILE, "")
    assert "there is no frame in standard input" in outcome.err
    sys.stdin.close()


def typed(data: bytes) -> io.TextIOWrapper:
    """A standard input that holds these bytes."""
    return io.TextIOWrapper(io.BufferedReader(io.BytesIO(data)), encoding="utf-8")  # type: ignore[arg-type]
