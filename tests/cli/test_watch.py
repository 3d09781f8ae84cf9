"""`canopen watch` in virtual time: by PDO where one brings a value, else by SDO, and how it ends."""

from __future__ import annotations

import csv
import errno
import itertools
import json
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import trio

from canopen_cli.live import source as live_source
from canopen_master.simulation.serving import DEMO_LOCATOR, SimulatedDevices, simulated_drives
from canopen_proto.frame import Frame
from canopen_proto.machine import SECOND, Time
from canopen_proto.nmt import NmtCommand
from canopen_proto.simulation.drive.node import DriveNode
from canopen_transports import open_transport
from canopen_transports.log_files import LogReader
from tests.cli.cli_support import Alarm, Run, runner, watched_simulations

DEMO = ("-b", "demo")
LOG = "".join(
    f"(10.{number}00000) can0 185#37060000{value}000000\n(10.{number}10000) can1 185#37060000{value}0000FF\n"
    for number, value in enumerate(("01", "05", "03"))
)
"""TPDO 1 of node 5 on two buses, as schunk_default_tPDO, by a guess."""


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own").mkdir()
    return runner(capsys, monkeypatch, tmp_path / "own")


def asked(path: str, node_id: int = 3) -> Counter[str]:
    """The SDO reads in a trace, by object."""
    reads = (record.frame for record in LogReader(Path(path)) if record.frame.can_id == 0x600 + node_id)
    return Counter(f"{frame.data[2]:02X}{frame.data[1]:02X}" for frame in reads if frame.data[0] == 0x40)


def test_an_object_that_no_pdo_brings_is_read_at_the_given_rate(run: Run) -> None:
    outcome = run("watch", "3", "statusword", "6064", "--every", "500ms", "--seconds", "5", *DEMO, "--trace", "t.log")
    assert outcome.status == 0
    first, second = outcome.out.splitlines()  # only changes
    assert first.endswith("6041:00 statusword = 0x0240 (switch on disabled, remote)  [SDO]")
    assert second.endswith("6064:00 position_actual_value = -14000  [SDO]")
    reads = asked("t.log")
    assert reads["6041"] in (10, 11)
    assert reads["6064"] in (10, 11)
    assert max(reads.values()) <= 11, "and the mappings once"
    sent = {(record.frame.can_id, record.frame.data[0]) for record in LogReader(Path("t.log")) if record.sent}
    assert sent == {(0x603, 0x40)}, "nothing but reads"


def test_what_would_load_the_bus_is_asked_slower(run: Run) -> None:
    objects = [f"{index:04X}" for index in range(0x6060, 0x6067)]
    outcome = run("watch", "3", *objects, "--every", "10ms", "--seconds", "10", *DEMO, "--trace", "t.log")
    assert outcome.status == 0
    times = [record.time for record in LogReader(Path("t.log")) if record.frame.can_id == 0x603]
    assert len(times) < 10 * 125_000 * 0.05 / 200, "5 % of the slowest bus in use, if the bit rate is not known"


def sends_pdos(simulation: SimulatedDevices) -> None:
    """Have TPDO 1 of drive 3 sent each 50 ms, not at SYNC, and start the drive."""

    def set_up(node: DriveNode, now: Time) -> None:
        assert node.write(0x1800, 2, b"\xff", now) is None
        assert node.write(0x1800, 5, (50).to_bytes(2, "little"), now) is None
        node.execute(NmtCommand.START, now)

    simulation.change(3, set_up)


def test_a_pdo_takes_the_place_of_requests(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    alarm = Alarm()

    async def events(simulation: SimulatedDevices) -> None:
        await trio.sleep(2)
        sends_pdos(simulation)
        await trio.sleep(4)
        simulation.change(3, lambda node, now: node.execute(NmtCommand.ENTER_PRE_OPERATIONAL, now))

    alarm.task = events
    watched_simulations(monkeypatch, alarm)
    outcome = run("watch", "3", "6064", "--every", "100ms", "--seconds", "8", *DEMO, "--trace", "t.log", "--json")
    assert outcome.status == 0
    samples = [json.loads(line) for line in outcome.out.splitlines()]
    sources = [source for source, _ in itertools.groupby(each["source"] for each in samples)]
    assert sources == ["SDO", "TPDO 1", "SDO"]
    by_pdo = [each["time"] for each in samples if each["source"] == "TPDO 1"]
    assert len(by_pdo) in range(78, 83)
    reads = [record.time for record in LogReader(Path("t.log")) if record.frame.data[:3] == b"\x40\x64\x60"]
    assert not [time for time in reads if by_pdo[0] < time < by_pdo[-1] + 0.4 * SECOND]
    assert samples[0] | {"time": 0} == {
        "time": 0,
        "node": 3,
        "index": 0x6064,
        "sub": 0,
        "name": "position_actual_value",
        "value": -14000,
        "physical": None,
        "unit": "",
        "source": "SDO",
    }


def test_the_mappings_are_read_again_after_a_boot_up(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    alarm = Alarm()

    async def events(simulation: SimulatedDevices) -> None:
        await trio.sleep(2)
        simulation.change(3, lambda node, now: node.execute(NmtCommand.RESET_NODE, now))

    alarm.task = events
    watched_simulations(monkeypatch, alarm)
    outcome = run("watch", "3", "6064", "--seconds", "5", *DEMO, "--trace", "t.log")
    assert outcome.status == 0
    assert asked("t.log")["1A00"] == 2 * 4  # the number of objects, and the objects


THEIRS = bytes.fromhex("4064600000000001")
"""A request of another program: its last byte, which is reserved, tells it from ours."""


def test_the_node_is_left_to_another_program_that_asks_it(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    alarm = Alarm()

    async def ask(simulation: SimulatedDevices) -> None:
        await trio.sleep(2)
        async with await open_transport(DEMO_LOCATOR) as other:
            for _ in range(8):
                await other.send(Frame(0x603, THEIRS))
                await trio.sleep(0.5)

    alarm.task = ask
    watched_simulations(monkeypatch, alarm)
    outcome = run("watch", "3", "6041", "6064", "--seconds", "10", *DEMO, "--trace", "t.log", "--json")
    assert outcome.status == 0
    assert outcome.err.count("another program asks this node by SDO") == 1
    requests = [record for record in LogReader(Path("t.log")) if record.frame.can_id == 0x603]
    theirs = [record.time for record in requests if record.frame.data == THEIRS]
    ours = [record.time for record in requests if record.frame.data != THEIRS]
    assert not [time for time in ours if theirs[0] < time < theirs[-1] + 2 * SECOND]
    assert min(ours) < theirs[0]
    assert max(ours) > theirs[-1]
    values = [each["time"] for each in map(json.loads, outcome.out.splitlines()) if each["index"] == 0x6064]
    shown = [time for time in values if theirs[0] < time < theirs[-1] + SECOND]
    assert len(shown) in (7, 8), "theirs are shown (the trace has a clock of its own)"


def test_passive_sends_nothing(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    alarm = Alarm()

    async def events(simulation: SimulatedDevices) -> None:
        sends_pdos(simulation)

    alarm.task = events
    monkeypatch.setattr(live_source, "simulated_drives", watched_by(alarm))
    outcome = run("watch", "3", "6064", "--passive", "--seconds", "2", *DEMO, "--trace", "t.log")
    assert outcome.status == 0
    assert outcome.out.endswith("6064:00 position_actual_value = -14000  [schunk_default_tPDO?]\n")
    assert not [record for record in LogReader(Path("t.log")) if record.sent]


def watched_by(alarm: Alarm) -> Callable[..., AbstractAsyncContextManager[SimulatedDevices]]:
    """Return what makes simulated devices with the alarm in them."""

    @asynccontextmanager
    async def made(*arguments: Any) -> AsyncIterator[SimulatedDevices]:
        async with simulated_drives(*arguments) as simulation:
            trio.lowlevel.spawn_system_task(alarm.ring, simulation)
            yield simulation

    return made


def test_a_node_that_does_not_answer(run: Run) -> None:
    outcome = run("watch", "99", "6041", "6064", "--seconds", "4", *DEMO, "--trace", "t.log")
    assert outcome.status == 5
    assert "6041:00 statusword: the node does not answer SDO requests" in outcome.err
    assert "error CO210: no value of 6041:00, 6064:00 of node 99 has come" in outcome.err
    assert sum(asked("t.log", 99).values()) <= 5, "it is asked seldom"


def test_a_node_that_stops_answering_is_no_success(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    alarm = Alarm()

    async def events(simulation: SimulatedDevices) -> None:
        async with await open_transport(DEMO_LOCATOR) as transport:
            await trio.sleep(1.5)
            await transport.send(Frame(0, bytes((NmtCommand.STOP, 3))))

    alarm.task = events
    watched_simulations(monkeypatch, alarm)
    outcome = run("watch", "3", "6041", "6064", "--every", "500ms", "--for", "5s", *DEMO, "--csv", "values.csv")
    assert outcome.status == 5
    assert "node 3 has stopped answering: there are no new values of 6041:00, 6064:00" in outcome.err
    assert len(Path("values.csv").read_text().splitlines()) > 4, "what came before is there"


def test_an_object_that_the_node_does_not_have(run: Run) -> None:
    outcome = run("watch", "3", "5FFF", "6064", "--type", "u16", "--seconds", "4", *DEMO, "--trace", "t.log")
    assert outcome.status == 0
    assert "5FFF:00 5FFF: refused: " in outcome.err
    assert asked("t.log")["5FFF"] == 1


def test_objects_that_cannot_be_meant(run: Run) -> None:
    outcome = run("watch", "3", *DEMO)
    assert (outcome.status, "no object was named" in outcome.err) == (2, True)
    outcome = run("watch", "3", "statusward", *DEMO)
    assert (outcome.status, "CO302" in outcome.err) == (2, True)
    assert run("watch", "3", "6041").status == 2  # no bus


@pytest.fixture
def log(run: Run) -> Path:
    Path("t.log").write_text(LOG)
    return Path("t.log")


def test_a_recording(run: Run, log: Path) -> None:
    outcome = run("watch", "5", "6064", "--log", str(log))
    assert outcome.status == 0
    assert [line.split()[-2] for line in outcome.out.splitlines()] == ["1", "5", "3"]
    assert "there are frames of other buses, too; these are of can0; or --channel can1" in outcome.err
    outcome = run("watch", "5", "6064", "--log", str(log), "--channel", "can1", "-q")
    assert (len(outcome.out.splitlines()), outcome.err) == (3, "")
    outcome = run("watch", "6", "6064", "--log", str(log), "--channel", "can1")
    assert (outcome.status, "nothing was heard of it" in outcome.err) == (5, True)
    assert run("watch", "5", "6064", "--log", "none.log").status == 6


def test_values_go_into_a_csv(run: Run, log: Path) -> None:
    Path("units.toml").write_text('[objects.6064]\nunit = "deg"\nfactor = 0.001\n')
    options = ("--log", str(log), "--csv", "run.csv", "--overlay", "units.toml")
    assert run("watch", "5", "6064", *options).status == 0
    rows = list(csv.reader(Path("run.csv").read_text().splitlines()))
    assert rows[0] == ["time", "node", "object", "name", "value", "physical", "unit", "source"]
    assert rows[1] == ["10.000000000", "5", "6064:00", "position_actual_value", "1", "0.001", "deg", "schunk_default_tPDO?"]
    assert [row[4] for row in rows[1:]] == ["1", "5", "3"]
    assert run("watch", "5", "6064", *options).status == 2  # it is there already
    assert run("watch", "5", "6064", "--log", str(log), "--csv", "no/run.csv").status == 6


def test_a_recording_that_is_damaged_further_on(run: Run) -> None:
    Path("odd.log").write_text(LOG + "no record\n")
    outcome = run("watch", "5", "6064", "--log", "odd.log")
    assert (outcome.status, len(outcome.out.splitlines())) == (6, 3)
    outcome = run("top", "--log", "odd.log")
    assert (outcome.status, outcome.out.count("5 (0x05)")) == (6, 2), "what could be read is shown"
    Path("odd.log").write_text(LOG + "(10.5) can0 185##0\n")  # CAN FD
    outcome = run("watch", "5", "6064", "--log", "odd.log")
    assert outcome.status == 0
    assert "1 entry passed over, the last: " in outcome.err


def test_no_room_for_what_is_printed_ends_it(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("canopen_cli.live.watch._tell_json", full)
    outcome = run("watch", "3", "6041", *DEMO, "--seconds", "5", "--json")
    assert (outcome.status, "CO341" in outcome.err) == (6, True)


def test_a_folder_is_no_csv(run: Run) -> None:
    outcome = run("watch", "3", "6041", *DEMO, "--csv", ".")
    assert (outcome.status, "cannot write .: it is a folder" in outcome.err) == (6, True)
