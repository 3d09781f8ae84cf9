"""`--dry-run`: for every command that has it, nothing leaves but what reads; and what is shown is what the command would send."""

from __future__ import annotations

from pathlib import Path

import click
import pytest
from hypothesis import given

from canopen_cli import app
from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.withholding import Withholding
from canopen_master.simulation import serving
from canopen_proto.frame import ERROR_CONTROL, NMT, SDO_CLIENT_TO_SERVER, SYNC, TIME, Frame
from canopen_proto.lss.messages import FROM_MASTER
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_testing.strategies import frames
from canopen_transports.log_files import LogReader
from tests.cli.backup_world import EDS, NODE, Lasting, change, lasting_device
from tests.cli.cli_support import Run, runner_in_folder
from tests.cli.test_clean import paths
from tests.cli.test_net import CELL
from tests.examples import examples

TRACE = ("--trace", "bus.log", "--force")
DRIVE = ("-b", "demo", *TRACE, "--dry-run")
OBJECT = (*NODE, *TRACE, *EDS)
WAYS: list[tuple[str, ...]] = [
    ("write", *OBJECT, "2012", "1.5"),
    ("write", *OBJECT, "2003", "a text of more than four bytes", "--verify"),
    ("write", *OBJECT, "2003", "--file", "text.bin", "--block"),
    *[("nmt", word, *NODE, *TRACE, "--yes") for word in ("start", "stop", "preop", "reset", "reset-comm")],
    ("nmt", "reset", *NODE, *TRACE, "--yes", "--wait"),
    ("nmt", "stop", "--all", "-b", "demo", *TRACE, "--yes"),
    ("sync", "-b", "demo", *TRACE, "--yes"),
    ("sync", "-b", "demo", *TRACE, "--yes", "--period", "10ms", "--count", "3"),
    ("time", "-b", "demo", *TRACE),
    ("store", *OBJECT, "--group", "all", "--yes"),
    ("emcy", "clear", *OBJECT),
    ("pdo", "map", *OBJECT, "tpdo2", "2000", "--type", "254", "--event", "100ms", "--yes"),
    ("pdo", "map", *OBJECT, "tpdo2", "--off", "--yes"),
    ("reset-defaults", *OBJECT, "--reset", "--yes"),
    ("restore", "5", "changed.dcf", "-b", "demo", *TRACE, "--verify", "--store", "--yes"),
]
"""Commands on the device of backup_world.py."""


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    return runner_in_folder(capsys, monkeypatch, tmp_path)


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch, run: Run) -> Lasting:
    held = lasting_device(monkeypatch)
    Path("text.bin").write_bytes(b"a text of more than four bytes, in blocks")
    return held


def reads(frame: Frame) -> bool:
    """Whether a frame of a master changes nothing in a device."""
    if frame.flags & 1:
        return True
    if frame.can_id == FROM_MASTER:
        return frame.data[0] not in (0x11, 0x13, 0x15, 0x17)
    node_id, specifier = frame.can_id - SDO_CLIENT_TO_SERVER, frame.data[0] >> 5 if frame.data else 0
    return 1 <= node_id <= 127 and specifier in (2, 3, 4, 5)


def sent() -> list[Frame]:
    """The frames of a master in the recording."""
    return [record.frame for record in LogReader(Path("bus.log")) if of_master(record.frame.can_id)]


def of_master(can_id: int) -> bool:
    return can_id in (NMT, SYNC, TIME, FROM_MASTER) or 1 <= can_id - SDO_CLIENT_TO_SERVER <= 127


def name(way: tuple[str, ...]) -> str:
    return "-".join(each for each in way if each not in (*TRACE, *NODE))[:40]


@pytest.mark.parametrize("way", WAYS, ids=name)
def test_what_is_shown_is_what_would_be_sent_and_nothing_is_sent(run: Run, world: Lasting, way: tuple[str, ...]) -> None:
    change(run, world)
    world.values.pop(0x1801_01, None)
    dry = run(*[each for each in way if each != "--yes"], "--dry-run", "--json")
    assert dry.status == ExitCode.OK, dry.err
    assert [str(frame) for frame in sent() if not reads(frame)] == []
    assert world.writes == []
    done = run(*way)
    assert done.status == ExitCode.OK, done.err
    document = dry.json if isinstance(dry.json, list) else dry.json["frames"]
    shown = [Frame.parse(each["frame"]) for each in document]
    if way[0] == "time":
        shown, changes = ([Frame(each.can_id) for each in some] for some in (shown, sent()))  # the time itself goes on
    else:
        changes = [frame for frame in sent() if not reads(frame)]
    assert [frame for frame in shown if not reads(frame)] == changes
    assert changes


OTHERS: list[tuple[str, ...]] = [
    ("flash", "5", "text.bin", "--expect", "7"),
    ("run", "script.py"),
    ("lss", "set-id", "5", "12"),
    ("lss", "store", "5"),
    ("lss", "set-bitrate", "250k", "--present", "500k", "--interface-command", "true"),
    ("home", "3"),
    ("move", "--to", "1,0,0,0,0,0"),
    *[("drive", "3", *words) for words in (
        ("fault-reset",), ("mode", "pp"), ("enable", "--seconds", "1"), ("home",), ("move", "5"),
        ("velocity", "5", "--seconds", "1"),
        ("torque", "5", "--seconds", "1"), ("outputs", "16=1"), ("probe", "--limit", "100ms"), ("stop",), ("disable",),
    )],
]  # fmt: skip
"""Commands on the six drives: whatever becomes of them."""


@pytest.mark.parametrize("way", OTHERS, ids=name)
def test_no_frame_leaves_but_what_reads(run: Run, way: tuple[str, ...]) -> None:
    Path("text.bin").write_bytes(b"no program")
    Path("script.py").write_text("await nodes[3].read('6081')\nawait nodes[3].write('6081', 5)\nawait master.send_sync()\n")
    outcome = run(*way, *DRIVE)
    assert outcome.status != ExitCode.INTERNAL, outcome.err
    assert [str(frame) for frame in sent() if not reads(frame)] == []
    assert sent()


REFUSED: list[tuple[str, ...]] = [
    ("jog",),
    ("drive", "commission", "3"),
    ("check", "3"),
    ("net", "watch", "cell.toml"),
]
"""Commands for which a dry run has no meaning."""


@pytest.mark.parametrize("way", REFUSED, ids=name)
def test_where_a_dry_run_has_no_meaning_it_is_refused_with_words(run: Run, way: tuple[str, ...]) -> None:
    outcome = run(*way, *DRIVE)
    assert outcome.status == ExitCode.USAGE
    assert f"{way[0]}" in outcome.err
    assert "has no --dry-run" in outcome.err
    assert "nothing was sent" in outcome.err
    assert not Path("bus.log").exists()
    assert "Refused here:" in run(*way[:2] if way[0] in ("drive", "net") else way[:1], "--help").out


def test_assign_shows_what_each_device_would_be_told(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "DEMO_NODES", (255, 255))
    words = ("lss", "assign", "--ids", "10-20", "--vendor", "0x332", "--product", "0x43", "--window", "10ms", "-b", "demo")
    dry = run(*words, *TRACE, "--dry-run")
    assert dry.status == ExitCode.OK, dry.err
    assert [str(frame) for frame in sent() if not reads(frame)] == []
    assert "7E5#110A" in dry.out
    assert "7E5#110B" in dry.out
    done = run(*words, *TRACE, "--yes", "--json")
    assert [each["node"] for each in done.json] == [10, 11]
    changes = [str(frame) for frame in sent() if not reads(frame)]
    assert [each for each in changes[: len(changes) // 2] if each.split("#")[0] == "7E5" and each not in dry.out] == []


def test_a_network_is_booted_without_a_write(run: Run) -> None:
    Path("cell.toml").write_text(CELL)
    words = ("net", "boot", "cell.toml", "-b", "demo", *TRACE)
    dry = run(*words, "--dry-run", "--json")
    assert dry.status == ExitCode.OK, dry.err
    assert [str(frame) for frame in sent() if not reads(frame)] == []
    shown = [each["frame"] for each in dry.json]
    assert run(*words, "--yes").status == ExitCode.OK
    done = [str(frame) for frame in sent() if not reads(frame)]
    assert {each for each in done if each[:3] not in ("080", "77F")} <= set(shown)
    assert any(each.startswith("000#82") for each in shown)


def test_a_replay_is_shown_in_words_and_opens_no_bus(run: Run) -> None:
    assert run("write", "3", "6081", "20000", "-b", "demo", *TRACE).status == ExitCode.OK
    outcome = run("log", "replay", "bus.log", "-b", "socketcan:nowhere", "--only-sent", "--dry-run")
    assert outcome.status == ExitCode.OK, outcome.err
    assert "write 6081:00 profile_velocity = 20000" in outcome.out
    assert "583" not in outcome.out
    assert "nothing was sent" in outcome.err


def test_every_command_with_a_dry_run_is_among_these() -> None:
    of_files = {("eds", "fix"), ("log", "replay"), ("lss", "assign"), ("net", "boot")} | {way[:2] for way in REFUSED}
    of_files |= {way[:1] for way in REFUSED}
    covered = {way[:length] for way in (*WAYS, *OTHERS) for length in (1, 2)} | {way[::2][:2] for way in OTHERS} | of_files
    assert {path for path in paths(app.cli) if has_dry_run(path)} - covered == set()


def has_dry_run(path: tuple[str, ...]) -> bool:
    command: click.Command = app.cli
    for word in path:
        assert isinstance(command, click.Group)
        found = command.get_command(click.Context(command), word)
        assert found is not None
        command = found
    return any("--dry-run" in option.opts for option in command.params)


@examples(200)
@given(frames())
def test_a_frame_that_is_not_known_to_read_never_leaves(frame: Frame) -> None:
    rules = Withholding()
    if rules.goes_out(frame):
        assert reads(frame)
    else:
        rules.answers(frame, 0)


def test_heartbeats_show_the_state_that_was_commanded() -> None:
    rules = Withholding()
    assert rules.answers(Frame(NMT, bytes((NmtCommand.STOP, 5))), 0) == []
    assert rules.heard(Frame(ERROR_CONTROL + 5, bytes((0x85,)))).data == bytes((0x80 | NmtState.STOPPED,))
    assert rules.heard(Frame(ERROR_CONTROL + 6, b"\x05")).data == b"\x05"
    assert rules.answers(Frame(NMT, bytes((NmtCommand.RESET_NODE, 5))), 0) == [Frame(ERROR_CONTROL + 5, b"\0")]


def test_a_way_over_a_text_gateway_has_no_frames_to_show(run: Run) -> None:
    outcome = run("write", "5", "1017", "100", "--dry-run", "-b", "gw:localhost:1")
    assert outcome.status == ExitCode.USAGE
    assert "carries no frames" in outcome.err
