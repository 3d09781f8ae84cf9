"""`canopen emcy`: emergencies in words, and the history of a node."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from canopen_cli.shared.problem import ExitCode
from canopen_master.simulation.serving import SimulatedDevices
from canopen_proto.abort import AbortCode
from tests.cli.backup_world import NODE, Lasting, answering, lasting_device
from tests.cli.cli_support import Alarm, Run, runner_in_folder
from tests.cli.test_drive import prepare

LOG = "(1.0) can0 085#2082110102030405\n(1.5) can0 705#05\n(2.0) can0 086#0000\n(3.0) can0 085#0000000000000000\n"


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    return runner_in_folder(capsys, monkeypatch, tmp_path)


def test_the_emergencies_of_a_recording_in_words(run: Run) -> None:
    Path("bus.log").write_text(LOG)
    outcome = run("emcy", "watch", "--log", "bus.log")
    first, second, third = outcome.out.splitlines()
    assert "node 5 (0x05): 0x8220 PDO length exceeded; register 0x11 (generic, communication), maker's bytes 01 02" in first
    assert first.startswith("! ")
    assert "node 6 (0x06): 0x0000 error reset or no error; register 0x00" in second
    assert third.split()[0] == "2.000"
    assert "3 emergencies" in outcome.err
    lines = run("emcy", "watch", "--log", "bus.log", "--node", "5", "--json").out.splitlines()
    documents = [json.loads(each) for each in lines]
    assert [each["code"] for each in documents] == [0x8220, 0]
    assert documents[0]["register_names"] == ["generic", "communication"]
    assert documents[0]["vendor"] == "0102030405"


def test_emergencies_as_they_come(
    run: Run, alarm: Alarm, simulations: list[SimulatedDevices], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fault(served: SimulatedDevices) -> None:
        served.change(4, lambda node, now: node.raise_fault(0x2310, now))

    alarm.task = fault
    outcome = run("emcy", "watch", "-b", "demo", "--for", "2s")
    assert outcome.status == ExitCode.OK
    assert "node 4 (0x04): 0x2310 continuous over-current, output side" in outcome.out
    assert "1 emergency" in outcome.err


def test_the_history_of_a_drive_in_fault(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    prepare(monkeypatch, lambda drive: drive.raise_fault(0x2310, 0))
    shown = run("emcy", "history", "3", "-b", "demo")
    assert "0x2310" in shown.out
    assert "continuous over-current, output side" in shown.out
    document = run("emcy", "history", "3", "-b", "demo", "--json").json
    assert document["history"][0]["code"] == 0x2310
    assert document["register"] & 1
    cleared = run("emcy", "clear", "3", "-b", "demo")
    assert "1 error forgotten" in cleared.err


def test_nothing_to_remember(run: Run) -> None:
    assert "none" in run("emcy", "history", "3", "-b", "demo").out
    assert run("emcy", "clear", "3", "-b", "demo", "--json").json == {"node": 3, "forgotten": 0}


def test_a_device_without_a_history(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    world: Lasting = lasting_device(monkeypatch)
    world.prepare = lambda node: answering(node, {0x1003: AbortCode.NO_SUCH_OBJECT})
    assert "has no history" in run("emcy", "history", *NODE).out
    assert run("emcy", "history", *NODE, "--json").json["history"] is None
