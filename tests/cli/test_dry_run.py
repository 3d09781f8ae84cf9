"""`--dry-run` of `canopen drive`: the frames that the same command would send, and nothing sent but reads; in virtual time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import pytest

from canopen_cli.shared.problem import ExitCode
from canopen_data.descriptions import load_description
from canopen_data.drive_from_file import drive_dictionary_of
from canopen_data.eds.writer import write_eds
from canopen_master.simulation.serving import SimulatedDevices
from canopen_proto.dictionary import Access
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.states import State
from canopen_proto.frame import ERROR_CONTROL, Frame
from canopen_proto.nmt import NmtCommand
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from canopen_transports.log_files import LogReader
from tests.cli.cli_support import Alarm, Run, only_drive
from tests.cli.test_drive import DEMO, powered, prepare


def in_fault(drive: DriveNode) -> None:
    drive.raise_fault(0x2310, 0)


def operational(drive: DriveNode) -> None:
    drive.execute(NmtCommand.START, 0)


def untouched(drive: DriveNode) -> None:
    """As after power-on."""


def commands_in(trace: Path) -> list[str]:
    """Return the frames of our side in a recording that change something in a drive."""
    frames = [record.frame for record in LogReader(trace) if record.sent]
    return [str(frame) for frame in frames if changes(frame)]


def changes(frame: Frame) -> bool:
    return frame.can_id & 0x780 != ERROR_CONTROL and frame.data[0] >> 5 not in (2, 3, 5)  # not a heartbeat, nor an SDO upload


@pytest.mark.thorough(5)
@pytest.mark.parametrize(
    ("state", "line"),
    [
        (untouched, "enable --seconds 0.5"),
        (untouched, "move -- 2000"),
        (untouched, "mode ip"),
        (in_fault, "fault-reset"),
        (in_fault, "move -- 2000"),
        (in_fault, "disable"),
        (powered, "move --relative -- -500"),
        (powered, "mode ip"),
        (powered, "stop"),
        (powered, "disable"),
        (operational, "move -- 2000"),
    ],
)
def test_the_frames_are_those_of_the_command(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, state: Callable[[DriveNode], None], line: str
) -> None:
    command = line.split()
    drives = prepare(monkeypatch, state)
    dry, real = tmp_path / "dry.log", tmp_path / "real.log"
    rehearsed = run("drive", "3", command[0], *DEMO, "--trace", str(dry), "--dry-run", "--json", *command[1:])
    assert commands_in(dry) == []
    before = drives[-1].drive.state
    done = run("drive", "3", command[0], *DEMO, "--trace", str(real), *command[1:])
    assert rehearsed.status == done.status
    shown = [each["frame"] for each in rehearsed.json]
    assert [each for each in shown if not each.startswith("77F")] == commands_in(real)
    assert drives[0].drive.state is (before if state is not untouched else State.SWITCH_ON_DISABLED)


def test_what_is_told(run: Run, simulations: list[SimulatedDevices]) -> None:
    outcome = run("drive", "3", "move", "2000", "--dry-run", *DEMO)
    assert outcome.status == 0
    rows = [" ".join(line.split()[1:]) for line in outcome.out.splitlines()[2:]]
    assert "603#237A6000D0070000 SDO write 607A:00 target_position = 2000 (0x7D0)" in rows
    assert rows.index("77F#05 heartbeat operational") == 1
    assert sum(row.startswith("77F") for row in rows) == 1  # repeated, and shown once
    assert "nothing of this was sent" in outcome.err
    assert simulations[0].drives[3].values[objects.POSITION_ACTUAL_VALUE] == -14000
    reads = run("drive", "3", "move", "2000", "--dry-run", "-v", *DEMO)
    assert "603#4041600000000000 SDO read 6041:00 statusword" in [" ".join(line.split()[1:]) for line in reads.out.splitlines()]


def test_a_command_that_waits_for_ctrl_c_ends(run: Run) -> None:
    outcome = run("drive", "3", "enable", "--dry-run", "--json", *DEMO)
    assert outcome.status == 0
    written = [each["frame"] for each in outcome.json if each["frame"].startswith("603#2B4060")]
    assert written[-2:] == ["603#2B4060000F000000", "603#2B40600000000000"]  # enabled, and disabled on the way out
    assert outcome.json[-1]["ms"] >= 1000


def test_a_rehearsal_does_not_say_that_the_drive_has_power(run: Run) -> None:
    outcome = run("drive", "3", "enable", "--for", "1s", "--dry-run", *DEMO)
    assert outcome.status == 0
    assert "is enabled" not in outcome.err
    assert "it gets no more power" not in outcome.err
    assert "nothing of this was sent" in outcome.err


def test_a_drive_that_refuses_is_seen_in_the_rehearsal(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    prepare(monkeypatch, in_fault)
    outcome = run("drive", "3", "move", "2000", "--dry-run", *DEMO)
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "CO402" in outcome.err
    assert "nothing of this was sent" not in outcome.err  # the error says what stopped it


def test_nothing_to_send(run: Run) -> None:
    outcome = run("drive", "3", "fault-reset", "--dry-run", *DEMO)
    assert outcome.status == 0
    assert outcome.out == "no frames, except those that read\n"


def test_a_stop_is_sent_whatever_the_drive_shows(run: Run) -> None:
    rows = run("drive", "3", "disable", "--dry-run", *DEMO).out.splitlines()[2:]
    assert len(rows) == 1
    assert "603#2B40600000000000" in rows[0]


def test_a_device_that_is_no_drive(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    from tests.cli.test_drive import device

    device(monkeypatch, {})
    outcome = run("drive", "5", "stop", "--dry-run", *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert "CO410" in outcome.err
    assert "it has no statusword" in outcome.err


def test_a_controlword_of_0_is_no_half_of_a_fault_reset(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    prepare(monkeypatch, in_fault)
    outcome = run("drive", "3", "fault-reset", "--dry-run", *DEMO)
    assert "controlword = 0 (disable voltage)" in " ".join(outcome.out.split())
    assert "reset_fault_0" not in outcome.out


def test_a_drive_whose_file_says_that_a_command_cannot_be_read_is_rehearsed(
    run: Run, alarm: Alarm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in the EDS of a profile: 0x6060 is write-only. The likeness has its type from the file, not from a refused read."""
    sample = load_description("sample_drive.eds")
    mode = sample.dictionary.objects[0x6060]
    write_only = replace(mode, variables=MappingProxyType({0: replace(mode.variables[0], access=Access.WO)}))
    file = tmp_path / "drive.eds"
    file.write_text(write_eds(replace(sample, dictionary=sample.dictionary.with_objects([write_only]))))
    dictionary, _ = drive_dictionary_of(load_description(file).dictionary, Shape.STANDARD)
    only_drive(monkeypatch, alarm, lambda out, node_id: DriveNode(out, node_id, DriveSettings(), dictionary))
    outcome = run("drive", "5", "move", "12000", "-e", str(file), "--dry-run", *DEMO)
    assert outcome.status == 0, outcome.err
    assert "target_position = 12000" in " ".join(outcome.out.split())
