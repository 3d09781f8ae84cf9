"""`canopen pdo show`: the PDOs that a node has set up."""

from __future__ import annotations

from typing import Final

import click

from canopen_cli.pdo.reading import pdo_of, read_all_pdos
from canopen_cli.shared.options import NodeOfObject, Settings, command, with_word_at_node
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, escape, node_text
from canopen_cli.shared.session import open_session
from canopen_master.pdo_reading import PdoRead, objects_text, read_one, times_text, type_text
from canopen_proto.dictionary import Direction, ObjectDictionary

COLUMNS: Final = ("PDO", "CAN-ID", "sent or taken", "times", "bytes", "objects")


@command()
@click.argument("node_id", metavar="NODE", type=NodeOfObject())
@click.argument("words", metavar="[PDO]...", nargs=-1)
@click.option("--all", "everything", is_flag=True, help="Those that are switched off, too.")
def show(settings: Settings, screen: Screen, node_id: int, words: tuple[str, ...], everything: bool) -> None:
    """Show the PDOs of a node: CAN-ID, when they are sent, times, and their objects by name. PDO: tpdo1, rpdo2 ...; the
    first one may stand at its node.

    The device is asked: what its file says may be another thing.

    \b
    canopen pdo show 3 -b demo
    canopen pdo show 5:tpdo1 -e drive.eds
    canopen pdo show 5 tpdo1 rpdo1 -e drive.eds
    """
    pdos = tuple(map(pdo_of, with_word_at_node(words, node_id)))
    found, dictionary = run(settings, screen, lambda: _read(settings, screen, node_id, pdos))
    shown = [each for each in found if everything or pdos or each.settings is None or each.settings.is_valid]
    if settings.json:
        screen.json({"node": node_id, "pdos": [each.as_json(dictionary) for each in shown]})
        return
    screen.say(f"[bold]{node_text(node_id)}[/]")
    if shown:
        screen.table(COLUMNS, [_row(each, dictionary) for each in shown], right=("bytes",))
    else:
        screen.data("no PDO is in use" if found else "this device has no PDOs")
    hidden = len(found) - len(shown)
    if hidden:
        screen.say(f"[dim]and {hidden} switched off (--all shows them)[/]")


async def _read(
    settings: Settings, screen: Screen, node_id: int, pdos: tuple[tuple[Direction, int], ...]
) -> tuple[list[PdoRead], ObjectDictionary]:
    async with open_session(settings, screen) as session, session.turn(node_id):
        node = session.node(node_id)
        if not pdos:
            return await read_all_pdos(session, node), node.dictionary
        found = []
        for direction, number in pdos:
            each = await read_one(session.master, node, direction, number)
            if each is None:
                raise CommandError(
                    ExitCode.SDO_ABORT,
                    "CO202",
                    f"node {node_id} has no {direction} {number}",
                    tries=(f"canopen pdo show {node_id} --all    (those that it has)",),
                    node=node_id,
                )
            found.append(each)
        return found, node.dictionary


def _row(read: PdoRead, dictionary: ObjectDictionary) -> tuple[str, ...]:
    pdo = read.settings
    if pdo is None:
        return read.name, "", "", "", "", escape(read.remark)
    off = "" if pdo.is_valid else "off, "
    kind = f"{off}{type_text(pdo)} ({pdo.transmission_type})"
    return read.name, pdo.can_id_text, kind, times_text(read), str(pdo.size), escape(objects_text(dictionary, pdo))
