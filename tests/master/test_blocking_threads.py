"""Eight threads on one blocking master: see blocking_threads.py. For long: `python -m fuzz blocking_threads`."""

from __future__ import annotations

import pytest

from tests.master.blocking_threads import judge, program


@pytest.mark.thorough(5)
@pytest.mark.parametrize("number", range(3))
def test_nothing_hangs_every_drive_stands_and_every_answer_is_the_answer_to_its_own_question(number: int) -> None:
    answers, interrupts = judge(program(number))
    assert answers > 10
    assert interrupts > 0


def test_a_program_is_the_same_each_time() -> None:
    assert program(5) == program(5)
    assert program(5) != program(6)
