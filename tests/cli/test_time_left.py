"""The time left of a wait whose length is known: on a terminal, and only if it is long."""

from __future__ import annotations

import io
from math import inf

import pytest
import trio
import trio.testing
from rich.console import Console

from canopen_cli.shared.screen import Screen
from canopen_cli.shared.time_left import time_left


def shown_during(
    wait: float,
    told: float,
    *,
    is_terminal: bool = True,
    json_output: bool = False,
    failure: Exception | None = None,
) -> str:
    """What is shown during a wait. told: how long the bar is told that it is."""
    screen, shown = Screen(json_output=json_output), io.StringIO()
    screen.err = Console(file=shown, force_terminal=is_terminal, width=200, color_system=None)  # type: ignore[assignment]

    async def main() -> None:
        async with time_left(screen, "listening", told):
            await trio.sleep(wait)
            if failure is not None:
                raise failure

    trio.run(main, clock=trio.testing.MockClock(autojump_threshold=0))
    return shown.getvalue()


def test_a_long_wait_shows_the_time_left() -> None:
    shown = shown_during(5.0, 5.0)
    assert "listening" in shown
    assert all(f"0:00:0{left}" in shown for left in (1, 2, 3, 4))


@pytest.mark.parametrize(("wait", "told"), [(5.0, 0.5), (5.0, 1.0), (0.9, inf)])
def test_a_short_wait_shows_nothing(wait: float, told: float) -> None:
    assert shown_during(wait, told) == ""


def test_a_wait_of_unknown_length_shows_what_for_how_long_already_and_how_to_end_it() -> None:
    shown = shown_during(5.0, inf)
    assert "listening" in shown
    assert "Ctrl-C ends it" in shown
    assert all(f"0:00:0{over}" in shown for over in (1, 2, 3, 4))


@pytest.mark.parametrize("told", [5.0, inf])
def test_a_pipe_and_a_program_see_nothing(told: float) -> None:
    assert shown_during(5.0, told, is_terminal=False) == ""
    assert shown_during(5.0, told, json_output=True) == ""


def test_an_error_comes_as_it_is() -> None:
    with pytest.raises(KeyError, match="lost"):
        shown_during(5.0, 5.0, failure=KeyError("lost"))
