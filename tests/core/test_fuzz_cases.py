"""Random cases by `python -m fuzz flash_lives` and the like are the same each time, and one that fails is told."""

from __future__ import annotations

from types import ModuleType

import pytest

from fuzz import copied_frames, flash_lives, lossy_restores
from fuzz.__main__ import main as fuzz
from tests.manager.test_program_identity import Ways
from tests.observer import test_observer_gaps


def test_random_lives_can_be_lived_by_hand(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """python -m fuzz flash_lives: the same lives for the same numbers, and a failure is told and counted."""
    assert fuzz(["flash_lives", "5", "3"]) == 0
    assert "3 lives from 5 on: 0 failed" in capsys.readouterr().out

    def false(ways: Ways, *rest: bool) -> None:
        assert ways != flash_lives.life(6)[0], "false"

    monkeypatch.setattr(flash_lives, "judge", false)
    assert flash_lives.main(["5", "3"]) == 1
    printed = capsys.readouterr().out
    assert f"life 6 has failed: {flash_lives.life(6)}" in printed
    assert "3 lives from 5 on: 1 failed" in printed


def test_random_recordings_can_be_damaged_by_hand(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """python -m fuzz damaged_recordings: the same, of recordings; an observer that accuses is told and counted."""
    assert fuzz(["damaged_recordings", "5", "3"]) == 0
    assert "3 recordings from 5 on: 0 failed" in capsys.readouterr().out
    monkeypatch.setattr(test_observer_gaps, "OF_THE_RECORDER", ())
    assert fuzz(["damaged_recordings", "0", "20"]) == 1
    assert "has failed: " in capsys.readouterr().out


@pytest.mark.parametrize(("program", "plural"), [(copied_frames, "cases"), (lossy_restores, "restores")])
def test_random_faults_of_the_bus_can_be_played_by_hand(
    program: ModuleType, plural: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """python -m fuzz copied_frames, lossy_restores: the same, and a false word is told and counted."""
    name = program.__name__.rpartition(".")[2]
    assert fuzz([name, "5", "3"]) == 0
    assert f"3 {plural} from 5 on: 0 failed" in capsys.readouterr().out

    def false(*case: object) -> None:
        assert case not in (program.case(6), (program.case(6),)), "false"

    monkeypatch.setattr(program, "judge", false)
    assert fuzz([name, "5", "3"]) == 1
    printed = capsys.readouterr().out
    assert f"{program.case(6)}" in printed
    assert f"3 {plural} from 5 on: 1 failed" in printed
