"""`canopen run SCRIPT`: run a Python script with the bus of the options open, and `await` at its top level."""

from __future__ import annotations

import inspect
import types
from pathlib import Path
from typing import Any

import click
import trio

from canopen_cli.scripting.namespace import compiled, execute, failure_of, names_for
from canopen_cli.shared.options import NodeId, Settings, commanding, common, enabling
from canopen_cli.shared.running import first_of, run
from canopen_cli.shared.screen import Screen
from canopen_cli.shared.session import open_session
from canopen_cli.shared.withholding import show_unsent
from canopen_data.named_files import read_text


@click.command("run")
@click.argument("script", type=click.Path(dir_okay=False, path_type=Path))
@click.argument("args", metavar="[ARG]...", nargs=-1)
@click.option("--node", "node_id", type=NodeId(), help="The node that the script finds as `node`.")
@enabling
@commanding
@common
@click.pass_obj
def run_script(settings: Settings, script: Path, args: tuple[str, ...], node_id: int | None) -> None:
    """Run a Python script on a bus that is open already, with `await` at its top level.

    It finds `master`, `nodes` (`nodes[5]`, or by a name of the machine file), `node` (that of --node), `bus` and `args`. A
    function `main` is called then: `main(master, *args)`. Its end, an error and Ctrl-C halt what moves. With --dry-run nothing is
    sent but what reads; drives that are to move need a simulated bus (-b demo) instead.

    \b
    canopen run look.py -b demo
    canopen run look.py --node 5 -b can0 first second
    """
    screen = settings.screen()
    name = str(script)
    try:
        code = compiled(read_text(script), name)
    except (SyntaxError, ValueError) as error:
        raise failure_of(error, name) from error

    async def work() -> None:
        try:
            await _run(settings, screen, code, node_id, args)
        except trio.Cancelled:
            raise
        except Exception as error:  # noqa: BLE001 - of the script: raised again, with its line
            cause = first_of(error)
            raise failure_of(cause, name) from cause

    if settings.dry_run:
        show_unsent(settings, screen, work)
        return
    run(settings, screen, work)


async def _run(settings: Settings, screen: Screen, code: types.CodeType, node_id: int | None, args: tuple[str, ...]) -> None:
    async with open_session(settings, screen) as session:
        names: dict[str, Any] = names_for(session, node_id, args) | {"__file__": code.co_filename}
        await execute(code, names)
        main = names.get("main")
        if callable(main):
            result = main(session.master, *args)
            if inspect.isawaitable(result):
                await result
