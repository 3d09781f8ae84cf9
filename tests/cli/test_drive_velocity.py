"""`canopen drive NODE velocity`: it runs while the command runs, and then stands without power; in virtual time."""

from __future__ import annotations

import json
import math
import signal

import pytest
import trio

from canopen_cli.shared.problem import ExitCode
from canopen_master.simulation.serving import SimulatedDevices
from canopen_proto.abort import AbortCode
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import State
from canopen_proto.multiplexer import Mux
from canopen_proto.simulation.drive.answers import Answer
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Track
from tests.cli.cli_support import Alarm, Run, only_drive, stands
from tests.cli.command_examples import json_that_fits

DEMO = ("-b", "demo")


@pytest.fixture
def drives(monkeypatch: pytest.MonkeyPatch, alarm: Alarm) -> list[DriveNode]:
    """Drive 5, the only one, has 6000 counts a turn of its motor, and no end; the drives of the commands to come."""
    settings = DriveSettings(position=0, track=Track(-math.inf, math.inf))
    dictionary = drive_dictionary().with_objects([standard_object(0x608F, highest=2, defaults={1: 6_000, 2: 1})])
    return only_drive(monkeypatch, alarm, lambda out, node_id: DriveNode(out, node_id, settings, dictionary))


def is_over(drive: DriveNode) -> None:
    assert stands(drive)
    assert drive.drive.state is State.SWITCH_ON_DISABLED
    assert drive.values.store[objects.TARGET_VELOCITY] == drive.values.store[objects.VL_TARGET_VELOCITY] == 0


def position(drive: DriveNode) -> int:
    value = drive.values.store[objects.POSITION_ACTUAL_VALUE]
    assert isinstance(value, int)
    return value


def test_for_a_time_in_counts(run: Run, drives: list[DriveNode]) -> None:
    outcome = run("drive", "5", "velocity", "-2000", "--seconds", "3", *DEMO)
    assert outcome.status == 0, outcome.err
    assert "it runs at -2000 counts per second, in profile velocity (pv); for 3 s" in outcome.err
    told, ran, state = outcome.out.splitlines()
    assert (told, state) == ("told              -2000 counts per second", "state             switch on disabled")
    assert float(ran.split()[2]) == pytest.approx(-2_000, abs=20)
    assert position(drives[-1]) == pytest.approx(-6_000, abs=200)
    is_over(drives[-1])


@pytest.mark.thorough(4)
@pytest.mark.parametrize(
    ("unit", "counts"), [("rpm", 100), ("turn", 6_000), ("degree", 6_000 / 360), ("radian", 6_000 / 2 / math.pi)]
)
@pytest.mark.parametrize("mode", ["pv", "vl"])
def test_units(run: Run, drives: list[DriveNode], unit: str, counts: float, mode: str) -> None:
    value = 2_000 / counts
    outcome = run("drive", "5", "velocity", str(value), "--in", unit, "--mode", mode, "--seconds", "3", "--json", *DEMO)
    document = json_that_fits("drive velocity", outcome)
    assert document["velocity"] == pytest.approx(value, rel=0.01)
    assert document["measured"] == pytest.approx(value, rel=0.02)
    assert (document["mode"], document["state"]) == ({"pv": 3, "vl": 2}[mode], "switch on disabled")
    assert document["reached"] is True
    assert position(drives[-1]) == pytest.approx(6_000, abs=300)
    is_over(drives[-1])


def test_what_its_unit_cannot_hold_is_told(run: Run, drives: list[DriveNode]) -> None:
    outcome = run("drive", "5", "velocity", "10.4", "--in", "rpm", "--mode", "vl", "--seconds", "1", *DEMO)
    assert outcome.status == 0, outcome.err
    assert "it runs at 10 rpm (10.4 was asked for), in velocity (vl)" in outcome.err


@pytest.mark.thorough(3)
@pytest.mark.parametrize("at", [0.01, 0.05, 0.3, 2.0])
@pytest.mark.parametrize("mode", ["pv", "vl"])
def test_ctrl_c_stops_it(run: Run, drives: list[DriveNode], alarm: Alarm, at: float, mode: str) -> None:
    alarm.set((at, signal.SIGINT))
    outcome = run("drive", "5", "velocity", "5000", "--mode", mode, *DEMO)
    assert outcome.status == ExitCode.INTERRUPTED
    assert "the drive was halted, and has no power" in outcome.err
    is_over(drives[-1])


def test_a_fault_ends_it_and_is_told(run: Run, drives: list[DriveNode], alarm: Alarm) -> None:
    async def fault(simulation: SimulatedDevices) -> None:
        await trio.sleep(1)
        simulation.raise_fault(5, 0x2310)

    alarm.task = fault
    outcome = run("drive", "5", "velocity", "5000", *DEMO)
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "0x2310" in outcome.err
    assert stands(drives[-1])


def test_a_velocity_beyond_the_limit(run: Run, drives: list[DriveNode]) -> None:
    outcome = run("drive", "5", "velocity", "3000", "--max-speed", "2000", *DEMO)
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "(max_speed) allows 2000; nothing was sent" in outcome.err
    assert drives[-1].drive.mode == Mode.NO_MODE


@pytest.mark.parametrize("unit", ["rpm", "degree", "turn"])
def test_a_joint_that_does_not_tell_a_turn_of_its_motor_never_runs_at_a_velocity_that_nobody_knows(
    run: Run, simulations: list[SimulatedDevices], unit: str
) -> None:
    """It took "500 rpm" as 500 counts per second, 0.08 turns a minute, and compared 500 with a limit in counts per second."""
    outcome = run("drive", "3", "velocity", "500", "--in", unit, "--seconds", "1", *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert "does not tell how many counts a turn of its motor has (0x608F)" in outcome.err
    given = f"canopen drive velocity 3 500 --in {unit} --counts-per-motor-turn COUNTS -b demo"
    assert f"{given}    by its manual: 360000, a turn of its shaft, divided by its gear" in outcome.err
    assert "counts_per_motor_turn of its joint in a machine file" in outcome.err
    assert simulations[-1].drives[3].drive.mode != Mode.VELOCITY


def test_a_joint_that_does_not_tell_a_turn_of_its_motor_runs_by_the_turn_that_is_given(
    run: Run, simulations: list[SimulatedDevices]
) -> None:
    """A simulated joint without 0x608F has 60 counts in a turn of its motor: 300 rpm are 300 counts per second."""
    before = json.loads(run("drive", "state", "3", "--json", *DEMO).out)["position"]
    outcome = run("drive", "3", "velocity", "300", "--in", "rpm", "--counts-per-motor-turn", "60", "--for", "10s", *DEMO)
    assert outcome.status == 0, outcome.err
    assert "told              300 rpm" in outcome.out.splitlines()
    assert position(simulations[-1].drives[3]) - before == pytest.approx(3_000, abs=100)


@pytest.mark.parametrize("mode", ["pv", "vl"])
def test_turns_per_minute_are_never_held_against_a_limit_per_second(run: Run, drives: list[DriveNode], mode: str) -> None:
    """What 0x607F and 0x6080 allow is told in turns per minute; 40,000 of them are not "40000 per second"."""
    outcome = run("drive", "5", "velocity", "40000", "--in", "rpm", "--mode", mode, "--seconds", "1", *DEMO)
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "was not run at 40000" in outcome.err
    assert "0x6080 of the drive allows 100; nothing was sent" in outcome.err
    assert "per second" not in outcome.err
    outcome = run("drive", "5", "velocity", "99", "--in", "rpm", "--mode", mode, "--seconds", "1", *DEMO)
    assert outcome.status == 0, outcome.err


def test_a_joint_without_a_mode_for_velocities_says_what_it_has(run: Run, simulations: list[SimulatedDevices]) -> None:
    outcome = run("drive", "3", "velocity", "500", "--mode", "pv", *DEMO)
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "CO405" in outcome.err
    assert "it has profile position (pp), velocity (vl), interpolated position (ip)" in outcome.err


def converter(monkeypatch: pytest.MonkeyPatch, alarm: Alarm, limits: dict[int, int]) -> list[DriveNode]:
    """Drive 5 is a frequency converter: it has no position, and counts turns of its motor."""
    absent = Answer(abort=AbortCode.NO_SUCH_OBJECT)
    answers = {Mux(index << 8): absent for index in (0x6064, 0x606C, 0x6080)}
    answers[Mux(0x6502 << 8)] = Answer(value=1 << Mode.VELOCITY - 1)
    answers |= {Mux(index << 8): Answer(value=value) for index, value in limits.items()}
    return only_drive(
        monkeypatch, alarm, lambda out, node_id: DriveNode(out, node_id, DriveSettings(answers=tuple(answers.items())))
    )


def test_a_frequency_converter_runs_in_rpm_within_a_limit_in_rpm(run: Run, monkeypatch: pytest.MonkeyPatch, alarm: Alarm) -> None:
    made = converter(monkeypatch, alarm, {0x6080: 1_500})
    outcome = run("drive", "5", "velocity", "1600", "--in", "rpm", "--seconds", "1", *DEMO)
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "allows 1500; nothing was sent" in outcome.err
    outcome = run("drive", "5", "velocity", "1400", "--in", "rpm", "--seconds", "1", *DEMO)
    assert outcome.status == 0, outcome.err
    assert "ran               at 1400 rpm, as it shows" in outcome.out.splitlines()
    assert made[-1].drive.state is State.SWITCH_ON_DISABLED


def test_a_frequency_converter_without_a_limit_in_rpm_never_runs_by_a_limit_in_counts(
    run: Run, monkeypatch: pytest.MonkeyPatch, alarm: Alarm
) -> None:
    made = converter(monkeypatch, alarm, {})
    outcome = run("drive", "5", "velocity", "500", "--in", "rpm", "--seconds", "1", *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert "--max-speed" in outcome.err
    assert made[-1].drive.mode == Mode.NO_MODE
    outcome = run("drive", "5", "velocity", "500", "--in", "rpm", "--max-speed", "600", "--seconds", "1", *DEMO)
    assert outcome.status == 0, outcome.err


def test_a_rehearsal_shows_the_frames_and_sends_none(run: Run, drives: list[DriveNode]) -> None:
    outcome = run("drive", "5", "velocity", "2000", "--seconds", "1", "--dry-run", *DEMO)
    assert outcome.status == 0, outcome.err
    assert "60FF" in outcome.out
    assert drives[-1].drive.mode == Mode.NO_MODE
