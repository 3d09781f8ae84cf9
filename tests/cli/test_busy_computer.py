"""Simulated drives in the process of their master, on a computer that is busy: all is done, and nothing is late."""

from __future__ import annotations

import json
from typing import Any

import pytest
import trio

from canopen_cli.app import main
from canopen_master.participant.patient_clock import PatientClock
from tests.cli.cli_support import TWO, TWO_JOINTS
from tests.master.starved import StarvedClock


@pytest.mark.thorough(5)
@pytest.mark.parametrize("seed", range(4))
def test_a_demonstration_stands_still_while_its_process_does(capsys: pytest.CaptureFixture[str], seed: int) -> None:
    clock = StarvedClock(seed)
    assert main(["demo", "--seconds", "2", *TWO_JOINTS, "--json"], clock=clock) == 0
    out, err = capsys.readouterr()
    result = json.loads(out)
    assert result["missed_cycles"] == result["skipped_cycles"] == 0
    assert result["stood_still_seconds"] == pytest.approx(clock.lost, abs=5.0)
    assert "this computer was busy: the simulated world stood still for" in err


@pytest.mark.parametrize(
    ("arguments", "is_patient"),
    [
        (["demo", *TWO], True),
        (["read", "3", "statusword", "-b", "demo"], True),
        (["read", "3", "statusword", "-b", "virtual:other", "--timeout", "20ms"], False),
    ],
)
def test_a_world_in_this_process_has_a_patient_clock(
    monkeypatch: pytest.MonkeyPatch, arguments: list[str], is_patient: bool
) -> None:
    clocks: list[trio.abc.Clock | None] = []

    def run(*_: Any, clock: trio.abc.Clock | None = None) -> None:
        clocks.append(clock)
        raise BrokenPipeError

    monkeypatch.setattr(trio, "run", run)
    main(arguments)
    assert [isinstance(clock, PatientClock) for clock in clocks] == [is_patient]
