"""`canopen drive NODE torque`: a torque for a time, and then the drive stands without power; in virtual time."""

from __future__ import annotations

import math
import signal

import pytest

from canopen_cli.shared.problem import ExitCode
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import State
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.plant import Mechanics
from canopen_proto.simulation.drive.settings import DriveSettings, Track
from tests.cli.cli_support import Alarm, Run, only_drive, stands
from tests.cli.command_examples import json_that_fits

ON_IT = ("-b", "demo", "--seconds", "0.5")


@pytest.fixture
def drives(monkeypatch: pytest.MonkeyPatch, alarm: Alarm) -> list[DriveNode]:
    """Drive 5, the only one, is a joint with a mass at 0; the drives of the commands to come."""
    settings = DriveSettings(position=0, mechanics=Mechanics(), track=Track(-math.inf, math.inf))
    return only_drive(monkeypatch, alarm, lambda out, node_id: DriveNode(out, node_id, settings))


def is_over(drive: DriveNode) -> None:
    assert stands(drive)
    assert drive.drive.state is State.SWITCH_ON_DISABLED
    assert drive.values.store[objects.TARGET_TORQUE] == 0


def test_a_torque_for_a_time(run: Run, drives: list[DriveNode]) -> None:
    outcome = run("drive", "5", "torque", "80.4", "--any-speed", *ON_IT)
    assert outcome.status == 0, outcome.err
    assert "applied           80 per mille of the rated torque for 0.5 s, which is 0.8 N·m" in outcome.out
    assert "state             switch on disabled" in outcome.out
    drive = drives[-1]
    is_over(drive)
    assert drive.drive.mode == Mode.TORQUE
    assert drive.values.store[objects.POSITION_ACTUAL_VALUE] > 1_000  # type: ignore[operator]


def test_in_newton_metres_to_the_other_side(run: Run, drives: list[DriveNode]) -> None:
    outcome = run("drive", "5", "torque", "--in", "newton-metre", "--slope", "5", "--any-speed", "--json", *ON_IT, "--", "-1")
    assert json_that_fits("drive torque", outcome) == {
        "per_mille": -100,
        "newton_metre": -1,
        "seconds": 0.5,
        "state": "switch on disabled",
    }
    assert drives[-1].values.store[objects.TORQUE_SLOPE] == 500
    assert drives[-1].values.store[objects.POSITION_ACTUAL_VALUE] < -1_000  # type: ignore[operator]
    is_over(drives[-1])


def test_without_a_limit_of_the_speed_it_is_not_moved(run: Run, drives: list[DriveNode]) -> None:
    outcome = run("drive", "5", "torque", "80", *ON_IT)
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "nothing limits its speed" in outcome.err
    assert drives[-1].drive.mode == Mode.NO_MODE


def test_a_drive_that_gets_too_fast_is_stopped_and_loses_its_power(run: Run, drives: list[DriveNode]) -> None:
    outcome = run("drive", "5", "torque", "80", "--max-speed", "10000", *ON_IT)
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "is too fast: 1" in outcome.err
    assert "the limit is 1e+04, by what was asked for (max_speed)" in outcome.err
    is_over(drives[-1])


@pytest.mark.parametrize("at", [0.05, 0.15, 0.4])
def test_ctrl_c_ends_it_standing_without_power(run: Run, drives: list[DriveNode], alarm: Alarm, at: float) -> None:
    alarm.set((at, signal.SIGINT))
    outcome = run("drive", "5", "torque", "80", "--any-speed", "-b", "demo", "--seconds", "20")
    assert outcome.status == ExitCode.INTERRUPTED
    assert "the drive was stopped, and has no power" in outcome.err
    is_over(drives[-1])


def test_wrong_words(run: Run, drives: list[DriveNode]) -> None:
    assert run("drive", "5", "torque", "80", "-b", "demo").status == ExitCode.USAGE  # no --seconds
    assert run("drive", "5", "torque", "80", "--any-speed", "--max-speed", "3", *ON_IT).status == ExitCode.USAGE
    outcome = run("drive", "5", "torque", "0.4", "--any-speed", *ON_IT)
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "counts thousandths" in outcome.err
    assert drives[-1].drive.mode == Mode.NO_MODE


@pytest.mark.parametrize("torque", ["nan", "inf"])
def test_a_torque_is_a_finite_number(run: Run, drives: list[DriveNode], torque: str) -> None:
    outcome = run("drive", "5", "torque", torque, "--any-speed", *ON_IT)
    assert outcome.status == ExitCode.USAGE
    assert f"CO120: a torque must be a finite number; it is {torque}" in outcome.err


def test_a_drive_without_the_mode_is_named_before_anything_is_written(run: Run) -> None:
    outcome = run("drive", "3", "torque", "80", "--any-speed", *ON_IT)  # a joint of Schunk's
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "CO405: drive 3 does not support torque (tq)" in outcome.err


def test_a_rehearsal_shows_the_frames_and_sends_none(run: Run, drives: list[DriveNode]) -> None:
    outcome = run("drive", "5", "torque", "80", "--any-speed", "--dry-run", *ON_IT)
    assert outcome.status == 0, outcome.err
    assert "6071" in outcome.out
    assert drives[-1].drive.mode == Mode.NO_MODE
