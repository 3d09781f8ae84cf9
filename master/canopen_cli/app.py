"""The command tree, and `main`: one command run, one exit status, one screen where it fails."""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
from collections.abc import Sequence
from importlib import metadata
from typing import IO

import click
import trio

from canopen_cli.data import data
from canopen_cli.demo import demo
from canopen_cli.doctor import doctor
from canopen_cli.eds import eds
from canopen_cli.home import home
from canopen_cli.info import info
from canopen_cli.nmt import nmt
from canopen_cli.objects import read, write
from canopen_cli.options import Settings, common
from canopen_cli.plan import plan
from canopen_cli.problem import NO_ROOM, ExitCode, Problem, problem_of
from canopen_cli.scan import scan
from canopen_cli.sim import sim

CLOSED_PIPE = 128 + 13
"""What a shell reports of a command whose reader went away (SIGPIPE)."""


class InOrder(click.Group):
    """Lists its commands in the order in which they were added: the first thing to try comes first. Those of LATE, which stand
    before `sim`, are read in only when they are called."""

    LATE = ("backup", "restore", "compare", "dump", "check", "bus", "log")

    def list_commands(self, ctx: click.Context) -> list[str]:
        names = list(self.commands)
        place = names.index("sim")
        return [*names[:place], *self.LATE, *names[place:]]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self.LATE:
            return super().get_command(ctx, cmd_name)
        command = getattr(importlib.import_module(f"canopen_cli.{cmd_name}"), cmd_name)
        assert isinstance(command, click.Command)
        return command


@click.group(cls=InOrder, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(metadata.version("canopen-proto"), prog_name="canopen")
@common
def cli() -> None:
    """CANopen from the command line. Without hardware, begin with `canopen demo`; every command takes `-b demo`.

    Exit status: 0 ok, 1 findings or differences, 2 usage, 3 cannot open the bus, 4 bus fault, 5 no answer, 6 bad input file,
    7 partial, 9 permission, 10 internal, 11 SDO abort, 12 drive fault or refused, 13 verify mismatch, 130 interrupted.
    """


for _command in (demo, doctor, scan, info, read, write, nmt, home, sim, plan, eds, data):
    cli.add_command(_command)


def main(arguments: Sequence[str] | None = None, *, clock: trio.abc.Clock | None = None) -> int:
    """Run the command line; the exit status. arguments: by default those of this process. clock: trio's, for tests."""
    settings = Settings(clock=clock)
    _open_closed_streams()
    try:
        result = cli.main(
            None if arguments is None else list(arguments), prog_name="canopen", standalone_mode=False, obj=settings
        )
        sys.stdout.flush()
    except BrokenPipeError:
        _put_to_rest(sys.stdout)
        return CLOSED_PIPE
    except SystemExit:  # click met a closed pipe, and has put stdout to rest
        return CLOSED_PIPE
    except (click.Abort, KeyboardInterrupt):
        return _show(settings, Problem(ExitCode.INTERRUPTED, "CO132", "interrupted by Ctrl-C"))
    except click.exceptions.NoArgsIsHelpError as no_arguments:
        click.echo(no_arguments.format_message(), err=True)
        return ExitCode.USAGE
    except Exception as error:  # noqa: BLE001 - the last place: whatever it is becomes one screen
        if isinstance(error, click.UsageError | Problem) and "--json" in (sys.argv if arguments is None else arguments):
            settings.json = True  # click did not come to that
        if isinstance(error, OSError) and error.errno in NO_ROOM:
            _put_to_rest(sys.stdout)
        return _show(settings, problem_of(error))
    except BaseExceptionGroup as group:  # a Ctrl-C before anything was begun comes out of trio like this
        if group.subgroup(KeyboardInterrupt) is None:
            raise
        return _show(settings, Problem(ExitCode.INTERRUPTED, "CO132", "interrupted by Ctrl-C"))
    if settings.late is not None:
        return _show(settings, settings.late)
    return result if isinstance(result, int) else ExitCode.OK


def _open_closed_streams() -> None:
    """Python has no stdin, stdout or stderr at all where a shell closed it (`canopen scan >&-`)."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115 - until the process ends


def _put_to_rest(stream: IO[str]) -> None:
    """What is still to be written goes nowhere, or Python would complain when it flushes at the end."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _show(settings: Settings, problem: Problem) -> int:
    if settings.late is not None and settings.late is not problem:
        problem.more.append(f"{settings.late.failed}: {settings.late.seen}")
    try:
        settings.screen().problem(problem.on_bus(settings.bus))
    except BrokenPipeError:  # perhaps that was the problem
        _put_to_rest(sys.stderr)
        return CLOSED_PIPE
    return problem.exit_code
