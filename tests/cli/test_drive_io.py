"""`canopen drive NODE inputs|outputs|probe`, and positions in the user's unit; in virtual time."""

from __future__ import annotations

from pathlib import Path

import pytest
import trio

from canopen_cli.shared.problem import ExitCode
from canopen_master.simulation.serving import SimulatedDevices
from canopen_proto.abort import AbortCode
from canopen_proto.drives.cia402 import objects
from canopen_proto.multiplexer import mux
from canopen_proto.simulation.drive.answers import Answer
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Track
from tests.cli.cli_support import Alarm, Run, only_drive
from tests.cli.command_examples import fit_their_schema, json_that_fits

DEMO = ("-b", "demo")


@pytest.fixture
def drives(monkeypatch: pytest.MonkeyPatch, alarm: Alarm) -> list[DriveNode]:
    """Drive 5, the only one, stands on its negative limit switch; the drives of the commands to come."""
    settings = DriveSettings(position=90_000, track=Track(negative_limit=90_000), stops_at_switches=False)
    return only_drive(monkeypatch, alarm, lambda out, node_id: DriveNode(out, node_id, settings))


def rows(text: str) -> list[str]:
    return [" ".join(line.split()) for line in text.splitlines()]


def output(drive: DriveNode) -> tuple[object, object]:
    store = drive.values.store
    return store[objects.DIGITAL_OUTPUTS], store[objects.DIGITAL_OUTPUT_MASK]


def test_inputs_by_name(run: Run, drives: list[DriveNode]) -> None:
    outcome = run("drive", "5", "inputs", *DEMO)
    assert outcome.status == 0, outcome.err
    for row in ("0 negative limit switch 1", "1 positive limit switch 0", "3 interlock 0"):
        assert row in rows(outcome.out)
    assert run("drive", "5", "inputs", "--json", *DEMO).json["active"][0] == "negative limit switch"


def test_outputs_are_shown_and_set_with_their_mask(run: Run, drives: list[DriveNode]) -> None:
    assert "0 brake: 1 holds 0 the drive" in rows(run("drive", "5", "outputs", *DEMO).out)
    outcome = run("drive", "5", "outputs", "17=1", "16=0", *DEMO)
    assert outcome.status == 0, outcome.err
    assert "17 the maker's 17 1 the master" in rows(outcome.out)
    assert "16 the maker's 16 0 the master" in rows(outcome.out)
    assert output(drives[-1]) == (1 << 17, 0b11 << 16)
    assert json_that_fits("drive outputs", run("drive", "5", "outputs", "17=1", "--json", *DEMO)) == {
        "outputs": 1 << 17,
        "mask": 1 << 17,
    }


def test_a_dry_run_sets_nothing(run: Run, drives: list[DriveNode]) -> None:
    outcome = run("drive", "5", "outputs", "17=1", "--dry-run", *DEMO)
    assert outcome.status == 0, outcome.err
    assert "digital_outputs" in outcome.out
    assert output(drives[-1]) == (0, 0)
    outcome = run("drive", "5", "probe", "--dry-run", *DEMO)
    assert outcome.status == 0, outcome.err
    assert "touch_probe_function" in outcome.out
    assert drives[-1].values.store[objects.TOUCH_PROBE_FUNCTION] == 0


def test_the_brake_is_not_opened_by_the_way(run: Run, drives: list[DriveNode]) -> None:
    outcome = run("drive", "5", "outputs", "0=0", *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert "output 0 is the brake of drive 5" in outcome.err
    assert output(drives[-1]) == (0, 0)
    assert run("drive", "5", "outputs", "0=1", *DEMO).status == 0
    assert run("drive", "5", "outputs", "0=0", "--cannot-fall", *DEMO).status == 0


@pytest.mark.parametrize("change", ["16", "32=1", "16=2", "a=1", "-1=1", "1 6=1"])
def test_what_is_no_output(run: Run, drives: list[DriveNode], change: str) -> None:
    assert run("drive", "5", "outputs", *DEMO, "--", change).status == ExitCode.USAGE


def test_a_probe_that_latches(run: Run, drives: list[DriveNode], alarm: Alarm) -> None:
    """The index pulse, while somebody else moves the drive."""

    async def turn(simulation: SimulatedDevices) -> None:
        await trio.sleep(0.5)
        drive = simulation.drives[5]
        drive.values.store[objects.TARGET_VELOCITY] = 20_000
        drive.values.store[objects.MODES_OF_OPERATION] = 3
        drive.drive.written(0x6060, 0, 0)
        for word in (0x06, 0x07, 0x0F):
            drive.values.store[objects.CONTROLWORD] = word
            drive.drive.written(0x6040, 0, 0)

    alarm.task = turn
    outcome = run("drive", "5", "probe", "--source", "index", "--limit", "20s", "--json", *DEMO)
    fit_their_schema("drive probe", outcome.out)
    assert outcome.status == 0, outcome.err
    document = outcome.json
    assert document["unit"] == "counts"
    assert document["positive"] > 90_000
    assert drives[-1].values.store[objects.TOUCH_PROBE_FUNCTION] == 0


def test_a_probe_that_latches_nothing_is_disarmed(run: Run, drives: list[DriveNode]) -> None:
    outcome = run("drive", "5", "probe", "--limit", "1s", *DEMO)
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "latched nothing by touch probe 1 within 1 s" in outcome.err
    assert drives[-1].values.store[objects.TOUCH_PROBE_FUNCTION] == 0


@pytest.mark.parametrize(
    ("command", "what", "number"),
    [
        (("inputs",), "digital inputs", 0x60FD),
        (("outputs",), "digital outputs", 0x60FE),
        (("outputs", "17=1"), "digital outputs", 0x60FE),
        (("probe",), "touch probes", 0x60B8),
    ],
)
@pytest.mark.parametrize("is_described", [True, False])
def test_a_drive_without_the_object_says_so(
    run: Run, monkeypatch: pytest.MonkeyPatch, alarm: Alarm, tmp_path: Path,
    command: tuple[str, ...], what: str, number: int, is_described: bool,
) -> None:  # fmt: skip
    absent = Answer(abort=AbortCode.NO_SUCH_OBJECT)
    settings = DriveSettings(answers=tuple((mux(number, subindex), absent) for subindex in (0, 1, 2)))
    only_drive(monkeypatch, alarm, lambda out, node_id: DriveNode(out, node_id, settings))
    file = tmp_path / "drive.eds"
    if not is_described:
        kinds = {1000: 7, 6040: 6, 6041: 6, 6060: 2, 6061: 2, 6064: 4}
        of_file = [f"[{index}]\nObjectType=7\nDataType={kind}\nAccessType=rw\n" for index, kind in kinds.items()]
        file.write_text("[DeviceInfo]\n" + "".join(of_file))
    outcome = run("drive", "5", *command, *DEMO, *(() if is_described else ("-e", str(file))))
    assert f"drive 5 has no {what}" in outcome.err
    if is_described:
        assert (outcome.status, "CO202" in outcome.err) == (ExitCode.SDO_ABORT, True)
        assert f"it refused to tell 0x{number:04X}, which its dictionary describes" in outcome.err
    else:
        assert (outcome.status, "CO302" in outcome.err) == (ExitCode.USAGE, True)
        assert f"0x{number:04X} is not in the dictionary of drive 5; nothing was sent" in outcome.err


@pytest.mark.parametrize("scale", ["counts_per_unit = 1000.0", "unit = 'degree'\ncounts_per_turn = 360000"])
def test_state_in_the_unit_of_the_machine_file(run: Run, drives: list[DriveNode], tmp_path: Path, scale: str) -> None:
    machine = tmp_path / "m.toml"
    machine.write_text(f"[buses.can0]\n[nodes]\narm = {{ id = 5 }}\n[joints.arm]\ndirection = -1\n{scale}\n")
    outcome = run("drive", "arm", "state", "-m", str(machine), *DEMO)
    assert outcome.status == 0, outcome.err
    unit = "unit" if "per_unit" in scale else "degree"
    assert f"position -90 {unit} (90000 counts)" in rows(outcome.out)
    document = run("drive", "arm", "state", "-m", str(machine), "--json", *DEMO).json
    assert (document["position"], document["position_in_unit"], document["unit"]) == (90_000, -90, unit)
