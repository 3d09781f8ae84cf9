"""`canopen nmt`: start, stop and reset nodes. Commands to all nodes, and resets, must be confirmed."""

from __future__ import annotations

from typing import Final

import click
import trio

from canopen_cli.shared.dry_run import run_or_show
from canopen_cli.shared.options import NodeId, Settings, command, commanding
from canopen_cli.shared.over_text import is_text_gateway, refuse_over_text
from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_cli.shared.questions import confirm
from canopen_cli.shared.screen import Screen, node_text
from canopen_cli.shared.session import open_session
from canopen_cli.shared.text_gateway import open_text
from canopen_cli.shared.time_left import time_left
from canopen_master.errors import SdoError
from canopen_master.node import Node
from canopen_master.silence import NOT_BOOTED, missing_frame
from canopen_proto import indices
from canopen_proto.heartbeat import HeartbeatReceived, NodeBooted
from canopen_proto.machine import Event
from canopen_proto.nmt import NmtCommand, NmtState, target_of

COMMANDS: Final = {
    "start": NmtCommand.START,
    "stop": NmtCommand.STOP,
    "preop": NmtCommand.ENTER_PRE_OPERATIONAL,
    "reset": NmtCommand.RESET_NODE,
    "reset-comm": NmtCommand.RESET_COMMUNICATION,
}
RESETS: Final = (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION)
WAIT_TIME: Final = 5.0
"""Seconds for a heartbeat or boot-up with --wait."""


@command()
@click.argument("word", metavar="{start|stop|preop|reset|reset-comm}", type=click.Choice(list(COMMANDS)))
@click.argument("node_id", metavar="[NODE]", type=NodeId(), required=False)
@click.option("--all", "everyone", is_flag=True, help="All nodes of the bus.")
@click.option("--wait", is_flag=True, help="Until the node's heartbeat or boot-up frame shows that it is done.")
@click.option("--yes", is_flag=True, help="Do not ask: for all nodes, and for resets.")
@commanding
def nmt(settings: Settings, screen: Screen, word: str, node_id: int | None, everyone: bool, wait: bool, yes: bool) -> None:
    """Start, stop or reset a node, or all of them.

    \b
    canopen nmt start 3 -b demo
    canopen nmt preop --all --yes -b demo
    """
    if (node_id is None) != everyone:
        raise usage(
            "CO001", "which node? Name one, or say --all", tries=(f"canopen nmt {word} 3", f"canopen nmt {word} --all --yes")
        )
    if wait and everyone:
        raise usage("CO001", "--wait waits for one node, not for --all")
    refuse_over_text(settings, wait=wait, dry_run=settings.dry_run)
    command = COMMANDS[word]
    confirm(screen, _question(command, word, node_id), yes, needed=not settings.dry_run and (everyone or command in RESETS))
    state = run_or_show(settings, screen, lambda: _nmt(settings, screen, command, node_id, wait), over_text=True)
    target = "all nodes" if node_id is None else node_text(node_id)
    if settings.json:
        screen.json({"command": command.name, "node": node_id or 0, "state": state.name if state is not None else None})
    elif state is not None:
        screen.say(f"{target}: {word} sent, and it is {state.name.replace('_', '-')}")
    else:
        screen.say(f"{target}: {word} sent (NMT commands are not confirmed; --wait watches the heartbeat)")


def _question(command: NmtCommand, word: str, node_id: int | None) -> str:
    target = "ALL nodes" if node_id is None else node_text(node_id)
    effect = "drives that move stop, or coast" if command is not NmtCommand.START else "PDOs go live"
    return f"{word} {target}: {effect}"


async def _has_no_heartbeat(node: Node) -> bool:
    """Return whether the node says that it sends no heartbeat. A node that does not answer, such as a Stopped one, may send
    one."""
    try:
        return not any(await node.read_bytes(indices.PRODUCER_HEARTBEAT_TIME))
    except SdoError:
        return False


async def _nmt(settings: Settings, screen: Screen, command: NmtCommand, node_id: int | None, wait: bool) -> NmtState | None:
    if is_text_gateway(settings.named_bus()):
        async with open_text(settings, screen) as text:
            await text.gateway.nmt(command, node_id or 0)
        return None
    async with open_session(settings, screen) as session:
        if node_id is None:
            await session.master.nmt(command)
            return None
        node = session.node(node_id)
        if wait and command not in RESETS and await _has_no_heartbeat(node):
            await node.nmt(command)
            failed = f"node {node_id}: {command.name.lower().replace('_', ' ')} was sent, and nothing will show that it is done"
            hints = (f"canopen write {node_id} 1017 500    (a heartbeat each 500 ms)", "the same without --wait")
            raise CommandError(ExitCode.NO_ANSWER, "CO210", failed, seen="it sends no heartbeat: 0x1017 is 0", tries=hints)
        expected = NmtState.PRE_OPERATIONAL if command in RESETS else target_of(command)
        signs: tuple[type[Event], ...] = (NodeBooted,) if command in RESETS else (HeartbeatReceived,)
        with node.events(*signs) as reports:
            await node.nmt(command)
            if not wait:
                return None
            async with time_left(screen, f"waiting for {node_text(node_id)} to show that it is done", WAIT_TIME):
                with trio.move_on_after(WAIT_TIME):
                    async for report in reports:
                        if getattr(report, "state", expected) is expected:
                            return expected
        is_reset = command in RESETS
        cause = NOT_BOOTED if is_reset else "it sends no heartbeat"
        tries = () if is_reset else (f"canopen write {node_id} 1017 500    (a heartbeat each 500 ms)",)
        now = session.master.now()
        known = missing_frame(session.network, node.remote, now, cause, tries, pdo=False, is_asked=is_reset)
    failed = f"node {node_id} did not show within {WAIT_TIME:g} s that it is done"
    raise CommandError(ExitCode.NO_ANSWER, "CO210", failed, node=node_id, **known._asdict())
