"""The planted bugs of fuzz/mutants.py can still be planted. Whether they are found is looked at by hand, and once a week."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from fuzz.mutants import CORE, MUTANTS, ROOT, SOURCE, Mutant, plant


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_a_bug_can_be_planted(mutant: Mutant, tmp_path: Path) -> None:
    path = tmp_path / CORE / mutant.file
    path.parent.mkdir(parents=True)
    source = (SOURCE / mutant.file).read_text(encoding="utf-8")
    path.write_text(source, encoding="utf-8")
    plant(mutant, tmp_path)
    planted = path.read_text(encoding="utf-8")
    assert planted != source
    compile(planted, mutant.file, "exec")
    assert mutant.why
    assert mutant.tests
    assert all((ROOT / test).exists() for test in mutant.tests)
    with pytest.raises(ValueError, match="0 times"):
        plant(mutant._replace(old="nowhere"), tmp_path)


def test_there_are_forty_at_least_each_with_a_name() -> None:
    assert len(MUTANTS) >= 40
    assert max(Counter(mutant.name for mutant in MUTANTS).values()) == 1
