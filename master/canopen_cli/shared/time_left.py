"""What a wait that takes longer than PATIENCE shows on a terminal: the time left, or, if nobody knows how long it takes, the time
that is over and how to end it."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Final

import trio

from canopen_cli.shared.running import first_error
from canopen_cli.shared.screen import Screen, escape

PATIENCE: Final = 1.0
"""Seconds of a wait that needs no bar."""
REDRAW: Final = 0.1


@asynccontextmanager
async def time_left(screen: Screen, label: str, seconds: float = math.inf, ending: str = "Ctrl-C ends it") -> AsyncIterator[None]:
    """Show how far a wait is while the block runs. Nothing of the block may be drawn, or print to stdout.

    label: what is waited for. seconds: how long it takes, or takes at most; inf if nobody knows. ending: how it ends before.
    """
    if not screen.draws or screen.json_output or seconds <= PATIENCE:
        yield
        return
    async with first_error(), trio.open_nursery() as nursery:
        nursery.start_soon(_draw, screen, label, seconds, ending)
        try:
            yield
        finally:
            nursery.cancel_scope.cancel()


async def _draw(screen: Screen, label: str, seconds: float, ending: str) -> None:
    from rich.progress import (  # a terminal's alone
        BarColumn,
        Progress,
        ProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    start, is_known = trio.current_time(), seconds < math.inf
    columns: tuple[ProgressColumn, ...] = (TextColumn(escape(label)), BarColumn(30), TimeRemainingColumn())
    if not is_known:
        await trio.sleep(PATIENCE)
        columns = (TextColumn(escape(label)), TimeElapsedColumn(), TextColumn(f"[dim]{escape(ending)}[/]"))
    with Progress(
        *columns,
        console=screen.err,
        transient=True,
        auto_refresh=False,
        redirect_stdout=False,
        redirect_stderr=False,
        get_time=trio.current_time,
    ) as bar:
        task = bar.add_task("", total=seconds if is_known else None)
        bar.tasks[0].start_time = start
        while True:
            if is_known:
                bar.update(task, completed=min(seconds, trio.current_time() - start))
            bar.refresh()
            await trio.sleep(REDRAW)
