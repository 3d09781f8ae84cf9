"""`canopen home` and `canopen drive NODE home`: one code, the list of methods, what is refused; in virtual time."""

from __future__ import annotations

import math
from functools import partial

import pytest

from canopen_cli.shared import session
from canopen_cli.shared.problem import ExitCode
from canopen_master.simulation.host import DeviceMaker
from canopen_master.simulation.serving import simulated_drives
from canopen_proto.simulation.drive.homing import METHODS
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from tests.cli.cli_support import Run

DEMO = ("-b", "demo")


@pytest.fixture
def standard(monkeypatch: pytest.MonkeyPatch) -> None:
    """The drives of the demo are those of CiA 402, with homing methods."""
    monkeypatch.setattr(session, "simulated_drives", partial(simulated_drives, shape=Shape.STANDARD))


def test_one_drive_is_homed_by_either_command(run: Run, standard: None) -> None:
    for command in (("home", "3", "--method", "23"), ("drive", "3", "home", "23")):
        outcome = run(*command, *DEMO, "--json")
        assert outcome.status == 0, outcome.err
        (document,) = outcome.json
        assert (document["node"], document["homed"], document["position"]) == (3, True, 0)


def test_the_list_of_the_standard_needs_no_bus(run: Run) -> None:
    outcome = run("home", "--list")
    assert outcome.status == 0
    assert "7  home switch, negative end in negative direction, with index pulse; begins in positive direction" in outcome.out
    document = run("home", "--list", "--json").json
    assert [each["method"] for each in document["methods"]] == sorted(METHODS)
    assert document["listed"] == {}


def test_the_list_of_a_drive(run: Run, standard: None) -> None:
    document = run("drive", "3", "home", "--list", *DEMO, "--json").json
    assert document["listed"] == {"3": list(METHODS)}
    assert "yes" in run("home", "--list", "3", *DEMO).out


def test_a_joint_that_homes_without_a_method_is_never_shown_with_a_list_of_them(run: Run) -> None:
    outcome = run("home", "--list", "3", *DEMO)
    assert outcome.status == 0
    assert "its joints home without a method" in outcome.err
    assert "home switch" not in outcome.out
    assert run("home", "--list", "3", *DEMO, "--json").json["listed"] == {"3": []}


def test_a_method_that_the_drive_lacks(run: Run, standard: None) -> None:
    outcome = run("drive", "3", "home", "36", *DEMO)
    assert outcome.status == ExitCode.DRIVE_FAULT
    for text in ("CO405", "does not home by method 36: touch probe", "its list (0x60E3) has 1, 2, 3", "canopen home --list"):
        assert text in " ".join(outcome.err.split())


def test_what_cannot_be_a_method_or_lacks_a_node(run: Run) -> None:
    assert run("home", *DEMO).status == ExitCode.USAGE
    assert "no NODE" in run("home", *DEMO).err
    assert run("drive", "3", "home", "200", *DEMO).status == ExitCode.USAGE


def test_a_rehearsal_sends_nothing(run: Run, standard: None) -> None:
    outcome = run("drive", "3", "home", "23", "--dry-run", *DEMO)
    assert outcome.status == 0, outcome.err
    assert "homing_method = 23" in outcome.out
    assert "start_homing" in outcome.out
    assert "nothing of this was sent" in outcome.err


@pytest.mark.thorough(2)
@pytest.mark.parametrize("method", ["17", "23"])
def test_a_rehearsal_knows_no_switches_and_has_some_to_home_by(run: Run, monkeypatch: pytest.MonkeyPatch, method: str) -> None:
    """The drive stands far outside of any track that a simulation would guess."""

    def far_away(number: int, node_id: int, **_: Shape) -> DeviceMaker:
        settings = DriveSettings(position=5_000_000, track=Track(-math.inf, math.inf))
        return partial(DriveNode, node_id=node_id, settings=settings)

    monkeypatch.setattr(session, "simulated_drives", partial(simulated_drives, make=far_away))
    assert run("drive", "3", "home", method, "--dry-run", *DEMO).status == 0
    outcome = run("drive", "3", "move", "10000", "--relative", "--dry-run", *DEMO)
    assert outcome.status == 0, outcome.err
    assert "limit switch" not in outcome.out + outcome.err
