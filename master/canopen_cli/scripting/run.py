"""`canopen run SCRIPT`: run a Python script with the bus of the options open, and `await` at its top level."""

from __future__ import annotations

import inspect
import types
from pathlib import Path
from typing import Any

import click
import trio

from canopen_cli.scripting.namespace import compiled, execute, failure_of, names_for
from canopen_cli.shared.dry_run import run_or_show
from canopen_cli.shared.options import FILE, Settings, command, commanding, enabling
from canopen_cli.shared.running import first_of
from canopen_cli.shared.screen import Screen
from canopen_cli.shared.session import open_session
from canopen_data.named_files import read_text


@command("run")
@click.argument("script", type=FILE)
@click.argument("args", metavar="[ARG]...", nargs=-1)
@enabling
@commanding
def run_script(settings: Settings, screen: Screen, script: Path, args: tuple[str, ...]) -> None:
    """Run a Python script on a bus that is open already, with `await` at its top level.

    It finds `master`, `nodes` (`nodes[5]`, or by a name of the machine file; `nodes[args[0]]`), `bus` and `args`. A
    function `main` is called then: `main(master, *args)`. Its end, an error and Ctrl-C halt what moves. With --dry-run nothing is
    sent but what reads; drives that are to move need a simulated bus (-b demo) instead.

    \b
    canopen run look.py -b demo
    canopen run look.py 5 statusword -b can0      its words: args
    """
    name = str(script)
    try:
        code = compiled(read_text(script), name)
    except (SyntaxError, ValueError) as error:
        raise failure_of(error, name) from error

    async def work() -> None:
        try:
            await _run(settings, screen, code, args)
        except trio.Cancelled:
            raise
        except Exception as error:  # noqa: BLE001 - of the script: raised again, with its line
            cause = first_of(error)
            raise failure_of(cause, name) from cause

    run_or_show(settings, screen, work)


async def _run(settings: Settings, screen: Screen, code: types.CodeType, args: tuple[str, ...]) -> None:
    async with open_session(settings, screen) as session:
        names: dict[str, Any] = names_for(session, args=args) | {"__file__": code.co_filename}
        await execute(code, names)
        main = names.get("main")
        if callable(main):
            result = main(session.master, *args)
            if inspect.isawaitable(result):
                await result
