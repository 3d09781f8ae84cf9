"""`canopen drive NODE commission`: the whole way by answers, the safe defaults, and its ends. In virtual time."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
import trio

from canopen_cli.drive import commission as drive_commission
from canopen_cli.shared import questions
from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.screen import Screen
from canopen_master.machine_file import read_machine
from canopen_master.simulation.serving import SimulatedDevices
from canopen_proto.drives.axis.units import Unit
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.states import State
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings
from tests.cli.cli_support import Alarm, Outcome, Run, only_drive, stands

Commission = Callable[..., Outcome]
SHAPE_ANSWERS = ["", ""]
"""Degrees, by the drive's scale."""
LIMIT_ANSWERS = ["-90", "90", ""]


@pytest.fixture
def commission(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Commission:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(drive_commission, "is_asked", lambda screen: True)

    def commanded(*answers: str | float, node: str = "3", options: tuple[str, ...] = ()) -> Outcome:
        """A number stands for a Ctrl-C so many seconds after the next answer."""
        left = list(answers)

        async def interrupt(seconds: float) -> None:
            await trio.sleep(seconds)
            signal.raise_signal(signal.SIGINT)

        async def answer() -> bytes:
            await trio.lowlevel.checkpoint()
            if left and isinstance(left[0], float):
                trio.lowlevel.spawn_system_task(interrupt, left.pop(0))
            return f"{left.pop(0)}\n".encode() if left else b""

        monkeypatch.setattr(questions, "read_input", answer)
        return run("drive", node, "commission", "-b", "demo", *options)

    return commanded


def profile_speed(drive: DriveNode) -> object:
    return drive.values[objects.PROFILE_VELOCITY]


def test_from_the_box_to_the_first_move(commission: Commission, simulations: list[SimulatedDevices]) -> None:
    moves = ["5", "y", "r", "4", "y", "y"]  # the other way round; once more
    outcome = commission(*SHAPE_ANSWERS, *LIMIT_ANSWERS, *moves, "y", "10", "2", "yes", options=("--name", "elbow"))
    assert outcome.status == 0, outcome.err
    (drive,) = (each for each in simulations[0].drives.values() if each.node_id == 3)
    assert drive.drive.state is State.SWITCH_ON_DISABLED
    assert drive.values[objects.POSITION_ACTUAL_VALUE] == pytest.approx(-10_000, abs=100)
    assert profile_speed(drive) == 20_000  # its own again
    moved = re.findall("^moved +from (.*) to (.*) degrees$", outcome.out, re.MULTILINE)
    assert [list(map(float, each)) for each in moved] == [pytest.approx([-14, -9], abs=0.1), pytest.approx([9, 13], abs=0.1)]
    assert "It moves by 5 degrees, at 2.5 degrees per second. Move it? [y/N]" in outcome.err
    machine = read_machine("elbow.toml")
    settings = machine.joints["elbow"].settings
    assert (settings.unit, settings.counts_per_unit, settings.direction) == (Unit.DEGREE, 1000, -1)
    assert (settings.min_position, settings.max_position, settings.max_speed) == (-90, 90, 20)
    assert machine.chains["elbow"].joints == ("elbow",)
    assert re.search("^\\[6081\\][^[]*^ParameterValue=(20000|0x4E20)$", Path("elbow.dcf").read_text(), re.MULTILINE)


def test_an_empty_answer_is_safe_at_each_question(commission: Commission, simulations: list[SimulatedDevices]) -> None:
    outcome = commission(*[""] * 20)
    assert outcome.status == ExitCode.PARTIAL
    assert "It was not moved, so nothing else will be." in outcome.err
    assert simulations[0].drives[3].values[objects.POSITION_ACTUAL_VALUE] == -14_000
    assert Path("drive3.dcf").exists()
    assert not Path("drive3.toml").exists()


def test_a_move_that_is_not_confirmed_ends_it(commission: Commission, simulations: list[SimulatedDevices]) -> None:
    outcome = commission(*SHAPE_ANSWERS, *LIMIT_ANSWERS, "", "y", "", "y", "y")
    assert outcome.status == ExitCode.PARTIAL
    assert "Its scale is wrong then" in outcome.err
    assert "Homing" not in outcome.err
    assert simulations[0].drives[3].values[objects.POSITION_ACTUAL_VALUE] == pytest.approx(-9000, abs=100)
    assert not Path("drive3.toml").exists()


@pytest.mark.thorough(5)
@pytest.mark.parametrize("at", [0.001, 0.02, 0.1, 0.5, 1.9])
def test_ctrl_c_leaves_it_standing_and_says_what_was_done(
    commission: Commission, simulations: list[SimulatedDevices], at: float
) -> None:
    outcome = commission(*SHAPE_ANSWERS, *LIMIT_ANSWERS, "80", at, "y", "y", "y")
    assert outcome.status == ExitCode.INTERRUPTED
    drive = simulations[0].drives[3]
    assert stands(drive)
    assert drive.drive.state is State.SWITCH_ON_DISABLED
    assert profile_speed(drive) == 20_000
    assert -14_000 <= drive.values[objects.POSITION_ACTUAL_VALUE] < 60_000  # type: ignore[operator]
    assert "the drive was halted" in outcome.err
    assert "its values, as they were, are in drive3.dcf" in outcome.err
    assert "the small move was begun" in outcome.err


def test_the_end_of_the_input_is_as_a_ctrl_c(commission: Commission, simulations: list[SimulatedDevices]) -> None:
    outcome = commission(*SHAPE_ANSWERS)
    assert outcome.status == ExitCode.INTERRUPTED
    assert "by the end of the input" in outcome.err
    assert "its positions are in degrees, 1000 counts each" in outcome.err
    assert simulations[0].drives[3].drive.state is State.SWITCH_ON_DISABLED


def test_a_failure_says_what_was_done(commission: Commission, simulations: list[SimulatedDevices]) -> None:
    outcome = commission(*SHAPE_ANSWERS, "", "-12", "", "5", "y")  # it would go beyond its limits
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "max_position" in outcome.err
    assert "its values, as they were, are in drive3.dcf" in outcome.err
    assert profile_speed(simulations[0].drives[3]) == 20_000


def test_answers_that_make_no_sense_are_asked_again(
    commission: Commission, monkeypatch: pytest.MonkeyPatch, alarm: Alarm
) -> None:
    made = only_drive(monkeypatch, alarm, partial(DriveNode, settings=DriveSettings(position=500)))
    units = ["miles", "counts"]
    limits = ["10000", "-10000", "-10000", "10000", "0", "-1", "nan", "3000"]
    homing = ["1.5", "400", "35", "y"]
    outcome = commission(*units, *limits, "x", "200", "y", "y", *homing, "", node="5")
    assert outcome.status == 0, outcome.err
    for text in ("'miles' is none of", "the lowest has to be below", "'nan' is no number above 0", "from -128 to 127"):
        assert text in outcome.err
    settings = read_machine("drive5.toml").joints["drive5"].settings
    assert (settings.homing_method, settings.max_speed, settings.counts_per_unit) == (35, 3000, 1)
    assert made[-1].values[objects.POSITION_ACTUAL_VALUE] == 0  # here is its home


def test_the_machine_of_m_gets_the_joint(commission: Commission, tmp_path: Path, simulations: list[SimulatedDevices]) -> None:
    cell = tmp_path / "cell.toml"
    cell.write_text(
        '[buses.left]\nlocator = "virtual:x"\n[nodes]\na = { id = 3 }\nb = { id = 4 }\n[joints]\nelbow = { node = "a" }\nb = {}\n'
    )
    answers = (*SHAPE_ANSWERS, *LIMIT_ANSWERS, "", "y", "y", "n")
    outcome = commission(*answers, "", node="elbow", options=("-m", str(cell), "--force", "-o", str(cell)))
    assert outcome.status == 0, outcome.err
    machine = read_machine(cell)
    assert machine.joints["elbow"].settings.max_position == 90
    assert machine.joints["b"].settings.max_position is None
    assert machine.buses["left"].locator == "virtual:x"


def test_a_name_that_is_taken_is_told_as_it_becomes(
    commission: Commission, tmp_path: Path, simulations: list[SimulatedDevices]
) -> None:
    """And not as it was asked for, in the names of files and at the end."""
    cell = tmp_path / "cell.toml"
    cell.write_text('[buses.left]\nlocator = "virtual:x"\n[nodes]\ndrive3 = { id = 9 }\n')
    outcome = commission(*SHAPE_ANSWERS, *LIMIT_ANSWERS, "", "y", "y", "n", "", options=("-m", str(cell)))
    assert outcome.status == 0, outcome.err
    assert {"drive3-2.toml", "drive3-2.dcf"} <= {each.name for each in tmp_path.iterdir()}
    assert set(read_machine(tmp_path / "drive3-2.toml").joints) == {"drive3-2"}
    assert "drive3-2.toml: drive3-2 with its unit" in outcome.err
    assert "the joint is drive3-2 in the machine file, not drive3" in outcome.err


def test_yes_is_for_simulated_drives(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, simulations: list[SimulatedDevices]
) -> None:
    monkeypatch.chdir(tmp_path)
    for bus in ("tcp", "socketcan:can0"):
        outcome = run("drive", "3", "commission", "--yes", "-b", bus)
        assert outcome.status == ExitCode.USAGE
        assert "CO123" in outcome.err
    assert "CO122" in run("drive", "3", "commission", "-b", "demo").err
    assert not simulations
    document = run("drive", "3", "commission", "-b", "demo", "--yes", "--json", "-q")
    assert document.status == 0
    assert simulations[0].drives[3].drive.state is State.SWITCH_ON_DISABLED
    assert run("drive", "3", "commission", "-b", "demo", "--yes").status == ExitCode.USAGE  # the files are there


def test_answers_come_from_stdin_and_ctrl_c_ends_the_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = os.pipe()
    with os.fdopen(ours) as stdin, os.fdopen(theirs, "w") as person:
        monkeypatch.setattr("sys.stdin", stdin)

        async def asked() -> None:
            asking = questions.Questions(Screen(verbosity=-1))
            person.write("  7.5 \n\nYES\n")
            person.flush()
            assert await asking.number("How far", None) == 7.5
            assert await asking.choice("Which", ("a", "b"), "b") == "b"
            assert await asking.may("Move?")
            with trio.move_on_after(0.01) as scope:
                await asking.may("Move?")
            assert scope.cancelled_caught

        trio.run(asked)


def test_another_devices_file_is_seen(commission: Commission) -> None:
    outcome = commission("", "", options=("-e", "sample_io.eds"))
    assert outcome.status == ExitCode.INTERRUPTED
    assert "ANOTHER DEVICE" in outcome.out
    assert not Path("drive3.dcf").exists()
