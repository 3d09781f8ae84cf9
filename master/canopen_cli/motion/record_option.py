"""The option --record of commands that move a chain."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import click

from canopen_cli.shared.failures import problem_of
from canopen_cli.shared.new_files import check_new_file, check_writable
from canopen_cli.shared.options import FILE, Settings
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_master.motion.chain import Chain
from canopen_master.motion.record_files import PARQUET, RecordError, pyarrow_modules
from canopen_master.motion.recording import Recorder

record_option = click.option(
    "--record",
    type=FILE,
    help="Record each cycle: set-points, actual values, words; .csv, or .parquet (needs pyarrow). `canopen plot` draws it.",
)


def check_record(settings: Settings, screen: Screen, path: Path | None) -> None:
    """Raise, before anything moves, a CommandError if the recording cannot be written, or the user does not want the older file
    overwritten; PackageMissingError without pyarrow for Parquet. path: None for no recording."""
    if path is not None:
        check_new_file(settings, screen, path)
        if path.suffix.lower() == PARQUET:
            pyarrow_modules(str(path))
        check_writable(path)


@asynccontextmanager
async def recorded(
    settings: Settings, screen: Screen, chain: Chain, path: Path | None, *, told: bool = True
) -> AsyncIterator[Recorder | None]:
    """Record a chain while the block runs, if `path` is given. A recording that is not complete is told after the results.

    told: say how much was recorded.
    """
    if path is None:
        yield None
        return
    try:
        async with chain.record(path) as recorder:
            try:
                yield recorder
            finally:
                if told:
                    screen.say(f"[dim]{counted(recorder.rows, 'cycle')} recorded: {escape(str(path))}[/]")
    except RecordError as error:
        settings.late = problem_of(error)
