"""`canopen drive --axis`: a further drive of a node, by number or by the name of its joint; in virtual time."""

from __future__ import annotations

from pathlib import Path

import pytest

from canopen_data.describing import describe
from canopen_data.descriptions import load_description_with_names
from canopen_data.eds.writer import write_eds
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.axes import axes_of
from canopen_proto.drives.cia402.states import State
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings
from tests.cli.cli_support import Alarm, Run, only_drive

TWO = DriveSettings(further_axes=(DriveSettings(position=-7_000.0),))
MACHINE = """
[buses.left]
locator = "virtual:left"
[nodes.shoulder]
id = 5
file = "two.eds"
[joints.pan]
node = "shoulder"
counts_per_unit = 1.0
[joints.tilt]
node = "shoulder"
axis = 1
counts_per_unit = 10.0
"""


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch, alarm: Alarm) -> list[DriveNode]:
    """Node 5 of the demonstration is the only one, and has two axes; the nodes of the commands to come."""
    return only_drive(monkeypatch, alarm, lambda out, node_id: DriveNode(out, node_id, TWO))


@pytest.fixture
def eds(tmp_path: Path) -> Path:
    path = tmp_path / "two.eds"
    path.write_text(write_eds(describe(drive_dictionary(axes=2))))
    (tmp_path / "cell.toml").write_text(MACHINE)
    return path


def test_a_file_with_two_axes_is_read_back_with_both(eds: Path) -> None:
    dictionary = load_description_with_names(eds).dictionary
    assert axes_of(dictionary) == (0, 1)
    assert dictionary.variable("statusword_axis_1").index == 0x6841


def test_each_axis_shows_its_own_state_and_is_commanded_alone(run: Run, made: list[DriveNode]) -> None:
    assert run("drive", "5", "state", "-b", "demo", "--json").json["position"] == 3_000
    assert run("drive", "5", "state", "--axis", "1", "-b", "demo", "--json").json["position"] == -7_000
    moved = run("drive", "5", "move", "--axis", "1", "-b", "demo", "--", "-5000")
    assert moved.status == 0, moved.err
    first, second = made[-1].drives
    assert (first.values.store[objects.POSITION_ACTUAL_VALUE], first.state) == (3_000, State.SWITCH_ON_DISABLED)
    assert second.values.store[objects.POSITION_ACTUAL_VALUE] == pytest.approx(-5_000, abs=10)


def test_a_joint_on_a_further_axis_is_known_by_its_name(run: Run, made: list[DriveNode], eds: Path) -> None:
    machine = ("-m", str(eds.with_name("cell.toml")), "-b", "demo")
    assert run("drive", "tilt", "state", *machine, "--json").json["position"] == -7_000
    assert run("drive", "pan", "state", *machine, "--json").json["position"] == 3_000
    moved = run("drive", "tilt", "move", *machine, "--", "-600")  # 10 counts each
    assert moved.status == 0, moved.err
    assert made[-1].drives[1].values.store[objects.POSITION_ACTUAL_VALUE] == pytest.approx(-6_000, abs=10)
    refused = run("drive", "tilt", "state", "--axis", "0", *machine)
    assert (refused.status, "tilt is axis 1 by the machine file" in refused.err) == (2, True)


@pytest.mark.parametrize("command", [("read", "tilt", "statusword"), ("home", "tilt"), ("write", "tilt", "controlword", "6")])
def test_a_command_about_whole_nodes_does_not_take_such_a_joint_for_its_node(
    run: Run, made: list[DriveNode], eds: Path, command: tuple[str, ...]
) -> None:
    refused = run(*command, "-m", str(eds.with_name("cell.toml")), "-b", "demo")
    assert refused.status == 2
    assert "tilt is axis 1 of node shoulder" in refused.err
    assert not made


def test_a_dry_run_is_about_that_axis(run: Run, made: list[DriveNode]) -> None:
    outcome = run("drive", "5", "move", "--axis", "1", "--dry-run", "-b", "demo", "--json", "--", "-5000")
    assert outcome.status == 0, outcome.err
    shown = outcome.json
    sent = " ".join(each["frame"] for each in shown)
    assert "2B406800" in sent.replace("#", "").upper()
    assert "2B406000" not in sent.upper()
    assert {drive.state for drive in made[0].drives} == {State.SWITCH_ON_DISABLED}


def test_a_plan_has_the_pdos_of_that_axis(run: Run, made: list[DriveNode], eds: Path) -> None:
    shown = run("drive", "5", "plan", "--axis", "1", "-e", str(eds), "-b", "demo", "--json").json
    assert [pdo["pdo"] for pdo in shown["pdos"]] == ["RPDO 65", "TPDO 65"]
    assert shown["writes"] == []


def test_homing_and_its_methods_of_that_axis(run: Run, made: list[DriveNode]) -> None:
    assert 35 in [
        each["method"] for each in run("drive", "5", "home", "--list", "--axis", "1", "-b", "demo", "--json").json["methods"]
    ]
    (homed,) = run("drive", "5", "home", "35", "--axis", "1", "-b", "demo", "--json").json
    assert (homed["axis"], homed["homed"]) == (1, True)


def test_a_drive_without_the_axis_says_so(run: Run) -> None:
    outcome = run("drive", "3", "state", "--axis", "2", "-b", "demo")
    assert "error CO408: node 3 (0x03) has no axis 2: it has no statusword (0x7041)" in outcome.err


@pytest.mark.parametrize("arguments", [("state", "--axis", "8"), ("commission", "--axis", "1")])
def test_an_axis_that_cannot_be_is_a_typing_error(run: Run, arguments: tuple[str, ...]) -> None:
    assert run("drive", "5", *arguments, "-b", "demo").status == 2
