"""`canopen drive NODE home`: home one drive."""

from __future__ import annotations

import click

from canopen_cli.drive.home_many import METHOD, DrivesOnBus, HomingChoice, home_nodes, homing_options, list_methods
from canopen_cli.drive.session import axis_of_command, node_of_command
from canopen_cli.shared.options import Settings
from canopen_proto.machine import Time


@click.command()
@click.argument("method", metavar="[METHOD]", required=False, type=METHOD)
@homing_options
@click.pass_obj
def home(settings: Settings, method: int | None, style: str, limit: Time | None, reset_fault: bool, lists: bool) -> None:
    """Home a drive (CiA 402), by METHOD (written to 0x6098) or by its own. IT MOVES. Ctrl-C halts it.

    `canopen home NODE...` does the same with several at a time. A method below 0 goes after `--`.
    """
    node_ids = (node_of_command(),)
    if lists:
        list_methods(settings, node_ids, axis_of_command(settings))
    else:
        home_nodes([DrivesOnBus(settings, node_ids, axis_of_command(settings))], HomingChoice(style, method, limit, reset_fault))
