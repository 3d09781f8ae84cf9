"""What the command line says where nobody answers: it listens on for a while, and advises what can be typed as it stands."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest
import trio

from canopen_cli.bus.scan import nobody_there
from canopen_cli.shared import session
from canopen_cli.shared.failures import advice, problem_of
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_master.master import Master
from canopen_master.session import open_master
from canopen_master.silence import LONGER, SCAN
from canopen_proto.frame import Frame
from canopen_transports import Transport, open_transport
from tests.cli.cli_support import Run, runner

REAL = "virtual:real"
ON_BUS = ("-b", REAL)

Life = Callable[[Transport], Awaitable[None]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Run:
    return runner(capsys, monkeypatch, tmp_path_factory.mktemp("own"))


def populate(monkeypatch: pytest.MonkeyPatch, life: Life) -> None:
    """Let something else go on on the bus of the commands. life: from when the command has opened it."""

    @asynccontextmanager
    async def populated(*locators: Any, **options: Any) -> AsyncIterator[Master]:
        async with await open_transport(REAL) as bus, open_master(*locators, **options) as master:
            trio.lowlevel.spawn_system_task(life, bus)
            yield master

    monkeypatch.setattr(session, "open_master", populated)


def saying(*frames: tuple[float, str]) -> Life:
    """Frames, each so many seconds after the one before."""

    async def life(bus: Transport) -> None:
        for seconds, frame in frames:
            await trio.sleep(seconds)
            await bus.send(Frame.parse(frame))

    return life


# ---- read, write ----


def test_a_stopped_node_is_heard_though_its_heartbeat_comes_late(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    populate(monkeypatch, saying((0.9, "705#04")))
    outcome = run("read", "5", "statusword", *ON_BUS)
    assert outcome.status == ExitCode.NO_ANSWER
    assert "did not answer reading 6041:00 (statusword) in 0.5 s" in outcome.err
    assert "node 5 was last heard" in outcome.err
    assert "NMT state STOPPED" in outcome.err
    assert f"canopen nmt preop 5 -b {REAL}\n" in outcome.err
    assert "scan" not in outcome.err


def test_an_answer_that_comes_too_late_says_what_to_wait(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    populate(monkeypatch, saying((0.74, "585#4B41600037020000")))
    outcome = run("read", "5", "statusword", *ON_BUS)
    assert outcome.status == ExitCode.NO_ANSWER
    assert "it answered after 740 ms, too late" in outcome.err
    assert "try:   --timeout 2s" in outcome.err


def test_only_others_are_there(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    populate(monkeypatch, saying((0.9, "706#05"), (0.1, "707#7F")))
    error = run("write", "5", "controlword", "6", "--json", *ON_BUS).error
    assert error["seen"] == "nothing was heard of it: only nodes 6 and 7 were heard"
    scan = SCAN.replace("scan", f"scan -b {REAL}")
    stopped = f"canopen nmt preop 5 -b {REAL}    (a node that is Stopped answers again)"
    assert error["try"] == ["check the node-ID 5 (0x05) and its power", scan, stopped]
    assert (error["code"], error["node"], error["index"]) == ("CO201", 5, 0x6040)


def test_a_silent_bus(run: Run) -> None:
    outcome = run("info", "5", *ON_BUS)
    assert "nothing at all was heard on this bus" in outcome.err
    assert f"canopen scan -b {REAL}    (who is there?)" in outcome.err


def test_an_answer_that_stays_away_amid_a_procedure(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    populate(monkeypatch, saying((0.9, "705#04")))
    outcome = run("home", "5", *ON_BUS)
    assert outcome.status == ExitCode.NO_ANSWER
    assert f"canopen nmt preop 5 -b {REAL}\n" in outcome.err


def test_a_refusal_is_no_silence(run: Run) -> None:
    outcome = run("read", "3", "5000:01", "--type", "u16", "-b", "demo")
    assert outcome.status == ExitCode.SDO_ABORT
    outcome = run("home", "3", "--method", "99", "-b", "demo")
    assert outcome.status != ExitCode.NO_ANSWER


def test_a_drive_that_may_move_is_not_kept_waiting(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    populate(monkeypatch, saying((0.1, "585#4B40600006000000"), (0.8, "705#04")))  # it is read, and does not answer the write
    outcome = run("write", "5", "controlword", "15", *ON_BUS)
    assert outcome.status == ExitCode.NO_ANSWER
    assert "may have been executed" in outcome.err
    assert "node 5 was last heard " in outcome.err


def test_nmt_waits_for_what_does_not_come(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "nothing at all was heard on this bus" in run("nmt", "start", "5", "--wait", *ON_BUS).err
    populate(monkeypatch, saying((4, "085#0000")))
    outcome = run("nmt", "start", "5", "--wait", *ON_BUS)
    assert outcome.status == ExitCode.NO_ANSWER
    assert "node 5 was last heard" in outcome.err
    assert f"canopen write 5 1017 500 -b {REAL}    (a heartbeat each 500 ms)" in outcome.err


# ---- scan ----


@pytest.mark.parametrize(
    ("frames", "told"),
    [
        ((), "0 nodes heard. Nothing at all was heard. Nodes without a heartbeat"),
        (("080#",), "0 nodes heard. Frames were heard, but none that shows whose it is. Nodes without"),
        (("089#1023",), "0 nodes heard; heard, by emergency: node 9 (0x09)\n"),
        (("707#05", "188#00"), "1 node heard; PDOs were heard that may be those of node 8 (0x08)\n"),
    ],
)
def test_what_else_a_passive_scan_heard(run: Run, monkeypatch: pytest.MonkeyPatch, frames: tuple[str, ...], told: str) -> None:
    populate(monkeypatch, saying(*((0.1, frame) for frame in frames)))
    outcome = run("scan", "--passive", *ON_BUS)
    assert told in outcome.err


def test_a_scan_on_a_bus_without_nodes(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    told = " ".join(run("scan", *ON_BUS).err.split())
    assert "Nothing at all was heard. Is anybody there, with power?" in told
    assert "Devices that have no node-ID yet are silent, and found by canopen lss scan." in told
    assert "bit rate" not in told, "a bus in software has none"
    assert "acknowledge" not in told
    populate(monkeypatch, saying((0.1, "7E4#5000000000000000")))
    assert "Devices that have no node-ID yet are not found" in run("scan", *ON_BUS).err


def test_a_scan_of_a_silent_wire_speaks_of_the_bit_rate_too() -> None:
    told = nobody_there("socketcan:can0")
    assert "Is anybody there, with power and the same bit rate?" in told
    assert "canopen lss scan" in told
    assert "virtual" not in told
    for software in ("tcp:localhost:29000", "virtual:x", "demo"):
        assert "bit rate" not in nobody_there(software)


# ---- the next command ----


@pytest.mark.parametrize(
    ("step", "typed"),
    [
        (SCAN, "canopen scan -b can0    (who is there?)"),
        ("canopen nmt preop 5", "canopen nmt preop 5 -b can0"),
        ("canopen drive 5 units    what it tells", "canopen drive 5 units -b can0    what it tells"),
        ("canopen write 5 6064 -- -5", "canopen write 5 6064 -b can0 -- -5"),
        ("canopen scan -b can1", "canopen scan -b can1"),
        ("canopen read --help", "canopen read --help"),
        ("canopen demo --fault 5@2.0", "canopen demo --fault 5@2.0"),
        ("check power", "check power"),
    ],
)
def test_the_bus_of_the_user_stands_in_what_is_advised(step: str, typed: str) -> None:
    problem = CommandError(ExitCode.NO_ANSWER, "CO201", "no answer", tries=(step,))
    assert problem.on_bus(None).tries == (step,)
    assert problem.on_bus("can0").tries == (typed,)


def test_a_bus_with_a_blank_is_quoted() -> None:
    problem = CommandError(ExitCode.NO_ANSWER, "CO201", "no answer", tries=("canopen scan",))
    assert problem.on_bus("a b").tries == ("canopen scan -b 'a b'",)


def test_a_demonstration_that_fails_advises_its_own_bus(run: Run) -> None:
    outcome = run("demo", "-b", "virtual:empty")
    assert outcome.status == ExitCode.NO_ANSWER
    assert "nothing at all was heard on this bus" in outcome.err
    assert "canopen scan -b virtual:empty" in outcome.err


def test_advice_to_programs_and_to_people() -> None:
    assert advice([LONGER, f"{LONGER}: 0.5 s", "await this()", "check it"]) == [
        "a longer --timeout",
        "--timeout 0.5s",
        "check it",
    ]


def test_a_note_on_a_problem_is_told_once() -> None:
    problem = CommandError(ExitCode.NO_ANSWER, "CO201", "no answer")
    problem.add_note("not confirmed to stand: joint1")
    for _ in range(2):
        assert problem_of(problem).also == ["not confirmed to stand: joint1"]


# ---- what the next step speaks of ----


def test_a_node_without_a_heartbeat_is_not_waited_for(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    populate(monkeypatch, saying((0.1, "585#4B17100000000000")))
    error = run("nmt", "start", "5", "--wait", "--json", *ON_BUS).error
    assert error["message"] == "node 5: start was sent, and nothing will show that it is done"
    assert error["seen"] == "it sends no heartbeat: 0x1017 is 0"


def test_a_node_that_did_not_boot_after_a_reset_is_not_asked_for_a_heartbeat(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    populate(monkeypatch, saying((0.1, "705#05")))
    error = run("nmt", "reset", "6", "--wait", "--yes", "--json", *ON_BUS).error
    absent, slow = "no device has this node-ID, or its power is off", "it needs longer to start, or did not get the reset"
    assert error["cause"] == [f"{absent}; or {slow}"]
    assert not any("1017" in each for each in error["try"])


def test_an_object_of_another_length_stands_in_the_file_in_use(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    refusal = saying((0.1, "585#8000100010000706"))
    populate(monkeypatch, refusal)
    assert run("read", "5", "1000", "--json", *ON_BUS).error["try"] == ["check the object in installed indices.csv"]
    populate(monkeypatch, refusal)
    error = run("read", "5", "1000", "--json", "-e", "sample_io.eds", *ON_BUS).error
    assert error["try"] == ["check the object in sample_io.eds"]
