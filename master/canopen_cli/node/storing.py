"""`canopen store` and `canopen reset-defaults`: what a device keeps over power-off (0x1010), and its defaults again (0x1011)."""

from __future__ import annotations

from typing import Final

import click

from canopen_cli.shared.dry_run import run_or_show
from canopen_cli.shared.options import NodeId, Settings, TextKind, command, commanding
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_cli.shared.questions import confirm
from canopen_cli.shared.screen import Screen, node_text
from canopen_cli.shared.session import open_session
from canopen_proto.manager.parameters.restore import STORE_TIMEOUT
from canopen_proto.parameter_storage import ON_COMMAND, RESTORE, SIGNATURES, STORE

GROUPS: Final = {"all": 1, "communication": 2, "application": 3}
"""The subindices of 0x1010 and 0x1011 that have names in the standard. Behind them are the maker's, by number."""
MAKERS: Final = range(4, 128)


class ParameterGroup(TextKind):
    """A group of parameters: one of GROUPS, or a subindex of the maker's."""

    name = "group"

    def read(self, text: str) -> int:
        if text in GROUPS:
            return GROUPS[text]
        if not (text.isascii() and text.isdigit() and int(text) in MAKERS):
            raise ValueError(f"{text!r} is none of {', '.join(GROUPS)}, nor a number of the maker's, 4 to 127")
        return int(text)


_GROUP = click.option(
    "--group",
    type=ParameterGroup(),
    default="all",
    show_default=True,
    help="all, communication, application, or the maker's 4 to 127.",
)
_YES = click.option("--yes", is_flag=True, help="Do not ask.")


@command()
@click.argument("node_id", metavar="NODE", type=NodeId())
@_GROUP
@_YES
@commanding
def store(settings: Settings, screen: Screen, node_id: int, group: int, yes: bool) -> None:
    """Have a device keep its present parameters over power-off (0x1010).

    `canopen backup` before it is a way back. A device that answers late may still have stored: then read 0x1010 again, and
    do not repeat the command blindly, since a flash wears out.

    \b
    canopen store 5 --yes
    canopen store 5 --group communication --yes
    """
    confirm(screen, f"store parameters of {node_text(node_id)}: they stay over power-off", yes, needed=not settings.dry_run)
    run_or_show(settings, screen, lambda: _sign(settings, screen, node_id, STORE, group, resets=False))
    if settings.json:
        screen.json({"node": node_id, "index": STORE, "subindex": group, "stored": True})
    else:
        screen.say(f"{node_text(node_id)}: stored (0x{STORE:04X}:{group:02X})")


@command("reset-defaults")
@click.argument("node_id", metavar="NODE", type=NodeId())
@_GROUP
@click.option("--reset", is_flag=True, help="Reset the node then, so that the defaults count at once: IT STOPS, or coasts.")
@_YES
@commanding
def reset_defaults(settings: Settings, screen: Screen, node_id: int, group: int, reset: bool, yes: bool) -> None:
    """Have a device take the defaults of its parameters from its next reset on (0x1011). Its node-ID may change with them.

    \b
    canopen backup 5 -o before.dcf && canopen reset-defaults 5 --yes
    canopen reset-defaults 5 --reset --yes
    """
    then = "it is reset, and a drive stops, or coasts" if reset else "it takes them at its next reset"
    confirm(
        screen, f"forget stored parameters of {node_text(node_id)} for the defaults: {then}", yes, needed=not settings.dry_run
    )
    run_or_show(settings, screen, lambda: _sign(settings, screen, node_id, RESTORE, group, resets=reset))
    if settings.json:
        screen.json({"node": node_id, "index": RESTORE, "subindex": group, "reset": reset})
    elif reset:
        screen.say(f"{node_text(node_id)}: it has its defaults, and has booted")
    else:
        screen.say(f"{node_text(node_id)}: it has its defaults from its next reset on: canopen nmt reset {node_id}")


async def _sign(settings: Settings, screen: Screen, node_id: int, index: int, group: int, *, resets: bool) -> None:
    """Write the signature to 0x1010 or 0x1011, if the device says that it acts on it. resets: reset the node behind it."""
    async with open_session(settings, screen) as session, session.claim_to_write(node_id):
        node = session.node(node_id)
        capability = int.from_bytes(await node.read_bytes(index, group), "little")
        if not capability & ON_COMMAND:
            does = "store its parameters" if index == STORE else "restore its defaults"
            raise CommandError(
                ExitCode.DRIVE_FAULT,
                "CO218",
                f"node {node_id} does not {does} on command; nothing was written",
                seen=f"0x{index:04X}:{group:02X} is 0x{capability:08X}: bit 0 is not set",
                tries=("another --group", "its manual: some devices store by themselves"),
                node=node_id,
                index=index,
                subindex=group,
            )
        standing, node.remote.sdo.timeout = node.remote.sdo.timeout, max(node.remote.sdo.timeout, STORE_TIMEOUT)
        try:
            await node.write_bytes(index, group, SIGNATURES[index].to_bytes(4, "little"))
        finally:
            node.remote.sdo.timeout = standing
        if resets:
            await node.reset()
