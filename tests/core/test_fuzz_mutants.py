"""The planted bugs of fuzz/mutants.py can still be planted, and its score is honest. It runs by hand, and once a week."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

from fuzz import mutants
from fuzz.mutants import MUTANTS, REPLAY, ROOT, WINGS, Mutant, Outcome, main, outcome_of, place_of, plant, planted, source_of


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_a_bug_can_be_planted(mutant: Mutant) -> None:
    source = source_of(mutant.file).read_text(encoding="utf-8")
    with_bug = planted(mutant, source)
    assert with_bug != source
    compile(with_bug, mutant.file, "exec")
    assert mutant.why
    assert mutant.tests
    assert all((ROOT / test).exists() for test in mutant.tests)


def test_a_bug_is_planted_in_the_file_of_a_copy_once_and_nowhere_else(tmp_path: Path) -> None:
    mutant = MUTANTS[0]
    path = place_of(mutant.file, tmp_path)
    path.parent.mkdir(parents=True)
    source = source_of(mutant.file).read_text(encoding="utf-8")
    path.write_text(source, encoding="utf-8")
    plant(mutant, tmp_path)
    assert path.read_text(encoding="utf-8") == planted(mutant, source)
    with pytest.raises(ValueError, match="0 times"):
        plant(mutant, tmp_path)


def test_there_are_forty_at_least_each_with_a_name() -> None:
    assert len(MUTANTS) >= 40
    assert max(Counter(mutant.name for mutant in MUTANTS).values()) == 1


F, M, E = Outcome.FAILED, Outcome.PASSED, Outcome.ENDLESS


@pytest.mark.parametrize(
    ("clean", "planted", "status", "told"),
    [
        ((M, M), (F, F), 0, ["the corpus found 1, missed 0", "the tests found 1, missed 0, and did not end with 0"]),
        ((M, M), (M, F), 1, ["the corpus found 0, missed 1", "the tests found 1, missed 0"]),
        ((M, M), (F, M), 1, ["the corpus found 1, missed 0", "the tests found 0, missed 1"]),
        ((M, M), (E, F), 1, ["the corpus found 0, missed 0, and did not end with 1"]),
        ((M, M), (F, E), 1, ["the tests found 0, missed 0, and did not end with 1"]),
        ((F, M), (), 3, ["No bug was planted, and this failed: python -m fuzz.mutants --replay", "what was printed"]),
        ((M, F), (), 3, [f"No bug was planted, and this failed: python -m pytest .* {MUTANTS[0].tests[0]}"]),
        ((M, E), (), 3, ["No bug was planted"]),
    ],
)
def test_the_score(
    clean: tuple[Outcome, ...],
    planted: tuple[Outcome, ...],
    status: int,
    told: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Who fails without a bug finds nothing; who does not end may be slow only."""
    mutant, outcomes = MUTANTS[0], [*clean, *planted]

    def copy(tree: Path) -> None:
        place_of(mutant.file, tree).parent.mkdir(parents=True)
        place_of(mutant.file, tree).write_bytes(source_of(mutant.file).read_bytes())

    def outcome(tree: Path, *command: str) -> tuple[Outcome, str]:
        is_planted = mutant.old not in place_of(mutant.file, tree).read_text(encoding="utf-8")
        assert is_planted == (len(outcomes) <= len(planted))
        assert (command == REPLAY) == (len(outcomes) % 2 == (len(clean) + len(planted)) % 2)
        return outcomes.pop(0), "what was printed"

    monkeypatch.setattr(mutants, "copy_of_the_project", copy)
    monkeypatch.setattr(mutants, "outcome_of", outcome)
    assert main([mutant.name]) == status
    printed = capsys.readouterr().out
    for words in told:
        assert re.search(words, printed), printed


def test_a_name_that_no_bug_has(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["no_such_bug"]) == 2
    printed = capsys.readouterr().out
    assert "there is no bug no_such_bug; there are paused_unnoticed, " in printed
    assert f"nor is that a wing; there are {', '.join(WINGS)}" in printed


@pytest.mark.parametrize("wing", WINGS)
def test_a_wing_is_all_its_bugs(wing: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(mutants, "copy_of_the_project", lambda tree: None)
    monkeypatch.setattr(mutants, "outcome_of", lambda tree, *command: (M, f"{command}"))
    monkeypatch.setattr(mutants, "plant", lambda mutant, tree: None)
    monkeypatch.setattr(mutants, "place_of", lambda file, tree: _scratch(tree))
    main([wing])
    printed = capsys.readouterr().out
    assert [line.split()[0] for line in printed.splitlines()[:-2]] == [mutant.name for mutant in WINGS[wing]]


def _scratch(tree: Path) -> Path:
    (tree / "scratch").touch()
    return tree / "scratch"


def test_a_file_of_any_package_can_be_named(tmp_path: Path) -> None:
    assert place_of("sdo/client.py", tmp_path) == tmp_path / "canopen_proto/sdo/client.py"
    assert place_of("canopen_data/eds/numbers.py", tmp_path) == tmp_path / "data/canopen_data/eds/numbers.py"
    assert source_of("canopen_data/eds/numbers.py").is_file()


def test_how_a_run_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "ends.py").write_text("import sys\nprint('seen')\nsys.exit(int(sys.argv[1]))\n", encoding="utf-8")
    (tmp_path / "endless.py").write_text("while True:\n    pass\n", encoding="utf-8")
    assert outcome_of(tmp_path, "ends", "0") == (Outcome.PASSED, "seen\n")
    assert outcome_of(tmp_path, "ends", "1") == (Outcome.FAILED, "seen\n")
    monkeypatch.setattr(mutants, "MOST_SECONDS", 0.05)
    assert outcome_of(tmp_path, "endless")[0] is Outcome.ENDLESS
