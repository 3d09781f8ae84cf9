"""`canopen check`, in virtual time: which cases it runs, what it tells, how it ends, and how it leaves the device."""

from __future__ import annotations

import io
import signal
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from xml.etree import ElementTree

import pytest
import trio

from canopen_check.catalogue import CASES
from canopen_cli.node.check_report import CheckReport, write_junit
from canopen_cli.shared import session
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_data.describing import describe
from canopen_data.descriptions import load_description, read_file
from canopen_data.eds.writer import write_eds
from canopen_master.simulation.serving import DEMO_LOCATOR, simulated_devices
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import Event, Outbox, Time
from canopen_proto.nmt import NmtState, NmtStateChanged
from canopen_transports import open_transport
from tests.check.faulty_nodes import SelfStarting
from tests.cli.cli_support import Outcome, Run, runner_in_folder
from tests.core.full_device import full_device

SAMPLE = "sample_io.eds"
NODE = ("5", "-b", "demo", "-e", SAMPLE)
STORING = ["2.30", "6.8", "6.10", *(f"8.{number}" for number in range(1, 10))]


class HardOfHearing(LocalNode):
    """Hears no frames with the CAN-IDs of `deaf_to`."""

    deaf_to: range = range(0)

    def receive(self, frame: Frame, now: Time) -> None:
        if frame.can_id not in self.deaf_to:
            super().receive(frame, now)


class World:
    """One device on the bus of `-b demo`. task: what goes on beside the command; states: the NMT states that it was in."""

    def __init__(self) -> None:
        self.dictionary: ObjectDictionary = load_description(SAMPLE).dictionary
        self.task: Callable[[], Awaitable[None]] | None = None
        self.states: list[NmtState] = []
        self.made_by: type[LocalNode] = HardOfHearing

    def make(self, out: Outbox) -> LocalNode:
        self.node = self.made_by(out, 5, self.dictionary)
        return self.node

    def on_event(self, event: Event) -> None:
        if isinstance(event, NmtStateChanged):
            self.states.append(event.state)

    @asynccontextmanager
    async def simulation(self, *arguments: object) -> AsyncIterator[None]:
        async with simulated_devices({DEMO_LOCATOR: [self.make]}, self.on_event):
            if self.task is not None:
                trio.lowlevel.spawn_system_task(self.task)
            yield


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    return runner_in_folder(capsys, monkeypatch, tmp_path)


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> World:
    made = World()
    monkeypatch.setattr(session, "simulated_drives", made.simulation)
    return made


def cases(*numbers: str) -> list[str]:
    return [word for number in numbers for word in ("--case", number)]


def numbers_in(outcome: Outcome) -> list[str]:
    """The cases of a JSON report."""
    return [each["number"] for each in outcome.json["cases"]]


# ---- a file alone ----


def test_a_sound_file(run: Run) -> None:
    outcome = run("check", SAMPLE)
    assert outcome.status == 0
    assert outcome.out.splitlines()[-1].split() == ["1.0", "Check", "the", "EDS", "file", "passed"]
    assert outcome.err == "sample_io.eds: 1 passed, 0 failed, 0 not applicable\n"


def test_a_file_with_a_mistake(run: Run) -> None:
    Path("faulty.eds").write_bytes(read_file(SAMPLE).replace(b"LowLimit=0", b"LowLimit=10001"))
    outcome = run("check", "faulty.eds", "--junit", "report.xml")
    assert outcome.status == ExitCode.DIFFERENT
    assert "faulty.eds:366:10: error: in [2000] Filter time: LowLimit 10001 is above" in outcome.out
    assert "0 passed, 1 failed (1.0), 0 not applicable" in outcome.err
    assert "canopen eds lint faulty.eds" in outcome.err
    assert ElementTree.parse("report.xml").getroot().get("failures") == "1"
    assert run("check", "faulty.eds", "--json").json["counts"] == {
        "passed": 0,
        "remark": 0,
        "failed": 1,
        "not judged": 0,
        "not applicable": 0,
    }


def test_files_that_are_none(run: Run) -> None:
    Path("nothing.eds").write_text("nothing")
    assert run("check", "nothing.eds").status == ExitCode.BAD_FILE
    assert run("check", "missing.eds").status == ExitCode.BAD_FILE
    assert "there are two files" in run("check", SAMPLE, "-e", SAMPLE).err
    outcome = run("check", SAMPLE, "--case", "2.1")
    assert outcome.status == ExitCode.USAGE
    assert "these cases are for a node" in outcome.err


def test_the_file_of_a_node_needs_no_bus(run: Run) -> None:
    outcome = run("check", "5", "-e", SAMPLE, "--case", "1.0")
    assert outcome.status == 0
    assert "node 5 (0x05): 1 passed" in outcome.err
    assert run("check", "5", "--case", "1.0").status == ExitCode.USAGE


# ---- which cases ----


def test_the_list(run: Run) -> None:
    outcome = run("check", "--list", "--storing")
    assert outcome.status == 0
    assert len(outcome.out.splitlines()) == len(CASES) + 2
    assert [each["number"] for each in run("check", "--list", "--json", "--storing").json if each["stores"]] == STORING
    assert [each["number"] for each in run("check", "--list", "--json", *cases("10.2", "5")).json] == [
        *(f"5.{number}" for number in range(1, 7)),
        "10.2",
    ]


def test_what_cannot_be_run(run: Run) -> None:
    for arguments, said in (
        ([], "Missing argument"),
        (["5", "--case", "11"], "there is no case '11'"),
        (["5", "--case", "2.99"], "canopen check --list"),
        (["5", "--case", "8.2"], "the same with --storing"),
        (["5", "-b", "can0"], "no file was given for it"),
        (["5", "-e", SAMPLE], "no bus was named"),
        (["200", "-b", "demo"], "outside 1..127"),
        ([*NODE], "This must be confirmed"),
    ):
        outcome = run("check", *arguments)
        assert outcome.status == ExitCode.USAGE, arguments
        assert said in outcome.err
    assert run("check", *NODE, "--yes", "--junit", "nowhere/report.xml").status == ExitCode.BAD_FILE


class Typed(io.StringIO):
    """A keyboard."""

    def isatty(self) -> bool:
        return True


def test_it_asks_on_a_terminal_and_shows_what_it_does(run: Run, world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setattr(sys, "stdin", Typed("n\n"))
    assert run("check", *NODE, *cases("2.1")).status == ExitCode.INTERRUPTED
    assert world.states == []
    monkeypatch.setattr(sys, "stdin", Typed("y\n"))
    outcome = run("check", *NODE, *cases("2.1", "4.2"))
    assert outcome.status == 0
    assert "commands go to ALL nodes" in outcome.err
    assert "2.1 Read 0x1000:00 with an expedited transfer" in outcome.err
    assert "4.2 Compare each object" in outcome.err


# ---- a node ----


def test_a_sound_device_passes_all(run: Run, world: World) -> None:
    outcome = run("check", *NODE, "--yes", "--json")
    assert outcome.status == 0
    report = outcome.json
    assert report["counts"] == {"passed": 75, "remark": 0, "failed": 0, "not judged": 0, "not applicable": 40}
    assert (report["node"], report["file"], report["left_out"], report["not_run"]) == (5, SAMPLE, STORING, 0)
    assert numbers_in(outcome) == [case.number for case in CASES if case.number not in STORING]
    assert 10 < sum(each["seconds"] for each in report["cases"]) < 100


def test_a_simulated_drive(run: Run) -> None:
    outcome = run("check", "3", "-b", "demo", "--yes", *cases("1.0", "2.1", "8"))
    assert outcome.status == 0
    rows = [line.split(maxsplit=1) for line in outcome.out.splitlines()[2:]]
    assert [number for number, _ in rows] == ["1.0", "2.1", "8.10"]
    assert "there is no file of the device" in rows[0][1]
    assert "node 3 (0x03): 2 passed, 0 failed, 1 not applicable; " in outcome.err
    assert "left out, as they change what the device stores: 8.1, 8.2, 8.3," in outcome.err


def test_a_device_that_is_another_than_its_file_says(run: Run, world: World) -> None:
    Path("other.eds").write_bytes(read_file(SAMPLE).replace(b"0x00070191", b"0x00070192"))
    outcome = run("check", *NODE[:-1], "other.eds", "--yes", *cases("2.1", "2.3", "4.2"))
    assert outcome.status == ExitCode.DIFFERENT
    assert "read expedited, is 91 01 07 00, not 92 01 07 00" in outcome.out
    assert "1 passed, 2 failed (2.1, 4.2), 0 not applicable" in outcome.err
    assert "eds lint" not in outcome.err


def test_all_offenders_are_listed(run: Run, world: World) -> None:
    text = read_file(SAMPLE).replace(b"DefaultValue=0x00070191", b"DefaultValue=0x00070192").replace(b"=500", b"=501")
    Path("other.eds").write_bytes(text)
    arguments = (*NODE[:-1], "other.eds", "--yes", *cases("4.2"))
    outcome = run("check", *arguments, "--junit", "report.xml")
    assert outcome.status == ExitCode.DIFFERENT
    listed = outcome.out.partition("4.2, failures:\n")[2].splitlines()
    assert [line.split()[0] for line in listed] == ["device_type", "producer_heartbeat_time"]
    failure = ElementTree.parse("report.xml").getroot().find(".//failure")
    assert failure is not None
    assert failure.get("message", "").endswith("(and 1 more)")
    assert len((failure.text or "").splitlines()) == 2
    (case,) = run("check", *arguments, "--json").json["cases"]
    assert [line.strip() for line in listed] == case["failures"]
    assert case["remarks"] == []


def test_a_remark_is_no_failure_unless_strict(run: Run, world: World) -> None:
    """The device starts by itself."""
    world.made_by = SelfStarting
    arguments = (*NODE, "--yes", *cases("9.2", "10.2"))
    outcome = run("check", *arguments, "--junit", "report.xml")
    assert outcome.status == 0
    assert "node 5 (0x05): 1 passed, 1 remark, 0 failed" in outcome.err
    assert "after boot-up, the device is OPERATIONAL: it starts by itself" in outcome.out
    root = ElementTree.parse("report.xml").getroot()
    assert (root.get("failures"), root.get("skipped")) == ("0", "0")
    assert "it starts by itself" in (root.findtext(".//system-out") or "")
    first, _ = run("check", *arguments, "--json").json["cases"]
    assert (first["result"], first["failures"]) == ("remark", [])
    assert len(first["remarks"]) == 1
    assert run("check", *arguments, "--strict").status == ExitCode.DIFFERENT


def test_a_file_of_another_node_is_none(run: Run) -> None:
    outcome = run("check", "5", "-b", "virtual:check", "-e", f"6={SAMPLE}", "--yes")
    assert outcome.status == ExitCode.USAGE
    assert "no file was given for it" in outcome.err


def test_the_device_is_reset_at_the_end(run: Run, world: World) -> None:
    assert run("check", *NODE, "--yes", *cases("9.3", "10.3")).status == 0
    assert world.states[-2:] == [NmtState.INITIALISING, NmtState.PRE_OPERATIONAL]
    assert world.node.values.read(0x1017) == 500


def test_storing(run: Run, world: World) -> None:
    world.dictionary = full_device()
    Path("full.eds").write_text(write_eds(describe(world.dictionary)))
    outcome = run("check", "5", "-b", "demo", "-e", "full.eds", "--yes", "--storing", "--json", *cases("8", "6.8"))
    assert outcome.status == 0
    assert outcome.json["counts"]["passed"] == 11
    assert outcome.json["left_out"] == []


def test_the_time_of_an_answer_is_that_of_the_option(run: Run, world: World) -> None:
    async def ignore_sdo() -> None:
        world.node.deaf_to = range(0x600, 0x680)

    world.task = ignore_sdo
    for limit, seconds in (("100ms", 0.1), ("3s", 3)):
        outcome = run("check", *NODE, "--yes", "--timeout", limit, "--json", *cases("4.1"))
        (case,) = outcome.json["cases"]
        assert case["seconds"] == pytest.approx(0.2 + seconds)  # behind the reset
        assert "node 5 did not answer" in case["reason"]


# ---- JUnit ----


def test_junit(run: Run, world: World) -> None:
    Path("other.eds").write_bytes(read_file(SAMPLE).replace(b"0x00070191", b"0x00070192"))
    arguments = (*NODE[:-1], "other.eds", "--yes", "--junit", "report.xml", *cases("2.1", "2.12", "4.1", "8", "10.1"))
    assert run("check", *arguments).status == ExitCode.DIFFERENT
    root = ElementTree.parse("report.xml").getroot()
    assert {name: root.get(name) for name in ("name", "tests", "failures", "errors", "skipped")} == {
        "name": "canopen check node 5 (0x05)",
        "tests": "14",
        "failures": "1",
        "errors": "0",
        "skipped": "10",
    }
    assert [suite.get("name") for suite in root] == ["SDO", "OD", "Testing other", "Transition"]
    sdo, od, other, transition = root
    assert (sdo.get("package"), sdo.get("tests"), sdo.get("failures")) == ("canopen.conformance", "2", "1")
    first, second = sdo.findall("testcase")
    assert first.get("classname") == "canopen.conformance.SDO"
    assert first.get("name") == "2.1 Read 0x1000:00 with an expedited transfer"
    failure, skipped = first.find("failure"), second.find("skipped")
    assert failure is not None
    assert "not 92 01 07 00" in failure.get("message", "")
    assert skipped is not None
    assert skipped.get("message") == "the dictionary has no object 0x1200"
    assert od.findtext("testcase/system-out") == "35 objects"
    assert [each.get("name", "").split()[0] for each in other.findall("testcase")] == [f"8.{n}" for n in range(1, 11)]
    assert float(transition.get("time", "0")) > 1
    assert sdo.find("properties/property").get("value") == "other.eds"  # type: ignore[union-attr]


def test_a_case_that_another_master_disturbs_is_not_judged_and_the_check_does_not_pass(run: Run, world: World) -> None:
    async def start_all_nodes() -> None:
        async with await open_transport(DEMO_LOCATOR) as other:
            while True:
                await trio.sleep(0.037)
                await other.send(Frame.parse("000#0100"))

    world.task = start_all_nodes
    outcome = run("check", *NODE, "--yes", "--junit", "report.xml", *cases("10.1"))
    assert outcome.status == ExitCode.DIFFERENT
    assert "0 passed, 0 failed, 1 not judged (10.1), 0 not applicable" in outcome.err
    root = ElementTree.parse("report.xml").getroot()
    assert (root.get("failures"), root.get("errors")) == ("0", "1")
    error = root.find("testsuite/testcase/error")
    assert error is not None
    assert "another master is on the bus and sent 000#0100" in error.get("message", "")


def test_a_report_that_cannot_be_written_is_told(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    Path("report.xml").mkdir()
    with pytest.raises(CommandError, match="cannot write"):
        write_junit("report.xml", CheckReport(5, 0))


# ---- how it may end ----


def test_nobody_is_there(run: Run, world: World) -> None:
    outcome = run("check", "7", "-b", "demo", "-e", SAMPLE, "--yes")
    assert outcome.status == ExitCode.NO_ANSWER
    assert outcome.out == ""
    assert "node 7 did not answer reading 1000:00" in outcome.err
    assert "canopen scan -b demo" in outcome.err


def test_a_device_without_a_boot_up_is_there(run: Run, world: World) -> None:
    async def ignore_nmt() -> None:
        world.node.deaf_to = range(1)

    world.task = ignore_nmt
    outcome = run("check", *NODE, "--yes", *cases("2.1"))
    assert outcome.status == ExitCode.DIFFERENT
    assert "the boot-up frame did not come" in outcome.out


def test_a_device_that_goes_away(run: Run, world: World) -> None:
    async def later() -> None:
        await trio.sleep(2)
        world.node.deaf_to = range(0x800)

    world.task = later
    outcome = run("check", *NODE, "--yes", "--json", "--junit", "report.xml")
    assert outcome.status == ExitCode.NO_ANSWER
    assert outcome.json["counts"]["failed"] == 1
    assert outcome.json["not_run"] > 50
    assert outcome.error["code"] == "CO201"
    assert not Path("report.xml").exists()


@pytest.mark.parametrize("storing", [False, True])
def test_an_interrupt_resets_the_device(run: Run, world: World, storing: bool) -> None:
    async def interrupt() -> None:
        await trio.sleep(1.5 if storing else 3)
        signal.raise_signal(signal.SIGINT)

    world.task = interrupt
    chosen = cases("3", "4")
    if storing:
        world.dictionary = full_device()
        Path("full.eds").write_text(write_eds(describe(world.dictionary)))
        chosen = ["--storing", *cases("8")]
    outcome = run("check", *NODE[:-1], "full.eds" if storing else SAMPLE, "--yes", *chosen)
    assert outcome.status == ExitCode.INTERRUPTED
    assert "the node was reset" in outcome.err
    assert ("what it stores may not be what it was" in outcome.err) == storing
    assert world.states[-2:] == [NmtState.INITIALISING, NmtState.PRE_OPERATIONAL]
